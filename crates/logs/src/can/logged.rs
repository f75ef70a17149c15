//! Frames as logs have them: with a time, and with the interface that heard them.

use std::io;

use super::Frame;
pub use super::frame_error::FrameError;

/// A frame of a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LoggedFrame {
    /// Time, ns: since 1970 where the log has a date, else since it began.
    pub time_ns: i64,
    /// What heard it.
    pub interface: Interface,
    /// The frame.
    pub frame: Frame,
}

/// Longest name of an interface, bytes: Linux allows 15, and loggers number their channels.
const MOST_NAME_BYTES: usize = 15;

/// Name of an interface, such as `can0`, or a logger's channel, such as `1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Interface {
    length: u8,
    bytes: [u8; MOST_NAME_BYTES],
}

impl Interface {
    /// Takes a name; `None` where it is too long for one.
    pub fn new(name: &[u8]) -> Option<Self> {
        let mut bytes = [0; MOST_NAME_BYTES];
        bytes.get_mut(..name.len())?.copy_from_slice(name);
        Some(Interface { length: name.len() as u8, bytes })
    }

    /// A channel by its number.
    pub fn numbered(number: u32) -> Self {
        let (mut bytes, mut length, mut unit) = ([0; MOST_NAME_BYTES], 0, 1_000_000_000);
        while unit > 0 {
            let digit = (number / unit % 10) as u8;
            if digit > 0 || length > 0 || unit == 1 {
                bytes[length] = b'0' + digit;
                length += 1;
            }
            unit /= 10;
        }
        Interface { length: length as u8, bytes }
    }

    /// The name.
    pub fn name(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }
}

/// The next frame of a log, or why there is none at a place where one should be.
pub type NextFrame = io::Result<Option<Result<LoggedFrame, FrameError>>>;

/// Frames in the order of a log.
pub trait FrameLog {
    /// The next frame, or what is wrong at the place where it should be; `None` at the end.
    ///
    /// # Errors
    /// Reading failed.
    fn next_frame(&mut self) -> NextFrame;

    /// Where the frame that was read last stands, such as `line 12`.
    fn place(&self) -> String;

    /// What was damaged or left out beside single frames.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_kept_and_channels_are_numbered() {
        assert_eq!(Interface::new(b"vcan0").unwrap().name(), b"vcan0");
        assert_eq!(Interface::new(b"a name of 16 byt"), None);
        for (number, name) in [(0, "0"), (1, "1"), (10, "10"), (u32::MAX, "4294967295")] {
            assert_eq!(Interface::numbered(number).name(), name.as_bytes());
        }
    }
}
