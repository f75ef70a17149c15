//! Samples from a CAN log in candump's format, by the names that a DBC file gives.

use std::io::{BufRead, BufReader, Read};

use seepd_signals::{Sample, Signal};

use super::Source;
use crate::can::Content;
use crate::can::candump::Line;
use crate::can::dbc::{CanSignal, Dbc, Reading};
use crate::config::SignalMapping;
use crate::failure::{Code, Failure};

/// Longest line that is read, bytes: an FD frame takes some 170.
pub const LONGEST_LINE: u64 = 4096;
/// Frames after which stamps that share one second are no coincidence.
const STAMPS_LOOKED_AT: u64 = 200;

/// A signal of the mapping.
struct Wanted {
    signal: Signal,
    scale: f64,
    offset: f64,
    /// Interface; empty: any.
    interface: Vec<u8>,
    source: CanSignal,
}

/// See the [module](self).
pub struct CandumpSource<R> {
    name: String,
    reader: BufReader<R>,
    line: Vec<u8>,
    line_number: u64,
    wanted: Vec<Wanted>,
    stamps: Stamps,
    /// The newest value of each signal: a command is published with what was known beside it.
    held: Sample,
    counts: Counts,
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

#[derive(Default)]
struct Counts {
    given: u64,
    unreadable: u64,
    too_short: u64,
    remote: u64,
    error: u64,
}

impl<R: Read> CandumpSource<R> {
    /// Finds the mapping's signals in the DBC file. A signal under its own name may be missing there, unless it is the
    /// command.
    ///
    /// # Errors
    /// [`Failure`] where there is no DBC file, or it names no such signal.
    pub fn new(
        input: R,
        name: &str,
        mapping: Vec<(Signal, SignalMapping)>,
        dbc: Option<&Dbc>,
    ) -> Result<Self, Failure> {
        let dbc = dbc.ok_or_else(|| {
            let message =
                format!("{name}: is a CAN log; name the DBC file that describes its frames (--dbc FILE)");
            Failure::new(Code::Configuration, message)
        })?;
        let mut wanted = Vec::new();
        for (signal, mapping) in mapping {
            let optional = mapping.may_be_missing(signal);
            match dbc.find(&mapping.field) {
                Ok(source) => wanted.push(Wanted {
                    signal,
                    scale: mapping.scale,
                    offset: mapping.offset,
                    interface: mapping.topic.into_bytes(),
                    source,
                }),
                Err(_) if optional => {}
                Err(message) => return Err(Failure::new(Code::Configuration, message)),
            }
        }
        Ok(CandumpSource {
            name: name.into(),
            reader: BufReader::with_capacity(1 << 16, input),
            line: Vec::new(),
            line_number: 0,
            wanted,
            stamps: Stamps::default(),
            held: Sample::new(0),
            counts: Counts::default(),
            first_unreadable: None,
        })
    }

    /// The sample that the line at hand completes, if its frame carries a command.
    fn take_line(&mut self) -> Option<Sample> {
        let text = self.line.trim_ascii();
        if text.is_empty() {
            return None;
        }
        let line = match Line::parse(text) {
            Ok(line) => line,
            Err(what) => {
                self.counts.unreadable += 1;
                let number = self.line_number;
                self.first_unreadable.get_or_insert_with(|| format!("line {number}: {what}"));
                return None;
            }
        };
        self.stamps.take(&line);
        match line.frame.content {
            Content::Remote => self.counts.remote += 1,
            Content::Error => self.counts.error += 1,
            Content::Data => {}
        }
        let mut has_command = false;
        let mut too_short = false;
        for wanted in &self.wanted {
            if !wanted.interface.is_empty() && wanted.interface != line.interface {
                continue;
            }
            match wanted.source.read(&line.frame) {
                Reading::Value(value) => {
                    self.held.set(wanted.signal, value * wanted.scale + wanted.offset);
                    has_command |= wanted.signal == Signal::Command;
                }
                Reading::TooShort => too_short = true,
                Reading::Absent => {}
            }
        }
        self.counts.too_short += u64::from(too_short);
        self.counts.given += u64::from(has_command);
        self.held.time_ns = line.time_ns;
        has_command.then_some(self.held)
    }

    fn check_stamps(&self) -> Result<(), Failure> {
        let Stamps { frames, shared, fractions, .. } = self.stamps;
        if fractions || shared * 2 < frames || frames < 2 {
            return Ok(());
        }
        Err(Failure::data(format!(
            "{}: its time stamps are whole seconds ({shared} of the first {frames} frames share the stamp of the frame \
             before), so the time between samples is lost; record with `candump -l`, which writes microseconds",
            self.name
        )))
    }

    fn nothing_matched(&self) -> Failure {
        let command = self.wanted.iter().find(|wanted| wanted.signal == Signal::Command);
        let wanted = command.map_or("a command: the mapping has none".into(), |wanted| {
            let interface = String::from_utf8_lossy(&wanted.interface);
            let on = if interface.is_empty() { String::new() } else { format!(" on {interface}") };
            format!("{} (identifier {}){on}", wanted.source.name, wanted.source.identifier)
        });
        let short = if self.counts.too_short > 0 {
            format!(", {} of them too short for the mapped signals", self.counts.too_short)
        } else {
            String::new()
        };
        Failure::data(format!(
            "{}: no frame carries {wanted}; the log has {} frames{short}; `seepd inspect` lists them",
            self.name, self.stamps.frames
        ))
    }
}

impl Stamps {
    fn take(&mut self, line: &Line<'_>) {
        self.frames += 1;
        self.fractions |= !line.whole_second;
        self.shared += u64::from(self.newest_ns == Some(line.time_ns));
        self.newest_ns = Some(line.time_ns);
    }
}

/// Reads a line into `line`, which is emptied first; one that is too long is cut, and its rest skipped. `false` at the end.
pub(crate) fn next_line(reader: &mut impl BufRead, line: &mut Vec<u8>) -> std::io::Result<bool> {
    line.clear();
    reader.by_ref().take(LONGEST_LINE).read_until(b'\n', line)?;
    if line.len() as u64 == LONGEST_LINE && line.last() != Some(&b'\n') {
        reader.skip_until(b'\n')?;
    }
    Ok(!line.is_empty())
}

impl<R: Read> Source for CandumpSource<R> {
    fn next_sample(&mut self) -> Result<Option<Sample>, Failure> {
        loop {
            let more = next_line(&mut self.reader, &mut self.line)
                .map_err(|error| Failure::new(Code::Io, format!("{}: {error}", self.name)))?;
            if !more {
                self.check_stamps()?;
                return if self.counts.given == 0 { Err(self.nothing_matched()) } else { Ok(None) };
            }
            self.line_number += 1;
            let sample = self.take_line();
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
        let counts = &self.counts;
        let notes = [
            (counts.unreadable, format!("lines left out, the first at {first}")),
            (counts.too_short, "frames left out as too short for their signals".into()),
            (counts.remote, "remote frames, which carry no data".into()),
            (counts.error, "error frames".into()),
        ];
        let told = notes.into_iter().filter(|(count, _)| *count > 0);
        told.map(|(count, what)| format!("{}: {count} {what}", self.name)).collect()
    }
}
