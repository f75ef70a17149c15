//! Where the daemon's own words go: the journal with levels and fields, or standard error.

use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use crate::failure::{Code, Failure};

/// Begins logging: to the journal where standard error is connected to it, else to standard error.
///
/// # Errors
/// [`Failure`] where the level is none, or logging has begun already.
pub fn begin(level: &str) -> Result<(), Failure> {
    let level: LevelFilter = level.parse().map_err(|_| {
        let message = format!("--log-level is `{level}`; levels are error, warn, info, debug, trace");
        Failure::new(Code::Usage, message)
    })?;
    let journal = std::env::var_os("JOURNAL_STREAM").and_then(|_| tracing_journald::layer().ok());
    let to_journal = journal.is_some();
    let terminal = (!to_journal).then(|| {
        tracing_subscriber::fmt::layer().with_writer(std::io::stderr).with_target(false).with_ansi(false)
    });
    tracing_subscriber::registry()
        .with(level)
        .with(journal.map(|journal| journal.with_syslog_identifier("seepd".into())))
        .with(terminal)
        .try_init()
        .map_err(|error| Failure::new(Code::Internal, error.to_string()))
}
