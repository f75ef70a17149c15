//! Rows of a CSV text: fields divided by commas, semicolons or tabs, in quotes where they hold these. A row is a line, so that a
//! stray quote costs the line that it is in, and not all that follow.

use std::io::{self, Read};

use super::lines::{Line, Lines};

/// Longest line that is read, bytes: some ten thousand columns.
const LONGEST_LINE: u64 = 1 << 20;

/// See the [module](self).
pub(crate) struct Rows<R> {
    lines: Lines<R>,
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
    /// Reads the header row, divided by what divides it most; gives the columns' names too.
    ///
    /// # Errors
    /// One line: nothing can be read, or the first line is no header row.
    pub(crate) fn new(input: R) -> Result<(Self, Vec<String>), String> {
        let mut lines = Lines::new(input, LONGEST_LINE);
        let header = match lines.next().map_err(|error| error.to_string())? {
            None => b"",
            Some(Line::TooLong) => return Err(format!("its first line has more than {LONGEST_LINE} bytes")),
            Some(Line::Whole(line)) => line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line),
        };
        let count = |divider: u8| header.iter().filter(|byte| **byte == divider).count();
        let divider = [b'\t', b';']
            .into_iter()
            .fold(b',', |best, other| if count(other) > count(best) { other } else { best });
        let mut row = Row::default();
        row.split(header, divider).map_err(|what| format!("line 1: {what}"))?;
        let columns = row.fields().map(|name| String::from_utf8_lossy(name).into_owned()).collect();
        Ok((Rows { lines, divider, row }, columns))
    }

    /// The next row, or what is wrong with it; empty lines are none.
    pub(crate) fn next(&mut self) -> io::Result<Option<Result<&Row, &'static str>>> {
        loop {
            return Ok(Some(match self.lines.next()? {
                None => return Ok(None),
                Some(Line::Whole(line)) if line.trim_ascii().is_empty() => continue,
                Some(Line::Whole(line)) => self.row.split(line, self.divider).map(|()| &self.row),
                Some(Line::TooLong) => Err("the line is longer than a row can be"),
            }));
        }
    }

    /// Line of the row that was read last.
    pub(crate) fn line_number(&self) -> u64 {
        self.lines.number()
    }
}

impl Row {
    /// A field by its column.
    pub(crate) fn field(&self, column: usize) -> Option<&[u8]> {
        let begin = if column == 0 { 0 } else { *self.ends.get(column - 1)? };
        self.text.get(begin..*self.ends.get(column)?)
    }

    /// The fields in their order.
    pub(crate) fn fields(&self) -> impl Iterator<Item = &[u8]> {
        (0..self.ends.len()).map_while(|column| self.field(column))
    }

    fn split(&mut self, line: &[u8], divider: u8) -> Result<(), &'static str> {
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
    fn take_quoted<'l>(&mut self, mut text: &'l [u8], divider: u8) -> Result<Option<&'l [u8]>, &'static str> {
        loop {
            let end = text.iter().position(|byte| *byte == b'"').ok_or("a quote is opened and not closed")?;
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

    fn rows(text: &str) -> (Vec<String>, Vec<Result<Vec<String>, &'static str>>) {
        let (mut rows, columns) = Rows::new(text.as_bytes()).unwrap();
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
    fn a_stray_quote_costs_its_line() {
        let (_, found) = rows("t_s,command\n0,\"1\n1,2\n2,3\"\n");
        assert_eq!(
            found,
            [
                Err("a quote is opened and not closed"),
                Ok(vec!["1".into(), "2".into()]),
                // Within a field it is a character like others.
                Ok(vec!["2".into(), "3\"".into()]),
            ]
        );
    }
}
