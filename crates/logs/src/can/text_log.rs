//! Bus logs of one line a frame.

use std::io::Read;

use super::asc::Asc;
use super::busmaster::Busmaster;
use super::candump;
use super::frame_error::FrameError;
use super::logged::{FrameLog, Interface, LoggedFrame, NextFrame};
use super::savvycan::SavvyCan;
use super::trc::Trc;
use crate::lines::{Line, Lines};

/// Longest line that is read, bytes: an FD frame takes some 250.
const LONGEST_LINE: u64 = 4096;

/// How a line says what a frame is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TextFormat {
    /// `candump -l` of can-utils.
    Candump,
    /// Vector's `.asc`.
    Asc,
    /// PEAK's `.trc`.
    Trc,
    /// SavvyCAN's (GVRET) CSV.
    SavvyCan,
    /// BUSMASTER's `.log`.
    Busmaster,
}

impl TextFormat {
    /// What people call it.
    pub fn name(self) -> &'static str {
        match self {
            TextFormat::Candump => "candump",
            TextFormat::Asc => "Vector ASC",
            TextFormat::Trc => "PEAK TRC",
            TextFormat::SavvyCan => "SavvyCAN",
            TextFormat::Busmaster => "BUSMASTER",
        }
    }
}

/// A format with what its header said.
#[derive(Debug)]
enum Format {
    Candump,
    Asc(Asc),
    Trc(Trc),
    SavvyCan(SavvyCan),
    Busmaster(Busmaster),
}

/// See the [module](self).
pub struct TextLog<R> {
    lines: Lines<R>,
    format: Format,
}

impl<R: Read> TextLog<R> {
    /// Reads a text of a format.
    pub fn new(input: R, format: TextFormat) -> Self {
        let format = match format {
            TextFormat::Candump => Format::Candump,
            TextFormat::Asc => Format::Asc(Asc::new()),
            TextFormat::Trc => Format::Trc(Trc::new()),
            TextFormat::SavvyCan => Format::SavvyCan(SavvyCan::default()),
            TextFormat::Busmaster => Format::Busmaster(Busmaster::new()),
        };
        TextLog { lines: Lines::new(input, LONGEST_LINE), format }
    }
}

impl Format {
    /// A line's frame; `None` where none is to be expected.
    fn take(&mut self, line: &[u8]) -> Option<Result<LoggedFrame, FrameError>> {
        match self {
            Format::Candump => {
                let line = line.trim_ascii();
                (!line.is_empty()).then(|| logged(&candump::Line::parse(line)?))
            }
            Format::Asc(asc) => asc.take(line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line)),
            Format::Trc(trc) => trc.take(line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line)),
            Format::SavvyCan(savvycan) => savvycan.take(line),
            Format::Busmaster(busmaster) => {
                busmaster.take(line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line))
            }
        }
    }
}

fn logged(line: &candump::Line<'_>) -> Result<LoggedFrame, FrameError> {
    let interface = Interface::new(line.interface).ok_or(FrameError::InterfaceTooLong)?;
    Ok(LoggedFrame { time_ns: line.time_ns, interface, frame: line.frame })
}

impl<R: Read> FrameLog for TextLog<R> {
    fn next_frame(&mut self) -> NextFrame {
        loop {
            return Ok(Some(match self.lines.next()? {
                None => return Ok(None),
                Some(Line::TooLong) => Err(FrameError::TooLong),
                Some(Line::Whole(line)) => match self.format.take(line) {
                    None => continue,
                    Some(found) => found,
                },
            }));
        }
    }

    fn place(&self) -> String {
        format!("line {}", self.lines.number())
    }
}
