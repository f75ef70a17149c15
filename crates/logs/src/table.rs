//! A text with a column for each signal, as scopes, controllers and spreadsheets write it: what stands before the rows, where the names
//! are, and how numbers are written.

use std::io::{self, Read};

use crate::civil::StampReader;
use crate::rows::{Row, RowError, Rows, TableError, divider_of};

/// Lines of a text's beginning in which the first row is looked for.
const PREAMBLE_LINES: usize = 256;
/// Bytes of them.
const PREAMBLE_BYTES: usize = 1 << 20;

/// Lines after the first row in which a line with a name that is asked for is looked for: numbers stand in preambles too.
const LINES_LOOKED_ON: usize = 32;

/// See the [module](self).
pub(crate) struct Table<R> {
    rows: Rows<R>,
    /// The columns' names; their numbers, from 1 on, where the text has none.
    pub(crate) columns: Vec<String>,
    /// The columns' units, where a line of them follows the names; else empty.
    pub(crate) units: Vec<String>,
    /// Whether the text has names.
    pub(crate) has_names: bool,
}

/// A line of the beginning.
struct Beginning {
    divider: u8,
    fields: Vec<String>,
}

impl Beginning {
    fn of(line: &[u8]) -> Self {
        let divider = divider_of(line);
        let mut row = Row::default();
        // A stray quote makes a line that is no header.
        let fields = match row.split(line, divider) {
            Ok(()) => row.fields().map(|field| String::from_utf8_lossy(field).into_owned()).collect(),
            Err(_) => Vec::new(),
        };
        Beginning { divider, fields }
    }

    /// Whether it is a row: most of what is in it are numbers or stamps of time.
    fn is_row(&self) -> bool {
        let filled = self.fields.iter().filter(|field| !field.is_empty());
        let (mut numbers, mut all) = (0, 0);
        for field in filled {
            all += 1;
            let is_value = number(field.as_bytes()).is_some() || StampReader::default().read(field).is_some();
            numbers += usize::from(is_value);
        }
        2 * numbers > all
    }

    fn has(&self, names: &[&str]) -> bool {
        self.fields.iter().any(|field| names.contains(&field.as_str()))
    }
}

impl<R: Read> Table<R> {
    /// Finds the first row: it follows the line that has one of the names, or the columns' names and perhaps their units, or nothing.
    ///
    /// # Errors
    /// [`TableError`]: nothing can be read, or the first line is none of a table.
    pub(crate) fn new(input: R, names: &[&str]) -> Result<Self, TableError> {
        // Columns that are named by their numbers have no line of names.
        let names: Vec<&str> = names.iter().copied().filter(|name| name.parse::<f64>().is_err()).collect();
        let mut rows = Rows::new(input);
        let mut before: Vec<Beginning> = Vec::new();
        let (mut bytes, mut first_row) = (0, None);
        loop {
            let looked_on =
                first_row.is_some_and(|row| names.is_empty() || before.len() > row + LINES_LOOKED_ON);
            let room = before.len() < PREAMBLE_LINES && bytes < PREAMBLE_BYTES && !looked_on;
            let line = if room { rows.look_at_next()? } else { None };
            let Some(line) = line else { break };
            bytes += line.len();
            let line = Beginning::of(line);
            let (at, wide) = (before.len(), line.fields.len() > 1);
            if wide && line.has(&names) {
                before.push(line);
                let first_row = at + 1 + Self::look_for_units(&mut rows, &mut before)?;
                return Ok(Self::with_names(rows, before, at, first_row));
            }
            if wide && line.is_row() {
                first_row.get_or_insert(at);
            }
            before.push(line);
        }
        Ok(match first_row {
            // Nothing but one line, or none that looks like a row: the first is then the header.
            None => Self::with_names(rows, before, 0, 1),
            Some(at) => match names_before(&before, at) {
                Some(header) => Self::with_names(rows, before, header, at),
                None => Self::without_names(rows, &before[at], at),
            },
        })
    }

    /// Lines after the names up to and with that of their units; 0 where there is none.
    fn look_for_units(rows: &mut Rows<R>, before: &mut Vec<Beginning>) -> Result<usize, TableError> {
        let (names, count) = (before.len(), before.last().map_or(0, |names| names.fields.len()));
        while let Some(line) = rows.look_at_next()? {
            let is_empty = line.trim_ascii().is_empty();
            before.push(Beginning::of(line));
            if !is_empty || before.len() > names + LINES_LOOKED_ON {
                break;
            }
        }
        let units = before.last().filter(|line| line.fields.len() == count && count > 1 && !line.is_row());
        Ok(if units.is_some_and(|line| are_units(&line.fields)) { before.len() - names } else { 0 })
    }

    fn with_names(mut rows: Rows<R>, mut before: Vec<Beginning>, header: usize, first_row: usize) -> Self {
        let count = before.get(header).map_or(0, |names| names.fields.len());
        let units =
            (header + 1..first_row).find(|at| before.get(*at).is_some_and(|line| line.fields.len() == count));
        let units = units.map(|at| std::mem::take(&mut before[at].fields)).unwrap_or_default();
        let units =
            units.iter().map(|unit| unit.trim_matches(['(', ')', '[', ']', ' ']).to_owned()).collect();
        let (divider, columns) = before
            .into_iter()
            .nth(header)
            .map_or((b',', vec![String::new()]), |names| (names.divider, names.fields));
        rows.begin(first_row, divider);
        Table { rows, columns, units, has_names: true }
    }

    fn without_names(mut rows: Rows<R>, first: &Beginning, at: usize) -> Self {
        rows.begin(at, first.divider);
        let columns = (1..=first.fields.len()).map(|number| number.to_string()).collect();
        Table { rows, columns, units: Vec::new(), has_names: false }
    }

    /// The column of a name.
    pub(crate) fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }

    /// The next row, or what is wrong with it.
    pub(crate) fn next(&mut self) -> io::Result<Option<Result<&Row, RowError>>> {
        self.rows.next()
    }

    /// Line of the row that was read last.
    pub(crate) fn line_number(&self) -> u64 {
        self.rows.line_number()
    }
}

/// The line with the names of the row at an index: the one before it that has as many fields, of which none is a number; between them may
/// be one of units, and empty ones.
fn names_before(before: &[Beginning], row: usize) -> Option<usize> {
    let count = before[row].fields.len();
    // A divider at a row's end, as controllers write it, is no column.
    let fits = |line: &Beginning| {
        (line.fields.len() == count || line.fields.len() + 1 == count)
            && !line.is_row()
            && line.fields.len() > 1
    };
    let nearest = (0..row).rev().find(|at| before[*at].fields.iter().any(|field| !field.is_empty()))?;
    if !fits(&before[nearest]) {
        return None;
    }
    let above =
        nearest.checked_sub(1).filter(|above| fits(&before[*above]) && are_units(&before[nearest].fields));
    Some(above.unwrap_or(nearest))
}

/// Whether a line has units: each field is short, or in brackets. A number is none, but for the 1 of what has no unit; and the first field,
/// which mostly is the time, has one.
fn are_units(fields: &[String]) -> bool {
    let is_number = |field: &String| number(field.as_bytes()).is_some();
    let is_unit = |field: &String| {
        field.is_empty()
            || field.starts_with(['(', '['])
            || field.chars().count() <= 5 && !field.contains(' ') && (field == "1" || !is_number(field))
    };
    let begins_with_a_number = fields.first().is_some_and(is_number);
    !begins_with_a_number && fields.iter().all(is_unit) && fields.iter().any(|field| !field.is_empty())
}

/// A number as people write it: `1.5`, `1,5`, `1.234,5`, `1,234.5`, `true`.
pub(crate) fn number(text: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(text).ok()?.trim();
    if let Ok(value) = text.parse() {
        return Some(value);
    }
    match text {
        "TRUE" | "True" | "true" => return Some(1.0),
        "FALSE" | "False" | "false" => return Some(0.0),
        _ => {}
    }
    let comma = text.rfind(',')?;
    let mut plain = [0; 48];
    let mut length = 0;
    let decimal = if text.rfind('.').is_some_and(|point| point > comma) { b'.' } else { b',' };
    for byte in text.bytes() {
        let put = match byte {
            b'.' | b',' if byte == decimal => b'.',
            b'.' | b',' => continue,
            other => other,
        };
        *plain.get_mut(length)? = put;
        length += 1;
    }
    std::str::from_utf8(&plain[..length]).ok()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names, units, and the first row with its line.
    fn table(text: &str, names: &[&str]) -> (Vec<String>, Vec<String>, Vec<String>, u64) {
        let mut table = Table::new(text.as_bytes(), names).unwrap();
        let row = match table.next().unwrap() {
            Some(row) => {
                row.unwrap().fields().map(|field| String::from_utf8_lossy(field).into_owned()).collect()
            }
            None => Vec::new(),
        };
        (table.columns.clone(), table.units.clone(), row, table.line_number())
    }

    #[test]
    fn names_are_found_below_a_preamble_and_above_units() {
        let scope = "Model,DPO2024\nSampling Interval,1e-3\nNotes,\"a, b\"\n\nTIME,CH1,CH2\n(ms),(mV),(V)\n\n0.0,1.5,2\n";
        let (columns, units, row, line) = table(scope, &[]);
        assert_eq!(columns, ["TIME", "CH1", "CH2"]);
        assert_eq!(units, ["ms", "mV", "V"]);
        assert_eq!((row.join(" ").as_str(), line), ("0.0 1.5 2", 8));
        // A preamble of numbers, as the names tell.
        let plc = "Station;7\n1;2;3\nZeit;Ventil;p\n01.02.2024 10:00:00,5;0,25;7\n";
        assert_eq!(table(plc, &["Ventil"]).0, ["Zeit", "Ventil", "p"]);
        assert_eq!(
            table("Export of line 7\nZeit;Ventil\n01.02.2024 10:00:00,5;0,25\n", &[]).0,
            ["Zeit", "Ventil"]
        );
        assert_eq!(
            table("a,b\n1,2\n", &[]),
            (vec!["a".into(), "b".into()], vec![], vec!["1".into(), "2".into()], 2)
        );
    }

    #[test]
    fn columns_without_names_are_numbered() {
        let (columns, _, row, line) = table("# no names\n0\t1,5\t2\n1\t1,6\t2\n", &[]);
        assert_eq!(columns, ["1", "2", "3"]);
        assert_eq!((row.join(" ").as_str(), line), ("0 1,5 2", 2));
        assert_eq!(table("command\n", &[]).0, ["command"]);
        assert_eq!(table("", &[]).0, [""]);
    }

    #[test]
    fn numbers_as_people_write_them() {
        for (text, value) in [
            ("1.5", 1.5),
            ("-1,5", -1.5),
            ("1.234,5", 1234.5),
            ("1,234.5", 1234.5),
            ("1,5e-3", 0.0015),
            (" 7 ", 7.0),
            ("TRUE", 1.0),
        ] {
            assert_eq!(number(text.as_bytes()), Some(value), "{text}");
        }
        for text in ["", "oil", "1,2,x", "12:00", "01.02.2024", "1 2"] {
            assert_eq!(number(text.as_bytes()), None, "{text}");
        }
    }
}
