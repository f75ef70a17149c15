//! Rows of a CSV text: fields divided by commas, semicolons or tabs, in quotes where they hold these. A row is a line, so that a
//! stray quote costs the line that it is in, and not all that follow.

use std::collections::VecDeque;
use std::io::{self, Read};

use super::lines::{Line, Lines};

/// Longest line that is read, bytes: some ten thousand columns.
const LONGEST_LINE: u64 = 1 << 20;

/// Why no row can be looked for in a text.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TableError {
    /// The text cannot be read.
    #[error(transparent)]
    Reading(#[from] io::Error),
    /// No header is that long: it is no table.
    #[error("its first line has more than {LONGEST_LINE} bytes")]
    LongFirstLine,
}

/// Why a row cannot be used. Each message follows the row's line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum RowError {
    /// Its line is longer than what is held.
    #[error("the line is longer than a row can be")]
    TooLong,
    /// Its last field never ends.
    #[error("a quote is opened and not closed")]
    OpenQuote,
    /// It ends before a column that is wanted.
    #[error("column {number} is missing")]
    NoColumn {
        /// Column, from 1 on.
        number: usize,
    },
    /// A field is not UTF-8.
    #[error("column {number} is not text")]
    NotText {
        /// Column, from 1 on.
        number: usize,
    },
    /// A field is neither a number nor, where the time is, a date or a clock.
    #[error("`{begin}` is not a number")]
    NotANumber {
        /// The field, or its beginning.
        begin: String,
    },
    /// The field of the time is empty, or not finite.
    #[error("the time is missing")]
    NoTime,
}

impl RowError {
    /// The error of a field that is no number, of which as much is told as one line holds.
    pub(crate) fn not_a_number(field: &str) -> Self {
        RowError::NotANumber { begin: field.chars().take(40).collect() }
    }
}

/// See the [module](self).
pub(crate) struct Rows<R> {
    lines: Lines<R>,
    /// Lines that were looked at before the first row, and the number of the first of them.
    looked_at: VecDeque<Vec<u8>>,
    number: u64,
    /// The line after them is too long for a row.
    long_line: bool,
    divider: u8,
    row: Row,
}

/// A row's fields, without quotes and the blanks around them.
#[derive(Debug, Default)]
pub(crate) struct Row {
    text: Vec<u8>,
    /// Where each field ends in `text`.
    ends: Vec<usize>,
}

impl<R: Read> Rows<R> {
    /// Looks at the first lines of a text. The lines before the first row, and the divider, are for [`begin`](Self::begin).
    pub(crate) fn new(input: R) -> Self {
        let lines = Lines::new(input, LONGEST_LINE);
        Rows {
            lines,
            looked_at: VecDeque::new(),
            number: 0,
            long_line: false,
            divider: b',',
            row: Row::default(),
        }
    }

    /// One more line of the text's beginning, without taking it; `None` at the end.
    ///
    /// # Errors
    /// [`TableError`]: it cannot be read, or the first is too long. A later one that is ends the look, and is a row that cannot be read.
    pub(crate) fn look_at_next(&mut self) -> Result<Option<&[u8]>, TableError> {
        if self.long_line {
            return Ok(None);
        }
        let number = self.lines.number() + 1;
        let line = match self.lines.next()? {
            None => return Ok(None),
            Some(Line::TooLong) if number == 1 => return Err(TableError::LongFirstLine),
            Some(Line::TooLong) => {
                self.long_line = true;
                return Ok(None);
            }
            Some(Line::Whole(line)) if number == 1 => line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line),
            Some(Line::Whole(line)) => line,
        };
        self.looked_at.push_back(line.to_vec());
        Ok(self.looked_at.back().map(Vec::as_slice))
    }

    /// Rows begin after so many of the lines that were looked at, with their fields divided so.
    pub(crate) fn begin(&mut self, after: usize, divider: u8) {
        self.looked_at.drain(..after.min(self.looked_at.len()));
        self.number = after as u64;
        self.divider = divider;
    }

    /// The next row, or what is wrong with it; empty lines are none.
    pub(crate) fn next(&mut self) -> io::Result<Option<Result<&Row, RowError>>> {
        while let Some(line) = self.looked_at.pop_front() {
            self.number += 1;
            if !line.trim_ascii().is_empty() {
                return Ok(Some(self.row.split(&line, self.divider).map(|()| &self.row)));
            }
        }
        if std::mem::take(&mut self.long_line) {
            return Ok(Some(Err(RowError::TooLong)));
        }
        loop {
            return Ok(Some(match self.lines.next()? {
                None => return Ok(None),
                Some(Line::Whole(line)) if line.trim_ascii().is_empty() => continue,
                Some(Line::Whole(line)) => self.row.split(line, self.divider).map(|()| &self.row),
                Some(Line::TooLong) => Err(RowError::TooLong),
            }));
        }
    }

    /// Line of the row that was read last.
    pub(crate) fn line_number(&self) -> u64 {
        if self.looked_at.is_empty() { self.lines.number() } else { self.number }
    }
}

/// What divides a line's fields: what stands in it most.
pub(crate) fn divider_of(line: &[u8]) -> u8 {
    let count = |divider: u8| line.iter().filter(|byte| **byte == divider).count();
    [b'\t', b';'].into_iter().fold(b',', |best, other| if count(other) > count(best) { other } else { best })
}

impl Row {
    /// A field by its column, from 0 on.
    pub(crate) fn field(&self, column: usize) -> Option<&[u8]> {
        let begin = if column == 0 { 0 } else { *self.ends.get(column - 1)? };
        self.text.get(begin..*self.ends.get(column)?)
    }

    /// A field by its column, which the row is to have.
    ///
    /// # Errors
    /// [`RowError::NoColumn`].
    pub(crate) fn wanted(&self, column: usize) -> Result<&[u8], RowError> {
        self.field(column).ok_or(RowError::NoColumn { number: column + 1 })
    }

    /// The fields in their order.
    pub(crate) fn fields(&self) -> impl Iterator<Item = &[u8]> {
        (0..self.ends.len()).map_while(|column| self.field(column))
    }

    /// Divides a line.
    ///
    /// # Errors
    /// [`RowError::OpenQuote`].
    pub(crate) fn split(&mut self, line: &[u8], divider: u8) -> Result<(), RowError> {
        self.text.clear();
        self.ends.clear();
        let mut rest = Some(line);
        while let Some(text) = rest {
            rest = match text.trim_ascii_start().strip_prefix(b"\"") {
                Some(quoted) => self.take_quoted(quoted, divider)?,
                None => self.take_plain(text, divider),
            };
            self.ends.push(self.text.len());
        }
        Ok(())
    }

    /// Takes a field up to its divider; what follows it, if anything does.
    fn take_plain<'l>(&mut self, text: &'l [u8], divider: u8) -> Option<&'l [u8]> {
        let end = text.iter().position(|byte| *byte == divider);
        self.text.extend_from_slice(text[..end.unwrap_or(text.len())].trim_ascii());
        end.map(|end| &text[end + 1..])
    }

    /// Takes a field up to its closing quote, two of which are one in it; what follows its divider.
    fn take_quoted<'l>(&mut self, mut text: &'l [u8], divider: u8) -> Result<Option<&'l [u8]>, RowError> {
        loop {
            let end = text.iter().position(|byte| *byte == b'"').ok_or(RowError::OpenQuote)?;
            self.text.extend_from_slice(&text[..end]);
            text = &text[end + 1..];
            match text.strip_prefix(b"\"") {
                Some(after) => {
                    self.text.push(b'"');
                    text = after;
                }
                None => return Ok(self.take_plain(text, divider)),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(text: &str) -> (Vec<String>, Vec<Result<Vec<String>, RowError>>) {
        let mut rows = Rows::new(text.as_bytes());
        let header = rows.look_at_next().unwrap().unwrap_or_default().to_vec();
        let divider = divider_of(&header);
        rows.begin(1, divider);
        let mut row = Row::default();
        row.split(&header, divider).unwrap();
        let columns = row.fields().map(|name| String::from_utf8_lossy(name).into_owned()).collect();
        let mut found = Vec::new();
        while let Some(row) = rows.next().unwrap() {
            found.push(
                row.map(|row| {
                    row.fields().map(|field| String::from_utf8_lossy(field).into_owned()).collect()
                }),
            );
        }
        (columns, found)
    }

    #[test]
    fn dividers_quotes_and_blanks() {
        let (columns, found) = rows("\u{feff}t_s; \"the; command\" ;x\n1;2; \n\n\"a\"\"b\";;\r\n");
        assert_eq!(columns, ["t_s", "the; command", "x"]);
        assert_eq!(
            found,
            [Ok(vec!["1".into(), "2".into(), "".into()]), Ok(vec!["a\"b".into(), "".into(), "".into()])]
        );
        assert_eq!(rows("a\tb,c\td").0, ["a", "b,c", "d"]);
        assert_eq!(rows("").0, [""]);
    }

    #[test]
    fn a_long_line_costs_itself_wherever_it_stands() {
        let long = "7".repeat(LONGEST_LINE as usize + 1);
        let mut rows = Rows::new(long.as_bytes());
        let error = rows.look_at_next().unwrap_err().to_string();
        assert_eq!(error, format!("its first line has more than {LONGEST_LINE} bytes"));
        let text = format!("a,b\n{long}\n1,2\n");
        let mut rows = Rows::new(text.as_bytes());
        while rows.look_at_next().unwrap().is_some() {}
        rows.begin(1, b',');
        assert_eq!(rows.next().unwrap().map(|row| row.map(|_| ())), Some(Err(RowError::TooLong)));
        assert_eq!(rows.line_number(), 2);
        assert_eq!(rows.next().unwrap().unwrap().unwrap().field(1), Some(&b"2"[..]));
    }

    #[test]
    fn a_stray_quote_costs_its_line() {
        let (_, found) = rows("t_s,command\n0,\"1\n1,2\n2,3\"\n");
        assert_eq!(
            found,
            [
                Err(RowError::OpenQuote),
                Ok(vec!["1".into(), "2".into()]),
                // Within a field it is a character like others.
                Ok(vec!["2".into(), "3\"".into()]),
            ]
        );
    }
}
