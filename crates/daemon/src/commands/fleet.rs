//! `seepd fleet`: jobs over the logs of many machines, which the Python package does.

use std::ffi::OsString;
use std::io;
use std::process::{Command, Stdio};

use clap::Args;

use crate::cli::Outcome;
use crate::failure::{Code, Failure};

/// Do a job for every log of a fleet of machines, on Ray or on this machine's cores, and report what comes of it
///
/// This is written in Python, on the same core: it needs `pip install 'seepd[fleet]'`. SEEPD_PYTHON names another interpreter than
/// `python3`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  seepd fleet run press-shop.toml --out results --learn-cycles 50\n  \
                        seepd fleet run press-shop.toml --out results --job gap --shard 3/8\n  \
                        seepd fleet report results --html fleet.html")]
pub struct FleetArguments {
    /// `run`, `check`, `report` or `pooled`, and what belongs to it; `seepd fleet run --help` has it
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    words: Vec<OsString>,
}

/// Becomes the package's program.
///
/// # Errors
/// [`Failure`] where there is no such package.
pub fn run(arguments: &FleetArguments) -> Result<Outcome, Failure> {
    let python = std::env::var_os("SEEPD_PYTHON").unwrap_or_else(|| "python3".into());
    let is_there = Command::new(&python)
        .args(["-c", "import importlib.util as u, sys; sys.exit(u.find_spec('seepd') is None)"])
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|ended| ended.success());
    let name = python.display();
    if !is_there {
        let text = format!(
            "`fleet` is in the Python package, which {name} does not have: pip install 'seepd[fleet]' (SEEPD_PYTHON names another interpreter)"
        );
        return Err(Failure::new(Code::NoInput, text));
    }
    let mut command = Command::new(&python);
    let error = become_this(command.args(["-m", "seepd", "fleet"]).args(&arguments.words));
    Err(Failure::new(Code::Io, format!("{name}: {error}")))
}

/// Goes on as another program; comes back where it cannot.
#[cfg(unix)]
fn become_this(command: &mut Command) -> io::Error {
    std::os::unix::process::CommandExt::exec(command)
}

/// Where a process cannot become another: waits for it, and ends as it does.
#[cfg(not(unix))]
fn become_this(command: &mut Command) -> io::Error {
    match command.status() {
        Ok(ended) => std::process::exit(ended.code().unwrap_or(1)),
        Err(error) => error,
    }
}
