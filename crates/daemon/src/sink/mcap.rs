//! MCAP logs: simulated signals and truth, and estimates and flags.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Write};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Attachment, Compression, McapError, WriteOptions, Writer};
use seepd_monitor::event::Event;

/// Library name in the files' header.
const LIBRARY: &str = concat!("seepd ", env!("CARGO_PKG_VERSION"));
/// Bytes after which a chunk is closed.
const CHUNK_BYTES: u64 = 1 << 20;

/// Compression of the chunks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "simulate", derive(clap::ValueEnum))]
pub enum ChunkCompression {
    /// Zstandard.
    #[default]
    Zstd,
    /// LZ4.
    Lz4,
    /// None.
    None,
}

/// What the system said: the library's own text is "I/O error" and no more.
fn plainly(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

/// Writes messages to channels.
pub struct McapSink<W: Write> {
    writer: Writer<NoSeek<W>>,
    sequence: BTreeMap<u16, u32>,
}

impl<W: Write> McapSink<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// Writing failed.
    pub fn new(out: W, compression: ChunkCompression) -> io::Result<Self> {
        let compression = match compression {
            ChunkCompression::Zstd => Some(Compression::Zstd),
            ChunkCompression::Lz4 => Some(Compression::Lz4),
            ChunkCompression::None => None,
        };
        let options = WriteOptions::new().profile("").library(LIBRARY).compression(compression);
        Self::begin(options, out)
    }

    /// Begins a file that may be cut short at any moment: whole chunks, which [`flush`](Self::flush) closes.
    ///
    /// # Errors
    /// Writing failed.
    #[cfg(feature = "live")]
    pub fn new_for_recording(out: W) -> io::Result<Self> {
        let options = WriteOptions::new().profile("").library(LIBRARY).compression(Some(Compression::Lz4));
        Self::begin(options, out)
    }

    /// Chunks are written whole: a pipe cannot go back, and `/dev/null` does not know where it is.
    fn begin(options: WriteOptions, out: W) -> io::Result<Self> {
        let options = options.disable_seeking(true).chunk_size(Some(CHUNK_BYTES));
        let writer = options.create(NoSeek::new(out)).map_err(plainly)?;
        Ok(McapSink { writer, sequence: BTreeMap::new() })
    }

    /// Closes the open chunk and hands it to the system.
    ///
    /// # Errors
    /// Writing failed.
    #[cfg(feature = "live")]
    pub fn flush(&mut self) -> io::Result<()> {
        self.writer.flush().map_err(plainly)
    }

    /// Adds a channel of JSON messages; the schema is a JSON schema.
    ///
    /// # Errors
    /// Writing failed.
    pub fn add_channel(&mut self, topic: &str, schema_name: &str, schema: &str) -> io::Result<u16> {
        let schema = self.writer.add_schema(schema_name, "jsonschema", schema.as_bytes()).map_err(plainly)?;
        self.writer.add_channel(schema, topic, "json", &BTreeMap::new()).map_err(plainly)
    }

    /// Writes a message.
    ///
    /// # Errors
    /// Writing failed.
    pub fn write(&mut self, channel_id: u16, time_ns: i64, json: &[u8]) -> io::Result<()> {
        let time = time_ns.max(0) as u64;
        let sequence = self.sequence.entry(channel_id).or_default();
        *sequence += 1;
        let header = MessageHeader { channel_id, sequence: *sequence, log_time: time, publish_time: time };
        self.writer.write_to_known_channel(&header, json).map_err(plainly)
    }

    /// Adds facts about the file.
    ///
    /// # Errors
    /// Writing failed.
    pub fn write_metadata(&mut self, name: &str, facts: BTreeMap<String, String>) -> io::Result<()> {
        self.writer.write_metadata(&Metadata { name: name.into(), metadata: facts }).map_err(plainly)
    }

    /// Adds a file within the file.
    ///
    /// # Errors
    /// Writing failed.
    pub fn attach(&mut self, name: &str, media_type: &str, content: &[u8]) -> io::Result<()> {
        let attachment = Attachment {
            log_time: 0,
            create_time: 0,
            name: name.into(),
            media_type: media_type.into(),
            data: Cow::Borrowed(content),
        };
        self.writer.attach(&attachment).map_err(plainly)
    }

    /// Writes index and footer; nothing can be written after that.
    ///
    /// # Errors
    /// Writing failed.
    pub fn finish(&mut self) -> io::Result<()> {
        self.writer.finish().map(drop).map_err(plainly)
    }

    /// What the file was written into.
    pub fn into_inner(self) -> W {
        self.writer.into_inner().into_inner()
    }
}

/// Schemas of what is written.
pub mod schema {
    /// `/axis/signals`.
    pub const SIGNALS: &str = r#"{"title":"seepd.Signals","type":"object","properties":{"command":{"type":"number"},"demand":{"type":"number"},"position":{"type":"number"},"p_supply":{"type":"number"},"p_inlet":{"type":"number"},"p_cap":{"type":"number"},"p_rod":{"type":"number"},"load":{"type":"number"},"cycle_start":{"type":"number"}}}"#;
    /// Any JSON object.
    #[cfg(any(feature = "gap", feature = "live"))]
    pub const ANY: &str = r#"{"type":"object"}"#;
    /// `/axis/truth`.
    pub const TRUTH: &str = r#"{"title":"seepd.Truth","type":"object","properties":{"leak_area":{"type":"number"},"leak_flow":{"type":"number"}}}"#;
    /// `/axis/leakage`.
    pub const CYCLE: &str = r#"{"title":"seepd.cycle/1","type":"object","properties":{"schema":{"const":"seepd.cycle/1"},"axis":{"type":"string"},"cycle":{"type":"integer"},"t_start_s":{"type":"number"},"t_end_s":{"type":"number"},"t_start_ns":{"type":"integer"},"leak_area_m2":{"type":["number","null"]},"leak_flow_lpm":{"type":["number","null"]},"reference_dp_pa":{"type":"number"},"flag":{"type":"string"},"reason":{"type":["string","null"]},"cause":{"type":"string"},"cause_probability":{"type":"number"},"cause_also":{"type":["string","null"]},"cause_candidates":{"type":"array","items":{"type":"object"}},"distinguish":{"type":"array","items":{"type":"string"}},"onset_cycle":{"type":["integer","null"]},"conditions":{"type":"array","items":{"type":"object"}}}}"#;
    /// `/axis/notices`.
    pub const NOTICE: &str = r#"{"title":"seepd.notice/1","type":"object","properties":{"schema":{"const":"seepd.notice/1"},"axis":{"type":"string"},"notice":{"type":"string"},"text":{"type":"string"},"cycle":{"type":"integer"},"t_s":{"type":"number"}}}"#;
    /// `/axis/flags`.
    pub const EVENT: &str = r#"{"title":"seepd.event/1","type":"object","properties":{"schema":{"const":"seepd.event/1"},"axis":{"type":"string"},"flag_from":{"type":"string"},"flag_to":{"type":"string"},"cycle":{"type":"integer"},"t_s":{"type":"number"},"evidence":{"type":"object"}}}"#;
}

/// Writes cycles to `/axis/leakage`, changes of flag to `/axis/flags` and notices to `/axis/notices`.
pub struct EventSink<W: Write> {
    sink: McapSink<W>,
    leakage: u16,
    flags: u16,
    notices: u16,
    line: Vec<u8>,
}

impl<W: Write> EventSink<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// Writing failed.
    pub fn new(out: W) -> io::Result<Self> {
        let mut sink = McapSink::new(out, ChunkCompression::default())?;
        let leakage = sink.add_channel("/axis/leakage", "seepd.cycle/1", schema::CYCLE)?;
        let flags = sink.add_channel("/axis/flags", "seepd.event/1", schema::EVENT)?;
        let notices = sink.add_channel("/axis/notices", "seepd.notice/1", schema::NOTICE)?;
        Ok(EventSink { sink, leakage, flags, notices, line: Vec::new() })
    }

    /// Writes an event: a cycle at its end, a flag at its change.
    ///
    /// # Errors
    /// Writing failed.
    pub fn write_event(&mut self, event: &Event<'_>) -> io::Result<()> {
        self.line.clear();
        let (channel, time_ns, result) = match event {
            Event::Cycle(line) => {
                (self.leakage, line.t_end_ns(), serde_json::to_writer(&mut self.line, line))
            }
            Event::Flag(flag) => (self.flags, flag.t_ns, serde_json::to_writer(&mut self.line, flag)),
            Event::Notice(notice) => {
                (self.notices, notice.t_ns, serde_json::to_writer(&mut self.line, notice))
            }
        };
        result?;
        self.sink.write(channel, time_ns, &self.line)
    }

    /// Writes index and footer, and gives back what the file was written into.
    ///
    /// # Errors
    /// Writing failed.
    pub fn finish(mut self) -> io::Result<W> {
        self.sink.finish()?;
        Ok(self.sink.into_inner())
    }
}
