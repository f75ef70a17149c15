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
#[cfg(feature = "live")]
pub mod live;
pub mod mcap;
pub mod mcap_file;
pub mod protobuf;
pub mod record;
pub mod ros;
#[cfg(feature = "live")]
pub mod socketcan;
pub mod survey;

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use indicatif::ProgressBar;
use seepd_signals::Sample;

use crate::can::dbc::Dbc;
use crate::can::decode::FrameDecoder;
use crate::config::Config;
use crate::failure::{Code, Failure};
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
    if file.metadata().map_err(reading)?.is_dir() {
        return Err(Failure::new(Code::NoInput, format!("{}: is a folder; name a log file", path.display())));
    }
    let mut head = Vec::with_capacity(HEAD_BYTES);
    file.by_ref().take(HEAD_BYTES as u64).read_to_end(&mut head).map_err(reading)?;
    let name = path.display().to_string();
    let kind = LogKind::of(&head, &name)?;
    let file = bar.wrap_read(File::open(path).map_err(reading)?);
    match kind {
        LogKind::Mcap => Ok(Box::new(mcap::McapSource::new(file, &name, config.mapping())?)),
        LogKind::Csv | LogKind::Candump => open_text(kind, file, &name, config),
    }
}

fn open_standard_input(config: &Config) -> Result<Box<dyn Source + Send>, Failure> {
    let name = "standard input";
    let mut input = BufReader::new(std::io::stdin());
    let head = input.fill_buf().map_err(|error| Failure::new(Code::Io, format!("{name}: {error}")))?;
    match LogKind::of(&head[..head.len().min(HEAD_BYTES)], name)? {
        LogKind::Mcap => {
            Err(Failure::data(format!("{name}: is an MCAP log; name its file, MCAP is not read from a pipe")))
        }
        kind => open_text(kind, input, name, config),
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
    Ok(Box::new(csv::CsvSource::new(input, name, mapping, &config.time_column)?))
}
