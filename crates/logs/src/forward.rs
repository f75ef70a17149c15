//! A stream that can go back a little, for what comes by a pipe or out of an archive.

use std::io::{self, Read, Seek, SeekFrom};

/// Bytes that can be gone back to: an MCAP record of the length that is held, and the window that the next chunk is looked for in.
const HISTORY: usize = 10 << 20;

/// See the [module](self).
pub(crate) struct Forward<R> {
    input: R,
    /// The newest bytes, up to twice [`HISTORY`].
    held: Vec<u8>,
    /// Where the first of them stands.
    begin: u64,
    at: u64,
}

impl<R: Read> Forward<R> {
    pub(crate) fn new(input: R) -> Self {
        Forward { input, held: Vec::new(), begin: 0, at: 0 }
    }

    fn end(&self) -> u64 {
        self.begin + self.held.len() as u64
    }

    /// Reads on; how many bytes came.
    fn extend(&mut self) -> io::Result<usize> {
        if self.held.len() >= HISTORY + HISTORY / 4 {
            let old = self.held.len() - HISTORY;
            self.held.drain(..old);
            self.begin += old as u64;
        }
        let there = self.held.len();
        self.held.resize(there + (1 << 16), 0);
        let read = self.input.read(&mut self.held[there..]);
        self.held.truncate(there + *read.as_ref().unwrap_or(&0));
        read
    }
}

impl<R: Read> Read for Forward<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.at == self.end() && self.extend()? == 0 {
            return Ok(0);
        }
        let rest = &self.held[(self.at - self.begin) as usize..];
        let count = rest.len().min(buffer.len());
        buffer[..count].copy_from_slice(&rest[..count]);
        self.at += count as u64;
        Ok(count)
    }
}

impl<R: Read> Seek for Forward<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let to = match to {
            SeekFrom::Start(to) => to,
            SeekFrom::Current(by) => self.at.saturating_add_signed(by),
            SeekFrom::End(_) => {
                return Err(io::Error::new(io::ErrorKind::Unsupported, "a stream's end is not known"));
            }
        };
        if to < self.begin {
            return Err(io::Error::new(io::ErrorKind::Unsupported, "a stream does not come again"));
        }
        while self.end() < to && self.extend()? > 0 {}
        self.at = to.min(self.end());
        Ok(self.at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_read_lately_comes_again_and_what_comes_is_passed_over() {
        let bytes: Vec<u8> = (0..40u32 << 20).map(|n| (n >> 8) as u8).collect();
        let mut forward = Forward::new(&bytes[..]);
        let mut byte = [0];
        for at in [0, 9 << 20, 1, 30 << 20, 21 << 20] {
            assert_eq!(forward.seek(SeekFrom::Start(at)).unwrap(), at);
            forward.read_exact(&mut byte).unwrap();
            assert_eq!(byte[0], bytes[at as usize], "{at}");
        }
        assert!(forward.seek(SeekFrom::Start(1 << 20)).is_err());
        assert_eq!(forward.seek(SeekFrom::Start(1 << 40)).unwrap(), 40 << 20);
        assert!(forward.held.capacity() < 2 * HISTORY);
    }
}
