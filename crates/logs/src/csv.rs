//! Samples from a table as text: commas, semicolons or tabs divide; the time stands in a column, or follows from a rate.

use std::collections::VecDeque;
use std::io::Read;

use seepd_signals::{Sample, Signal};

use super::Source;
use super::rows::{Row, RowError};
use super::table::{Table, number};
use super::table_time::{TablePlace, TableTime};
use crate::error::{LogError, listed};
use crate::mapping::{LogMapping, ToSi};

/// Columns that an error lists.
pub(crate) const COLUMNS_TOLD: usize = 32;
/// Samples of a log's beginning that tell whether its stamps are coarser than its rows.
const BEGINNING: usize = 16;
/// Of these, how many have the stamp of the row before where they are.
const SHARED: usize = 4;
/// Rows with one stamp that are held until the next stamp tells how far they reach.
const MOST_WITH_ONE_STAMP: usize = 1 << 16;

/// A signal's column.
struct Column {
    index: usize,
    signal: Signal,
    to_si: ToSi,
}

/// Samples from a table.
pub struct CsvSource<R> {
    name: String,
    table: Table<R>,
    time: TableTime,
    signals: Vec<Column>,
    held: Held,
    given: u64,
    unreadable: u64,
    first_unreadable: Option<String>,
}

/// Samples that wait for what follows them.
#[derive(Default)]
struct Held {
    /// Ready to be given.
    ready: VecDeque<Sample>,
    /// Those that share the newest stamp.
    sharing: Vec<Sample>,
    /// Whether stamps are coarser than rows; unknown at the beginning.
    coarse: Option<bool>,
    /// Rows that were moved off the stamp that they share with others.
    spread: u64,
}

impl<R: Read> CsvSource<R> {
    /// Finds the rows, and the columns of the mapping. Without a unit the time column's name tells it.
    ///
    /// # Errors
    /// [`LogError`] where there is no column for the time or the command; it lists what there is.
    pub fn new(input: R, name: &str, mapping: &LogMapping) -> Result<Self, LogError> {
        let places = mapping.places();
        let names: Vec<&str> =
            places.iter().map(|(_, place)| &*place.field).chain([&*mapping.time_column]).collect();
        let table = Table::new(input, &names).map_err(|error| LogError::data(name, error.to_string()))?;
        let signals: Vec<Column> = places
            .iter()
            .filter_map(|(signal, place)| {
                let index = table.column(&place.field)?;
                Some(Column { index, signal: *signal, to_si: place.to_si(*signal, "") })
            })
            .collect();
        let command = places.iter().find(|(signal, _)| *signal == Signal::Command);
        let command = command.map_or("command", |(_, mapping)| &mapping.field);
        let time = TablePlace::of(&table, mapping);
        let mut missing = Vec::new();
        if time.is_none() {
            missing.push(format!("`{}` for the time", mapping.time_column));
        }
        if !signals.iter().any(|column| column.signal == Signal::Command) {
            missing.push(format!("`{command}` for the command"));
        }
        let (Some(time), true) = (time, missing.is_empty()) else {
            let what = missing.join(" and no column ");
            let named = if table.has_names { "there are" } else { "its columns have no names but numbers" };
            return Err(LogError::data(
                name,
                format!("no column {what}; {named}: {}", listed(&table.columns, COLUMNS_TOLD)),
            ));
        };
        Ok(CsvSource {
            name: name.into(),
            table,
            time: TableTime::new(time),
            signals,
            held: Held::default(),
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

    /// Reads a row, which completes what is held or is held itself; `false` at the end.
    fn read_row(&mut self) -> Result<bool, LogError> {
        let row = self.table.next().map_err(|error| LogError::reading(&self.name, error))?;
        let Some(row) = row else {
            self.held.end();
            return Ok(false);
        };
        let sample = row.and_then(|row| sample_of(row, &mut self.time, &self.signals));
        match sample {
            Ok(sample) => self.held.take(sample),
            Err(error) => {
                self.unreadable += 1;
                let line = self.table.line_number();
                self.first_unreadable.get_or_insert_with(|| format!("line {line}: {error}"));
            }
        }
        Ok(true)
    }
}

impl Held {
    fn take(&mut self, sample: Sample) {
        match self.coarse {
            Some(false) => self.ready.push_back(sample),
            Some(true) => self.share(sample),
            None => {
                self.sharing.push(sample);
                if self.sharing.len() == BEGINNING {
                    self.decide();
                }
            }
        }
    }

    /// Tells by the beginning whether several rows share a stamp as a rule.
    fn decide(&mut self) {
        let shared = self.sharing.windows(2).filter(|pair| pair[0].time_ns == pair[1].time_ns).count();
        self.coarse = Some(shared >= SHARED);
        for sample in std::mem::take(&mut self.sharing) {
            self.take(sample);
        }
    }

    /// Holds a sample until the next stamp; spreads those that share one over the time up to it.
    fn share(&mut self, sample: Sample) {
        if let Some(first) = self.sharing.first()
            && (first.time_ns != sample.time_ns || self.sharing.len() >= MOST_WITH_ONE_STAMP)
        {
            let count = self.sharing.len() as i64;
            let reach_ns = sample.time_ns.saturating_sub(first.time_ns).max(0);
            self.spread += self.sharing.len() as u64 - 1;
            for (place, mut held) in self.sharing.drain(..).enumerate() {
                held.time_ns = held.time_ns.saturating_add(reach_ns / count * place as i64);
                self.ready.push_back(held);
            }
        }
        self.sharing.push(sample);
    }

    fn end(&mut self) {
        if self.coarse.is_none() {
            self.decide();
        }
        self.ready.extend(self.sharing.drain(..));
    }
}

fn sample_of(row: &Row, time: &mut TableTime, signals: &[Column]) -> Result<Sample, RowError> {
    let mut sample = Sample::new(time.of_row(row)?);
    for column in signals {
        let value = value_of(row, column.index)?;
        if column.signal == Signal::Command || !value.is_nan() {
            sample.set(column.signal, column.to_si.of(value));
        }
    }
    Ok(sample)
}

fn value_of(row: &Row, index: usize) -> Result<f64, RowError> {
    let field = row.wanted(index)?;
    if field.is_empty() {
        return Ok(f64::NAN);
    }
    let text = std::str::from_utf8(field).map_err(|_| RowError::NotText { number: index + 1 })?;
    number(field).ok_or_else(|| RowError::not_a_number(text))
}

impl<R: Read> Source for CsvSource<R> {
    fn next_sample(&mut self) -> Result<Option<Sample>, LogError> {
        loop {
            if let Some(sample) = self.held.ready.pop_front() {
                self.given += 1;
                return Ok(Some(sample));
            }
            if !self.read_row()? && self.held.ready.is_empty() {
                return if self.given == 0 { Err(self.nothing_usable()) } else { Ok(None) };
            }
        }
    }

    fn notes(&self) -> Vec<String> {
        let first = self.first_unreadable.as_deref().unwrap_or_default();
        let unreadable = (self.unreadable > 0)
            .then(|| format!("{}: {} rows were left out, the first at {first}", self.name, self.unreadable));
        let spread = (self.held.spread > 0).then(|| {
            format!(
                "{}: its time stamps are coarser than its rows; {} rows were put evenly between the stamps",
                self.name, self.held.spread
            )
        });
        unreadable.into_iter().chain(spread).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_cannot_be_used_say_why() {
        for (row, told) in [
            (&b"0"[..], "column 2 is missing"),
            (b"0,\xff", "column 2 is not text"),
            (b"0,oops", "`oops` is not a number"),
            (b",0", "the time is missing"),
            (b"nan,0", "the time is missing"),
            (b"soon,0", "`soon` is not a number"),
            (b"0,\"1", "a quote is opened and not closed"),
        ] {
            let log = [b"t_s,command\n", row, b"\n"].concat();
            let mut source = CsvSource::new(&*log, "log", &LogMapping::default()).unwrap();
            assert_eq!(
                source.next_sample().unwrap_err().to_string(),
                format!("log: none of the 1 rows can be used; the first of them is at line 2: {told}")
            );
        }
    }

    #[test]
    fn a_text_that_cannot_be_read_says_why() {
        struct Torn;
        impl Read for Torn {
            fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
                Err(std::io::Error::other("the disk is gone"))
            }
        }
        let error = CsvSource::new(Torn, "log", &LogMapping::default()).err().unwrap();
        assert_eq!(error.to_string(), "log: the disk is gone");
        assert!(matches!(error, LogError::Data { .. }));
    }
}
