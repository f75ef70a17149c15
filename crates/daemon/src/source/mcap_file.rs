//! The records of an MCAP file, as many as its damages leave.
//!
//! The `mcap` crate decodes chunks, one at a time and checked by their CRC before use, so that a damaged chunk costs
//! itself alone. The walk from record to record is ours: it goes on after a damaged chunk, finds the next one
//! after a damaged length, and reads a chunk that was cut short as far as it goes.

use std::io::{self, BufReader, Read, Seek, SeekFrom};

use mcap::records::op;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::kind::MCAP_MAGIC;

/// Longest record that is believed, bytes: chunks are a few MiB; a flipped bit in a length says petabytes.
const MAX_RECORD_BYTES: u64 = 64 << 20;
/// Opcode and length before each record.
const PREFIX_BYTES: u64 = 9;

/// Footer record (prefix, summary start, summary offset start, CRC) and the magic bytes that end a file.
const FOOTER_AND_MAGIC_BYTES: u64 = PREFIX_BYTES + 8 + 8 + 4 + 8;

/// What was damaged or missing.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Damage {
    /// Chunks that did not pass their checks, with the byte where the first one begins.
    pub chunks: u64,
    /// Byte of the first damage.
    pub first_at: Option<u64>,
    /// Stretches of bytes that were no records.
    pub skipped_bytes: u64,
    /// Byte at which the file ends too early.
    pub cut_at: Option<u64>,
}

impl Damage {
    /// What was damaged, one line each.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if let Some(at) = self.cut_at {
            notes.push(format!("ends at byte {at} in the middle of its data; read up to there"));
        }
        if self.chunks > 0 || self.skipped_bytes > 0 {
            let at = self.first_at.unwrap_or(0);
            notes.push(format!(
                "{} damaged chunks and {} damaged bytes between them left out, the first at byte {at}",
                self.chunks, self.skipped_bytes
            ));
        }
        notes
    }
}

/// Walks through a file's records, those within chunks included.
pub struct McapFile<R> {
    input: BufReader<R>,
    length: u64,
    at: u64,
    chunk: Option<Chunk>,
    /// What was damaged so far.
    pub damage: Damage,
    ended: bool,
}

impl<R: Read + Seek> McapFile<R> {
    /// Starts after the magic bytes.
    ///
    /// # Errors
    /// The input cannot be read, is shorter than the magic bytes, or has others.
    pub fn new(mut input: R) -> io::Result<Self> {
        let length = input.seek(SeekFrom::End(0))?;
        input.seek(SeekFrom::Start(0))?;
        let mut input = BufReader::with_capacity(1 << 16, input);
        let mut magic = [0; 8];
        input.read_exact(&mut magic)?;
        if &magic != MCAP_MAGIC {
            return Err(io::Error::new(
                io::ErrorKind::InvalidData,
                "the first bytes are not those of an MCAP file",
            ));
        }
        Ok(McapFile { input, length, at: 8, chunk: None, damage: Damage::default(), ended: false })
    }

    /// Puts the next record's content into `record` and gives its opcode; `None` after the data section, or where
    /// the file ends.
    ///
    /// # Errors
    /// Reading failed; damages are no error.
    pub fn next_record(&mut self, record: &mut Vec<u8>) -> io::Result<Option<u8>> {
        loop {
            if let Some(chunk) = &mut self.chunk {
                match chunk.next_record(record) {
                    Some(Ok(opcode)) => return Ok(Some(opcode)),
                    Some(Err(_)) if !chunk.cut => {
                        self.damage.chunks += 1;
                        self.damage.first_at.get_or_insert(chunk.begin);
                    }
                    Some(Err(_)) | None => {}
                }
                self.chunk = None;
            }
            if self.ended {
                return Ok(None);
            }
            if let Some(opcode) = self.file_record(record)? {
                return Ok(Some(opcode));
            }
        }
    }

    /// Reads the next record of the file itself: its opcode, or `None` where it opened a chunk or ended the file.
    fn file_record(&mut self, record: &mut Vec<u8>) -> io::Result<Option<u8>> {
        let Some((opcode, length)) = self.prefix()? else { return Ok(None) };
        if opcode == op::DATA_END || opcode == op::FOOTER {
            self.ended = true;
            return Ok(None);
        }
        let known = (op::HEADER..=op::DATA_END).contains(&opcode) || opcode >= 0x80;
        let there = length.min(self.length - self.at - PREFIX_BYTES);
        let cut = there < length;
        // An attachment may be longer than what is worth holding; a length that leads out of the file is a
        // cut file's last record, or damaged.
        if !known || (length > MAX_RECORD_BYTES && (cut || opcode == op::CHUNK)) {
            self.resynchronise()?;
            return Ok(None);
        }
        let begin = self.at;
        self.at += PREFIX_BYTES + there;
        if length > MAX_RECORD_BYTES {
            self.input.seek(SeekFrom::Start(self.at))?;
            return Ok(None);
        }
        record.resize(there as usize, 0);
        self.input.read_exact(record)?;
        if cut && self.damage.first_at.is_none() && opcode != op::CHUNK && self.resumes_within(begin)? {
            return Ok(None);
        }
        if cut {
            self.damage.cut_at = Some(self.length);
            self.ended = true;
        }
        if opcode == op::CHUNK {
            self.chunk = Some(Chunk::new(std::mem::take(record), begin, length, cut));
            return Ok(None);
        }
        Ok((!cut).then_some(opcode))
    }

    /// A record that seems to be cut by the file's end may have a damaged length instead: then chunks follow.
    fn resumes_within(&mut self, begin: u64) -> io::Result<bool> {
        let end = self.at;
        self.at = begin;
        if self.resynchronise()? {
            return Ok(true);
        }
        self.damage = Damage { skipped_bytes: 0, first_at: None, ..self.damage.clone() };
        self.at = end;
        Ok(false)
    }

    /// The schemas and channels in the file's summary: where the chunk that announced a channel is damaged, the summary
    /// still knows it. Reading goes on where it stood.
    ///
    /// # Errors
    /// Reading failed; a summary that is missing or damaged is an empty list.
    pub fn summary_channels(&mut self) -> io::Result<Announced> {
        let stood = self.input.stream_position()?;
        let channels = self.read_summary();
        self.input.seek(SeekFrom::Start(stood))?;
        channels
    }

    fn read_summary(&mut self) -> io::Result<Announced> {
        let mut found = Announced::default();
        let Some(footer_at) = self.length.checked_sub(FOOTER_AND_MAGIC_BYTES) else { return Ok(found) };
        let mut footer = [0; FOOTER_AND_MAGIC_BYTES as usize];
        self.input.seek(SeekFrom::Start(footer_at))?;
        self.input.read_exact(&mut footer)?;
        let mut at = u64::from_le_bytes(std::array::from_fn(|index| footer[PREFIX_BYTES as usize + index]));
        if footer[0] != op::FOOTER || !footer.ends_with(MCAP_MAGIC) || at == 0 {
            return Ok(found);
        }
        while at + PREFIX_BYTES <= footer_at {
            let mut prefix = [0; PREFIX_BYTES as usize];
            self.input.seek(SeekFrom::Start(at))?;
            self.input.read_exact(&mut prefix)?;
            let [opcode, length @ ..] = prefix;
            let length = u64::from_le_bytes(length);
            at += PREFIX_BYTES;
            if length > footer_at - at {
                break;
            }
            if matches!(opcode, op::CHANNEL | op::SCHEMA) && length <= MAX_RECORD_BYTES {
                let mut content = vec![0; length as usize];
                self.input.read_exact(&mut content)?;
                if opcode == op::CHANNEL {
                    found.channels.extend(ChannelRecord::parse(&content));
                } else {
                    found.schemas.extend(SchemaRecord::parse(&content));
                }
            }
            at += length;
        }
        Ok(found)
    }

    /// Opcode and length of the record at hand; notes a cut where there is not even that.
    fn prefix(&mut self) -> io::Result<Option<(u8, u64)>> {
        if self.at + PREFIX_BYTES > self.length {
            self.damage.cut_at = Some(self.length);
            self.ended = true;
            return Ok(None);
        }
        let mut prefix = [0; PREFIX_BYTES as usize];
        self.input.read_exact(&mut prefix)?;
        let [opcode, length @ ..] = prefix;
        Ok(Some((opcode, u64::from_le_bytes(length))))
    }

    /// Looks for the next chunk after something that is no record; whether there is one.
    fn resynchronise(&mut self) -> io::Result<bool> {
        let damaged_at = self.at;
        self.damage.first_at.get_or_insert(damaged_at);
        let mut from = damaged_at + 1;
        let mut window = vec![0; 1 << 20];
        loop {
            self.input.seek(SeekFrom::Start(from))?;
            let there = read_up_to(&mut self.input, &mut window)?;
            let found =
                (0..there).find(|at| chunk_begins(&window[*at..there], self.length - from - *at as u64));
            if let Some(at) = found {
                self.at = from + at as u64;
                self.damage.skipped_bytes += self.at - damaged_at;
                self.input.seek(SeekFrom::Start(self.at))?;
                return Ok(true);
            }
            if there < window.len() {
                self.damage.skipped_bytes += self.length - damaged_at;
                self.ended = true;
                return Ok(false);
            }
            from += (there - CHUNK_HEAD_BYTES) as u64;
        }
    }
}

fn read_up_to(input: &mut impl Read, window: &mut [u8]) -> io::Result<usize> {
    let mut there = 0;
    while there < window.len() {
        match input.read(&mut window[there..])? {
            0 => break,
            read => there += read,
        }
    }
    Ok(there)
}

/// Bytes of a chunk's prefix and header that are looked at: times, sizes, CRC and the compression's name.
const CHUNK_HEAD_BYTES: usize = 9 + 8 + 8 + 8 + 4 + 4 + 4 + 8;

/// Whether a chunk begins here: opcode, length, compression and size have to fit together.
fn chunk_begins(bytes: &[u8], remaining: u64) -> bool {
    if bytes.len() < CHUNK_HEAD_BYTES || bytes[0] != op::CHUNK {
        return false;
    }
    let number = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
    let length = number(1);
    let name_length = u32::from_le_bytes(std::array::from_fn(|i| bytes[37 + i])) as usize;
    if length > MAX_RECORD_BYTES || length > remaining || !matches!(name_length, 0 | 3 | 4) {
        return false;
    }
    let name = &bytes[41..41 + name_length];
    let compressed = number(41 + name_length);
    matches!(name, b"" | b"lz4" | b"zstd") && compressed + 40 + name_length as u64 == length
}

/// A chunk that is being read: fed to the crate's reader as if it were a file of its own.
struct Chunk {
    reader: LinearReader,
    prefix: [u8; PREFIX_BYTES as usize],
    content: Vec<u8>,
    given: usize,
    begin: u64,
    cut: bool,
}

impl Chunk {
    /// Of a chunk whose end is cut off there is no CRC to check, and what is there is taken.
    fn new(content: Vec<u8>, begin: u64, length: u64, cut: bool) -> Self {
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_record_length_limit(MAX_RECORD_BYTES as usize)
            .with_prevalidate_chunk_crcs(!cut);
        let mut prefix = [op::CHUNK; PREFIX_BYTES as usize];
        prefix[1..].copy_from_slice(&length.to_le_bytes());
        Chunk { reader: LinearReader::new_with_options(options), prefix, content, given: 0, begin, cut }
    }

    /// Puts the next record's content into `record` and gives its opcode; an error ends the chunk.
    fn next_record(&mut self, record: &mut Vec<u8>) -> Option<Result<u8, mcap::McapError>> {
        loop {
            match self.reader.next_event()? {
                Ok(LinearReadEvent::ReadRequest(wanted)) => self.give(wanted),
                Ok(LinearReadEvent::Record { opcode, data }) => {
                    record.clear();
                    record.extend_from_slice(data);
                    return Some(Ok(opcode));
                }
                Err(error) => return Some(Err(error)),
            }
        }
    }

    fn give(&mut self, wanted: usize) {
        let into = self.reader.insert(wanted);
        let from = match self.given.checked_sub(self.prefix.len()) {
            Some(given) => &self.content[given..],
            None => &self.prefix[self.given..],
        };
        let length = from.len().min(into.len());
        into[..length].copy_from_slice(&from[..length]);
        self.given += length;
        self.reader.notify_read(length);
    }
}

/// The announcements in a file's summary.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Announced {
    /// Schemas.
    pub schemas: Vec<SchemaRecord>,
    /// Channels.
    pub channels: Vec<ChannelRecord>,
}

/// What announces a channel. Parsed here because the crate reserves memory for a string's length before it looks how
/// much there is: four bytes of damage would ask for 4 GiB.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChannelRecord {
    /// Identifier.
    pub id: u16,
    /// Identifier of the schema; 0 for none.
    pub schema_id: u16,
    /// Topic.
    pub topic: String,
    /// Message encoding.
    pub encoding: String,
}

impl ChannelRecord {
    /// Reads a record's content: identifier, schema's identifier, topic, encoding; `None` where it is too short.
    pub fn parse(content: &[u8]) -> Option<Self> {
        let (id, rest) = content.split_first_chunk::<2>()?;
        let (schema_id, rest) = rest.split_first_chunk::<2>()?;
        let (topic, rest) = split_string(rest)?;
        let (encoding, _metadata) = split_string(rest)?;
        let (id, schema_id) = (u16::from_le_bytes(*id), u16::from_le_bytes(*schema_id));
        Some(ChannelRecord { id, schema_id, topic, encoding })
    }
}

/// What announces a schema.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SchemaRecord {
    /// Identifier.
    pub id: u16,
    /// Name.
    pub name: String,
    /// Encoding, such as `jsonschema`, `protobuf`, `ros2msg`.
    pub encoding: String,
    /// The schema itself.
    pub data: Vec<u8>,
}

impl SchemaRecord {
    /// Reads a record's content; `None` where it is too short.
    pub fn parse(content: &[u8]) -> Option<Self> {
        let (id, rest) = content.split_first_chunk::<2>()?;
        let (name, rest) = split_string(rest)?;
        let (encoding, rest) = split_string(rest)?;
        let (length, rest) = rest.split_first_chunk::<4>()?;
        let data = rest.get(..u32::from_le_bytes(*length) as usize)?.to_vec();
        Some(SchemaRecord { id: u16::from_le_bytes(*id), name, encoding, data })
    }
}

fn split_string(content: &[u8]) -> Option<(String, &[u8])> {
    let (length, rest) = content.split_first_chunk::<4>()?;
    let (text, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    Some((String::from_utf8_lossy(text).into_owned(), rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channel_record_of_wrong_length_is_none() {
        let content = b"\x07\x00\x01\x00\x02\x00\x00\x00/a\x04\x00\x00\x00json\x00\x00\x00\x00";
        let channel = ChannelRecord { id: 7, schema_id: 1, topic: "/a".into(), encoding: "json".into() };
        assert_eq!(ChannelRecord::parse(content), Some(channel));
        assert!((0..content.len() - 4).all(|length| ChannelRecord::parse(&content[..length]).is_none()));
        let mut endless = *content;
        endless[4..8].fill(0xff);
        assert_eq!(ChannelRecord::parse(&endless), None);
    }
}
