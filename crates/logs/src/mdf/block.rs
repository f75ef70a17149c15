//! Blocks of an MDF file: an identifier, links to other blocks, and content.

use std::io::{self, Seek, SeekFrom};

use crate::opened::Anywhere;

/// Identifier, reserved, length, count of links.
pub(super) const HEADER_BYTES: u64 = 24;
/// Longest block that is held whole, bytes: descriptions, texts, tables, lists of blocks.
const LONGEST: u64 = 1 << 20;

/// A file as its blocks.
pub(super) struct Blocks<'i> {
    input: Anywhere<'i>,
    pub(super) length: u64,
}

/// A block that is held whole.
#[derive(Debug)]
pub(super) struct Block {
    pub(super) id: [u8; 2],
    pub(super) links: Vec<u64>,
    pub(super) content: Vec<u8>,
}

/// A block's header.
#[derive(Debug, Clone, Copy)]
pub(super) struct Header {
    pub(super) id: [u8; 2],
    /// Bytes in all, the header included.
    pub(super) length: u64,
    pub(super) links: u64,
}

impl<'i> Blocks<'i> {
    pub(super) fn new(mut input: Anywhere<'i>) -> io::Result<Self> {
        let length = input.seek(SeekFrom::End(0))?;
        Ok(Blocks { input, length })
    }

    /// Reads bytes; how many there are up to the file's end.
    pub(super) fn read(&mut self, at: u64, bytes: &mut [u8]) -> io::Result<usize> {
        if at >= self.length {
            return Ok(0);
        }
        self.input.seek(SeekFrom::Start(at))?;
        crate::mcap_file::read_up_to(&mut self.input, bytes)
    }

    /// A block's header; `None` where there is none.
    pub(super) fn header(&mut self, at: u64) -> io::Result<Option<Header>> {
        let mut bytes = [0; HEADER_BYTES as usize];
        if at == 0 || self.read(at, &mut bytes)? < bytes.len() || &bytes[..2] != b"##" {
            return Ok(None);
        }
        let number = |at: usize| u64::from_le_bytes(std::array::from_fn(|index| bytes[at + index]));
        Ok(Some(Header { id: [bytes[2], bytes[3]], length: number(8), links: number(16) }))
    }

    /// A block of one of these kinds; `None` where there is none, or it is longer than what is held.
    pub(super) fn block(&mut self, at: u64, ids: &[&[u8; 2]]) -> io::Result<Option<Block>> {
        let Some(header) = self.header(at)? else { return Ok(None) };
        let there = header.length.min(self.length - at);
        let link_bytes = header.links.saturating_mul(8);
        if !ids.contains(&&header.id)
            || !(HEADER_BYTES..=LONGEST).contains(&there)
            || link_bytes > there - HEADER_BYTES
        {
            return Ok(None);
        }
        let mut bytes = vec![0; (there - HEADER_BYTES) as usize];
        let read = self.read(at + HEADER_BYTES, &mut bytes)?;
        bytes.truncate(read);
        if link_bytes > bytes.len() as u64 {
            return Ok(None);
        }
        let content = bytes.split_off(link_bytes as usize);
        let links = bytes.chunks_exact(8).map(|link| u64_at(link, 0)).collect();
        Ok(Some(Block { id: header.id, links, content }))
    }

    /// The text of a TX or MD block; empty where there is none.
    pub(super) fn text(&mut self, at: u64) -> io::Result<String> {
        let Some(block) = self.block(at, &[b"TX", b"MD"])? else { return Ok(String::new()) };
        let end = block.content.iter().position(|byte| *byte == 0).unwrap_or(block.content.len());
        let text = String::from_utf8_lossy(&block.content[..end.min(MOST_TEXT_BYTES)]).into_owned();
        // A description in XML has the text in its first element.
        if block.id == *b"MD" {
            let inner = text
                .split_once("<TX")
                .and_then(|(_, rest)| rest.split_once('>'))
                .and_then(|(_, rest)| rest.split_once("</TX>"));
            return Ok(inner.map_or(String::new(), |(inner, _)| inner.trim().to_owned()));
        }
        Ok(text)
    }
}

/// Names and units that are longer are cut.
const MOST_TEXT_BYTES: usize = 1024;

impl Block {
    /// A link; 0 where there is none.
    pub(super) fn link(&self, index: usize) -> u64 {
        self.links.get(index).copied().unwrap_or(0)
    }

    pub(super) fn u8(&self, at: usize) -> u8 {
        self.content.get(at).copied().unwrap_or(0)
    }

    pub(super) fn u16(&self, at: usize) -> u16 {
        u16::from_le_bytes(self.bytes(at))
    }

    pub(super) fn u32(&self, at: usize) -> u32 {
        u32::from_le_bytes(self.bytes(at))
    }

    pub(super) fn u64(&self, at: usize) -> u64 {
        u64::from_le_bytes(self.bytes(at))
    }

    pub(super) fn f64(&self, at: usize) -> f64 {
        f64::from_le_bytes(self.bytes(at))
    }

    /// Bytes of the content; zeros where it is too short.
    fn bytes<const N: usize>(&self, at: usize) -> [u8; N] {
        let there = self.content.get(at..).and_then(|rest| rest.first_chunk());
        there.copied().unwrap_or([0; N])
    }
}

pub(super) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|index| bytes[at + index]))
}
