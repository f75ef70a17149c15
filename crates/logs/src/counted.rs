//! How much of a log has been read, for whoever shows it.

use std::io::{self, Read, Seek, SeekFrom};

/// A log whose reading is told in bytes: its length in all, whatever is read twice or left out.
pub struct CountedReader<R, F: FnMut(u64)> {
    input: R,
    on_bytes: F,
    left: u64,
}

impl<R, F: FnMut(u64)> CountedReader<R, F> {
    /// A log of so many bytes.
    pub fn new(input: R, bytes: u64, on_bytes: F) -> Self {
        CountedReader { input, on_bytes, left: bytes }
    }

    fn count(&mut self, bytes: u64) {
        let bytes = bytes.min(self.left);
        self.left -= bytes;
        (self.on_bytes)(bytes);
    }
}

impl<R: Read, F: FnMut(u64)> Read for CountedReader<R, F> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let bytes = self.input.read(buffer)?;
        self.count(bytes as u64);
        Ok(bytes)
    }
}

impl<R: Seek, F: FnMut(u64)> Seek for CountedReader<R, F> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.input.seek(to)
    }
}

impl<R, F: FnMut(u64)> Drop for CountedReader<R, F> {
    fn drop(&mut self) {
        self.count(self.left);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;
    use std::io::Cursor;

    #[test]
    fn the_count_ends_at_the_length_whatever_is_read() {
        let count = Cell::new(0);
        let add = |bytes| count.set(count.get() + bytes);
        let mut twice = CountedReader::new(Cursor::new([0; 100]), 100, add);
        let mut end = Vec::new();
        twice.seek(SeekFrom::End(-30)).unwrap();
        twice.read_to_end(&mut end).unwrap();
        assert_eq!(count.get(), 30);
        twice.seek(SeekFrom::Start(0)).unwrap();
        twice.read_to_end(&mut end).unwrap();
        assert_eq!(count.get(), 100);
        // Of the second log only a part is read.
        let mut part = CountedReader::new(Cursor::new([0; 50]), 50, add);
        part.read_exact(&mut [0; 20]).unwrap();
        assert_eq!(count.get(), 120);
        drop((twice, part));
        assert_eq!(count.get(), 150);
    }
}
