//! Where samples come from: one file a kind of source.

pub(crate) mod bus_survey;
pub mod candump;
mod channels;
pub mod csv;
pub mod decode;
pub mod fields;
pub mod guess;
mod intervals;
pub mod json;
pub mod kind;
mod lines;
#[cfg(feature = "live")]
pub mod live;
pub mod mcap;
mod mcap_chunk;
pub mod mcap_file;
pub mod protobuf;
mod protobuf_wire;
pub mod record;
pub mod ros;
mod rows;
#[cfg(feature = "live")]
pub mod socketcan;
pub mod survey;

use std::fs::File;
use std::io::{Cursor, Read, Seek};
use std::path::Path;

use indicatif::ProgressBar;
use seepd_signals::{Sample, Signal};

use crate::can::dbc::Dbc;
use crate::can::decode::FrameDecoder;
use crate::config::Config;
use crate::failure::{Code, Failure};
use crate::progress::Counted;
use kind::{HEAD_BYTES, LogKind};

/// A stream of samples.
pub trait Source {
    /// The next sample; `None` at the end.
    ///
    /// # Errors
    /// [`Failure`] where nothing more can be read.
    fn next_sample(&mut self) -> Result<Option<Sample>, Failure>;

    /// What was damaged, missing or left out, one line each; complete after the end.
    fn notes(&self) -> Vec<String>;
}

/// Opens a log by its content, whatever its name; `-` is a text on standard input.
///
/// # Errors
/// [`Failure`] where there is no such file, it is empty, or it is of no kind that is read.
pub fn open(path: &Path, config: &Config) -> Result<Box<dyn Source + Send>, Failure> {
    open_with(path, config, &ProgressBar::hidden())
}

/// As [`open`]; the bar counts the bytes that have been read.
///
/// # Errors
/// As [`open`].
pub fn open_with(path: &Path, config: &Config, bar: &ProgressBar) -> Result<Box<dyn Source + Send>, Failure> {
    if path == Path::new("-") {
        return open_standard_input(config);
    }
    let reading = |error| Failure::reading(path, &error);
    let mut file = File::open(path).map_err(reading)?;
    let facts = file.metadata().map_err(reading)?;
    if facts.is_dir() {
        return Err(Failure::new(Code::NoInput, format!("{}: is a folder; name a log file", path.display())));
    }
    let name = path.display().to_string();
    let head = head_of(&mut file).map_err(reading)?;
    let kind = LogKind::of(&head, &name)?;
    let source = match kind {
        LogKind::Mcap => {
            file.rewind().map_err(|_| mcap_from_pipe(&name))?;
            Box::new(mcap::McapSource::new(Counted::new(file, facts.len(), bar), &name, config.mapping())?)
        }
        // What has been read of a pipe does not come again.
        LogKind::Csv | LogKind::Candump => {
            open_text(kind, Counted::new(Cursor::new(head).chain(file), facts.len(), bar), &name, config)?
        }
    };
    Ok(Box::new(Usable { source, name, samples: 0, usable: false }))
}

fn open_standard_input(config: &Config) -> Result<Box<dyn Source + Send>, Failure> {
    let name = "standard input";
    let mut input = std::io::stdin();
    let head = head_of(&mut input).map_err(|error| Failure::new(Code::Io, format!("{name}: {error}")))?;
    let source = match LogKind::of(&head, name)? {
        LogKind::Mcap => return Err(mcap_from_pipe(name)),
        kind => open_text(kind, Cursor::new(head).chain(input), name, config)?,
    };
    Ok(Box::new(Usable { source, name: name.into(), samples: 0, usable: false }))
}

/// The bytes by which a log's kind is told.
fn head_of(input: &mut impl Read) -> std::io::Result<Vec<u8>> {
    let mut head = Vec::with_capacity(HEAD_BYTES);
    input.take(HEAD_BYTES as u64).read_to_end(&mut head)?;
    Ok(head)
}

fn mcap_from_pipe(name: &str) -> Failure {
    Failure::data(format!("{name}: is an MCAP log; name its file, MCAP is not read from a pipe"))
}

/// A log that ends in a failure where none of its commands was a number: nobody is to take silence for health.
struct Usable {
    source: Box<dyn Source + Send>,
    name: String,
    samples: u64,
    usable: bool,
}

impl Source for Usable {
    fn next_sample(&mut self) -> Result<Option<Sample>, Failure> {
        let sample = self.source.next_sample()?;
        match &sample {
            Some(sample) => {
                self.samples += 1;
                self.usable |= sample.get(Signal::Command).is_some_and(f64::is_finite);
            }
            None if self.usable => {}
            None => {
                let what = format!("{}: none of its {} commands is a number", self.name, self.samples);
                return Err(Failure::data(what));
            }
        }
        Ok(sample)
    }

    fn notes(&self) -> Vec<String> {
        self.source.notes()
    }
}

/// What reads a bus's frames by the mapping.
///
/// # Errors
/// [`Failure`] where the DBC file cannot be read, or nothing says where a mapped signal is.
pub fn frame_decoder(config: &Config) -> Result<FrameDecoder, Failure> {
    let dbc = config.dbc.as_deref().map(Dbc::read).transpose()?;
    FrameDecoder::new(config.mapping(), config.source.counter.as_ref(), dbc.as_ref())
        .map_err(|message| Failure::new(Code::Configuration, message))
}

fn open_text(
    kind: LogKind,
    input: impl Read + Send + 'static,
    name: &str,
    config: &Config,
) -> Result<Box<dyn Source + Send>, Failure> {
    let mapping = config.mapping();
    if kind == LogKind::Candump {
        let decoder = frame_decoder(config).map_err(|failure| match &config.dbc {
            Some(_) => failure,
            None => Failure::new(failure.code, format!("{name}: is a CAN log; {}", failure.message)),
        })?;
        return Ok(Box::new(candump::CandumpSource::new(input, name, decoder)));
    }
    Ok(Box::new(csv::CsvSource::new(input, name, &mapping, &config.time_column, config.time_unit)?))
}
