//! Where samples come from: one file a kind of source.

pub mod csv;
pub mod decode;
pub mod fields;
pub mod mcap;
pub mod mcap_file;
pub mod ros;
pub mod survey;

use std::fs::File;
use std::io::Read;
use std::path::Path;

use seepd_signals::Sample;

use crate::config::Config;
use crate::failure::{Code, Failure};

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

/// First bytes of an MCAP file.
pub const MCAP_MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";

/// Opens a log by its content, whatever its name; `-` is a CSV text on standard input.
///
/// # Errors
/// [`Failure`] where there is no such file, it is empty, or it is of no kind that is read.
pub fn open(path: &Path, config: &Config, topic: Option<&str>) -> Result<Box<dyn Source>, Failure> {
    let mapping = config.mapping(topic);
    if path == Path::new("-") {
        return Ok(Box::new(csv::CsvSource::new(
            std::io::stdin(),
            "standard input",
            mapping,
            &config.time_column,
        )?));
    }
    let reading = |error| Failure::reading(path, &error);
    let mut file = File::open(path).map_err(reading)?;
    if file.metadata().map_err(reading)?.is_dir() {
        return Err(Failure::new(Code::NoInput, format!("{}: is a folder; name a log file", path.display())));
    }
    let mut head = Vec::with_capacity(512);
    file.by_ref().take(512).read_to_end(&mut head).map_err(reading)?;
    let name = path.display().to_string();
    let kind = LogKind::of(&head, &name)?;
    let file = File::open(path).map_err(reading)?;
    Ok(match kind {
        LogKind::Mcap => Box::new(mcap::McapSource::new(file, &name, mapping)?),
        LogKind::Csv => Box::new(csv::CsvSource::new(file, &name, mapping, &config.time_column)?),
    })
}

/// The kinds of logs that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LogKind {
    Mcap,
    Csv,
}

impl LogKind {
    /// Tells a log's kind by its first bytes, whatever its name.
    pub(crate) fn of(head: &[u8], name: &str) -> Result<Self, Failure> {
        if head.is_empty() {
            Err(Failure::data(format!("{name}: the file is empty")))
        } else if head.starts_with(&MCAP_MAGIC[..head.len().min(8)]) {
            Ok(LogKind::Mcap)
        } else if looks_like_text(head) {
            Ok(LogKind::Csv)
        } else {
            Err(Failure::data(format!("{name}: is neither an MCAP log nor a CSV text with a header row")))
        }
    }
}

fn looks_like_text(head: &[u8]) -> bool {
    let printable = |byte: &u8| matches!(byte, b'\t' | b'\n' | b'\r' | 0x20..=0x7e | 0x80..);
    head.iter().all(printable)
        && std::str::from_utf8(head).map_or_else(|error| error.error_len().is_none(), |_| true)
}
