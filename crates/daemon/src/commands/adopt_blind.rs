//! `seepd adopt-blind`: adoption checked on machines whose truth is withheld from it.
//!
//! `plant` writes papers and logs of machines that another simulator has made, and the truth into another folder.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum};
use rayon::prelude::*;
use seepd_blind::axis::{self, Case, LoggedSignals, Truth};

use super::blind::{begin_folder, in_own_folder, write_json};
use crate::cli::Outcome;
use crate::failure::{Code, Failure};
use crate::progress::Steps;
use crate::sink::terminal::print;

/// Checks `seepd adopt` on machines of others: plants their papers and logs with a second simulator.
#[derive(Debug, Args)]
#[command(after_help = "Example: seepd adopt-blind plant --out logs --truth truth --machines 12 --seed 1")]
pub struct AdoptBlindArguments {
    #[command(subcommand)]
    step: Step,
}

#[derive(Debug, Subcommand)]
enum Step {
    /// Write a folder for each machine, with machine.toml and logs, and the truth into another folder
    #[command(
        after_help = "Example: seepd adopt-blind plant --out logs --truth truth --machines 12 --seed 1"
    )]
    Plant(PlantArguments),
}

#[derive(Debug, Args)]
struct PlantArguments {
    /// Folder for the machines; must be empty or not exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Folder for the truth; must be empty or not exist
    #[arg(long, value_name = "DIR")]
    truth: PathBuf,
    /// Number of machines
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u16).range(1..=999))]
    machines: u16,
    /// Seed of everything that is drawn
    #[arg(long, value_name = "S")]
    seed: u64,
    /// Signals in the logs
    #[arg(long, value_enum, default_value_t = Signals::Both)]
    signals: Signals,
}

/// Which signals the logs have.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Signals {
    /// The valve command.
    Command,
    /// The valve command, the position demand and the position.
    Position,
    /// Every second machine has the command alone.
    Both,
}

impl Signals {
    fn of(self, number: usize) -> LoggedSignals {
        match self {
            Signals::Command => LoggedSignals::Command,
            Signals::Position => LoggedSignals::Position,
            Signals::Both if number.is_multiple_of(2) => LoggedSignals::Command,
            Signals::Both => LoggedSignals::Position,
        }
    }
}

const TRUTH: &str = "truth.json";
const MACHINE: &str = "machine.toml";

/// Runs the command.
///
/// # Errors
/// [`Failure`] for folders and files.
pub fn run(arguments: &AdoptBlindArguments) -> Result<Outcome, Failure> {
    match &arguments.step {
        Step::Plant(arguments) => plant(arguments),
    }
}

fn plant(arguments: &PlantArguments) -> Result<Outcome, Failure> {
    for folder in [&arguments.out, &arguments.truth] {
        begin_folder(folder)?;
    }
    let machines = usize::from(arguments.machines);
    let steps = Steps::begin(machines as u64, "planting");
    let truths: BTreeMap<String, Truth> = (1..=machines)
        .into_par_iter()
        .map(|number| {
            let drawn = axis::draw(arguments.seed, number, arguments.signals.of(number));
            let case = drawn.ok_or_else(|| {
                Failure::new(Code::Internal, format!("machine {number}: no machine that works was drawn"))
            })?;
            write_case(&arguments.out.join(&case.name), &case)?;
            steps.one_more();
            Ok((case.name, case.truth))
        })
        .collect::<Result<_, Failure>>()?;
    drop(steps);
    write_json(&in_own_folder(&arguments.truth.join(TRUTH))?, &truths)?;
    print(format!("{machines} machines\n").as_bytes())?;
    Ok(Outcome::Good)
}

fn write_case(folder: &Path, case: &Case) -> Result<(), Failure> {
    begin_folder(folder)?;
    let sheet = toml::to_string(&case.sheet)
        .map_err(|error| Failure::new(Code::Internal, format!("{}: {error}", case.name)))?;
    in_own_folder(&folder.join(MACHINE))?.write(sheet)?;
    for (name, log) in &case.truth.logs {
        let out = in_own_folder(&folder.join(format!("{name}.csv")))?;
        let mut file = out.create()?;
        let finite = case
            .truth
            .write_log(log, |line| file.write_all(line.as_bytes()))
            .map_err(|error| Failure::writing(out.path(), error))?;
        if !finite {
            let what = format!("{}: the machine of {name} went out of bounds", case.name);
            return Err(Failure::new(Code::Internal, what));
        }
        file.finish()?;
    }
    Ok(())
}
