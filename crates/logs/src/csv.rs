//! Samples from a CSV text with a header row and a time column; commas, semicolons or tabs divide.

use std::io::Read;

use seepd_signals::{Sample, Signal};

use super::Source;
use super::rows::{Row, Rows};
use crate::error::LogError;
use crate::mapping::{SignalMapping, TimeUnit};

/// Columns that an error lists.
const COLUMNS_TOLD: usize = 32;

/// A signal's column.
struct Column {
    index: usize,
    signal: Signal,
    scale: f64,
    offset: f64,
}

/// The columns that are read.
struct Columns {
    time_index: usize,
    time_unit: TimeUnit,
    signals: Vec<Column>,
}

/// Samples from a CSV with a header row.
pub struct CsvSource<R> {
    name: String,
    rows: Rows<R>,
    columns: Columns,
    given: u64,
    unreadable: u64,
    first_unreadable: Option<String>,
}

impl<R: Read> CsvSource<R> {
    /// Reads the header row. Without a unit the time column's name tells it.
    ///
    /// # Errors
    /// [`LogError`] where the header names no time or no command; it lists what there is.
    pub fn new(
        input: R,
        name: &str,
        mapping: &[(Signal, SignalMapping)],
        time_column: &str,
        time_unit: Option<TimeUnit>,
    ) -> Result<Self, LogError> {
        let (rows, headers) = Rows::new(input).map_err(|what| LogError::data(name, what))?;
        let find = |wanted: &str| headers.iter().position(|header| header == wanted);
        let signals: Vec<Column> = mapping
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
        if !signals.iter().any(|column| column.signal == Signal::Command) {
            missing.push(format!("`{command}` for the command"));
        }
        let (Some(time_index), true) = (time_index, missing.is_empty()) else {
            let what = missing.join(" and no column ");
            return Err(LogError::data(name, format!("no column {what}; there are: {}", listed(&headers))));
        };
        let time_unit = time_unit.unwrap_or_else(|| TimeUnit::of_column(time_column));
        Ok(CsvSource {
            name: name.into(),
            rows,
            columns: Columns { time_index, time_unit, signals },
            given: 0,
            unreadable: 0,
            first_unreadable: None,
        })
    }

    /// What there is where no row was of use.
    fn nothing_usable(&self) -> LogError {
        let what = match &self.first_unreadable {
            Some(first) => {
                format!("none of the {} rows can be used; the first of them is at {first}", self.unreadable)
            }
            None => "the file has a header row and nothing else".into(),
        };
        LogError::data(&self.name, what)
    }
}

fn listed(headers: &[String]) -> String {
    let mut text = headers.iter().take(COLUMNS_TOLD).map(String::as_str).collect::<Vec<_>>().join(", ");
    if headers.len() > COLUMNS_TOLD {
        text += &format!(" and {} more", headers.len() - COLUMNS_TOLD);
    }
    text
}

impl Columns {
    fn sample(&self, row: &Row) -> Result<Sample, String> {
        let time = number(row, self.time_index)?;
        if !time.is_finite() {
            return Err("the time is missing".into());
        }
        let mut sample = Sample::new((time * self.time_unit.nanoseconds()).round() as i64);
        for column in &self.signals {
            let value = number(row, column.index)?;
            if column.signal == Signal::Command || !value.is_nan() {
                sample.set(column.signal, value * column.scale + column.offset);
            }
        }
        Ok(sample)
    }
}

fn number(row: &Row, index: usize) -> Result<f64, String> {
    let field = row.field(index).ok_or_else(|| format!("column {} is missing", index + 1))?;
    if field.is_empty() {
        return Ok(f64::NAN);
    }
    let text = std::str::from_utf8(field).map_err(|_| format!("column {} is not text", index + 1))?;
    text.parse().map_err(|_| {
        let begin: String = text.chars().take(40).collect();
        format!("`{begin}` is not a number")
    })
}

impl<R: Read> Source for CsvSource<R> {
    fn next_sample(&mut self) -> Result<Option<Sample>, LogError> {
        loop {
            let row = self.rows.next().map_err(|error| LogError::reading(&self.name, error))?;
            let sample = match row {
                None if self.given == 0 => return Err(self.nothing_usable()),
                None => return Ok(None),
                Some(row) => row.map_err(str::to_owned).and_then(|row| self.columns.sample(row)),
            };
            match sample {
                Ok(sample) => {
                    self.given += 1;
                    return Ok(Some(sample));
                }
                Err(what) => {
                    self.unreadable += 1;
                    let line = self.rows.line_number();
                    self.first_unreadable.get_or_insert_with(|| format!("line {line}: {what}"));
                }
            }
        }
    }

    fn notes(&self) -> Vec<String> {
        let first = self.first_unreadable.as_deref().unwrap_or_default();
        let unreadable = (self.unreadable > 0)
            .then(|| format!("{}: {} rows were left out, the first at {first}", self.name, self.unreadable));
        unreadable.into_iter().collect()
    }
}
