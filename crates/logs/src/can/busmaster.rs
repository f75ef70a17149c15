//! The text log of BUSMASTER: `22:20:14:992 Rx 0 0000021A s 8 FE 36 12 FE 69 05 07 AD`.

use super::frame_error::FrameError;
use super::logged::{Interface, LoggedFrame};
use super::words::{bytes_of_code, number_u32, push_words, words};
use super::{Content, Frame, Identifier};
use crate::civil;

/// First bytes of a log.
pub(crate) const HEAD: &[u8] = b"***BUSMASTER";

const DAY_NS: i64 = 86_400_000_000_000;

/// What the header said, and the time of the frame before.
#[derive(Debug)]
pub(super) struct Busmaster {
    base: u32,
    mode: Mode,
    /// What is added to a frame's time, ns.
    shift_ns: i64,
    at_ns: Option<i64>,
}

/// What times count from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    /// Midnight.
    System,
    /// The beginning of the log.
    Absolute,
    /// The frame before.
    Relative,
}

impl Busmaster {
    pub(super) fn new() -> Self {
        Busmaster { base: 16, mode: Mode::System, shift_ns: 0, at_ns: None }
    }

    /// A line's frame; `None` for the header.
    pub(super) fn take(&mut self, line: &[u8]) -> Option<Result<LoggedFrame, FrameError>> {
        let line = line.trim_ascii();
        if let Some(header) = line.strip_prefix(b"***") {
            self.header(header.strip_suffix(b"***").unwrap_or(header));
            return None;
        }
        (!line.is_empty()).then(|| self.frame(line))
    }

    fn header(&mut self, text: &[u8]) {
        match text {
            b"HEX" => self.base = 16,
            b"DEC" => self.base = 10,
            b"SYSTEM MODE" => self.mode = Mode::System,
            b"ABSOLUTE MODE" => self.mode = Mode::Absolute,
            b"RELATIVE MODE" => self.mode = Mode::Relative,
            _ => {
                if let Some(date) = text.strip_prefix(b"START DATE AND TIME ")
                    && let Some((midnight_ns, begin_ns)) = date_of(date)
                {
                    self.shift_ns = midnight_ns;
                    self.at_ns = Some(begin_ns);
                }
            }
        }
    }

    fn frame(&mut self, line: &[u8]) -> Result<LoggedFrame, FrameError> {
        let mut words = words(line);
        let mut next = || words.next().ok_or(FrameError::CutShort);
        let stamp = std::str::from_utf8(next()?).ok().and_then(civil::clock);
        let (hour, minute, second, nanosecond) = stamp.ok_or(FrameError::TimeNotOfClock)?;
        let direction = next()?;
        let interface = Interface::new(next()?).ok_or(FrameError::ChannelNotNumber)?;
        let id = next()?;
        let kind = next()?;
        let time_ns = self.time_ns(((hour * 60 + minute) * 60 + second) * 1_000_000_000 + nanosecond);
        if direction.eq_ignore_ascii_case(b"Err") {
            let frame = Frame::new(Identifier::Standard(0), Content::Error);
            return Ok(LoggedFrame { time_ns, interface, frame });
        }
        let id = id.strip_prefix(b"0x").unwrap_or(id);
        let bits = number_u32(id, self.base).ok_or(FrameError::IdentifierNotNumber)?;
        let identifier = match (kind.first(), bits) {
            (Some(b's'), 0..=0x7ff) => Identifier::Standard(bits as u16),
            (Some(b'x'), 0..=0x1fff_ffff) => Identifier::Extended(bits),
            _ => return Err(FrameError::IdentifierNotOfCan),
        };
        let length = number_u32(next()?, 10).and_then(bytes_of_code).ok_or(FrameError::Length)?;
        let mut frame = Frame::new(identifier, Content::Data);
        if kind.contains(&b'r') {
            frame.content = Content::Remote;
        } else {
            push_words(&mut frame, &mut words, length, self.base)?;
        }
        Ok(LoggedFrame { time_ns, interface, frame })
    }

    fn time_ns(&mut self, stamp_ns: i64) -> i64 {
        let begin_ns = *self.at_ns.get_or_insert(0);
        match self.mode {
            Mode::System => {
                let mut at_ns = self.shift_ns.saturating_add(stamp_ns);
                // Frames of interfaces overtake one another by milliseconds; by half a day they do not.
                if at_ns < begin_ns.saturating_sub(DAY_NS / 2) {
                    self.shift_ns = self.shift_ns.saturating_add(DAY_NS);
                    at_ns = at_ns.saturating_add(DAY_NS);
                }
                self.at_ns = Some(at_ns);
                at_ns
            }
            Mode::Absolute => begin_ns.saturating_add(stamp_ns),
            Mode::Relative => {
                self.at_ns = Some(begin_ns.saturating_add(stamp_ns));
                begin_ns.saturating_add(stamp_ns)
            }
        }
    }
}

/// `23:9:2015 22:17:28:928`: that day's midnight and the time, ns since 1970.
fn date_of(text: &[u8]) -> Option<(i64, i64)> {
    let text = std::str::from_utf8(text).ok()?;
    let (date, time) = text.trim().split_once(' ')?;
    let mut parts = date.split(':').map(civil::whole);
    let (day, month, year) = (parts.next()??, parts.next()??, parts.next()??);
    let (hour, minute, second, nanosecond) = civil::clock(time.trim())?;
    let midnight_ns = civil::of_numbers((year, month, day), (0, 0, 0), 0)?;
    let begin_ns = civil::of_numbers((year, month, day), (hour, minute, second), nanosecond)?;
    Some((midnight_ns, begin_ns))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(mode: &str, stamps: &[&str]) -> Vec<i64> {
        let mut log = Busmaster::new();
        for header in
            ["***START DATE AND TIME 2:1:1970 23:59:00:000***", "***HEX***", &format!("***{mode} MODE***")]
        {
            assert_eq!(log.take(header.as_bytes()), None);
        }
        let frame = |stamp: &&str| format!("{stamp} Rx 1 0x12 s 1 FF");
        stamps.iter().map(|stamp| log.take(frame(stamp).as_bytes()).unwrap().unwrap().time_ns).collect()
    }

    #[test]
    fn times_count_from_midnight_the_beginning_or_the_frame_before() {
        let begin_ns = 2 * DAY_NS - 60_000_000_000;
        let since =
            |times: Vec<i64>| times.into_iter().map(|time| (time - begin_ns) / 1_000_000).collect::<Vec<_>>();
        assert_eq!(
            since(times("SYSTEM", &["23:59:01:500", "23:59:59:5000", "00:00:00:5000"])),
            [1500, 59_500, 60_500]
        );
        assert_eq!(since(times("ABSOLUTE", &["0:0:1:500", "0:0:2:000"])), [1500, 2000]);
        assert_eq!(since(times("RELATIVE", &["0:0:1:500", "0:0:2:000"])), [1500, 3500]);
    }

    #[test]
    fn kinds_of_frames_and_damage() {
        let mut log = Busmaster::new();
        let mut take = |line: &str| log.take(line.as_bytes()).unwrap().map(|found| found.frame);
        let frame = take("10:00:00:0 Tx 2 0x18FEF100 x 2 01 02").unwrap();
        assert_eq!((frame.identifier, frame.data()), (Identifier::Extended(0x18fe_f100), &[1, 2][..]));
        assert_eq!(take("10:00:00:0 Tx 2 0x12 sr 8").unwrap().content, Content::Remote);
        for wrong in
            ["10:00 Rx 1 12 s 1 00", "10:00:00:0 Rx 1 0x800 s 1 00", "10:00:00:0 Rx 1 0x1 s 2 00", "x"]
        {
            assert!(take(wrong).is_err(), "{wrong}");
        }
    }
}
