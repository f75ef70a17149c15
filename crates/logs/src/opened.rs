//! A log that has been opened: unpacked where it is in an archive, and known by its kind.

use std::fs::File;
use std::io::{self, Chain, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use crate::can::blf::Blf;
use crate::can::logged::FrameLog;
use crate::can::text_log::TextLog;
use crate::counted::CountedReader;
use crate::error::LogError;
use crate::far::is_address;
#[cfg(not(feature = "object-store"))]
use crate::far::not_built;
#[cfg(feature = "object-store")]
use crate::far::{Parts, SILENCE};
use crate::forward::Forward;
use crate::kind::{HEAD_BYTES, LogKind};
use crate::mcap_file::McapFile;
use crate::mdf::MdfFile;
use crate::record_log::RecordLog;
use crate::source::log_name;
use crate::wrapping::Wrapping;

/// What can be read from any place.
pub(crate) trait ReadSeek: Read + Seek {}
impl<T: Read + Seek> ReadSeek for T {}

pub(crate) type Anywhere<'i> = Box<dyn ReadSeek + Send + 'i>;
pub(crate) type Stream<'i> = Box<dyn Read + Send + 'i>;

/// The bytes of a log.
pub(crate) enum Bytes<'i> {
    /// They can be read from any place.
    File(Anywhere<'i>),
    /// They come once.
    Stream(Stream<'i>),
}

/// Where a log's bytes come from, as far as it is known.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Origin<'p> {
    /// The file that has them as they are.
    pub(crate) path: Option<&'p Path>,
    /// Length of the file, packed or not.
    pub(crate) length: Option<u64>,
    /// Whether its bytes come from far away, so that what is not needed had better not be read.
    pub(crate) is_far: bool,
}

/// A log by its kind.
pub(crate) enum Opened<'i> {
    /// MCAP, and what is turned into its records.
    Records(LogKind, Box<dyn RecordLog + Send + 'i>),
    Csv(Stream<'i>),
    Frames(LogKind, Box<dyn FrameLog + Send + 'i>),
    Mdf(Box<MdfFile<'i>>),
}

/// Archives around archives that are unpacked: text of two bytes a character in a gzip archive, once more.
const MOST_WRAPPINGS: usize = 3;
/// An archive whose content has to be read from any place is unpacked into a file without a name, of so many times the archive's size…
const MOST_GROWTH: u64 = 200;
/// … and so many bytes at least.
const LEAST_ROOM: u64 = 1 << 30;

impl Opened<'static> {
    /// Opens a file; `-` is standard input.
    pub(crate) fn at(path: &Path, on_bytes: impl FnMut(u64) + Send + 'static) -> Result<Self, LogError> {
        let name = log_name(path);
        if path == Path::new("-") {
            return Opened::of(Bytes::Stream(Box::new(io::stdin())), &name, Origin::default());
        }
        if is_address(path) {
            return Opened::far(path, &name, on_bytes);
        }
        let reading = |error| LogError::reading(&name, error);
        let file = File::open(path).map_err(reading)?;
        let facts = file.metadata().map_err(reading)?;
        let bytes = facts.len();
        let file = CountedReader::new(file, bytes, on_bytes);
        // What has been read of a pipe does not come again.
        let log = if facts.is_file() { Bytes::File(Box::new(file)) } else { Bytes::Stream(Box::new(file)) };
        let origin = Origin {
            path: facts.is_file().then_some(path),
            length: facts.is_file().then_some(bytes),
            is_far: false,
        };
        Opened::of(log, &name, origin)
    }

    #[cfg(feature = "object-store")]
    fn far(path: &Path, name: &str, on_bytes: impl FnMut(u64) + Send + 'static) -> Result<Self, LogError> {
        let address = path.to_str().unwrap_or_default();
        let parts = Parts::open(address, SILENCE).map_err(|error| LogError::reading(name, error))?;
        let length = parts.length();
        let log = Bytes::File(Box::new(CountedReader::new(parts, length, on_bytes)));
        Opened::of(log, name, Origin { path: None, length: Some(length), is_far: true })
    }

    #[cfg(not(feature = "object-store"))]
    fn far(_path: &Path, name: &str, _on_bytes: impl FnMut(u64)) -> Result<Self, LogError> {
        Err(not_built(name))
    }
}

impl<'i> Opened<'i> {
    /// Opens a log of that name.
    pub(crate) fn of(mut log: Bytes<'i>, name: &str, mut origin: Origin<'_>) -> Result<Self, LogError> {
        let reading = |error| LogError::reading(name, error);
        for _ in 0..=MOST_WRAPPINGS {
            let (head, rest) = log.head().map_err(reading)?;
            log = rest;
            let Some(wrapping) = Wrapping::of(&head) else {
                return Self::of_kind(LogKind::of(&head, name)?, log, name, origin);
            };
            // What is in an archive is not what stands at the path.
            origin.path = None;
            let unwrapped = wrapping.unwrap(log.into_stream().map_err(reading)?);
            log = Bytes::Stream(unwrapped.map_err(reading)?);
        }
        Err(LogError::data(name, "it is an archive in an archive, again and again; unpack it first"))
    }

    fn of_kind(kind: LogKind, log: Bytes<'i>, name: &str, origin: Origin<'_>) -> Result<Self, LogError> {
        let reading = |error| LogError::reading(name, error);
        Ok(match kind {
            LogKind::Mcap => {
                let file = mcap_file(log, origin.is_far).map_err(|error| {
                    LogError::data(name, format!("this is not an MCAP log, or it is cut short: {error}"))
                })?;
                Opened::Records(kind, Box::new(file))
            }
            LogKind::Csv => Opened::Csv(log.into_stream().map_err(reading)?),
            LogKind::Frames(format) => {
                let text = TextLog::new(log.into_stream().map_err(reading)?, format);
                Opened::Frames(kind, Box::new(text))
            }
            LogKind::Blf => {
                let blf = Blf::new(log.into_stream().map_err(reading)?);
                let blf =
                    blf.map_err(|error| LogError::data(name, format!("this is a BLF log, but {error}")))?;
                Opened::Frames(kind, Box::new(blf))
            }
            LogKind::Mdf => Opened::Mdf(Box::new(MdfFile::new(log.into_file(origin, name)?, name)?)),
            LogKind::Bag => bag(log, name, origin)?,
        })
    }
}

fn mcap_file(log: Bytes<'_>, is_far: bool) -> io::Result<McapFile<Anywhere<'_>>> {
    match log {
        Bytes::File(mut file) => {
            let length = file.seek(SeekFrom::End(0))?;
            file.rewind()?;
            let file = McapFile::new(file, Some(length))?;
            Ok(if is_far { file.by_index() } else { file })
        }
        Bytes::Stream(stream) => McapFile::new(Box::new(Forward::new(stream)), None),
    }
}

impl<'i> Bytes<'i> {
    /// The bytes by which a log's kind is told, and all of them again.
    fn head(self) -> io::Result<(Vec<u8>, Bytes<'i>)> {
        let mut head = Vec::with_capacity(HEAD_BYTES);
        Ok(match self {
            Bytes::File(mut file) => {
                file.rewind()?;
                file.by_ref().take(HEAD_BYTES as u64).read_to_end(&mut head)?;
                file.rewind()?;
                (head, Bytes::File(file))
            }
            Bytes::Stream(mut stream) => {
                stream.by_ref().take(HEAD_BYTES as u64).read_to_end(&mut head)?;
                let again: Chain<Cursor<Vec<u8>>, Stream<'i>> = Cursor::new(head.clone()).chain(stream);
                (head, Bytes::Stream(Box::new(again)))
            }
        })
    }

    fn into_stream(self) -> io::Result<Stream<'i>> {
        Ok(match self {
            Bytes::File(mut file) => {
                file.rewind()?;
                Box::new(file)
            }
            Bytes::Stream(stream) => stream,
        })
    }

    /// What can be read from any place; a stream goes into a file without a name, which vanishes with the program.
    fn into_file(self, origin: Origin<'_>, name: &str) -> Result<Anywhere<'i>, LogError> {
        let stream = match self {
            Bytes::File(file) => return Ok(file),
            Bytes::Stream(stream) => stream,
        };
        let mut file = tempfile::tempfile().map_err(|error| unpacking(name, error))?;
        unpack(stream, &mut file, origin, name)?;
        file.rewind().map_err(|error| unpacking(name, error))?;
        Ok(Box::new(file))
    }
}

/// Copies a stream into a file, as much as an archive of that length may hold.
fn unpack(stream: Stream<'_>, file: &mut File, origin: Origin<'_>, name: &str) -> Result<(), LogError> {
    let most =
        origin.length.map_or(u64::MAX - 1, |length| length.saturating_mul(MOST_GROWTH).max(LEAST_ROOM));
    let copied = io::copy(&mut stream.take(most + 1), file).map_err(|error| unpacking(name, error))?;
    if copied > most {
        let what = format!("it unpacks to more than {MOST_GROWTH} times its size; unpack it first");
        return Err(LogError::data(name, what));
    }
    Ok(())
}

fn unpacking(name: &str, error: io::Error) -> LogError {
    let what = format!("unpacking it into {}: {error}", std::env::temp_dir().display());
    LogError::reading(name, io::Error::new(error.kind(), what))
}

#[cfg(feature = "bags")]
fn bag<'i>(log: Bytes<'i>, name: &str, origin: Origin<'_>) -> Result<Opened<'i>, LogError> {
    use crate::bag::Bag;

    let bag = match (log, origin.path) {
        (Bytes::File(_), Some(path)) => Bag::open(path, name)?,
        (log, _) => {
            // SQLite keeps the file open; its name may go.
            let mut file = tempfile::NamedTempFile::new().map_err(|error| unpacking(name, error))?;
            let stream = log.into_stream().map_err(|error| LogError::reading(name, error))?;
            unpack(stream, file.as_file_mut(), origin, name)?;
            Bag::open(file.path(), name)?
        }
    };
    Ok(Opened::Records(LogKind::Bag, Box::new(bag)))
}

#[cfg(not(feature = "bags"))]
fn bag<'i>(_log: Bytes<'i>, name: &str, _origin: Origin<'_>) -> Result<Opened<'i>, LogError> {
    let what = "this is an SQLite file, perhaps a ROS 2 bag, which this build does not read; convert it: pip install rosbags; \
                rosbags-convert --src FOLDER --dst OTHER_FOLDER --dst-storage mcap";
    Err(LogError::data(name, what))
}
