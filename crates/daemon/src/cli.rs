//! The command line.

use std::ffi::OsString;
use std::process::ExitCode;
use std::sync::OnceLock;

use clap::error::ErrorKind;
use clap::{Args, CommandFactory, Parser, Subcommand};

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
    #[cfg(feature = "study")]
    Fleet(commands::fleet::FleetArguments),
    Replay(commands::replay::ReplayArguments),
    LearnBaseline(commands::learn_baseline::LearnBaselineArguments),
    Evaluate(commands::evaluate::EvaluateArguments),
    Bound(commands::bound::BoundArguments),
    Repair(commands::repair::RepairArguments),
    #[cfg(feature = "live")]
    Run(commands::run::RunArguments),
    #[cfg(feature = "live")]
    Init(commands::init::InitArguments),
    #[cfg(feature = "live")]
    TestSinks(commands::test_sinks::TestSinksArguments),
    #[cfg(feature = "gap")]
    Gap(commands::gap::GapArguments),
    #[cfg(feature = "gap")]
    ExportFmu(commands::export_fmu::ExportFmuArguments),
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

/// The command line's description, for completions, manual pages, and whoever holds a command line against it.
pub fn description() -> clap::Command {
    Arguments::command()
}

/// Runs the program: the only place that reads the arguments and writes the last error.
pub fn main() -> ExitCode {
    ExitCode::from(run(std::env::args_os()))
}

/// Runs the program with these arguments, its name the first; gives the exit code.
pub fn run(arguments: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> u8 {
    let arguments = match Arguments::try_parse_from(arguments) {
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
        #[cfg(feature = "study")]
        Command::Fleet(arguments) => commands::fleet::run(arguments),
        Command::Replay(arguments) => commands::replay::run(arguments),
        Command::LearnBaseline(arguments) => commands::learn_baseline::run(arguments),
        Command::Evaluate(arguments) => commands::evaluate::run(arguments),
        Command::Bound(arguments) => commands::bound::run(arguments),
        Command::Repair(arguments) => commands::repair::run(arguments),
        #[cfg(feature = "live")]
        Command::Run(arguments) => commands::run::run(arguments),
        #[cfg(feature = "live")]
        Command::Init(arguments) => commands::init::run(arguments),
        #[cfg(feature = "live")]
        Command::TestSinks(arguments) => commands::test_sinks::run(arguments),
        #[cfg(feature = "gap")]
        Command::Gap(arguments) => commands::gap::run(arguments),
        #[cfg(feature = "gap")]
        Command::ExportFmu(arguments) => commands::export_fmu::run(arguments),
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
        Ok(Outcome::Good) => 0,
        Ok(Outcome::Finding) => Code::Finding as u8,
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

fn tell(failure: &Failure) -> u8 {
    warn(&failure.message);
    failure.code as u8
}

/// How this program is started, where it is a part of another.
static STARTED_BY: OnceLock<Vec<String>> = OnceLock::new();

/// Says with which words this program is started, where that is not the running program's own name: an interpreter and its module. The
/// first to say so is believed.
pub fn is_started_by(words: Vec<String>) {
    let _ = STARTED_BY.set(words);
}

/// The words that start this program once more.
///
/// # Errors
/// [`Failure`] where the system does not tell.
#[cfg(feature = "gap")]
pub(crate) fn start_words() -> Result<Vec<String>, Failure> {
    if let Some(words) = STARTED_BY.get() {
        return Ok(words.clone());
    }
    let program = std::env::current_exe().map_err(|error| Failure::new(Code::Internal, error.to_string()))?;
    Ok(vec![program.display().to_string()])
}

/// A command's arguments, for programs that embed it: the same words, and the same checks.
///
/// # Errors
/// [`Failure`] with what is wrong in one line.
pub fn parse<A: Args>(words: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> Result<A, Failure> {
    #[derive(Parser)]
    #[command(name = "seepd", no_binary_name = true, disable_help_flag = true)]
    struct Only<A: Args> {
        #[command(flatten)]
        arguments: A,
    }
    let parsed = Only::<A>::try_parse_from(words).map_err(|error| {
        let text = error.to_string();
        // The first line says what is wrong, the rest how the command line is used.
        let said =
            text.lines().take_while(|line| !line.is_empty()).map(str::trim).collect::<Vec<_>>().join(" ");
        Failure::new(Code::Usage, said.trim_start_matches("error: "))
    })?;
    Ok(parsed.arguments)
}

/// clap's own texts; asking for help is no error, and a wrong argument is usage.
fn tell_usage(error: &clap::Error) -> u8 {
    let _ = error.print();
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => 0,
        _ => Code::Usage as u8,
    }
}
