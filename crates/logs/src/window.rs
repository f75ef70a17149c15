//! A look ahead into bytes that come from anywhere.

use std::io::{self, Read};

/// Bytes that are read at a time.
const PORTION: usize = 1 << 16;

/// See the [module](self).
pub(crate) struct Window<R> {
    input: R,
    held: Vec<u8>,
    /// Of these, how many have been taken.
    taken: usize,
    /// Bytes taken in all.
    at: u64,
    ended: bool,
}

impl<R: Read> Window<R> {
    pub(crate) fn new(input: R) -> Self {
        Window { input, held: Vec::new(), taken: 0, at: 0, ended: false }
    }

    /// Bytes taken so far.
    pub(crate) fn at(&self) -> u64 {
        self.at
    }

    /// What comes next: so many bytes or more, fewer only at the end.
    pub(crate) fn look(&mut self, bytes: usize) -> io::Result<&[u8]> {
        if self.held.len() - self.taken < bytes && !self.ended {
            self.held.drain(..self.taken);
            self.taken = 0;
            let there = self.held.len();
            let wanted = (bytes - there).max(PORTION);
            let read = self.input.by_ref().take(wanted as u64).read_to_end(&mut self.held)?;
            self.ended = read < wanted;
        }
        Ok(&self.held[self.taken..])
    }

    /// Passes over so many of the bytes that were looked at.
    pub(crate) fn take(&mut self, bytes: usize) {
        let bytes = bytes.min(self.held.len() - self.taken);
        self.taken += bytes;
        self.at += bytes as u64;
    }
}

/// Where a pattern begins.
pub(crate) fn find(bytes: &[u8], pattern: &[u8]) -> Option<usize> {
    let first = *pattern.first()?;
    let mut from = 0;
    while let Some(at) = bytes[from..].iter().position(|byte| *byte == first) {
        if bytes[from + at..].starts_with(pattern) {
            return Some(from + at);
        }
        from += at + 1;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_looked_at_before_they_are_taken() {
        let bytes: Vec<u8> = (0..200_000u32).map(|n| n as u8).collect();
        let mut window = Window::new(&bytes[..]);
        assert_eq!(window.look(3).unwrap()[..3], [0, 1, 2]);
        window.take(70_000);
        assert_eq!(window.at(), 65_536);
        assert_eq!(window.look(100_000).unwrap()[..100_000], bytes[65_536..165_536]);
        window.take(100_000);
        assert_eq!(window.look(1 << 20).unwrap().len(), 200_000 - 165_536);
        assert_eq!(find(b"LOLOBJ", b"LOBJ"), Some(2));
        assert_eq!(find(b"LOB", b"LOBJ"), None);
    }
}
