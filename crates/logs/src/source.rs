//! A log as a stream of samples, whatever its kind.

use std::fs::File;
use std::io::{Cursor, Read, Seek};
use std::path::Path;

use seepd_signals::{Sample, Signal};

use crate::can::dbc::Dbc;
use crate::can::decode::FrameDecoder;
use crate::candump::CandumpSource;
use crate::counted::CountedReader;
use crate::csv::CsvSource;
use crate::error::LogError;
use crate::kind::{HEAD_BYTES, LogKind};
use crate::mapping::LogMapping;
use crate::mcap::McapSource;

/// A stream of samples.
pub trait Source {
    /// The next sample; `None` at the end.
    ///
    /// # Errors
    /// [`LogError`] where nothing more can be read.
    fn next_sample(&mut self) -> Result<Option<Sample>, LogError>;

    /// What was damaged, missing or left out, one line each; complete after the end.
    fn notes(&self) -> Vec<String>;
}

/// Opens a log by its content, whatever its name; `-` is a text on standard input.
///
/// # Errors
/// [`LogError`] where there is no such file, it is empty, or it is of no kind that is read.
pub fn open(path: &Path, mapping: &LogMapping) -> Result<Box<dyn Source + Send>, LogError> {
    open_with(path, mapping, |_| {})
}

/// As [`open`]; `on_bytes` hears how many more bytes of the log have been read, its length in all. It hears nothing of standard
/// input.
///
/// # Errors
/// As [`open`].
pub fn open_with(
    path: &Path,
    mapping: &LogMapping,
    on_bytes: impl FnMut(u64) + Send + 'static,
) -> Result<Box<dyn Source + Send>, LogError> {
    if path == Path::new("-") {
        return open_standard_input(mapping);
    }
    let name = path.display().to_string();
    let reading = |error| LogError::reading(&name, error);
    let mut file = File::open(path).map_err(reading)?;
    let facts = file.metadata().map_err(reading)?;
    if facts.is_dir() {
        return Err(LogError::Folder { name });
    }
    let head = head_of(&mut file).map_err(reading)?;
    let kind = LogKind::of(&head, &name)?;
    let source: Box<dyn Source + Send> = match kind {
        LogKind::Mcap => {
            file.rewind().map_err(|_| mcap_from_pipe(&name))?;
            let file = CountedReader::new(file, facts.len(), on_bytes);
            Box::new(McapSource::new(file, &name, mapping.places())?)
        }
        // What has been read of a pipe does not come again.
        LogKind::Csv | LogKind::Candump => {
            let text = CountedReader::new(Cursor::new(head).chain(file), facts.len(), on_bytes);
            open_text(kind, text, &name, mapping)?
        }
    };
    Ok(Box::new(Usable { source, name, samples: 0, usable: false }))
}

fn open_standard_input(mapping: &LogMapping) -> Result<Box<dyn Source + Send>, LogError> {
    let name = "standard input";
    let mut input = std::io::stdin();
    let head = head_of(&mut input).map_err(|error| LogError::reading(name, error))?;
    let source = match LogKind::of(&head, name)? {
        LogKind::Mcap => return Err(mcap_from_pipe(name)),
        kind => open_text(kind, Cursor::new(head).chain(input), name, mapping)?,
    };
    Ok(Box::new(Usable { source, name: name.into(), samples: 0, usable: false }))
}

/// The bytes by which a log's kind is told.
fn head_of(input: &mut impl Read) -> std::io::Result<Vec<u8>> {
    let mut head = Vec::with_capacity(HEAD_BYTES);
    input.take(HEAD_BYTES as u64).read_to_end(&mut head)?;
    Ok(head)
}

fn mcap_from_pipe(name: &str) -> LogError {
    LogError::data(name, "this is an MCAP log; name its file, since MCAP is not read from a pipe")
}

/// A log that ends in a failure where none of its commands was a number: nobody is to take silence for health.
struct Usable {
    source: Box<dyn Source + Send>,
    name: String,
    samples: u64,
    usable: bool,
}

impl Source for Usable {
    fn next_sample(&mut self) -> Result<Option<Sample>, LogError> {
        let sample = self.source.next_sample()?;
        match &sample {
            Some(sample) => {
                self.samples += 1;
                self.usable |= sample.get(Signal::Command).is_some_and(f64::is_finite);
            }
            None if self.usable => {}
            None => {
                let what = format!("none of its {} commands is a number", self.samples);
                return Err(LogError::data(&self.name, what));
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
/// [`LogError`] where the DBC file cannot be read, or nothing says where a mapped signal is.
pub fn frame_decoder(mapping: &LogMapping) -> Result<FrameDecoder, LogError> {
    let dbc = mapping.dbc.as_deref().map(Dbc::read).transpose()?;
    FrameDecoder::new(mapping.places(), mapping.counter.as_ref(), dbc.as_ref())
}

fn open_text(
    kind: LogKind,
    input: impl Read + Send + 'static,
    name: &str,
    mapping: &LogMapping,
) -> Result<Box<dyn Source + Send>, LogError> {
    if kind == LogKind::Candump {
        let decoder = frame_decoder(mapping).map_err(|error| match error {
            LogError::Mapping { what } if mapping.dbc.is_none() => {
                LogError::mapping(format!("{name}: this is a CAN log; {what}"))
            }
            other => other,
        })?;
        return Ok(Box::new(CandumpSource::new(input, name, decoder)));
    }
    let LogMapping { time_column, time_unit, .. } = mapping;
    Ok(Box::new(CsvSource::new(input, name, &mapping.places(), time_column, *time_unit)?))
}
