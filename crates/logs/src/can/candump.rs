//! The log format of can-utils' `candump -l` and `-L`: `(1436509052.249713) can0 044#2A366C2BBA`.

use super::frame_error::FrameError;
use super::words::{fixed_point, words};
use super::{Content, Frame, Identifier};

/// Flag of an error frame in an identifier of eight digits (`CAN_ERR_FLAG` of Linux).
const ERROR_FLAG: u32 = 0x2000_0000;

/// A line of a log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line<'a> {
    /// Time, ns.
    pub time_ns: i64,
    /// Interface.
    pub interface: &'a [u8],
    /// Frame.
    pub frame: Frame,
}

impl<'a> Line<'a> {
    /// Reads a line.
    ///
    /// # Errors
    /// [`FrameError`] says what is wrong with it.
    pub fn parse(line: &'a [u8]) -> Result<Self, FrameError> {
        let mut words = words(line);
        let stamp = words.next().ok_or(FrameError::Empty)?;
        let stamp = stamp
            .strip_prefix(b"(")
            .and_then(|stamp| stamp.strip_suffix(b")"))
            .ok_or(FrameError::TimeNotInParentheses)?;
        let time_ns = fixed_point(stamp, 9).ok_or(FrameError::TimeNotSeconds)?;
        let interface = words.next().ok_or(FrameError::InterfaceMissing)?;
        let frame = frame(words.next().ok_or(FrameError::FrameMissing)?)?;
        Ok(Line { time_ns, interface, frame })
    }
}

fn frame(text: &[u8]) -> Result<Frame, FrameError> {
    let mut parts = text.splitn(2, |byte| *byte == b'#');
    let id = parts.next().unwrap_or_default();
    let data = parts.next().ok_or(FrameError::SeparatorMissing)?;
    let bits = hexadecimal(id).ok_or(FrameError::IdentifierNotHexadecimal)?;
    let (identifier, error) = match id.len() {
        3 if bits <= 0x7ff => (Identifier::Standard(bits as u16), false),
        8 => (Identifier::Extended(bits & 0x1fff_ffff), bits & ERROR_FLAG != 0),
        _ => return Err(FrameError::IdentifierDigits),
    };
    if error {
        return Ok(Frame::new(identifier, Content::Error));
    }
    if data.first() == Some(&b'R') {
        return Ok(Frame::new(identifier, Content::Remote));
    }
    // FD frames have a second `#` and a digit of flags; classic ones may end in `_` and their length code.
    let (data, most) = match data.strip_prefix(b"#") {
        Some(fd) => (fd.get(1..).ok_or(FrameError::FlagsMissing)?, 64),
        None => (data, 8),
    };
    let data = data.split(|byte| *byte == b'_').next().unwrap_or_default();
    if data.len() % 2 != 0 || data.len() / 2 > most {
        return Err(FrameError::DataCutShortOrTooLong);
    }
    let mut frame = Frame::new(identifier, Content::Data);
    for pair in data.chunks_exact(2) {
        let byte = hexadecimal(pair).ok_or(FrameError::DataNotHexadecimal)?;
        frame.push(byte as u8);
    }
    Ok(frame)
}

fn hexadecimal(text: &[u8]) -> Option<u32> {
    if text.is_empty() || text.len() > 8 {
        return None;
    }
    text.iter().try_fold(0u32, |number, byte| Some(number << 4 | char::from(*byte).to_digit(16)?))
}

/// Whether a text begins like such a log.
pub fn looks_like_candump(head: &[u8]) -> bool {
    let first = head.split(|byte| *byte == b'\n').find(|line| !line.trim_ascii().is_empty());
    first.is_some_and(|line| {
        line.trim_ascii().starts_with(b"(") && line.contains(&b'#') && !line.contains(&b'[')
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(line: &str) -> Result<Line<'_>, FrameError> {
        Line::parse(line.as_bytes())
    }

    #[test]
    fn classic_extended_and_fd_frames() {
        let line = parse("(1436509052.249713) vcan0 044#2A366C2BBA").unwrap();
        assert_eq!((line.time_ns, line.interface), (1_436_509_052_249_713_000, &b"vcan0"[..]));
        assert_eq!(line.frame.identifier, Identifier::Standard(0x44));
        assert_eq!(line.frame.data(), [0x2a, 0x36, 0x6c, 0x2b, 0xba]);
        let line = parse("(0.5) can1 18FEF100#01ff R\r").unwrap();
        assert_eq!((line.time_ns, line.frame.identifier), (500_000_000, Identifier::Extended(0x18fe_f100)));
        let fd = format!("(7.000000001) can0 123##1{}", "AB".repeat(64));
        let line = parse(&fd).unwrap();
        assert_eq!((line.time_ns, line.frame.data().len()), (7_000_000_001, 64));
        assert_eq!(parse("(1.0) can0 123#1122334455667788_E").unwrap().frame.data().len(), 8);
    }

    #[test]
    fn remote_and_error_frames_are_told_apart() {
        assert_eq!(parse("(1.0) can0 123#R4").unwrap().frame.content, Content::Remote);
        let error = parse("(1.0) can0 20000004#0000000000000000").unwrap();
        assert_eq!(error.frame.content, Content::Error);
    }

    #[test]
    fn damaged_lines_are_refused() {
        for (line, error) in [
            ("", FrameError::Empty),
            ("1.0 can0 123#00", FrameError::TimeNotInParentheses),
            ("(x) can0 123#00", FrameError::TimeNotSeconds),
            ("(1.0)", FrameError::InterfaceMissing),
            ("(1.0) can0", FrameError::FrameMissing),
            ("(1.0) can0 123", FrameError::SeparatorMissing),
            ("(1.0) can0 12G#00", FrameError::IdentifierNotHexadecimal),
            ("(1.0) can0 12#00", FrameError::IdentifierDigits),
            ("(1.0) can0 FFF#00", FrameError::IdentifierDigits),
            ("(1.0) can0 123#0", FrameError::DataCutShortOrTooLong),
            ("(1.0) can0 123#0G", FrameError::DataNotHexadecimal),
            ("(1.0) can0 123#001122334455667788", FrameError::DataCutShortOrTooLong),
            ("(1.0) can0 123##", FrameError::FlagsMissing),
            ("(99999999999999999999.0) can0 123#00", FrameError::TimeNotSeconds),
            ("(9999999999.9) can0 123#00", FrameError::TimeNotSeconds),
        ] {
            assert_eq!(parse(line), Err(error), "{line}");
        }
    }
}
