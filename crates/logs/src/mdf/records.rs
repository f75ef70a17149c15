//! The records of a data group, those of several channel groups mixed or of one alone.

use std::io;

use super::block::Blocks;
use super::stream::{ByteStream, Look};

/// Longest record that is held, bytes.
const LONGEST: usize = 1 << 20;
/// Times that bytes of varying length are looked for from the beginning: records refer to them in order.
const MOST_RETURNS: u32 = 8;

/// What the records of a channel group are like.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    pub(super) id: u64,
    /// Bytes of a record; `None` where each says how long it is.
    pub(super) bytes: Option<usize>,
}

/// See the [module](self).
pub(super) struct Records {
    stream: ByteStream,
    /// Bytes of the number of a record's group; 0 where there is one group.
    id_bytes: usize,
    layouts: Vec<Layout>,
    /// The record at hand.
    pub(super) record: Vec<u8>,
    broken: bool,
}

impl Records {
    pub(super) fn new(link: u64, unfinished: bool, id_bytes: usize, layouts: Vec<Layout>) -> Self {
        let stream = ByteStream::new(link, unfinished);
        Records { stream, id_bytes, layouts, record: Vec::new(), broken: false }
    }

    /// Reads the next record; the place of its group among the layouts, and where the record's bytes stand in the data.
    pub(super) fn next(&mut self, blocks: &mut Blocks<'_>) -> io::Result<Option<(usize, u64)>> {
        loop {
            if self.broken {
                return Ok(None);
            }
            let Some(group) = self.next_group(blocks)? else { return Ok(None) };
            let Some(bytes) = self.next_length(blocks, group)? else { continue };
            let at = self.stream.at();
            match self.stream.look(blocks, bytes)? {
                Look::Bytes(record) => {
                    self.record.clear();
                    self.record.extend_from_slice(record);
                    self.stream.take(bytes);
                    return Ok(Some((group, at)));
                }
                Look::Gap => self.after_gap(blocks)?,
                Look::End => self.broken = true,
            }
        }
    }

    fn next_group(&mut self, blocks: &mut Blocks<'_>) -> io::Result<Option<usize>> {
        if self.id_bytes == 0 {
            return Ok((!self.layouts.is_empty()).then_some(0));
        }
        loop {
            let id = match self.stream.look(blocks, self.id_bytes)? {
                Look::Bytes(bytes) => bytes.iter().rev().fold(0u64, |id, byte| id << 8 | u64::from(*byte)),
                Look::Gap => {
                    self.after_gap(blocks)?;
                    if self.broken {
                        return Ok(None);
                    }
                    continue;
                }
                Look::End => return Ok(None),
            };
            let found = self.layouts.iter().position(|layout| layout.id == id);
            if found.is_none() {
                // Where records end is no longer known.
                self.stream.damage.cut = true;
                self.broken = true;
            }
            self.stream.take(self.id_bytes);
            return Ok(found);
        }
    }

    fn next_length(&mut self, blocks: &mut Blocks<'_>, group: usize) -> io::Result<Option<usize>> {
        if let Some(bytes) = self.layouts[group].bytes {
            if bytes == 0 || bytes > LONGEST {
                self.broken = true;
                return Ok(None);
            }
            return Ok(Some(bytes));
        }
        let bytes = match self.stream.look(blocks, 4)? {
            Look::Bytes(bytes) => u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]) as usize,
            Look::Gap => {
                self.after_gap(blocks)?;
                return Ok(None);
            }
            Look::End => {
                self.broken = true;
                return Ok(None);
            }
        };
        self.stream.take(4);
        if bytes > LONGEST {
            self.stream.damage.cut = true;
            self.broken = true;
            return Ok(None);
        }
        Ok(Some(bytes))
    }

    /// Goes on at the next whole record where records have one length; else nothing says where one begins.
    fn after_gap(&mut self, blocks: &mut Blocks<'_>) -> io::Result<()> {
        match self.layouts.first().and_then(|layout| layout.bytes) {
            Some(bytes) if self.id_bytes == 0 && bytes > 0 => {
                let into = (self.stream.at() % bytes as u64) as usize;
                let skip = if into == 0 { 0 } else { bytes - into };
                match self.stream.look(blocks, skip)? {
                    Look::Bytes(_) => self.stream.take(skip),
                    // The next one is met where the next record is looked for.
                    Look::Gap => {}
                    Look::End => self.broken = true,
                }
            }
            _ => {
                self.stream.damage.cut = true;
                self.broken = true;
            }
        }
        Ok(())
    }

    pub(super) fn damage(&self) -> super::stream::Damage {
        self.stream.damage
    }
}

/// Bytes of varying length that records refer to by where they stand.
pub(super) struct Elsewhere {
    place: ElsewherePlace,
    records: Records,
    unfinished: bool,
    /// Where the next bytes stand.
    next: u64,
    returns: u32,
}

/// Where the bytes are.
#[derive(Debug, Clone)]
pub(super) enum ElsewherePlace {
    /// In data of their own.
    Data(u64),
    /// In the data of a group, as the records of another group.
    Group { link: u64, id_bytes: usize, layouts: Vec<Layout>, group: usize },
}

impl Elsewhere {
    pub(super) fn new(place: ElsewherePlace, unfinished: bool) -> Self {
        let records = Self::open(&place, unfinished);
        Elsewhere { place, records, unfinished, next: 0, returns: 0 }
    }

    fn open(place: &ElsewherePlace, unfinished: bool) -> Records {
        match place {
            ElsewherePlace::Data(link) => {
                Records::new(*link, unfinished, 0, vec![Layout { id: 0, bytes: None }])
            }
            ElsewherePlace::Group { link, id_bytes, layouts, .. } => {
                Records::new(*link, unfinished, *id_bytes, layouts.clone())
            }
        }
    }

    /// The bytes at a place.
    pub(super) fn at(&mut self, blocks: &mut Blocks<'_>, place: u64) -> io::Result<Option<&[u8]>> {
        if place < self.next {
            if self.returns == MOST_RETURNS {
                return Ok(None);
            }
            self.returns += 1;
            self.records = Self::open(&self.place, self.unfinished);
            self.next = 0;
        }
        let group = match &self.place {
            ElsewherePlace::Data(_) => 0,
            ElsewherePlace::Group { group, .. } => *group,
        };
        while let Some((found, _)) = self.records.next(blocks)? {
            if found != group {
                continue;
            }
            let at = self.next;
            self.next += 4 + self.records.record.len() as u64;
            if at == place {
                return Ok(Some(&self.records.record));
            }
            if at > place {
                return Ok(None);
            }
        }
        Ok(None)
    }
}
