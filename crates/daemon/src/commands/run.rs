//! `seepd run`: the live daemon.

use std::path::PathBuf;

use clap::Args;

use crate::cli::Outcome;
use crate::failure::{Code, Failure};
use crate::live;

/// Watches axes live: CAN in; leakage, flags and a dashboard out. Made to run under systemd.
///
/// Signals: HUP takes a changed configuration over and refuses a bad one, TERM and INT end the daemon once everything is
/// written. A daemon all of whose sources are logs ends with them.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  seepd run --config /etc/seepd/seepd.toml\n  kill -HUP $(pidof seepd)   # take changes over"
)]
pub struct RunArguments {
    /// Configuration: axes with sources, model and alarm; sinks
    #[arg(long, value_name = "FILE", default_value = "/etc/seepd/seepd.toml")]
    config: PathBuf,
    /// What is logged: error, warn, info, debug or trace
    #[arg(long, value_name = "LEVEL", default_value = "info")]
    log_level: String,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] where the configuration cannot be used.
pub fn run(arguments: &RunArguments) -> Result<Outcome, Failure> {
    live::journal::begin(&arguments.log_level)?;
    let result = runtime()?.block_on(live::run(&arguments.config));
    if let Err(failure) = &result {
        tracing::error!("{failure}");
    }
    result.map(|()| Outcome::Good)
}

/// One thread for everything but the disks.
pub(super) fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .max_blocking_threads(4)
        .build()
        .map_err(|error| Failure::new(Code::Internal, format!("starting: {error}")))
}
