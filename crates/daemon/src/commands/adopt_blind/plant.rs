//! `seepd adopt-blind plant`: machines with their papers and logs, and the truth elsewhere.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use rayon::prelude::*;
use seepd_blind::axis::{self, Case, Container, Later, LogTruth, LoggedSignals, Truth};

use super::{MACHINE, TRUTH};
use crate::cli::Outcome;
use crate::commands::blind::{begin_folder, in_own_folder, write_json};
use crate::failure::{Code, Failure};
use crate::progress::Steps;
use crate::sink::mcap::{ChunkCompression, McapSink, schema};
use crate::sink::terminal::print;

#[derive(Debug, Args)]
pub(super) struct PlantArguments {
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
    /// Plant a ladder of leaks in the place of two or three, to tell the smallest that is found
    #[arg(long)]
    ladder: bool,
    /// Duty cycles of the later healthy log [default: 20 to 30]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=10_000))]
    healthy_cycles: Option<u16>,
    /// Plant one more log of each machine, its seal healthy and its valve's null shifted, by 0.2 to 2 % of full command
    #[arg(long)]
    null_shift: bool,
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

pub(super) fn run(arguments: &PlantArguments) -> Result<Outcome, Failure> {
    for folder in [&arguments.out, &arguments.truth] {
        begin_folder(folder)?;
    }
    let machines = usize::from(arguments.machines);
    let later = Later {
        ladder: arguments.ladder,
        healthy_cycles: arguments.healthy_cycles.map(usize::from),
        null_shift: arguments.null_shift,
    };
    let steps = Steps::begin(machines as u64, "planting");
    let truths: BTreeMap<String, Truth> = (1..=machines)
        .into_par_iter()
        .map(|number| {
            let drawn = axis::draw(arguments.seed, number, arguments.signals.of(number), later);
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
        let finite = match case.truth.format.container {
            Container::Csv => write_csv(&folder.join(format!("{name}.csv")), &case.truth, log),
            Container::Mcap => write_mcap(&folder.join(format!("{name}.mcap")), &case.truth, log),
        }?;
        if !finite {
            let what = format!("{}: the machine of {name} went out of bounds", case.name);
            return Err(Failure::new(Code::Internal, what));
        }
    }
    Ok(())
}

fn write_csv(path: &Path, truth: &Truth, log: &LogTruth) -> Result<bool, Failure> {
    let mut file = in_own_folder(path)?.create()?;
    let written = file
        .write_all(truth.format.header().as_bytes())
        .and_then(|()| truth.write_log(log, |_, line| file.write_all(line.as_bytes())));
    let finite = written.map_err(|error| Failure::writing(path, error))?;
    file.finish()?;
    Ok(finite)
}

fn write_mcap(path: &Path, truth: &Truth, log: &LogTruth) -> Result<bool, Failure> {
    let writing = |error| Failure::writing(path, error);
    let mut sink = McapSink::new(in_own_folder(path)?.create()?, ChunkCompression::Zstd).map_err(writing)?;
    let channel = sink.add_channel("/machine/axis", "machine.Axis", schema::ANY).map_err(writing)?;
    let finite = truth
        .write_log(log, |time_s, message| {
            sink.write(channel, (time_s * 1e9).round() as i64, message.as_bytes())
        })
        .map_err(writing)?;
    sink.finish().map_err(writing)?;
    sink.into_inner().finish()?;
    Ok(finite)
}
