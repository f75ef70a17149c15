//! Samples from a CSV text with a header row and a time column in seconds; commas, semicolons or tabs divide.

use std::io::{BufRead, BufReader, Read};

use csv::{ByteRecord, Reader, ReaderBuilder};
use seepd_signals::{Sample, Signal};

use super::Source;
use crate::config::SignalMapping;
use crate::failure::Failure;

/// A reader of rows, divided by what divides the first line most.
///
/// # Errors
/// [`Failure`] where nothing can be read.
pub fn csv_reader<R: Read>(input: R, name: &str) -> Result<Reader<BufReader<R>>, Failure> {
    let mut input = BufReader::new(input);
    let begin = input.fill_buf().map_err(|error| Failure::data(format!("{name}: {error}")))?;
    let header = begin.split(|byte| *byte == b'\n').next().unwrap_or_default();
    let count = |divider: u8| header.iter().filter(|byte| **byte == divider).count();
    let delimiter = [b'\t', b';']
        .into_iter()
        .fold(b',', |best, other| if count(other) > count(best) { other } else { best });
    Ok(ReaderBuilder::new().flexible(true).trim(csv::Trim::All).delimiter(delimiter).from_reader(input))
}

/// A signal's column.
struct Column {
    index: usize,
    signal: Signal,
    scale: f64,
    offset: f64,
}

/// See the [module](self).
pub struct CsvSource<R> {
    name: String,
    reader: Reader<BufReader<R>>,
    record: ByteRecord,
    time_index: usize,
    columns: Vec<Column>,
    unreadable: u64,
    first_unreadable: Option<String>,
}

impl<R: Read> CsvSource<R> {
    /// Reads the header row.
    ///
    /// # Errors
    /// [`Failure`] where the header names no time or no command; it lists what there is.
    pub fn new(
        input: R,
        name: &str,
        mapping: Vec<(Signal, SignalMapping)>,
        time_column: &str,
    ) -> Result<Self, Failure> {
        let mut reader = csv_reader(input, name)?;
        let headers = reader.headers().map_err(|error| Failure::data(format!("{name}: {error}")))?.clone();
        let find = |wanted: &str| headers.iter().position(|header| header == wanted);
        let listed = || headers.iter().collect::<Vec<_>>().join(", ");
        let columns: Vec<Column> = mapping
            .iter()
            .filter_map(|(signal, m)| {
                Some(Column { index: find(&m.field)?, signal: *signal, scale: m.scale, offset: m.offset })
            })
            .collect();
        let command = mapping.iter().find(|(signal, _)| *signal == Signal::Command);
        let command = command.map_or("command", |(_, mapping)| &mapping.field);
        let time_index = find(time_column);
        let mut missing = Vec::new();
        if time_index.is_none() {
            missing.push(format!("`{time_column}` for the time"));
        }
        if !columns.iter().any(|column| column.signal == Signal::Command) {
            missing.push(format!("`{command}` for the command"));
        }
        let (Some(time_index), true) = (time_index, missing.is_empty()) else {
            let what = missing.join(" and no column ");
            return Err(Failure::data(format!("{name}: no column {what}; there are: {}", listed())));
        };
        Ok(CsvSource {
            name: name.into(),
            reader,
            record: ByteRecord::new(),
            time_index,
            columns,
            unreadable: 0,
            first_unreadable: None,
        })
    }

    fn number(&self, index: usize) -> Result<f64, String> {
        let field = self.record.get(index).ok_or_else(|| format!("column {} is missing", index + 1))?;
        if field.is_empty() {
            return Ok(f64::NAN);
        }
        let text = std::str::from_utf8(field).map_err(|_| format!("column {} is not text", index + 1))?;
        text.parse().map_err(|_| format!("`{text}` is not a number"))
    }

    fn sample(&self) -> Result<Sample, String> {
        let time_s = self.number(self.time_index)?;
        if !time_s.is_finite() {
            return Err("the time is missing".into());
        }
        let mut sample = Sample::new((time_s * 1e9).round() as i64);
        for column in &self.columns {
            let value = self.number(column.index)?;
            if column.signal == Signal::Command || !value.is_nan() {
                sample.set(column.signal, value * column.scale + column.offset);
            }
        }
        Ok(sample)
    }
}

impl<R: Read> Source for CsvSource<R> {
    fn next_sample(&mut self) -> Result<Option<Sample>, Failure> {
        loop {
            match self.reader.read_byte_record(&mut self.record) {
                Ok(false) => return Ok(None),
                Ok(true) => {}
                Err(error) => return Err(Failure::data(format!("{}: {error}", self.name))),
            }
            match self.sample() {
                Ok(sample) => return Ok(Some(sample)),
                Err(what) => {
                    self.unreadable += 1;
                    let line = self.record.position().map_or(0, csv::Position::line);
                    self.first_unreadable.get_or_insert_with(|| format!("line {line}: {what}"));
                }
            }
        }
    }

    fn notes(&self) -> Vec<String> {
        let first = self.first_unreadable.as_deref().unwrap_or_default();
        let unreadable = (self.unreadable > 0)
            .then(|| format!("{}: {} rows left out; the first at {first}", self.name, self.unreadable));
        unreadable.into_iter().collect()
    }
}
