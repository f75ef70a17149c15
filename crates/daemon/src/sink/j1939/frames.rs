//! Frames of SAE J1939-21 and -81: identifiers, long messages to everybody (BAM), requests, address claims.

use seepd_logs::can::{Content, Frame, Identifier};

/// Parameter groups that are spoken.
pub(super) const DM1: u32 = 65_226;
pub(super) const DM2: u32 = 65_227;
pub(super) const REQUEST: u32 = 59_904;
pub(super) const ACKNOWLEDGEMENT: u32 = 59_392;
pub(super) const ADDRESS_CLAIMED: u32 = 60_928;
const CONNECTION: u32 = 60_416;
const TRANSFER: u32 = 60_160;
/// Everybody.
pub(super) const GLOBAL: u8 = 255;
/// The address of one that has none.
pub(super) const NULL: u8 = 254;
/// Data bytes of a classic frame, and of a packet of a long message.
const FRAME: usize = 8;
const PACKET: usize = 7;
/// Parameter groups below this are addressed to one.
const BROADCAST_FORMATS: u32 = 0xf000;

/// A frame of a parameter group, its bytes filled up with ones.
pub(super) fn frame(pgn: u32, from: u8, to: u8, data: &[u8]) -> Frame {
    let priority: u32 = if [CONNECTION, TRANSFER].contains(&pgn) { 7 } else { 6 };
    let group = if pgn < BROADCAST_FORMATS { pgn | u32::from(to) } else { pgn };
    let identifier = Identifier::Extended(priority << 26 | group << 8 | u32::from(from));
    let mut frame = Frame::new(identifier, Content::Data);
    for index in 0..FRAME {
        frame.push(data.get(index).copied().unwrap_or(0xff));
    }
    frame
}

/// A message to everybody: one frame, or the announcement of a long one and its packets.
pub(super) fn broadcast(pgn: u32, from: u8, data: &[u8]) -> Vec<Frame> {
    if data.len() <= FRAME {
        return vec![frame(pgn, from, GLOBAL, data)];
    }
    // A message has 17 codes at most: 70 bytes, 10 packets.
    let [size_low, size_high] = (data.len() as u16).to_le_bytes();
    let packets = data.len().div_ceil(PACKET) as u8;
    let [low, middle, high, _] = pgn.to_le_bytes();
    let announcement = [32, size_low, size_high, packets, 0xff, low, middle, high];
    let mut frames = vec![frame(CONNECTION, from, GLOBAL, &announcement)];
    for (number, packet) in (1u8..).zip(data.chunks(PACKET)) {
        let numbered: Vec<u8> = std::iter::once(number).chain(packet.iter().copied()).collect();
        frames.push(frame(TRANSFER, from, GLOBAL, &numbered));
    }
    frames
}

/// What others say that concerns an address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Said {
    /// Somebody asks for a parameter group; of this address alone, or of everybody.
    Request { pgn: u32, from: u8, directed: bool },
    /// Somebody says that the address is theirs.
    Claim { name: u64 },
}

/// Reads a frame from the bus.
pub(super) fn heard(frame: &Frame, address: u8) -> Option<Said> {
    let Identifier::Extended(identifier) = frame.identifier else { return None };
    if frame.content != Content::Data {
        return None;
    }
    let (from, to) = (identifier.to_le_bytes()[0], identifier.to_le_bytes()[1]);
    let pgn = (identifier >> 8) & 0x3ff00;
    match pgn {
        REQUEST if to == address || to == GLOBAL => {
            let [low, middle, high] = *frame.data().first_chunk::<3>()?;
            let pgn = u32::from_le_bytes([low, middle, high, 0]);
            Some(Said::Request { pgn, from, directed: to == address })
        }
        ADDRESS_CLAIMED if from == address => {
            Some(Said::Claim { name: u64::from_le_bytes(*frame.data().first_chunk::<8>()?) })
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn identifier(frame: &Frame) -> u32 {
        match frame.identifier {
            Identifier::Extended(identifier) => identifier,
            Identifier::Standard(_) => 0,
        }
    }

    #[test]
    fn analytic_frames_are_laid_out_as_the_standard_says() {
        let short = broadcast(DM1, 0x80, &[4, 0xff, 0, 0xe0, 0xf0, 1]);
        assert_eq!(short.len(), 1);
        assert_eq!(
            (identifier(&short[0]), short[0].data()),
            (0x18fe_ca80, &[4, 0xff, 0, 0xe0, 0xf0, 1, 0xff, 0xff][..])
        );
        let data: Vec<u8> = (0..10).collect();
        let long = broadcast(DM1, 0x80, &data);
        let told: Vec<(u32, &[u8])> = long.iter().map(|frame| (identifier(frame), frame.data())).collect();
        assert_eq!(
            told,
            [
                (0x1cec_ff80, &[32, 10, 0, 2, 0xff, 0xca, 0xfe, 0][..]),
                (0x1ceb_ff80, &[1, 0, 1, 2, 3, 4, 5, 6]),
                (0x1ceb_ff80, &[2, 7, 8, 9, 0xff, 0xff, 0xff, 0xff]),
            ]
        );
    }

    #[test]
    fn requests_and_claims_are_heard_and_others_are_not() {
        let asked = |to, data: &[u8]| heard(&frame(REQUEST, 0x21, to, data), 0x80);
        let request = |directed| Some(Said::Request { pgn: DM2, from: 0x21, directed });
        assert_eq!(asked(0x80, &[0xcb, 0xfe, 0]), request(true));
        assert_eq!(asked(GLOBAL, &[0xcb, 0xfe, 0]), request(false));
        assert_eq!(asked(0x81, &[0xcb, 0xfe, 0]), None);
        let claim = frame(ADDRESS_CLAIMED, 0x80, GLOBAL, &7u64.to_le_bytes());
        assert_eq!(heard(&claim, 0x80), Some(Said::Claim { name: 7 }));
        assert_eq!(heard(&claim, 0x81), None);
        let mut short = Frame::new(Identifier::Extended(0x18ea_8021), Content::Data);
        assert_eq!(heard(&short, 0x80), None);
        short = Frame::new(Identifier::Standard(0x123), Content::Data);
        assert_eq!(heard(&short, 0x80), None);
    }
}
