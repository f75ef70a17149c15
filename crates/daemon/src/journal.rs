//! Where the daemon's own words go: the journal with levels and fields, or standard error.

use std::collections::BTreeSet;
use std::time::Duration;

use tokio::time::Instant;
use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use crate::failure::{Code, Failure};
use crate::sink::plain;

/// Begins logging: to the journal where standard error is connected to it, else to standard error.
///
/// # Errors
/// [`Failure`] where the level is none, or logging has begun already.
pub fn begin(level: &str) -> Result<(), Failure> {
    let level: LevelFilter = level.parse().map_err(|_| {
        let message = format!("--log-level is `{level}`; it must be error, warn, info, debug or trace");
        Failure::new(Code::Usage, message)
    })?;
    let journal = std::env::var_os("JOURNAL_STREAM").and_then(|_| tracing_journald::layer().ok());
    let to_journal = journal.is_some();
    let terminal = (!to_journal).then(|| {
        tracing_subscriber::fmt::layer().with_writer(plain::stderr).with_target(false).with_ansi(false)
    });
    tracing_subscriber::registry()
        .with(level)
        .with(journal.map(|journal| journal.with_syslog_identifier("seepd".into())))
        .with(terminal)
        .try_init()
        .map_err(|error| Failure::new(Code::Internal, error.to_string()))
}

/// Different warnings that are logged in a while, once each; the others are counted.
const WARNINGS: usize = 10;
/// That while.
const WHILE: Duration = Duration::from_secs(10);

/// Warnings about what others send: a flood of it must not become a flood in the journal.
#[derive(Debug)]
pub struct Warnings {
    since: Instant,
    said: BTreeSet<String>,
    unsaid: u64,
}

impl Warnings {
    /// None yet.
    pub fn new(now: Instant) -> Self {
        Warnings { since: now, said: BTreeSet::new(), unsaid: 0 }
    }

    /// Logs a warning, or counts it where it or many others were logged lately.
    pub fn warn(&mut self, now: Instant, text: &str) {
        match self.admit(now, text) {
            Some(0) => tracing::warn!("{text}"),
            Some(unsaid) => tracing::warn!("{text} ({unsaid} warnings before this one were not logged)"),
            None => {}
        }
    }

    /// Whether one more may be logged, and how many were not since the last.
    fn admit(&mut self, now: Instant, text: &str) -> Option<u64> {
        if now.duration_since(self.since) >= WHILE {
            self.since = now;
            self.said.clear();
        }
        if self.said.len() >= WARNINGS || !self.said.insert(text.to_owned()) {
            self.unsaid += 1;
            return None;
        }
        Some(std::mem::take(&mut self.unsaid))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_of_warnings_is_a_line_each_in_ten_seconds_and_a_count() {
        let begin = crate::clock::instant();
        let mut warnings = Warnings::new(begin);
        let mut line = |after_s, text: &str| warnings.admit(begin + Duration::from_secs(after_s), text);
        let of_one: Vec<u64> = (0..1000).filter_map(|_| line(1, "a")).collect();
        assert_eq!((of_one, line(2, "b"), line(2, "b")), (vec![0], Some(999), None));
        // Nor do ever new ones.
        assert_eq!((0..100).filter_map(|number| line(3, &number.to_string())).count(), WARNINGS - 2);
        assert_eq!((line(12, "a"), line(12, "b")), (Some(92), Some(0)));
    }
}
