//! `seepd run`: the live daemon.

use std::path::PathBuf;

use clap::Args;

use crate::cli::Outcome;
use crate::failure::{Code, Failure};
use crate::{journal, live};

/// Watch axes live: read CAN, and give leakage, flags and a dashboard
///
/// Made to run under systemd. HUP makes the daemon take over a changed configuration (a bad one is refused); TERM and INT end it once
/// everything is written. A daemon that reads nothing but logs ends with them.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  seepd run --config /etc/seepd/seepd.toml\n  kill -HUP $(pidof seepd)   # take over a changed configuration"
)]
pub struct RunArguments {
    /// Configuration with the axes (source, model, alarm) and the sinks
    #[arg(long, value_name = "FILE", default_value = "/etc/seepd/seepd.toml")]
    config: PathBuf,
    /// Least level that is logged: error, warn, info, debug or trace
    #[arg(long, value_name = "LEVEL", default_value = "info")]
    log_level: String,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] where the configuration cannot be used.
pub fn run(arguments: &RunArguments) -> Result<Outcome, Failure> {
    let _journal = journal::begin(&arguments.log_level)?;
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
        .map_err(|error| Failure::new(Code::Internal, format!("the daemon cannot start: {error}")))
}
