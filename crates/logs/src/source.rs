//! A log as a stream of samples, whatever its kind.

use std::path::Path;

use seepd_signals::{Sample, Signal};

use crate::bus_log::BusLogSource;
use crate::can::dbc::Dbc;
use crate::can::decode::FrameDecoder;
use crate::can::logged::FrameLog;
use crate::csv::CsvSource;
use crate::error::LogError;
use crate::far::{is_address, told};
use crate::mapping::LogMapping;
use crate::mcap::McapSource;
use crate::mdf::{MdfFile, MdfFrames, MdfSource};
use crate::opened::Opened;
use crate::series::{Series, is_series, logs_of};

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

/// Opens a log by its content, whatever its name; `-` is standard input, a folder or a pattern the logs in it, one after the other.
///
/// # Errors
/// [`LogError`] where there is no such file, it is empty, or it is of no kind that is read.
pub fn open(path: &Path, mapping: &LogMapping) -> Result<Box<dyn Source + Send>, LogError> {
    open_with(path, mapping, |_| {})
}

/// As [`open`]; `on_bytes` hears how many more bytes of the log have been read, [`bytes_of`](crate::bytes_of) in all. It hears nothing of
/// standard input.
///
/// # Errors
/// As [`open`].
pub fn open_with(
    path: &Path,
    mapping: &LogMapping,
    on_bytes: impl FnMut(u64) + Clone + Send + 'static,
) -> Result<Box<dyn Source + Send>, LogError> {
    if is_series(path) {
        return Ok(Box::new(Series::new(logs_of(path)?, mapping, on_bytes)));
    }
    open_file(path, mapping, on_bytes)
}

/// As [`open_with`], of one log.
pub(crate) fn open_file(
    path: &Path,
    mapping: &LogMapping,
    on_bytes: impl FnMut(u64) + Send + 'static,
) -> Result<Box<dyn Source + Send>, LogError> {
    let log = Opened::at(path, on_bytes)?;
    let name = log_name(path);
    let source = of_opened(log, &name, mapping)?;
    Ok(Box::new(Usable { source, name, samples: 0, usable: false }))
}

/// What messages call a log: its path, or its address without what may be secret in it.
pub fn log_name(path: &Path) -> String {
    if path == Path::new("-") {
        "standard input".into()
    } else if is_address(path) {
        told(&path.display().to_string())
    } else {
        path.display().to_string()
    }
}

pub(crate) fn of_opened<'i>(
    log: Opened<'i>,
    name: &str,
    mapping: &LogMapping,
) -> Result<Box<dyn Source + Send + 'i>, LogError> {
    Ok(match log {
        Opened::Records(_, file) => Box::new(McapSource::of(file, name, mapping.places())),
        Opened::Csv(text) => Box::new(CsvSource::new(text, name, mapping)?),
        Opened::Frames(_, frames) => Box::new(BusLogSource::new(frames, name, log_decoder(name, mapping)?)),
        Opened::Mdf(file) => mdf_source(*file, name, mapping)?,
    })
}

/// Samples from an MDF log: from the frames of a bus where the mapping has what tells fields in them, else from what was measured.
fn mdf_source<'i>(
    file: MdfFile<'i>,
    name: &str,
    mapping: &LogMapping,
) -> Result<Box<dyn Source + Send + 'i>, LogError> {
    let places = mapping.places();
    let in_frames = mapping.dbc.is_some() || places.iter().any(|(_, place)| place.bits.is_some());
    if file.has_frames() && (in_frames || !file.has_signals()) {
        let frames = Box::new(MdfFrames::new(file).map_err(|error| LogError::reading(name, error))?);
        return Ok(Box::new(BusLogSource::new(frames, name, log_decoder(name, mapping)?)));
    }
    Ok(Box::new(MdfSource::new(file, name, places)?))
}

/// The frames of a bus's log, as they are.
///
/// # Errors
/// [`LogError`] where it cannot be read, or has none.
pub fn frames(path: &Path) -> Result<Box<dyn FrameLog + Send>, LogError> {
    let name = log_name(path);
    match Opened::at(path, |_| {})? {
        Opened::Frames(_, frames) => Ok(frames),
        Opened::Mdf(file) if file.has_frames() => {
            Ok(Box::new(MdfFrames::new(*file).map_err(|error| LogError::reading(name, error))?))
        }
        _ => Err(LogError::data(name, "this is no log of a bus")),
    }
}

/// The decoder for a log's frames.
fn log_decoder(name: &str, mapping: &LogMapping) -> Result<FrameDecoder, LogError> {
    frame_decoder(mapping).map_err(|error| match error {
        LogError::Mapping { what } if mapping.dbc.is_none() => {
            LogError::mapping(format!("{name}: this is a CAN log; {what}"))
        }
        other => other,
    })
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
