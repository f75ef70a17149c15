//! `seepd study`: the source article again.

use std::path::PathBuf;

use clap::Args;

use crate::cli::Outcome;
use crate::config::embedded_model;
use crate::failure::{Code, Failure};
use crate::html::study::StudyPage;
use crate::output::{Outputs, OverwriteArguments};
use crate::progress::Steps;
use crate::sink::terminal::print;

/// Make the figures of the source article again, as one HTML page
///
/// Makes figures 2 and 5 to 9 again on the corrected plant, compares the article's ensemble with that of this program, and finds the
/// largest leak that the controller can hold. Each figure says whether it agrees with the article and, if not, why.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  seepd study --out study.html\n  seepd study --out study.html --json | jq .holding.largest"
)]
pub struct StudyArguments {
    /// Page to write
    #[arg(long, default_value = "study.html", value_name = "FILE")]
    out: PathBuf,
    /// Print the numbers of the figures as one JSON object
    #[arg(long)]
    json: bool,
    /// Seed of machines, noise, trees and embeddings
    #[arg(long, default_value_t = 1, value_name = "S")]
    seed: u64,
    #[command(flatten)]
    overwrite: OverwriteArguments,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] where the page cannot be written.
pub fn run(arguments: &StudyArguments) -> Result<Outcome, Failure> {
    let model = embedded_model()?;
    let out = Outputs::new(arguments.overwrite, []).claim(&arguments.out)?;
    let steps = Steps::begin(seepd_study::STEPS as u64, "studying");
    let study = seepd_study::run(&model, arguments.seed, &mut |done| steps.set(done as u64))
        .map_err(|error| Failure::new(Code::Internal, error.to_string()))?;
    drop(steps);
    let page = StudyPage { study: &study };
    out.write(page.render())?;
    if arguments.json {
        let text = serde_json::to_string(&study)
            .map_err(|error| Failure::new(Code::Internal, format!("writing the study as JSON: {error}")))?;
        print(format!("{text}\n").as_bytes())?;
    } else {
        print(page.outcomes().as_bytes())?;
        print(format!("\npage: {}\n", arguments.out.display()).as_bytes())?;
    }
    Ok(Outcome::Good)
}
