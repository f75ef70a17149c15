//! Frames as Linux lays them out: `struct can_frame` (16 bytes) and `struct canfd_frame` (72 bytes), linux/can.h.

use super::frame_error::FrameError;
use super::j1939::FrameChoice;
use super::{Content, Frame, Identifier, MOST_BYTES};

/// Bytes of a classic frame (`CAN_MTU`).
pub const CLASSIC_BYTES: usize = 16;
/// Bytes of an FD frame (`CANFD_MTU`).
pub const FD_BYTES: usize = 72;
/// Most data bytes of a classic frame.
const CLASSIC_DATA: usize = 8;
/// Where the data begin.
const DATA_AT: usize = 8;

const EXTENDED_FLAG: u32 = 0x8000_0000;
const REMOTE_FLAG: u32 = 0x4000_0000;
const ERROR_FLAG: u32 = 0x2000_0000;
const STANDARD_MASK: u32 = 0x7ff;
const EXTENDED_MASK: u32 = 0x1fff_ffff;

/// Lengths that a frame of more than eight bytes can have.
const FD_LENGTHS: [usize; 7] = [12, 16, 20, 24, 32, 48, 64];

/// Reads a frame.
///
/// # Errors
/// [`FrameError::Size`] where it has neither size, [`FrameError::LengthCode`] where its length code is one that no frame has.
pub fn parse(bytes: &[u8]) -> Result<Frame, FrameError> {
    let most = match bytes.len() {
        CLASSIC_BYTES => CLASSIC_DATA,
        FD_BYTES => MOST_BYTES,
        _ => return Err(FrameError::Size),
    };
    let (Some(word), Some(length)) = (bytes.first_chunk::<4>(), bytes.get(4)) else {
        // Both sizes have them.
        return Err(FrameError::Size);
    };
    let word = u32::from_ne_bytes(*word);
    let length = usize::from(*length);
    if length > most || (length > CLASSIC_DATA && !FD_LENGTHS.contains(&length)) {
        return Err(FrameError::LengthCode);
    }
    let identifier = if word & EXTENDED_FLAG != 0 {
        Identifier::Extended(word & EXTENDED_MASK)
    } else {
        Identifier::Standard((word & STANDARD_MASK) as u16)
    };
    let content = if word & ERROR_FLAG != 0 {
        Content::Error
    } else if word & REMOTE_FLAG != 0 {
        Content::Remote
    } else {
        Content::Data
    };
    let mut frame = Frame::new(identifier, content);
    for byte in bytes.iter().skip(DATA_AT).take(length) {
        frame.push(*byte);
    }
    Ok(frame)
}

/// Identifier and flags in one word, as in a frame and in the kernel's receive filters.
pub fn identifier_word(identifier: Identifier) -> u32 {
    match identifier {
        Identifier::Standard(id) => u32::from(id),
        Identifier::Extended(id) => id | EXTENDED_FLAG,
    }
}

/// Mask of a receive filter for the frames of a choice: the bits that must be the same, the length, and data frames only.
pub const fn filter_mask(choice: FrameChoice) -> u32 {
    let bits = match choice.identifier {
        Identifier::Standard(_) => STANDARD_MASK,
        Identifier::Extended(_) => EXTENDED_MASK & choice.mask,
    };
    bits | EXTENDED_FLAG
}

/// Writes a data frame; classic where it has eight bytes or fewer. The second value is its size in bytes.
pub fn write(frame: &Frame) -> ([u8; FD_BYTES], usize) {
    let mut bytes = [0; FD_BYTES];
    let data = frame.data();
    bytes[..4].copy_from_slice(&identifier_word(frame.identifier).to_ne_bytes());
    // A frame's data are 64 bytes at most.
    bytes[4] = data.len() as u8;
    bytes[DATA_AT..DATA_AT + data.len()].copy_from_slice(data);
    (bytes, if data.len() <= CLASSIC_DATA { CLASSIC_BYTES } else { FD_BYTES })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_frames_of_both_sizes_and_identifiers_come_back() {
        for identifier in [Identifier::Standard(0x7ff), Identifier::Extended(0x1234_5678)] {
            for length in [0, 1, 8, 12, 64] {
                let mut frame = Frame::new(identifier, Content::Data);
                for byte in 0..length {
                    assert!(frame.push(byte));
                }
                let (bytes, size) = write(&frame);
                assert_eq!(parse(&bytes[..size]), Ok(frame));
            }
        }
    }

    #[test]
    fn remote_and_error_frames_are_told_apart() {
        let mut bytes = [0; CLASSIC_BYTES];
        bytes[..4].copy_from_slice(&(0x123 | REMOTE_FLAG).to_ne_bytes());
        assert_eq!(parse(&bytes).map(|frame| frame.content), Ok(Content::Remote));
        bytes[..4].copy_from_slice(&ERROR_FLAG.to_ne_bytes());
        assert_eq!(parse(&bytes).map(|frame| frame.content), Ok(Content::Error));
    }

    #[test]
    fn sizes_and_lengths_that_no_frame_has_are_refused() {
        assert_eq!(parse(&[0; 15]), Err(FrameError::Size));
        assert_eq!(parse(&[]), Err(FrameError::Size));
        let mut classic = [0; CLASSIC_BYTES];
        classic[4] = 9;
        assert_eq!(parse(&classic), Err(FrameError::LengthCode));
        let mut fd = [0; FD_BYTES];
        for (length, good) in [(8, true), (12, true), (13, false), (64, true), (65, false), (255, false)] {
            fd[4] = length;
            assert_eq!(parse(&fd).is_ok(), good, "{length}");
        }
    }
}
