//! `seepd adopt-blind`: adoption checked on machines whose truth is withheld from it.
//!
//! Three steps that share nothing but files: `plant` writes papers and logs of machines that another simulator has made, and the truth into
//! another folder; `adopt` adopts each machine and has its later logs watched; `score` compares what was said with the truth.

mod plant;
mod scores;
mod trial;

use clap::{Args, Subcommand};
use seepd_blind::axis::score;
use serde::{Deserialize, Serialize};

use crate::cli::Outcome;
use crate::failure::Failure;

/// Checks `seepd adopt` on machines of others: plants their papers and logs with a second simulator, adopts them, and scores what was said.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  seepd adopt-blind plant --out logs --truth truth --machines 60 --seed 1\n  \
                        seepd adopt-blind adopt --logs logs --adopted adopted\n  \
                        seepd adopt-blind score --truth truth --adopted adopted"
)]
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
    Plant(plant::PlantArguments),
    /// Adopt each machine without an edit, and replay its later logs
    #[command(
        after_help = "For each machine the folder gets NAME.json, with how adoption ended and how long it took, the adopted folder NAME, \
                      and in it LOG.jsonl for each later log. Machines that are there are kept.\n\n\
                      Example: seepd adopt-blind adopt --logs logs --adopted adopted"
    )]
    Adopt(trial::TrialArguments),
    /// Score what adoption and the adopted monitors said
    #[command(after_help = "Example: seepd adopt-blind score --truth truth --adopted adopted")]
    Score(scores::ScoreArguments),
}

/// Truth of all machines, in a folder of its own.
const TRUTH: &str = "truth.json";
/// Papers of a machine, in its folder.
const MACHINE: &str = "machine.toml";

/// How adoption of a machine ended: the content of NAME.json.
#[derive(Debug, Serialize, Deserialize)]
struct Ended {
    #[serde(flatten)]
    outcome: score::Outcome,
    seconds: f64,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] for folders and files.
pub fn run(arguments: &AdoptBlindArguments) -> Result<Outcome, Failure> {
    match &arguments.step {
        Step::Plant(arguments) => plant::run(arguments),
        Step::Adopt(arguments) => trial::run(arguments),
        Step::Score(arguments) => scores::run(arguments),
    }
}
