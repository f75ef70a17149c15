//! The bytes of a group's data: blocks one after the other, packed or not, in lists or alone.

use std::io::{self, Read};

use flate2::read::ZlibDecoder;

use super::block::{Blocks, HEADER_BYTES, Header, u64_at};

/// Longest packed block that is unpacked, bytes: writers pack some 4 MiB at a time.
const LONGEST_UNPACKED: u64 = 8 << 20;
/// Bytes of a block that are read at a time.
const PORTION: u64 = 1 << 16;
/// Header of a packed block: original kind, packing, parameter, original length, packed length.
const PACKED_HEADER_BYTES: usize = 24;

/// See the [module](self).
#[derive(Debug)]
pub(super) struct ByteStream {
    /// Blocks that are still to come, the next last.
    rest: Vec<u64>,
    next_list: u64,
    /// The block that is read in portions: from where, up to where.
    open: (u64, u64),
    held: Vec<u8>,
    taken: usize,
    packed: Vec<u8>,
    /// Bytes of the data before what is held.
    before: u64,
    /// Bytes of the file that were used. No byte is used twice, so that lists that lead in circles end.
    used: u64,
    pub(super) damage: Damage,
    /// The file was never closed: the last length may not have been written.
    unfinished: bool,
}

/// What was damaged.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Damage {
    pub(super) blocks: u64,
    pub(super) first_at: Option<u64>,
    pub(super) cut: bool,
    /// A block is packed, or laid out, in a way that is not read.
    pub(super) not_read: Option<&'static str>,
}

/// What comes next in the data.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Look<'s> {
    /// As many bytes as were asked for.
    Bytes(&'s [u8]),
    /// Some bytes are lost here.
    Gap,
    End,
}

enum Portion {
    More,
    Lost(u64),
    End,
}

impl ByteStream {
    /// The data that a link leads to.
    pub(super) fn new(link: u64, unfinished: bool) -> Self {
        ByteStream {
            rest: vec![link],
            next_list: 0,
            open: (0, 0),
            held: Vec::new(),
            taken: 0,
            packed: Vec::new(),
            before: 0,
            used: 0,
            damage: Damage::default(),
            unfinished,
        }
    }

    /// Where the next byte stands in the data.
    pub(super) fn at(&self) -> u64 {
        self.before + self.taken as u64
    }

    /// The next bytes, without taking them.
    pub(super) fn look(&mut self, blocks: &mut Blocks<'_>, bytes: usize) -> io::Result<Look<'_>> {
        while self.held.len() - self.taken < bytes {
            self.before += self.taken as u64;
            self.held.drain(..self.taken);
            self.taken = 0;
            match self.next_portion(blocks)? {
                Portion::More => {}
                Portion::Lost(lost) => {
                    self.before += self.held.len() as u64 + lost;
                    self.held.clear();
                    return Ok(Look::Gap);
                }
                Portion::End => return Ok(Look::End),
            }
        }
        Ok(Look::Bytes(&self.held[self.taken..self.taken + bytes]))
    }

    /// Passes over bytes that were looked at.
    pub(super) fn take(&mut self, bytes: usize) {
        self.taken += bytes.min(self.held.len() - self.taken);
    }

    /// Adds bytes to what is held.
    fn next_portion(&mut self, blocks: &mut Blocks<'_>) -> io::Result<Portion> {
        loop {
            let (from, to) = self.open;
            if from < to {
                let count = (to - from).min(PORTION);
                let there = self.held.len();
                self.held.resize(there + count as usize, 0);
                let read = blocks.read(from, &mut self.held[there..])?;
                self.held.truncate(there + read);
                self.open.0 = if (read as u64) < count { to } else { from + count };
                self.damage.cut |= (read as u64) < count;
                if read > 0 {
                    return Ok(Portion::More);
                }
                continue;
            }
            let Some(at) = self.next_block(blocks)? else { return Ok(Portion::End) };
            if at == 0 {
                continue;
            }
            let Some(header) = blocks.header(at)? else {
                self.damage.cut |= at >= blocks.length;
                self.damage_at(at);
                return Ok(Portion::Lost(0));
            };
            let begin = self.held.len();
            match &header.id {
                b"DT" | b"SD" => self.open_block(blocks, at, header),
                b"DZ" => match self.unpack(blocks, at, header)? {
                    Ok(()) => return Ok(Portion::More),
                    Err(lost) => {
                        self.held.truncate(begin);
                        self.damage_at(at);
                        return Ok(Portion::Lost(lost));
                    }
                },
                b"DL" | b"HL" => self.open_list(blocks, at)?,
                b"DV" | b"LD" => self.damage.not_read = Some("its data is stored by column"),
                _ => {
                    self.damage_at(at);
                    return Ok(Portion::Lost(0));
                }
            }
        }
    }

    fn damage_at(&mut self, at: u64) {
        self.damage.blocks += 1;
        self.damage.first_at.get_or_insert(at);
    }

    fn next_block(&mut self, blocks: &mut Blocks<'_>) -> io::Result<Option<u64>> {
        if let Some(at) = self.rest.pop() {
            return Ok(Some(at));
        }
        let list = std::mem::take(&mut self.next_list);
        if list != 0 {
            self.open_list(blocks, list)?;
        }
        Ok(self.rest.pop())
    }

    /// Whether so many more bytes of the file may be used.
    fn may_use(&mut self, bytes: u64, blocks: &Blocks<'_>) -> bool {
        self.used = self.used.saturating_add(bytes);
        let may = self.used <= blocks.length;
        self.damage.cut |= !may;
        may
    }

    fn open_block(&mut self, blocks: &Blocks<'_>, at: u64, header: Header) {
        let there = blocks.length - at;
        let mut length = header.length;
        // The last length of a file that was never closed is still that of an empty block.
        if self.unfinished && (length <= HEADER_BYTES || length > there) {
            length = there;
        }
        self.damage.cut |= length > there;
        let length = length.min(there);
        if self.may_use(length, blocks) {
            self.open = (at + HEADER_BYTES, at + length);
        }
    }

    /// Puts the blocks of a list, or the list that a header of lists leads to, before those that come.
    fn open_list(&mut self, blocks: &mut Blocks<'_>, at: u64) -> io::Result<()> {
        let Some(list) = blocks.block(at, &[b"DL", b"HL"])? else {
            self.damage_at(at);
            return Ok(());
        };
        let bytes = HEADER_BYTES + 8 * list.links.len() as u64;
        if !self.may_use(bytes, blocks) {
            return Ok(());
        }
        match list.links.split_first() {
            Some((first, _)) if list.id == *b"HL" => self.rest.push(*first),
            Some((next, data)) => {
                self.next_list = *next;
                self.rest.extend(data.iter().rev());
            }
            None => {}
        }
        Ok(())
    }

    /// Adds what is packed to what is held; else how many bytes are lost.
    fn unpack(&mut self, blocks: &mut Blocks<'_>, at: u64, header: Header) -> io::Result<Result<(), u64>> {
        let mut facts = [0; PACKED_HEADER_BYTES];
        if blocks.read(at + HEADER_BYTES, &mut facts)? < facts.len() {
            self.damage.cut = true;
            return Ok(Err(0));
        }
        let (packing, columns) = (facts[2], u32::from_le_bytes([facts[4], facts[5], facts[6], facts[7]]));
        let (length, packed_length) = (u64_at(&facts, 8), u64_at(&facts, 16));
        let lost = Ok(Err(length));
        // Deflate makes a thousandth at best, and never more than a little more than there was.
        if length > LONGEST_UNPACKED
            || packed_length > LONGEST_UNPACKED + (1 << 16)
            || packed_length > header.length
        {
            return lost;
        }
        if !self.may_use(packed_length, blocks) {
            return lost;
        }
        self.packed.resize(packed_length as usize, 0);
        if blocks.read(at + HEADER_BYTES + PACKED_HEADER_BYTES as u64, &mut self.packed)? < self.packed.len()
        {
            self.damage.cut = true;
            return lost;
        }
        let begin = self.held.len();
        let packed = &self.packed[..];
        let read = match packing {
            0 | 1 => ZlibDecoder::new(packed).take(length + 1).read_to_end(&mut self.held),
            2 | 3 => zstd::stream::read::Decoder::new(packed).and_then(|mut decoder| {
                decoder.window_log_max(23)?;
                decoder.take(length + 1).read_to_end(&mut self.held)
            }),
            _ => {
                self.damage.not_read = Some("its data is packed in another way than zip and zstd");
                return lost;
            }
        };
        if read.ok().map(|read| read as u64) != Some(length) {
            return lost;
        }
        if packing % 2 == 1 {
            self.packed.clear();
            self.packed.extend_from_slice(&self.held[begin..]);
            transpose(&self.packed, columns as usize, &mut self.held[begin..]);
        }
        Ok(Ok(()))
    }
}

/// Puts bytes that were stored column by column back into rows of so many bytes; what is left over stays.
fn transpose(columns: &[u8], width: usize, rows: &mut [u8]) {
    if width == 0 {
        return;
    }
    let count = columns.len() / width;
    for (row, bytes) in rows.chunks_exact_mut(width).enumerate() {
        for (column, byte) in bytes.iter_mut().enumerate() {
            *byte = columns[column * count + row];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_become_rows() {
        let mut rows = *b"aAbBcCx";
        transpose(b"abcABCx", 2, &mut rows);
        assert_eq!(&rows, b"aAbBcCx");
    }
}
