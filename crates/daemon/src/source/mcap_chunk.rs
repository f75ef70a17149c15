//! A chunk of an MCAP file: checked by its CRC, then unpacked as its records are read.

use std::io::{self, BufReader, Cursor, Read, Take};

use mcap::records::op;

use super::mcap_file::{Damage, LONGEST_RECORD, PREFIX_BYTES, read_up_to};

/// Longest chunk that is unpacked, bytes.
const LONGEST_UNPACKED: u64 = 256 << 20;
/// Largest window of a zstd frame, as a power of two: 8 MiB, which compression up to level 19 stays in.
const ZSTD_WINDOW_LOG: u32 = 23;

/// A chunk that is being read.
pub(super) struct Chunk {
    /// Its records, unpacked as they are read.
    records: BufReader<Take<Box<dyn Read + Send>>>,
    /// Byte of the file at which it begins.
    pub(super) begin: u64,
    /// Whether its end is cut off.
    pub(super) cut: bool,
}

impl Chunk {
    /// Checks a chunk. Of one whose end is cut off there is no CRC to check, and what is there is taken.
    pub(super) fn open(content: Vec<u8>, begin: u64, cut: bool) -> io::Result<Self> {
        let header = ChunkHeader::parse(&content).ok_or(io::ErrorKind::InvalidData)?;
        let from = header.records_at;
        let to = content.len().min(from.saturating_add(usize::try_from(header.packed).unwrap_or(usize::MAX)));
        let too_long = header.unpacked > LONGEST_UNPACKED;
        if too_long || (!cut && (to - from) as u64 != header.packed) {
            return Err(io::ErrorKind::InvalidData.into());
        }
        if header.crc != 0 && !cut {
            let records = unpack(header.compression, Cursor::new(&content[from..to]))?;
            let mut checked = Checked::default();
            io::copy(&mut records.take(header.unpacked), &mut checked)?;
            if checked.bytes != header.unpacked || checked.crc.finalize() != header.crc {
                return Err(io::ErrorKind::InvalidData.into());
            }
        }
        let mut packed = Cursor::new(content);
        packed.set_position(from as u64);
        let records = unpack(header.compression, packed.take((to - from) as u64))?.take(header.unpacked);
        Ok(Chunk { records: BufReader::with_capacity(1 << 16, records), begin, cut })
    }

    /// Puts the next record's content into `record` and gives its opcode; `None` after the last one.
    pub(super) fn next_record(
        &mut self,
        record: &mut Vec<u8>,
        damage: &mut Damage,
    ) -> io::Result<Option<u8>> {
        loop {
            let mut prefix = [0; PREFIX_BYTES as usize];
            match read_up_to(&mut self.records, &mut prefix)? {
                0 => return Ok(None),
                there if there < prefix.len() => return Err(io::ErrorKind::UnexpectedEof.into()),
                _ => {}
            }
            let [opcode, length @ ..] = prefix;
            let length = u64::from_le_bytes(length);
            if length > self.records.get_ref().limit() + self.records.buffer().len() as u64 {
                return Err(io::ErrorKind::InvalidData.into());
            }
            if length <= LONGEST_RECORD {
                record.resize(length as usize, 0);
                self.records.read_exact(record)?;
                return Ok(Some(opcode));
            }
            damage.passed_over += u64::from(opcode == op::MESSAGE);
            io::copy(&mut self.records.by_ref().take(length), &mut io::sink())?;
        }
    }
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
