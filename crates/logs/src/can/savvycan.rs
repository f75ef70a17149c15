//! The text log of SavvyCAN (GVRET): `Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,…` with microseconds.

use super::frame_error::FrameError;
use super::logged::{Interface, LoggedFrame};
use super::words::{number, number_u32, push_words};
use super::{Content, Frame, Identifier, MOST_BYTES};

/// First words of the header.
pub(crate) const HEAD: &[u8] = b"Time Stamp,ID,Extended,";

/// What the header said.
#[derive(Debug, Default)]
pub(super) struct SavvyCan {
    /// A column tells received from sent; older logs have none.
    has_direction: bool,
}

impl SavvyCan {
    /// A line's frame; `None` for the header.
    pub(super) fn take(&mut self, line: &[u8]) -> Option<Result<LoggedFrame, FrameError>> {
        let line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line).trim_ascii();
        if line.is_empty() {
            return None;
        }
        if let Some(rest) = line.strip_prefix(HEAD) {
            self.has_direction = rest.starts_with(b"Dir");
            return None;
        }
        Some(self.frame(line))
    }

    fn frame(&self, line: &[u8]) -> Result<LoggedFrame, FrameError> {
        let mut fields = line.split(|byte| *byte == b',').map(<[u8]>::trim_ascii);
        let mut next = || fields.next().ok_or(FrameError::CutShort);
        let time_us = number(next()?, 10).ok_or(FrameError::TimeNotMicroseconds)?;
        let id = number_u32(next()?, 16).ok_or(FrameError::IdentifierNotHexadecimal)?;
        let extended = next()?.eq_ignore_ascii_case(b"true");
        if self.has_direction {
            next()?;
        }
        let interface = Interface::new(next()?).ok_or(FrameError::BusNotNumber)?;
        let length = number(next()?, 10).and_then(|length| usize::try_from(length).ok());
        let length = length.filter(|length| *length <= MOST_BYTES).ok_or(FrameError::Length)?;
        let identifier = match (extended, id) {
            (false, 0..=0x7ff) => Identifier::Standard(id as u16),
            (true, 0..=0x1fff_ffff) => Identifier::Extended(id),
            _ => return Err(FrameError::IdentifierNotOfCan),
        };
        let mut frame = Frame::new(identifier, Content::Data);
        push_words(&mut frame, &mut fields, length, 16)?;
        let time_ns = time_us.checked_mul(1000).ok_or(FrameError::TimeNotMicroseconds)?;
        Ok(LoggedFrame { time_ns, interface, frame })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_headers_and_damage() {
        for (header, direction) in [
            ("Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2", "Rx,"),
            ("Time Stamp,ID,Extended,Bus,LEN,D1,D2", ""),
        ] {
            let mut log = SavvyCan::default();
            assert_eq!(log.take(header.as_bytes()), None);
            let line = format!("166064000,0000021A,false,{direction}0,2,FE,36,");
            let found = log.take(line.as_bytes()).unwrap().unwrap();
            assert_eq!((found.time_ns, found.interface.name()), (166_064_000_000, &b"0"[..]));
            assert_eq!(
                (found.frame.identifier, found.frame.data()),
                (Identifier::Standard(0x21a), &[0xfe, 0x36][..])
            );
            for wrong in ["x,21A,false,_0,1,00", "1,fff,false,_0,1,00", "1,21A,true,_0,2,00", "1,21A"] {
                let line = wrong.replace('_', direction);
                assert!(log.take(line.as_bytes()).unwrap().is_err(), "{wrong}");
            }
        }
    }
}
