//! `seepd adopt-blind adopt`: each machine adopted as its user would, by this very program, and its later logs replayed.
//!
//! Processes of their own: what a user meets is the command, with its exit code and its last line.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Instant;

use clap::Args;
use seepd_blind::axis::HEALTHY;
use seepd_blind::axis::score::Outcome as Adoption;
use serde::Deserialize;

use super::{Ended, MACHINE};
use crate::cli::Outcome;
use crate::commands::blind::{in_own_folder, write_json};
use crate::failure::{Code, Failure};
use crate::progress::Steps;

#[derive(Debug, Args)]
pub(super) struct TrialArguments {
    /// Folder with the machines
    #[arg(long, value_name = "DIR")]
    logs: PathBuf,
    /// Folder for what comes of them
    #[arg(long, value_name = "DIR")]
    adopted: PathBuf,
}

/// What is read of `seepd adopt --json`.
#[derive(Debug, Deserialize)]
struct Report {
    smallest: Vec<Smallest>,
}

/// Smallest leak found within so many cycles.
#[derive(Debug, Deserialize)]
struct Smallest {
    cycles: u32,
    leak_lpm: Option<f64>,
}

pub(super) fn run(arguments: &TrialArguments) -> Result<Outcome, Failure> {
    let program = std::env::current_exe().map_err(|error| Failure::new(Code::Internal, error.to_string()))?;
    fs::create_dir_all(&arguments.adopted).map_err(|error| Failure::writing(&arguments.adopted, error))?;
    let machines: Vec<PathBuf> =
        sorted(&arguments.logs)?.into_iter().filter(|folder| folder.join(MACHINE).exists()).collect();
    let steps = Steps::begin(machines.len() as u64, "adopting");
    for machine in &machines {
        let name = file_stem(machine);
        let ended = arguments.adopted.join(format!("{name}.json"));
        if !ended.exists() {
            let adopted = adopt(&program, machine, &arguments.adopted.join(name))?;
            write_json(&in_own_folder(&ended)?, &adopted)?;
        }
        steps.one_more();
    }
    Ok(Outcome::Good)
}

#[expect(
    clippy::disallowed_methods,
    reason = "how long an adoption took is part of it; nothing else depends on it"
)]
fn adopt(program: &Path, machine: &Path, adopted: &Path) -> Result<Ended, Failure> {
    let logs: Vec<PathBuf> = sorted(machine)?
        .into_iter()
        .filter(|path| path.extension().is_some_and(|kind| kind != "toml"))
        .collect();
    let (healthy, later): (Vec<_>, Vec<_>) = logs.iter().partition(|log| file_stem(log) == HEALTHY);
    let begin = Instant::now();
    let mut command = Command::new(program);
    command.args(["adopt", "--json", "--force", "--machine"]).arg(machine.join(MACHINE));
    let output = ran(command.arg("--out").arg(adopted).args(healthy))?;
    let seconds = begin.elapsed().as_secs_f64();
    let mut outcome = outcome(&output);
    for log in later.into_iter().filter(|_| matches!(outcome, Adoption::Adopted { .. })) {
        let mut command = Command::new(program);
        let output =
            ran(command.args(["replay", "--json", "--config"]).arg(adopted.join("seepd.toml")).arg(log))?;
        let name = file_stem(log);
        if !output.status.success() {
            outcome = Adoption::Failed { message: format!("replay of {name}: {}", last_line(&output)) };
            break;
        }
        in_own_folder(&adopted.join(format!("{name}.jsonl")))?.write(&output.stdout)?;
    }
    Ok(Ended { outcome, seconds })
}

/// How an adoption ended, by its exit code and what it printed.
fn outcome(output: &Output) -> Adoption {
    const REFUSED: [Code; 3] = [Code::Data, Code::NoInput, Code::Configuration];
    match output.status.code() {
        Some(0) => match serde_json::from_slice::<Report>(&output.stdout) {
            // The later logs have as many cycles as the shortest stretch that is predicted.
            Ok(report) => Adoption::Adopted {
                smallest_leak_lpm: report
                    .smallest
                    .iter()
                    .min_by_key(|smallest| smallest.cycles)
                    .and_then(|smallest| smallest.leak_lpm),
            },
            Err(error) => Adoption::Failed { message: format!("what `adopt --json` printed: {error}") },
        },
        Some(code) if REFUSED.iter().any(|refused| *refused as i32 == code) => {
            Adoption::Refused { reason: last_line(output) }
        }
        _ => Adoption::Failed { message: last_line(output) },
    }
}

fn ran(command: &mut Command) -> Result<Output, Failure> {
    command
        .stdin(Stdio::null())
        .output()
        .map_err(|error| Failure::new(Code::Io, format!("running seepd: {error}")))
}

/// The last line of the messages, without the program's name.
fn last_line(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr);
    let line = text.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("nothing was said");
    line.strip_prefix("seepd: ").unwrap_or(line).to_owned()
}

fn sorted(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let inside = fs::read_dir(folder).and_then(Iterator::collect::<io::Result<Vec<_>>>);
    let inside = inside.map_err(|error| Failure::reading(folder, &error))?;
    let mut paths: Vec<PathBuf> = inside.iter().map(fs::DirEntry::path).collect();
    paths.sort();
    Ok(paths)
}

fn file_stem(path: &Path) -> &str {
    path.file_stem().and_then(std::ffi::OsStr::to_str).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt;
    use std::process::ExitStatus;

    use super::*;

    fn ended(code: i32, stdout: &str, stderr: &str) -> Adoption {
        let status = ExitStatus::from_raw(code << 8);
        outcome(&Output { status, stdout: stdout.into(), stderr: stderr.into() })
    }

    #[test]
    fn an_adoption_is_told_by_its_exit_code_and_its_last_line() {
        let report =
            r#"{"smallest":[{"cycles":100,"leak_lpm":0.2},{"cycles":20,"leak_lpm":0.5}],"axis":"press-1"}"#;
        assert_eq!(ended(0, report, ""), Adoption::Adopted { smallest_leak_lpm: Some(0.5) });
        let reason = "Signals of a.csv\nseepd: a.csv: no stroke comes again\n\n";
        assert_eq!(
            ended(65, "", reason),
            Adoption::Refused { reason: "a.csv: no stroke comes again".into() }
        );
        assert_eq!(
            ended(70, "", reason),
            Adoption::Failed { message: "a.csv: no stroke comes again".into() }
        );
        assert!(matches!(ended(0, "no JSON", ""), Adoption::Failed { .. }));
    }
}
