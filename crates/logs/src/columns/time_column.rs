//! The column of a CSV that is its time, by name and by how it grows.

use std::io::Read;
use std::path::Path;

use super::Known;
use crate::csv::COLUMNS_TOLD;
use crate::error::{LogError, listed};
use crate::mapping::TimeUnit;
use crate::opened::Opened;
use crate::source::log_name;
use crate::table::{Table, number};
use crate::table_time::{TablePlace, TableTime};

/// Rows that are looked at.
const ROWS: usize = 4096;
/// Rates at which machines are logged, Hz.
const RATES_HZ: std::ops::RangeInclusive<f64> = 40.0..=5000.0;
/// The same, where a log is slow or fast.
const WIDE_RATES_HZ: std::ops::RangeInclusive<f64> = 0.5..=50_000.0;
/// Steps of a clock that are longer than so many medians are pauses, of which there are few.
const PAUSE_STEPS: f64 = 8.0;
/// Share of the steps that may be pauses or stand still.
const ODD_STEPS: f64 = 0.05;

/// Words in the name of a time column.
const WORDS: &[&str] = &[
    "t",
    "time",
    "timestamp",
    "zeit",
    "zeitstempel",
    "stamp",
    "clock",
    "elapsed",
    "date",
    "datetime",
    "sec",
    "seconds",
    "temps",
    "tiempo",
];

/// Where a CSV's time is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TimeColumn {
    /// Name.
    pub column: String,
    /// Unit.
    pub unit: TimeUnit,
    /// How that is known, in one sentence; what is to be checked where it is not certain.
    pub why: String,
    /// Whether name or clock leave no doubt.
    pub certain: bool,
}

/// A column as far as it is looked at.
struct Head {
    name: String,
    /// Unit in a row below the name; may be empty.
    unit: String,
    values: Vec<f64>,
    /// How many of them are dates or clocks.
    stamps: usize,
}

impl TimeColumn {
    /// Finds it in the first rows.
    ///
    /// # Errors
    /// [`LogError`] where no column can be a time, with what to do.
    pub(super) fn find(input: impl Read, name: &str, known: &Known) -> Result<Self, LogError> {
        let heads = heads(input, name)?;
        if let Some(column) = &known.time_column {
            let head = heads.iter().find(|head| head.name == *column);
            let head = head.ok_or_else(|| {
                LogError::data(
                    name,
                    format!("no column `{column}` for the time; there are: {}", listed_heads(&heads)),
                )
            })?;
            return Ok(head.as_time(known.time_unit).unwrap_or_else(|| head.taken_as_told(known.time_unit)));
        }
        let candidates = heads.iter().filter_map(|head| Some((head.rank(), head.as_time(known.time_unit)?)));
        // The first of equals: a controller's clock stands before what is derived from it.
        let best = candidates.reduce(|best, other| if other.0 > best.0 { other } else { best });
        best.map(|(_, time)| time).ok_or_else(|| {
            LogError::data(
                name,
                format!(
                    "none of its columns is a time: a clock's name or steady steps are looked for; \
                     name the time column, or add one; there are: {}",
                    listed_heads(&heads)
                ),
            )
        })
    }
}

impl TimeColumn {
    /// The time column of a CSV file; `None` where it is another kind of log, or none is found.
    pub(crate) fn of_csv(path: &Path) -> Option<Self> {
        if !path.is_file() {
            return None;
        }
        match Opened::at(path, |_| {}) {
            Ok(Opened::Csv(text)) => Self::find(text, &log_name(path), &Known::default()).ok(),
            _ => None,
        }
    }
}

impl Head {
    /// How much the name speaks for a time: the whole of it, a word in it, nothing.
    fn rank(&self) -> u8 {
        let lower = self.name.to_lowercase();
        let words: Vec<&str> =
            lower.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty()).collect();
        let named = |word: &&&str| WORDS.contains(*word);
        match (words.first(), words.iter().find(named)) {
            (Some(first), Some(_)) if named(&first) => 2,
            (_, Some(_)) => 1,
            _ => 0,
        }
    }

    /// As a time, if it can be one.
    fn as_time(&self, unit: Option<TimeUnit>) -> Option<TimeColumn> {
        if self.stamps > 0 {
            return self.as_stamps();
        }
        let step = self.clock_step()?;
        let named = self.rank() > 0;
        // Row numbers grow as steadily as clocks do.
        if !named && unit.is_none() && step == 1.0 {
            return None;
        }
        let column = self.name.clone();
        if let Some(unit) = unit.or_else(|| named_unit(&self.unit)).or_else(|| named_unit(&self.name)) {
            let why = format!("`{column}` grows in steady steps and is in {}", unit.name());
            return Some(TimeColumn { column, unit, why, certain: named });
        }
        let (unit, certain) =
            unit_of_date(self.values[0]).map(|unit| (unit, true)).or_else(|| unit_of_step(step))?;
        let rate_hz = 1e9 / (step * unit.nanoseconds());
        let why = format!(
            "`{column}` grows in steps of {step}; in {} that is a log at {rate_hz:.0} Hz",
            unit.name()
        );
        // A name without a unit is of seconds by custom; another unit is a guess that the rate speaks for.
        Some(TimeColumn { column, unit, why, certain: certain && named && unit == TimeUnit::S })
    }

    /// A column of dates and clocks, which grow; each may stand in several rows.
    fn as_stamps(&self) -> Option<TimeColumn> {
        let grow = self.values.windows(2).all(|pair| pair[1] >= pair[0]);
        let grown = self.values.last() > self.values.first();
        let column = self.name.clone();
        let why = format!("`{column}` has dates or times of the day, which are taken as UTC");
        (grow && grown).then_some(TimeColumn { column, unit: TimeUnit::S, why, certain: true })
    }

    fn taken_as_told(&self, unit: Option<TimeUnit>) -> TimeColumn {
        let unit = unit.unwrap_or_else(|| TimeUnit::of_column(&self.name));
        let why = format!("`{}` was named as the time, though it does not grow in steady steps", self.name);
        TimeColumn { column: self.name.clone(), unit, why, certain: false }
    }

    /// The step from row to row, if it grows like a clock.
    fn clock_step(&self) -> Option<f64> {
        let steps: Vec<f64> = self.values.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let mut sorted = steps.clone();
        sorted.sort_by(f64::total_cmp);
        let median = *sorted.get(sorted.len() / 2)?;
        let odd = steps.iter().filter(|step| !(0.0..=PAUSE_STEPS * median).contains(*step)).count();
        let still = steps.iter().filter(|step| **step == 0.0).count();
        let few = ODD_STEPS * steps.len() as f64;
        // A position in a slow stroke grows too; its steps differ from row to row, by many times and down to nothing.
        let first_tenth = sorted[sorted.len() / 10];
        let steady = first_tenth > 0.2 * median;
        (median > 0.0 && steady && odd as f64 <= few && still as f64 <= few).then_some(median)
    }
}

/// The unit that the name says; unlike [`TimeUnit::of_column`], none where it says nothing.
fn named_unit(name: &str) -> Option<TimeUnit> {
    match TimeUnit::of_column(name) {
        TimeUnit::S => {
            let last =
                name.rsplit(|c: char| !c.is_alphanumeric()).find(|word| !word.is_empty())?.to_lowercase();
            matches!(last.as_str(), "s" | "sec" | "secs" | "second" | "seconds" | "sekunden")
                .then_some(TimeUnit::S)
        }
        unit => Some(unit),
    }
}

/// Seconds since 1970 of the years 2001 to 2100 tell their unit.
fn unit_of_date(value: f64) -> Option<TimeUnit> {
    let units = [TimeUnit::S, TimeUnit::Ms, TimeUnit::Us, TimeUnit::Ns];
    units.into_iter().find(|unit| (1e9..4.1e9).contains(&(value * unit.nanoseconds() * 1e-9)))
}

/// The unit in which the step is that of a log; whether that is a usual rate.
fn unit_of_step(step: f64) -> Option<(TimeUnit, bool)> {
    let units = [TimeUnit::S, TimeUnit::Ms, TimeUnit::Us, TimeUnit::Ns];
    let within = |rates: std::ops::RangeInclusive<f64>| {
        units.into_iter().find(|unit| rates.contains(&(1e9 / (step * unit.nanoseconds()))))
    };
    within(RATES_HZ).map(|unit| (unit, true)).or_else(|| within(WIDE_RATES_HZ).map(|unit| (unit, false)))
}

fn heads(input: impl Read, name: &str) -> Result<Vec<Head>, LogError> {
    let mut table = Table::new(input, &[]).map_err(|error| LogError::data(name, error.to_string()))?;
    let units = table.units.iter().cloned().chain(std::iter::repeat(String::new()));
    let heads = table.columns.iter().cloned().zip(units);
    let mut heads: Vec<Head> =
        heads.map(|(name, unit)| Head { name, unit, values: Vec::new(), stamps: 0 }).collect();
    let mut times: Vec<Option<TableTime>> = heads
        .iter()
        .map(|head| TablePlace::in_column(&table, &head.name, Some(TimeUnit::S)).map(TableTime::new))
        .collect();
    for _ in 0..ROWS {
        let Some(row) = table.next().map_err(|error| LogError::reading(name, error))? else { break };
        let Ok(row) = row else { continue };
        for (index, (head, time)) in heads.iter_mut().zip(&mut times).enumerate() {
            let Some(text) = row.field(index) else { continue };
            match number(text) {
                Some(value) => head.values.extend(Some(value).filter(|value| value.is_finite())),
                None => {
                    // A date, or a clock: in s.
                    if let Some(Ok(time_ns)) = time.as_mut().map(|time| time.of_row(row)) {
                        head.values.push(time_ns as f64 * 1e-9);
                        head.stamps += 1;
                    }
                }
            }
        }
    }
    Ok(heads)
}

fn listed_heads(heads: &[Head]) -> String {
    let names: Vec<&str> = heads.iter().map(|head| head.name.as_str()).collect();
    listed(&names, COLUMNS_TOLD)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn find(header: &str, row: impl Fn(usize) -> String) -> Result<(String, TimeUnit, bool), String> {
        let rows: String = (0..500).map(|n| row(n) + "\n").collect();
        TimeColumn::find(format!("{header}\n{rows}").as_bytes(), "log", &Known::default())
            .map(|time| (time.column, time.unit, time.certain))
            .map_err(|error| error.to_string())
    }

    #[test]
    fn a_time_is_found_under_any_name_and_in_any_unit() {
        let time = |n: usize, step: f64| n as f64 * step;
        for (header, step, unit, certain) in [
            ("t_s,x", 0.001, TimeUnit::S, true),
            ("Time,x", 0.002, TimeUnit::S, true),
            ("Zeit [ms],x", 1.0, TimeUnit::Ms, true),
            ("time_us,x", 1000.0, TimeUnit::Us, true),
            // By the rate alone: steps of 1 in a log are more likely ms than s.
            ("Time,x", 1.0, TimeUnit::Ms, false),
            ("Time,x", 4000.0, TimeUnit::Us, false),
            ("col0,x", 0.01, TimeUnit::S, false),
        ] {
            let found = find(header, |n| format!("{},{}", time(n, step), (n as f64 / 30.0).sin())).unwrap();
            let column = header.split(',').next().unwrap().to_owned();
            assert_eq!(found, (column, unit, certain), "{header}");
        }
    }

    #[test]
    fn a_date_tells_its_unit_and_jitter_is_no_obstacle() {
        let found = find("x,stamp", |n| format!("0.1,{}", 1_700_000_000_000u64 + 7 * n as u64)).unwrap();
        assert_eq!(found, ("stamp".into(), TimeUnit::Ms, false));
        let jitter = |n: usize| n as f64 * 0.007 + [0.0, 0.004, 0.001, 0.003][n % 4];
        let found = find("x,t_s", |n| format!("{n},{}", jitter(n))).unwrap();
        assert_eq!(found, ("t_s".into(), TimeUnit::S, true));
    }

    #[test]
    fn row_numbers_and_ramps_are_no_times() {
        let error = find("k,position", |n| format!("{n},{}", (n as f64 / 200.0).sin())).unwrap_err();
        assert_eq!(
            error,
            "log: none of its columns is a time: a clock's name or steady steps are looked for; name the time column, or add one; \
             there are: k, position"
        );
    }

    #[test]
    fn what_the_user_names_goes_before_what_is_found() {
        let text: String = (0..100).map(|n| format!("{},{}\n", n as f64 * 0.001, n)).collect();
        let text = format!("t_s,k\n{text}");
        let known = |column: &str| Known {
            time_column: Some(column.into()),
            time_unit: Some(TimeUnit::Ms),
            ..Known::default()
        };
        let found = TimeColumn::find(text.as_bytes(), "log", &known("k")).unwrap();
        assert_eq!((found.column.as_str(), found.unit), ("k", TimeUnit::Ms));
        let error = TimeColumn::find(text.as_bytes(), "log", &known("zeit")).unwrap_err().to_string();
        assert_eq!(error, "log: no column `zeit` for the time; there are: t_s, k");
    }
}
