//! The text log of Vector's tools (`.asc`): `   0.015991 1  222  Rx   d 8 01 02 03 04 05 06 07 08`.

use super::frame_error::FrameError;
use super::logged::{Interface, LoggedFrame};
use super::words::{bytes_of_code, fixed_point, number, number_u32, push_words, words};
use super::{Content, Frame, Identifier, MOST_BYTES};
use crate::civil;

/// What the header said, and the time of the line before.
#[derive(Debug)]
pub(super) struct Asc {
    /// Base of identifiers and bytes.
    base: u32,
    /// Times count from line to line.
    relative: bool,
    /// Beginning of the measurement, ns since 1970; 0 where the header tells none.
    begin_ns: i64,
    /// Time of the line before, where times count from line to line, ns.
    at_ns: i64,
}

impl Asc {
    pub(super) fn new() -> Self {
        Asc { base: 16, relative: false, begin_ns: 0, at_ns: 0 }
    }

    /// A line's frame; `None` for headers, comments and events.
    pub(super) fn take(&mut self, line: &[u8]) -> Option<Result<LoggedFrame, FrameError>> {
        let mut words = words(line);
        let first = words.next()?;
        let Some(stamp_ns) = fixed_point(first, 9) else {
            return self.header(first, words).then_some(Err(FrameError::UnknownLine));
        };
        self.at_ns = if self.relative { self.at_ns.saturating_add(stamp_ns) } else { stamp_ns };
        let time_ns = self.begin_ns.saturating_add(self.at_ns);
        let channel = words.next()?;
        let (interface, frame) = if channel.eq_ignore_ascii_case(b"CANFD") {
            (words.next()?, self.fd_frame(words))
        } else if channel.iter().all(u8::is_ascii_digit) {
            (channel, self.classic_frame(words)?)
        } else {
            // Statistics, chip states, LIN, FlexRay and the like.
            return None;
        };
        Some(frame.and_then(|frame| {
            let interface = Interface::new(interface).ok_or(FrameError::ChannelNotNumber)?;
            Ok(LoggedFrame { time_ns, interface, frame })
        }))
    }

    /// Takes what a line of the header says; whether it is none.
    fn header<'w>(&mut self, first: &[u8], mut words: impl Iterator<Item = &'w [u8]>) -> bool {
        let lower = first.to_ascii_lowercase();
        match &lower[..] {
            b"date" => {
                self.begin_ns = civil::of_words(words.skip(1)).unwrap_or(0);
            }
            b"begin" if self.begin_ns == 0 => self.begin_ns = civil::of_words(words.skip(2)).unwrap_or(0),
            b"base" => {
                self.base =
                    if words.next().is_some_and(|base| base.eq_ignore_ascii_case(b"dec")) { 10 } else { 16 };
                self.relative = words.any(|word| word.eq_ignore_ascii_case(b"relative"));
            }
            b"begin" | b"end" | b"internal" | b"no" | b"previous" => {}
            other => return !other.starts_with(b"//"),
        }
        false
    }

    /// What follows the channel; `None` for an event.
    fn classic_frame<'w>(
        &self,
        mut words: impl Iterator<Item = &'w [u8]>,
    ) -> Option<Result<Frame, FrameError>> {
        let id = words.next()?;
        if id.eq_ignore_ascii_case(b"ErrorFrame") {
            return Some(Ok(Frame::new(Identifier::Standard(0), Content::Error)));
        }
        if !words.next().is_some_and(is_direction) {
            return None;
        }
        Some(self.identifier(id).and_then(|identifier| {
            let kind = words.next().ok_or(FrameError::FrameCutShort)?;
            if kind.eq_ignore_ascii_case(b"r") {
                return Ok(Frame::new(identifier, Content::Remote));
            }
            let code = words.next().and_then(|code| number_u32(code, 16));
            let bytes = code.and_then(bytes_of_code).ok_or(FrameError::Length)?;
            let mut frame = Frame::new(identifier, Content::Data);
            push_words(&mut frame, &mut words, bytes.min(8), self.base)?;
            Ok(frame)
        }))
    }

    /// What follows the channel of an FD frame: direction, identifier, name if there is one, two flags, length code, length, data.
    fn fd_frame<'w>(&self, mut words: impl Iterator<Item = &'w [u8]>) -> Result<Frame, FrameError> {
        let mut next = || words.next().ok_or(FrameError::FrameCutShort);
        let _direction = next()?;
        let id = next()?;
        if id.eq_ignore_ascii_case(b"ErrorFrame") {
            return Ok(Frame::new(Identifier::Standard(0), Content::Error));
        }
        let identifier = self.identifier(id)?;
        let is_flag = |word: &[u8]| matches!(word, b"0" | b"1");
        let flag = next()?;
        if !is_flag(flag) {
            // It was the frame's name.
            next()?;
        }
        next()?;
        let code = number(next()?, 16).ok_or(FrameError::Length)?;
        let bytes = number(next()?, 10).and_then(|bytes| usize::try_from(bytes).ok());
        let bytes = bytes.filter(|bytes| *bytes <= MOST_BYTES).ok_or(FrameError::Length)?;
        if bytes == 0 && code > 0 {
            return Ok(Frame::new(identifier, Content::Remote));
        }
        let mut frame = Frame::new(identifier, Content::Data);
        push_words(&mut frame, &mut words, bytes, self.base)?;
        Ok(frame)
    }

    /// An identifier, which has 29 bits where it ends in an x.
    fn identifier(&self, text: &[u8]) -> Result<Identifier, FrameError> {
        let extended = text.strip_suffix(b"x").or_else(|| text.strip_suffix(b"X"));
        let bits = number_u32(extended.unwrap_or(text), self.base);
        let bits = bits.ok_or(FrameError::IdentifierPerhapsName)?;
        match (extended, bits) {
            (None, 0..=0x7ff) => Ok(Identifier::Standard(bits as u16)),
            (Some(_), 0..=0x1fff_ffff) => Ok(Identifier::Extended(bits)),
            _ => Err(FrameError::IdentifierNotOfCan),
        }
    }
}

fn is_direction(word: &[u8]) -> bool {
    word.eq_ignore_ascii_case(b"Rx") || word.eq_ignore_ascii_case(b"Tx")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame, or the message of its error.
    type Found = Result<(i64, String, Identifier, Content, Vec<u8>), String>;

    fn frames(text: &str) -> Vec<Found> {
        let mut asc = Asc::new();
        let lines = text.lines().filter_map(|line| asc.take(line.as_bytes()));
        lines
            .map(|line| {
                line.map_err(|error| error.to_string()).map(|LoggedFrame { time_ns, interface, frame }| {
                    let interface = String::from_utf8_lossy(interface.name()).into_owned();
                    (time_ns, interface, frame.identifier, frame.content, frame.data().to_vec())
                })
            })
            .collect()
    }

    #[test]
    fn frames_events_and_damage() {
        let found = frames(
            "date Sam Sep 30 15:06:13.191 2017\nbase hex  timestamps absolute\ninternal events logged\n// version 9.0.0\n\
             Begin Triggerblock Sam Sep 30 15:06:13.191 2017\n   0.000000 Start of measurement\n\
             0.015991 CAN 1 Status:chip status error active\n   0.500000 1  222   Rx   d 2 01 ff  Length = 1 BitCount = 2\n\
             0.6 2  18FEF100x  Tx   r\n  0.7 1  ErrorFrame\n 0.8 1 Statistic: D 0 R 0\n\
             1.0 CANFD   3 Rx     33  Name 1 0 9 12 01 02 03 04 05 06 07 08 09 0a 0b 0c  130000 130 3000 0\n\
             1.1 CANFD 1 Rx 1ffx 0 0 1 1 aa\n1.2 1 Engine Rx d 1 00\n1.3 1 22 Rx d 3 00\nrubbish\nEnd TriggerBlock\n",
        );
        let begin_ns = 1_506_783_973_191_000_000;
        let ns = |ns: i64| begin_ns + ns;
        use Content::{Data, Error, Remote};
        use Identifier::{Extended, Standard};
        let fd: Vec<u8> = (1..=12).collect();
        assert_eq!(
            found,
            [
                Ok((ns(500_000_000), "1".into(), Standard(0x222), Data, vec![1, 255])),
                Ok((ns(600_000_000), "2".into(), Extended(0x18fe_f100), Remote, vec![])),
                Ok((ns(700_000_000), "1".into(), Standard(0), Error, vec![])),
                Ok((ns(1_000_000_000), "3".into(), Standard(0x33), Data, fd)),
                Ok((ns(1_100_000_000), "1".into(), Extended(0x1ff), Data, vec![0xaa])),
                Err("its identifier is not a number, but perhaps a name".into()),
                Err("its data is cut short".into()),
                Err("it is neither a frame nor a header".into()),
            ]
        );
    }

    #[test]
    fn decimal_numbers_and_times_from_line_to_line() {
        let found = frames("base dec timestamps relative\n0.5 1 100 Rx d 1 255\n0.25 1 100 Rx d 1 16\n");
        let times: Vec<_> =
            found.into_iter().map(|frame| frame.map(|frame| (frame.0, frame.2, frame.4))).collect();
        let id = Identifier::Standard(100);
        assert_eq!(times, [Ok((500_000_000, id, vec![255])), Ok((750_000_000, id, vec![16]))]);
    }
}
