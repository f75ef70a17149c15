//! Several logs as one machine's record.

use std::path::{Path, PathBuf};

use seepd_signals::Sample;

use crate::error::LogError;
use crate::mapping::LogMapping;
use crate::source::{log_name, open_with};

/// Hands every sample of the logs, one log after the other, to `take`; tells what a person should know of them. `on_bytes` hears how
/// many more bytes have been read.
///
/// # Errors
/// [`LogError`] of a log, or what `take` gives.
pub fn each_sample<E: From<LogError>>(
    logs: &[PathBuf],
    mapping: &LogMapping,
    on_bytes: impl FnMut(u64) + Clone + Send + 'static,
    mut take: impl FnMut(&Sample) -> Result<(), E>,
) -> Result<Vec<String>, E> {
    let (mut notes, mut clock) = (Vec::new(), Clock::default());
    for path in logs {
        let mut source = open_with(path, mapping, on_bytes.clone())?;
        clock.begin(path);
        while let Some(mut sample) = source.next_sample()? {
            sample.time_ns = clock.in_one_record(sample.time_ns);
            take(&sample)?;
        }
        notes.extend(source.notes());
        notes.extend(clock.note(&log_name(path)));
    }
    Ok(notes)
}

/// Puts logs one after the other whose clocks begin anew, as those of controllers do that know no date.
#[derive(Default)]
pub struct Clock {
    read: Vec<PathBuf>,
    newest_ns: Option<i64>,
    /// What is added to the log's times; unknown before its first sample.
    shift_ns: Option<i64>,
}

/// A clock that began less than this ago, ns, knows no date.
const UNDATED_NS: i64 = 10 * 86_400_000_000_000;

/// Whether a log that begins at a time has dates, rather than a clock that began with its machine or its recording.
pub fn knows_date(begin_ns: i64) -> bool {
    begin_ns.saturating_abs() >= UNDATED_NS
}

/// Pause between such a log and the one before it, ns.
const PAUSE_NS: i64 = 1_000_000_000;

impl Clock {
    /// A log begins.
    pub fn begin(&mut self, path: &Path) {
        // The same file again is the same cycles again, and to be found out as such.
        self.shift_ns = self.read.iter().any(|other| other == path).then_some(0);
        self.read.push(path.to_owned());
    }

    /// A time of the log as one of the whole record.
    pub fn in_one_record(&mut self, time_ns: i64) -> i64 {
        let newest_ns = self.newest_ns;
        let shift_ns = *self.shift_ns.get_or_insert_with(|| match newest_ns {
            Some(newest) if time_ns <= newest && !knows_date(time_ns) => {
                newest.saturating_add(PAUSE_NS).saturating_sub(time_ns)
            }
            _ => 0,
        });
        let time_ns = time_ns.saturating_add(shift_ns);
        self.newest_ns = Some(self.newest_ns.map_or(time_ns, |newest| newest.max(time_ns)));
        time_ns
    }

    /// What a person should know of the log's clock.
    pub fn note(&self, name: &str) -> Option<String> {
        let shift_s = self.shift_ns.filter(|shift| *shift != 0)? as f64 / 1e9;
        Some(format!(
            "{name}: its clock starts again; the log is taken to follow the one before it, {shift_s:.3} s later"
        ))
    }
}
