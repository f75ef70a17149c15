//! The time of a table's rows: numbers of a unit, date and clock, or a rate.

use std::io::Read;

use crate::civil::{Stamp, StampReader};
use crate::mapping::{LogMapping, TimeUnit};
use crate::rows::{Row, RowError};
use crate::table::{Table, number};

const DAY_NS: i64 = 86_400_000_000_000;

/// Where a table's time is.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum TablePlace {
    /// A column of numbers in a unit, or of dates and clocks.
    Column {
        /// Of the table's columns.
        index: usize,
        /// Of numbers.
        unit: TimeUnit,
        /// Columns that may hold the days of a column of clocks: its neighbours.
        days: [Option<usize>; 2],
    },
    /// A row after the other, so many a second.
    Rate(f64),
}

impl TablePlace {
    /// Finds it by a mapping.
    pub(crate) fn of<R: Read>(table: &Table<R>, mapping: &LogMapping) -> Option<Self> {
        match mapping.sample_rate_hz {
            Some(rate_hz) => Some(TablePlace::Rate(rate_hz)),
            None => Self::in_column(table, &mapping.time_column, mapping.time_unit),
        }
    }

    /// A column by its name, in a unit that is told, stands below the name, or in its end; seconds otherwise.
    pub(crate) fn in_column<R: Read>(table: &Table<R>, name: &str, unit: Option<TimeUnit>) -> Option<Self> {
        let index = table.column(name)?;
        let below = table.units.get(index).filter(|unit| !unit.is_empty());
        let unit = unit.unwrap_or_else(|| TimeUnit::of_column(below.map_or(name, |unit| unit)));
        let days = [index.checked_sub(1), Some(index + 1).filter(|next| *next < table.columns.len())];
        Some(TablePlace::Column { index, unit, days })
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub(crate) struct TableTime {
    place: TablePlace,
    rows: u64,
    stamps: StampReader,
    /// Which neighbour has the days; unknown before the first clock.
    days: Option<Option<usize>>,
    /// Midnights passed since the log began, where nothing has the days, ns.
    midnights_ns: i64,
    newest_clock_ns: i64,
}

impl TableTime {
    pub(crate) fn new(place: TablePlace) -> Self {
        TableTime {
            place,
            rows: 0,
            stamps: StampReader::default(),
            days: None,
            midnights_ns: 0,
            newest_clock_ns: 0,
        }
    }

    /// A row's time, ns.
    ///
    /// # Errors
    /// [`RowError`] where it has none.
    pub(crate) fn of_row(&mut self, row: &Row) -> Result<i64, RowError> {
        let (index, unit, days) = match self.place {
            TablePlace::Rate(rate_hz) => {
                let time_ns = (self.rows as f64 * 1e9 / rate_hz).round() as i64;
                self.rows += 1;
                return Ok(time_ns);
            }
            TablePlace::Column { index, unit, days } => (index, unit, days),
        };
        let field = row.wanted(index)?;
        if field.is_empty() {
            return Err(RowError::NoTime);
        }
        if let Some(value) = number(field) {
            let time_ns = (value * unit.nanoseconds()).round();
            return if value.is_finite() { Ok(time_ns as i64) } else { Err(RowError::NoTime) };
        }
        let text = String::from_utf8_lossy(field);
        match self.stamps.read(&text) {
            Some(Stamp::Whole(time_ns) | Stamp::Day(time_ns)) => Ok(time_ns),
            Some(Stamp::Clock(clock_ns)) => Ok(self.with_day(row, days, clock_ns)),
            None => Err(RowError::not_a_number(&text)),
        }
    }

    /// A time of the day on the day that a neighbouring column tells; else clocks that go back by half a day have passed midnight.
    fn with_day(&mut self, row: &Row, neighbours: [Option<usize>; 2], clock_ns: i64) -> i64 {
        let mut day_of = |index: usize| {
            let text = std::str::from_utf8(row.field(index)?).ok()?;
            match self.stamps.read(text)? {
                Stamp::Day(day_ns) => Some(day_ns),
                // Spreadsheets put midnight after a day.
                Stamp::Whole(time_ns) if time_ns % DAY_NS == 0 => Some(time_ns),
                _ => None,
            }
        };
        let days = *self
            .days
            .get_or_insert_with(|| neighbours.into_iter().flatten().find(|index| day_of(*index).is_some()));
        if let Some(day_ns) = days.and_then(day_of) {
            return day_ns.saturating_add(clock_ns);
        }
        if clock_ns < self.newest_clock_ns - DAY_NS / 2 {
            self.midnights_ns = self.midnights_ns.saturating_add(DAY_NS);
        }
        self.newest_clock_ns = clock_ns;
        self.midnights_ns.saturating_add(clock_ns)
    }
}
