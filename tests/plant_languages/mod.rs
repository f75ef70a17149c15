//! What the plant's other programs hear.

mod foxglove;
mod home_assistant;
mod influx;
mod j1939;
mod opentelemetry;
mod sparkplug;

use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::daemon::{axis_toml, log_axis_toml};
use crate::support::simulate;

const SOON: Duration = Duration::from_secs(20);

/// A configuration with the page at a port, some sinks, an axis `Press 1` that reads a log, and one that hears nothing.
fn two_axes(folder: &Path, port: u16, log: &Path, sinks: &str) -> String {
    format!(
        "state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{port}\"\n{sinks}{}{}",
        log_axis_toml("Press 1", log),
        axis_toml("silent", &folder.join("in.sock"))
    )
}

/// A log of a machine that leaks.
fn worn_log(folder: &Path) -> PathBuf {
    let log = folder.join("worn.mcap");
    simulate(&log, &["--cycles", "8", "--leak-area", "2e-7"]);
    log
}
