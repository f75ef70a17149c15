//! The command line.

use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};

use crate::commands;
use crate::failure::{Code, Failure};
use crate::progress::warn;

/// Detects and sizes the oil leak past a hydraulic cylinder's piston seal from the PID valve command alone.
#[derive(Debug, Parser)]
#[command(name = "seepd", version, about, propagate_version = true, max_term_width = 100)]
#[command(
    after_help = "Exit codes: 0 good, 1 a finding (with --fail-on-fault), 64 usage, 65 unreadable data, \
                        66 no input, 70 internal, 74 input/output, 75 held by another process, 78 configuration.\n\n\
                        Example: seepd replay press-1.mcap"
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

// No documentation here: help would show it in the place of that of the arguments.
#[derive(Debug, Subcommand)]
enum Command {
    #[cfg(feature = "simulate")]
    Demo(commands::demo::DemoArguments),
    #[cfg(feature = "simulate")]
    Simulate(commands::simulate::SimulateArguments),
    #[cfg(feature = "train")]
    Train(commands::train::TrainArguments),
    #[cfg(feature = "study")]
    Study(commands::study::StudyArguments),
    Replay(commands::replay::ReplayArguments),
    LearnBaseline(commands::learn_baseline::LearnBaselineArguments),
    Evaluate(commands::evaluate::EvaluateArguments),
    Repair(commands::repair::RepairArguments),
    #[cfg(feature = "live")]
    Run(commands::run::RunArguments),
    #[cfg(feature = "live")]
    Init(commands::init::InitArguments),
    #[cfg(feature = "live")]
    TestSinks(commands::test_sinks::TestSinksArguments),
    #[cfg(feature = "gap")]
    Gap(commands::gap::GapArguments),
    #[cfg(feature = "adopt")]
    Adopt(commands::adopt::AdoptArguments),
    #[cfg(feature = "gap")]
    #[command(hide = true)]
    AdoptBlind(commands::adopt_blind::AdoptBlindArguments),
    #[cfg(feature = "gap")]
    #[command(hide = true)]
    CauseBlind(commands::cause_blind::CauseBlindArguments),
    #[cfg(feature = "gap")]
    #[command(hide = true)]
    FmuHost(commands::user_simulator::FmuHostArguments),
    Inspect(commands::inspect::InspectArguments),
    Check(commands::check::CheckArguments),
    Explain(commands::explain::ExplainArguments),
    Completions(commands::shell::CompletionsArguments),
    Man(commands::shell::ManArguments),
}

/// The command line's description, for completions and manual pages.
pub(crate) fn description() -> clap::Command {
    Arguments::command()
}

/// Runs the program: the only place that reads the arguments and writes the last error.
pub fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return tell_usage(&error),
    };
    let result = match &arguments.command {
        #[cfg(feature = "simulate")]
        Command::Demo(arguments) => commands::demo::run(arguments),
        #[cfg(feature = "simulate")]
        Command::Simulate(arguments) => commands::simulate::run(arguments),
        #[cfg(feature = "train")]
        Command::Train(arguments) => commands::train::run(arguments),
        #[cfg(feature = "study")]
        Command::Study(arguments) => commands::study::run(arguments),
        Command::Replay(arguments) => commands::replay::run(arguments),
        Command::LearnBaseline(arguments) => commands::learn_baseline::run(arguments),
        Command::Evaluate(arguments) => commands::evaluate::run(arguments),
        Command::Repair(arguments) => commands::repair::run(arguments),
        #[cfg(feature = "live")]
        Command::Run(arguments) => commands::run::run(arguments),
        #[cfg(feature = "live")]
        Command::Init(arguments) => commands::init::run(arguments),
        #[cfg(feature = "live")]
        Command::TestSinks(arguments) => commands::test_sinks::run(arguments),
        #[cfg(feature = "gap")]
        Command::Gap(arguments) => commands::gap::run(arguments),
        #[cfg(feature = "adopt")]
        Command::Adopt(arguments) => commands::adopt::run(arguments),
        #[cfg(feature = "gap")]
        Command::AdoptBlind(arguments) => commands::adopt_blind::run(arguments),
        #[cfg(feature = "gap")]
        Command::CauseBlind(arguments) => commands::cause_blind::run(arguments),
        #[cfg(feature = "gap")]
        Command::FmuHost(_) => commands::user_simulator::host(),
        Command::Inspect(arguments) => commands::inspect::run(arguments),
        Command::Check(arguments) => commands::check::run(arguments),
        Command::Explain(arguments) => commands::explain::run(arguments),
        Command::Completions(arguments) => commands::shell::completions(arguments),
        Command::Man(arguments) => commands::shell::man(arguments),
    };
    match result {
        Ok(Outcome::Good) => ExitCode::SUCCESS,
        Ok(Outcome::Finding) => ExitCode::from(Code::Finding as u8),
        Err(failure) => tell(&failure),
    }
}

/// How a command ended well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Nothing to report.
    Good,
    /// A fault was found, and `--fail-on-fault` asked for it.
    Finding,
}

fn tell(failure: &Failure) -> ExitCode {
    warn(&failure.message);
    ExitCode::from(failure.code as u8)
}

/// clap's own texts; asking for help is no error, and a wrong argument is usage.
fn tell_usage(error: &clap::Error) -> ExitCode {
    let _ = error.print();
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => ExitCode::SUCCESS,
        _ => ExitCode::from(Code::Usage as u8),
    }
}
