//! Samples from a CAN log in candump's format, by the names that a DBC file gives.

use std::io::Read;

use seepd_signals::Sample;

use super::Source;
use super::lines::{Line, Lines};
use crate::can::candump;
use crate::can::decode::FrameDecoder;
use crate::error::LogError;

/// Longest line that is read, bytes: an FD frame takes some 170.
pub(super) const LONGEST_LINE: u64 = 4096;
/// Frames after which stamps that share one second are no coincidence.
const STAMPS_LOOKED_AT: u64 = 200;

/// Samples from a CAN log in the format of `candump -l`.
pub struct CandumpSource<R> {
    name: String,
    lines: Lines<R>,
    decoder: FrameDecoder,
    stamps: Stamps,
    unreadable: u64,
    first_unreadable: Option<String>,
}

/// Whether the stamps resolve the time between frames.
#[derive(Default)]
struct Stamps {
    frames: u64,
    /// Of these, how many have the stamp of the frame before.
    shared: u64,
    newest_ns: Option<i64>,
    fractions: bool,
}

impl<R: Read> CandumpSource<R> {
    /// Reads frames as the decoder takes them.
    pub fn new(input: R, name: &str, decoder: FrameDecoder) -> Self {
        CandumpSource {
            name: name.into(),
            lines: Lines::new(input, LONGEST_LINE),
            decoder,
            stamps: Stamps::default(),
            unreadable: 0,
            first_unreadable: None,
        }
    }

    fn check_stamps(&self) -> Result<(), LogError> {
        let Stamps { frames, shared, fractions, .. } = self.stamps;
        if fractions || shared * 2 < frames || frames < 2 {
            return Ok(());
        }
        Err(LogError::data(
            &self.name,
            format!(
                "its time stamps are whole seconds ({shared} of the first {frames} frames share the stamp of the frame \
             before), so the time between samples is lost; record with `candump -l`, which writes microseconds"
            ),
        ))
    }

    fn nothing_matched(&self) -> LogError {
        let wanted = self.decoder.command_place();
        let too_short = self.decoder.counts().too_short;
        let short = if too_short > 0 {
            format!(", {too_short} of them too short for the mapped signals")
        } else {
            String::new()
        };
        LogError::data(
            &self.name,
            format!(
                "no frame carries {wanted}; the log has {} frames{short}; `seepd inspect` lists them",
                self.stamps.frames
            ),
        )
    }
}

impl Stamps {
    fn take(&mut self, line: &candump::Line<'_>) {
        self.frames += 1;
        self.fractions |= !line.whole_second;
        self.shared += u64::from(self.newest_ns == Some(line.time_ns));
        self.newest_ns = Some(line.time_ns);
    }
}

/// Reads a line's frame; `None` for an empty line.
pub(super) fn parse(line: Line<'_>) -> Option<Result<candump::Line<'_>, &'static str>> {
    match line {
        Line::TooLong => Some(Err("it is longer than a frame can be")),
        Line::Whole(text) => match text.trim_ascii() {
            b"" => None,
            text => Some(candump::Line::parse(text)),
        },
    }
}

impl<R: Read> Source for CandumpSource<R> {
    fn next_sample(&mut self) -> Result<Option<Sample>, LogError> {
        loop {
            let line = self.lines.next().map_err(|error| LogError::reading(&self.name, error))?;
            let Some(line) = line else {
                self.check_stamps()?;
                return if self.decoder.counts().given == 0 { Err(self.nothing_matched()) } else { Ok(None) };
            };
            let sample = match parse(line) {
                None => continue,
                Some(Ok(line)) => {
                    self.stamps.take(&line);
                    self.decoder.take(&line.frame, line.interface, line.time_ns)
                }
                Some(Err(what)) => {
                    self.unreadable += 1;
                    let number = self.lines.number();
                    self.first_unreadable.get_or_insert_with(|| format!("line {number}: {what}"));
                    continue;
                }
            };
            if self.stamps.frames == STAMPS_LOOKED_AT {
                self.check_stamps()?;
            }
            if sample.is_some() {
                return Ok(sample);
            }
        }
    }

    fn notes(&self) -> Vec<String> {
        let first = self.first_unreadable.as_deref().unwrap_or_default();
        let counts = self.decoder.counts();
        let notes = [
            (self.unreadable, format!("lines were left out, the first at {first}")),
            (counts.too_short, "frames were left out, since they are too short for their signals".into()),
            (counts.remote, "remote frames, which carry no data".into()),
            (counts.error, "error frames".into()),
            (counts.missing, "frames lost before the log, by their counter".into()),
            (counts.repeated, "frames sent twice, or by two senders, by their counter".into()),
            (counts.jumps, "times that the counter of the frames went back".into()),
        ];
        let told = notes.into_iter().filter(|(count, _)| *count > 0);
        told.map(|(count, what)| format!("{}: {count} {what}", self.name)).collect()
    }
}
