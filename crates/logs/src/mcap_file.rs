//! The records of an MCAP file, as many as its damages leave.
//!
//! The walk goes on after a damaged chunk, finds the next one after a damaged length, and reads a chunk that was cut short
//! as far as it goes. Chunks are checked by their CRC before use, so that a damaged one costs itself alone, and unpacked as a
//! stream, twice: whatever a file says of its sizes, what is held of it is one packed chunk and one record.

use std::collections::BTreeMap;
use std::io::{self, BufReader, Read, Seek, SeekFrom};

use mcap::records::op;

use super::kind::MCAP_MAGIC;
use super::mcap_chunk::Chunk;
use crate::record_log::RecordLog;

/// Longest chunk that is believed, bytes as it is packed: they are a few MiB; a flipped bit in a length says petabytes.
const LONGEST_CHUNK: u64 = 32 << 20;
/// Longest other record that is held, bytes; longer ones are pictures and attachments, and passed over.
pub(crate) const LONGEST_RECORD: u64 = 8 << 20;
/// Opcode and length before each record.
pub(super) const PREFIX_BYTES: u64 = 9;

/// Footer record (prefix, summary start, summary offset start, CRC) and the magic bytes that end a file.
const FOOTER_AND_MAGIC_BYTES: u64 = PREFIX_BYTES + 8 + 8 + 4 + 8;

/// What was damaged or missing.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Damage {
    /// Chunks that did not pass their checks, with the byte where the first one begins.
    pub chunks: u64,
    /// Byte of the first damage.
    pub first_at: Option<u64>,
    /// Stretches of bytes that were no records.
    pub skipped_bytes: u64,
    /// Byte at which the file ends too early.
    pub cut_at: Option<u64>,
    /// Messages that are longer than what is held.
    pub passed_over: u64,
}

impl Damage {
    fn chunk_at(&mut self, begin: u64) {
        self.chunks += 1;
        self.first_at.get_or_insert(begin);
    }

    /// What was damaged, one line each.
    pub(crate) fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if let Some(at) = self.cut_at {
            notes.push(format!(
                "the log ends at byte {at} in the middle of its data; it was read up to there"
            ));
        }
        if self.chunks > 0 || self.skipped_bytes > 0 {
            let at = self.first_at.unwrap_or(0);
            notes.push(format!(
                "{} damaged chunks and {} damaged bytes between them were left out, the first at byte {at}",
                self.chunks, self.skipped_bytes
            ));
        }
        if self.passed_over > 0 {
            let (count, longest) = (self.passed_over, LONGEST_RECORD >> 20);
            notes.push(format!("{count} messages longer than {longest} MiB were passed over"));
        }
        notes
    }
}

/// Walks through a file's records, those within chunks included.
pub(crate) struct McapFile<R> {
    input: BufReader<R>,
    /// Bytes in all; of a stream as many as there can be, until its end is found.
    length: u64,
    is_stream: bool,
    at: u64,
    chunk: Option<Chunk>,
    /// Memory for a chunk's records, kept from chunk to chunk.
    held: Vec<u8>,
    /// What was damaged so far.
    pub damage: Damage,
    ended: bool,
    /// Whether the index is worth a way to the file's end.
    is_by_index: bool,
    /// Chunks without a message that is wanted, by their first bytes: bytes of them and of what belongs to them.
    unwanted: BTreeMap<u64, u64>,
}

impl<R: Read + Seek> McapFile<R> {
    /// Starts after the magic bytes of a file of a length; that of a stream is not known before its end.
    ///
    /// # Errors
    /// The input cannot be read, is shorter than the magic bytes, or has others.
    pub(crate) fn new(input: R, length: Option<u64>) -> io::Result<Self> {
        let mut input = BufReader::with_capacity(1 << 16, input);
        let mut magic = [0; 8];
        input.read_exact(&mut magic)?;
        if &magic != MCAP_MAGIC {
            return Err(io::Error::new(
                io::ErrorKind::InvalidData,
                "the first bytes are not those of an MCAP file",
            ));
        }
        Ok(McapFile {
            input,
            length: length.unwrap_or(u64::MAX),
            is_stream: length.is_none(),
            at: 8,
            chunk: None,
            held: Vec::new(),
            damage: Damage::default(),
            ended: false,
            is_by_index: false,
            unwanted: BTreeMap::new(),
        })
    }

    /// The same file, read by its index: what is not wanted is not read. What is damaged there is not told.
    pub(crate) fn by_index(self) -> Self {
        McapFile { is_by_index: true, ..self }
    }

    /// Starts after the magic bytes of what can be read from any place.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub(crate) fn whole(mut input: R) -> io::Result<Self> {
        let length = input.seek(SeekFrom::End(0))?;
        input.seek(SeekFrom::Start(0))?;
        Self::new(input, Some(length))
    }

    /// Puts the next record's content into `record` and gives its opcode; `None` after the data section, or where
    /// the file ends.
    ///
    /// # Errors
    /// Reading failed; damages are no error.
    fn next(&mut self, record: &mut Vec<u8>) -> io::Result<Option<u8>> {
        loop {
            if let Some(chunk) = &mut self.chunk {
                match chunk.next_record(record, &mut self.damage) {
                    Ok(Some(opcode)) => return Ok(Some(opcode)),
                    Err(_) if !chunk.cut => self.damage.chunk_at(chunk.begin),
                    Err(_) | Ok(None) => {}
                }
                self.held = self.chunk.take().map_or_else(Vec::new, Chunk::into_held);
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
        let mut cut = there < length;
        let longest = if opcode == op::CHUNK { LONGEST_CHUNK } else { LONGEST_RECORD };
        // A picture or an attachment may be longer than what is worth holding; a length that leads out of the file is a
        // cut file's last record, or damaged.
        if !known || (length > longest && (cut || opcode == op::CHUNK)) {
            self.resynchronise()?;
            return Ok(None);
        }
        let begin = self.at;
        self.at += PREFIX_BYTES + there;
        if length > longest {
            self.damage.passed_over += u64::from(opcode == op::MESSAGE);
            self.at = self.at.min(self.input.seek(SeekFrom::Start(self.at))?);
            return Ok(None);
        }
        record.resize(there as usize, 0);
        let read = read_up_to(&mut self.input, record)? as u64;
        if read < there {
            cut = true;
            record.truncate(read as usize);
            self.at = begin + PREFIX_BYTES + read;
            self.length = self.at;
        }
        if cut && self.damage.first_at.is_none() && opcode != op::CHUNK && self.resumes_within(begin)? {
            return Ok(None);
        }
        if cut {
            self.damage.cut_at = Some(self.length);
            self.ended = true;
        }
        if opcode == op::CHUNK {
            match Chunk::open(record, &mut self.held, begin, cut) {
                Ok(chunk) => self.chunk = Some(chunk),
                Err(_) if cut => {}
                Err(_) => self.damage.chunk_at(begin),
            }
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

    /// Hands the schemas, channels and entries of the index in the file's summary, by opcode and content, to `take`: where the chunk
    /// that announced a channel is damaged, the summary still knows it. Reading goes on where it stood.
    ///
    /// # Errors
    /// Reading failed; a summary that is missing or damaged is an empty one.
    fn summary(&mut self, take: &mut dyn FnMut(u8, &[u8])) -> io::Result<()> {
        if self.is_stream {
            return Ok(());
        }
        let stood = self.input.stream_position()?;
        let result = self.read_summary(take);
        self.input.seek(SeekFrom::Start(stood))?;
        result
    }

    /// Goes past chunks without a message that is wanted.
    fn pass_over(&mut self) -> io::Result<()> {
        let begin = self.at;
        while let Some(bytes) = self.unwanted.get(&self.at) {
            self.at = self.at.saturating_add(*bytes).min(self.length);
        }
        if self.at > begin {
            self.input.seek(SeekFrom::Start(self.at))?;
        }
        Ok(())
    }

    fn read_summary(&mut self, take: &mut dyn FnMut(u8, &[u8])) -> io::Result<()> {
        let Some(footer_at) = self.length.checked_sub(FOOTER_AND_MAGIC_BYTES) else { return Ok(()) };
        let mut footer = [0; FOOTER_AND_MAGIC_BYTES as usize];
        self.input.seek(SeekFrom::Start(footer_at))?;
        self.input.read_exact(&mut footer)?;
        let mut at = u64::from_le_bytes(std::array::from_fn(|index| footer[PREFIX_BYTES as usize + index]));
        if footer[0] != op::FOOTER || !footer.ends_with(MCAP_MAGIC) || at == 0 {
            return Ok(());
        }
        let mut content = Vec::new();
        // A damaged footer points anywhere; beyond the file there is no summary.
        while at < footer_at && footer_at - at >= PREFIX_BYTES {
            let mut prefix = [0; PREFIX_BYTES as usize];
            self.input.seek(SeekFrom::Start(at))?;
            self.input.read_exact(&mut prefix)?;
            let [opcode, length @ ..] = prefix;
            let length = u64::from_le_bytes(length);
            at += PREFIX_BYTES;
            if length > footer_at - at {
                break;
            }
            if matches!(opcode, op::CHANNEL | op::SCHEMA | op::CHUNK_INDEX) && length <= LONGEST_RECORD {
                content.resize(length as usize, 0);
                self.input.read_exact(&mut content)?;
                take(opcode, &content);
            }
            at += length;
        }
        Ok(())
    }

    /// Opcode and length of the record at hand; notes a cut where there is not even that.
    fn prefix(&mut self) -> io::Result<Option<(u8, u64)>> {
        self.pass_over()?;
        if self.at + PREFIX_BYTES > self.length {
            self.damage.cut_at = Some(self.length);
            self.ended = true;
            return Ok(None);
        }
        let mut prefix = [0; PREFIX_BYTES as usize];
        let there = read_up_to(&mut self.input, &mut prefix)? as u64;
        if there < PREFIX_BYTES {
            self.length = self.at + there;
            self.damage.cut_at = Some(self.length);
            self.ended = true;
            return Ok(None);
        }
        let [opcode, length @ ..] = prefix;
        Ok(Some((opcode, u64::from_le_bytes(length))))
    }

    /// Looks for the next chunk after something that is no record; whether there is one.
    fn resynchronise(&mut self) -> io::Result<bool> {
        let damaged_at = self.at;
        self.damage.first_at.get_or_insert(damaged_at);
        let mut from = damaged_at + 1;
        // Most damages are short; the window grows with what is searched in vain.
        let mut window = vec![0; 1 << 12];
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
                self.length = self.length.min(from + there as u64);
                self.damage.skipped_bytes += self.length - damaged_at;
                self.ended = true;
                return Ok(false);
            }
            from += (there - CHUNK_HEAD_BYTES) as u64;
            window.resize((2 * window.len()).min(1 << 20), 0);
        }
    }
}

impl<R: Read + Seek> RecordLog for McapFile<R> {
    fn next_record(&mut self, record: &mut Vec<u8>) -> io::Result<Option<u8>> {
        self.next(record)
    }

    fn each_in_summary(&mut self, take: &mut dyn FnMut(u8, &[u8])) -> io::Result<()> {
        self.summary(take)
    }

    fn has_far_index(&self) -> bool {
        self.is_by_index
    }

    fn only(&mut self, is_wanted: &dyn Fn(u16) -> bool) -> io::Result<()> {
        let mut unwanted = BTreeMap::new();
        self.summary(&mut |opcode, content| {
            if opcode == op::CHUNK_INDEX
                && let Some(chunk) = IndexedChunk::parse(content)
                && !chunk.channels.is_empty()
                && !chunk.channels.iter().any(|id| is_wanted(*id))
            {
                unwanted.insert(chunk.begin, chunk.bytes);
            }
        })?;
        self.unwanted = unwanted;
        Ok(())
    }

    fn notes(&self) -> Vec<String> {
        self.damage.notes()
    }
}

/// A chunk as the summary's index has it.
#[derive(Debug, Clone, PartialEq, Eq)]
struct IndexedChunk {
    /// Its first byte in the file.
    begin: u64,
    /// Its bytes, and those of its messages' index, which follows it.
    bytes: u64,
    /// Channels of its messages; none where its writer made no index of messages.
    channels: Vec<u16>,
}

impl IndexedChunk {
    /// Reads a record's content: times of the first and last message, begin, length, offsets by channel, length of the messages' index.
    fn parse(content: &[u8]) -> Option<Self> {
        let (_times, rest) = content.split_first_chunk::<16>()?;
        let (begin, rest) = rest.split_first_chunk::<8>()?;
        let (length, rest) = rest.split_first_chunk::<8>()?;
        let (offsets_bytes, rest) = rest.split_first_chunk::<4>()?;
        let (offsets, rest) = rest.split_at_checked(u32::from_le_bytes(*offsets_bytes) as usize)?;
        let (index_length, _) = rest.split_first_chunk::<8>()?;
        let channels =
            offsets.chunks_exact(10).map(|entry| u16::from_le_bytes([entry[0], entry[1]])).collect();
        let bytes = u64::from_le_bytes(*length).checked_add(u64::from_le_bytes(*index_length))?;
        (bytes > 0).then_some(IndexedChunk { begin: u64::from_le_bytes(*begin), bytes, channels })
    }
}

pub(super) fn read_up_to(input: &mut impl Read, window: &mut [u8]) -> io::Result<usize> {
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
    if length > LONGEST_CHUNK || length > remaining || !matches!(name_length, 0 | 3 | 4) {
        return false;
    }
    let name = &bytes[41..41 + name_length];
    let compressed = number(41 + name_length);
    matches!(name, b"" | b"lz4" | b"zstd") && length.checked_sub(40 + name_length as u64) == Some(compressed)
}

/// What announces a channel. Parsed here because the crate reserves memory for a string's length before it looks how
/// much there is: four bytes of damage would ask for 4 GiB.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ChannelRecord {
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
    /// Reads a record's content: identifier, schema's identifier, topic, encoding; `None` where it is too short, or a name too long.
    pub(crate) fn parse(content: &[u8]) -> Option<Self> {
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
pub(crate) struct SchemaRecord {
    /// Identifier.
    pub id: u16,
    /// Name.
    pub name: String,
    /// Encoding, such as `jsonschema`, `protobuf`, `ros2msg`.
    pub encoding: String,
    /// The schema itself, where it is in an encoding that messages are decoded by.
    pub data: Vec<u8>,
}

impl SchemaRecord {
    /// Reads a record's content; `None` where it is too short, or a name too long.
    pub(crate) fn parse(content: &[u8]) -> Option<Self> {
        let (id, rest) = content.split_first_chunk::<2>()?;
        let (name, rest) = split_string(rest)?;
        let (encoding, rest) = split_string(rest)?;
        let (length, rest) = rest.split_first_chunk::<4>()?;
        let data = rest.get(..u32::from_le_bytes(*length) as usize)?;
        let is_read = matches!(&*encoding, "protobuf" | "ros2msg");
        let data = if is_read { data.to_vec() } else { Vec::new() };
        Some(SchemaRecord { id: u16::from_le_bytes(*id), name, encoding, data })
    }

    fn bytes(&self) -> usize {
        self.name.len() + self.encoding.len() + self.data.len() + size_of::<Self>()
    }
}

/// The schemas that channels may refer to.
#[derive(Debug, Default)]
pub(crate) struct Schemas {
    kept: BTreeMap<u16, SchemaRecord>,
    bytes: usize,
}

/// Schemas that are kept, bytes.
const SCHEMA_BYTES_KEPT: usize = 8 << 20;

impl Schemas {
    /// Takes a record's content. Where the schemas become too many all are dropped: a schema stands right before the
    /// channels that refer to it.
    pub(crate) fn take(&mut self, content: &[u8]) {
        let Some(schema) = SchemaRecord::parse(content) else { return };
        self.bytes += schema.bytes();
        if self.bytes > SCHEMA_BYTES_KEPT {
            self.kept.clear();
            self.bytes = schema.bytes();
        }
        if let Some(before) = self.kept.insert(schema.id, schema) {
            self.bytes -= before.bytes();
        }
    }

    /// The schema of that identifier.
    pub(crate) fn get(&self, id: u16) -> Option<&SchemaRecord> {
        self.kept.get(&id)
    }
}

/// Longest name of a topic, a schema or an encoding that is believed, bytes.
const LONGEST_NAME: usize = 4096;

fn split_string(content: &[u8]) -> Option<(String, &[u8])> {
    let (length, rest) = content.split_first_chunk::<4>()?;
    let (text, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    (text.len() <= LONGEST_NAME).then(|| (String::from_utf8_lossy(text).into_owned(), rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Found by fuzzing: sizes of damage may be any.
    #[test]
    fn sizes_that_no_number_holds_begin_no_chunk() {
        let head = |compressed: u64| {
            let mut bytes = vec![op::CHUNK];
            bytes.extend(144u64.to_le_bytes());
            bytes.extend([0; 28]);
            bytes.extend(4u32.to_le_bytes());
            bytes.extend(b"zstd");
            bytes.extend(compressed.to_le_bytes());
            bytes
        };
        assert!(chunk_begins(&head(100), 1000));
        for compressed in [99, 101, u64::MAX, u64::MAX - 40, u64::MAX - 43] {
            assert!(!chunk_begins(&head(compressed), 1000), "{compressed}");
        }
    }

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
