//! A chunk of an MCAP file: checked by its CRC, then read record by record.
//!
//! Chunks as they are usually written, of some megabytes, are unpacked once, into memory. A longer one is unpacked as a stream, once for
//! its CRC and once for its records, so that memory does not depend on what it says of itself.

use std::io::{self, BufReader, Cursor, Read, Take};

use mcap::records::op;

use super::mcap_file::{Damage, LONGEST_RECORD, PREFIX_BYTES, read_up_to};

/// Longest chunk that is unpacked, bytes.
const LONGEST_UNPACKED: u64 = 256 << 20;
/// Longest chunk that is unpacked into memory, bytes.
const LONGEST_HELD: u64 = 8 << 20;
/// Largest window of a zstd frame, as a power of two: 8 MiB, which compression up to level 19 stays in.
const ZSTD_WINDOW_LOG: u32 = 23;

/// A chunk that is being read.
pub(super) struct Chunk {
    records: Records,
    /// Byte of the file at which it begins.
    pub(super) begin: u64,
    /// Whether its end is cut off.
    pub(super) cut: bool,
}

/// A chunk's records.
enum Records {
    /// Unpacked, and read as far as the second.
    Held(Vec<u8>, usize),
    /// Unpacked as they are read.
    Streamed(BufReader<Take<Box<dyn Read + Send>>>),
}

impl Chunk {
    /// Checks a chunk, whose records go into `held` where they are not too many. Of one whose end is cut off there is no CRC to
    /// check, and what is there is taken.
    pub(super) fn open(content: &mut Vec<u8>, held: &mut Vec<u8>, begin: u64, cut: bool) -> io::Result<Self> {
        let header = ChunkHeader::parse(content).ok_or(io::ErrorKind::InvalidData)?;
        let from = header.records_at;
        let to = content.len().min(from.saturating_add(usize::try_from(header.packed).unwrap_or(usize::MAX)));
        let too_long = header.unpacked > LONGEST_UNPACKED;
        if too_long || (!cut && (to - from) as u64 != header.packed) {
            return Err(io::ErrorKind::InvalidData.into());
        }
        if header.unpacked <= LONGEST_HELD && !cut {
            unpack_whole(&header, &content[from..to], held)?;
            return Ok(Chunk { records: Records::Held(std::mem::take(held), 0), begin, cut });
        }
        if header.crc != 0 && !cut {
            let records = unpack(header.compression, Cursor::new(&content[from..to]))?;
            let mut checked = Checked::default();
            io::copy(&mut records.take(header.unpacked), &mut checked)?;
            if checked.bytes != header.unpacked || checked.crc.finalize() != header.crc {
                return Err(io::ErrorKind::InvalidData.into());
            }
        }
        let mut packed = Cursor::new(std::mem::take(content));
        packed.set_position(from as u64);
        let records = unpack(header.compression, packed.take((to - from) as u64))?;
        let records = BufReader::with_capacity(1 << 16, records.take(header.unpacked));
        Ok(Chunk { records: Records::Streamed(records), begin, cut })
    }

    /// The memory that held the records, for the next chunk's.
    pub(super) fn into_held(self) -> Vec<u8> {
        match self.records {
            Records::Held(held, _) => held,
            Records::Streamed(_) => Vec::new(),
        }
    }

    /// Puts the next record's content into `record` and gives its opcode; `None` after the last one.
    pub(super) fn next_record(
        &mut self,
        record: &mut Vec<u8>,
        damage: &mut Damage,
    ) -> io::Result<Option<u8>> {
        match &mut self.records {
            Records::Held(held, at) => next_held(held, at, record),
            Records::Streamed(records) => next_streamed(records, record, damage),
        }
    }
}

/// The next of records that lie in memory, none of which is too long to be held.
fn next_held(held: &[u8], at: &mut usize, record: &mut Vec<u8>) -> io::Result<Option<u8>> {
    let rest = held.get(*at..).unwrap_or_default();
    if rest.is_empty() {
        return Ok(None);
    }
    let (prefix, rest) =
        rest.split_first_chunk::<{ PREFIX_BYTES as usize }>().ok_or(io::ErrorKind::UnexpectedEof)?;
    let [opcode, length @ ..] = *prefix;
    let content = usize::try_from(u64::from_le_bytes(length)).ok().and_then(|length| rest.get(..length));
    let content = content.ok_or(io::ErrorKind::InvalidData)?;
    record.clear();
    record.extend_from_slice(content);
    *at += prefix.len() + content.len();
    Ok(Some(opcode))
}

/// The next of records that are unpacked as they are read; those that are too long to be held are passed over.
fn next_streamed(
    records: &mut BufReader<Take<Box<dyn Read + Send>>>,
    record: &mut Vec<u8>,
    damage: &mut Damage,
) -> io::Result<Option<u8>> {
    loop {
        let mut prefix = [0; PREFIX_BYTES as usize];
        match read_up_to(records, &mut prefix)? {
            0 => return Ok(None),
            there if there < prefix.len() => return Err(io::ErrorKind::UnexpectedEof.into()),
            _ => {}
        }
        let [opcode, length @ ..] = prefix;
        let length = u64::from_le_bytes(length);
        if length > records.get_ref().limit() + records.buffer().len() as u64 {
            return Err(io::ErrorKind::InvalidData.into());
        }
        if length <= LONGEST_RECORD {
            record.resize(length as usize, 0);
            records.read_exact(record)?;
            return Ok(Some(opcode));
        }
        damage.passed_over += u64::from(opcode == op::MESSAGE);
        io::copy(&mut records.by_ref().take(length), &mut io::sink())?;
    }
}

/// A chunk's records, checked.
fn unpack_whole(header: &ChunkHeader, packed: &[u8], held: &mut Vec<u8>) -> io::Result<()> {
    match header.compression {
        Compression::Zstd => {
            held.resize(header.unpacked as usize, 0);
            let unpacked = zstd::bulk::decompress_to_buffer(packed, held)?;
            held.truncate(unpacked);
        }
        other => {
            held.clear();
            unpack(other, Cursor::new(packed))?.take(header.unpacked).read_to_end(held)?;
        }
    }
    let is_whole = held.len() as u64 == header.unpacked;
    if is_whole && (header.crc == 0 || crc32fast::hash(held) == header.crc) {
        return Ok(());
    }
    Err(io::ErrorKind::InvalidData.into())
}

/// What a chunk says of itself before its records.
struct ChunkHeader {
    unpacked: u64,
    crc: u32,
    compression: Compression,
    packed: u64,
    records_at: usize,
}

#[derive(Debug, Clone, Copy)]
enum Compression {
    None,
    Lz4,
    Zstd,
}

impl ChunkHeader {
    /// Reads two times, unpacked size, CRC, compression and packed size; `None` where they are cut or the compression is
    /// unknown.
    fn parse(content: &[u8]) -> Option<Self> {
        let (_times, rest) = content.split_first_chunk::<16>()?;
        let (unpacked, rest) = rest.split_first_chunk()?;
        let (crc, rest) = rest.split_first_chunk()?;
        let (length, rest) = rest.split_first_chunk()?;
        let (name, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        let (packed, records) = rest.split_first_chunk()?;
        let compression = match name {
            b"" => Compression::None,
            b"lz4" => Compression::Lz4,
            b"zstd" => Compression::Zstd,
            _ => return None,
        };
        Some(ChunkHeader {
            unpacked: u64::from_le_bytes(*unpacked),
            crc: u32::from_le_bytes(*crc),
            compression,
            packed: u64::from_le_bytes(*packed),
            records_at: content.len() - records.len(),
        })
    }
}

fn unpack<'r>(
    compression: Compression,
    packed: impl io::BufRead + Send + 'r,
) -> io::Result<Box<dyn Read + Send + 'r>> {
    Ok(match compression {
        Compression::None => Box::new(packed),
        Compression::Lz4 => Box::new(lz4::Decoder::new(packed)?),
        Compression::Zstd => {
            let mut decoder = zstd::Decoder::with_buffer(packed)?;
            decoder.window_log_max(ZSTD_WINDOW_LOG)?;
            Box::new(decoder)
        }
    })
}

/// Counts and checks what is written to it.
#[derive(Default)]
struct Checked {
    crc: crc32fast::Hasher,
    bytes: u64,
}

impl io::Write for Checked {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.crc.update(bytes);
        self.bytes += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
