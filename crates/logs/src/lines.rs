//! Lines of a text, none of which is held beyond a length: a log may be one line without end.

use std::io::{self, BufRead, BufReader, Read};

/// See the [module](self).
pub(crate) struct Lines<R> {
    reader: BufReader<R>,
    line: Vec<u8>,
    longest: u64,
    number: u64,
}

/// A line without what ends it.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Line<'l> {
    Whole(&'l [u8]),
    /// It is longer than what is held, and has been passed over.
    TooLong,
}

impl<R: Read> Lines<R> {
    /// Lines of up to so many bytes.
    pub(crate) fn new(input: R, longest: u64) -> Self {
        Lines { reader: BufReader::with_capacity(1 << 16, input), line: Vec::new(), longest, number: 0 }
    }

    /// The next line.
    pub(crate) fn next(&mut self) -> io::Result<Option<Line<'_>>> {
        self.line.clear();
        self.reader.by_ref().take(self.longest).read_until(b'\n', &mut self.line)?;
        if self.line.is_empty() {
            return Ok(None);
        }
        self.number += 1;
        let cut = self.line.len() as u64 == self.longest && self.line.last() != Some(&b'\n');
        if cut && self.reader.skip_until(b'\n')? > 0 {
            return Ok(Some(Line::TooLong));
        }
        let line = self.line.strip_suffix(b"\n").unwrap_or(&self.line);
        Ok(Some(Line::Whole(line.strip_suffix(b"\r").unwrap_or(line))))
    }

    /// Number of the line that was read last.
    pub(crate) fn number(&self) -> u64 {
        self.number
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_beyond_the_length_are_passed_over() {
        let mut lines = Lines::new(&b"abc\r\n\nabcdefgh\nabcd"[..], 5);
        for expected in [Line::Whole(b"abc"), Line::Whole(b""), Line::TooLong, Line::Whole(b"abcd")] {
            assert_eq!(lines.next().unwrap(), Some(expected));
        }
        assert_eq!(lines.next().unwrap(), None);
        assert_eq!(lines.number(), 4);
        let mut endless = Lines::new(io::repeat(b'x').take(10 << 20), 100);
        assert_eq!(endless.next().unwrap(), Some(Line::TooLong));
        assert!(endless.line.capacity() < 1000);
    }
}
