//! `seepd explain`: why there is no estimate, and what helps.

use clap::Args;
use seepd_settings::nearest;

use crate::cli::Outcome;
use crate::failure::{Code, Failure};
use crate::reasons::{self, Explanation};
use crate::sink::terminal::print;

/// Explain a reason for which there is no estimate: its cause, how to check, what helps
///
/// Reasons stand behind `no estimate` in a replay, on pages, in metrics and in the field `reason` of JSON and CSV.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  seepd explain unlike_training\n  seepd explain wrong rate\n  seepd explain > reasons.md"
)]
pub struct ExplainArguments {
    /// The reason's name, or its words; without it all are printed, as Markdown
    #[arg(value_name = "REASON")]
    reason: Vec<String>,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] for a reason that there is not.
pub fn run(arguments: &ExplainArguments) -> Result<Outcome, Failure> {
    let text = if arguments.reason.is_empty() {
        reasons::page()
    } else {
        named(&arguments.reason.join(" "))?.to_string()
    };
    print(text.as_bytes())?;
    Ok(Outcome::Good)
}

/// The reason of that name; `wrong rate`, as a terminal shows it, is `wrong_rate`.
fn named(words: &str) -> Result<&'static Explanation, Failure> {
    let name = words.trim().to_lowercase().replace([' ', '-'], "_");
    reasons::explanation(&name).ok_or_else(|| {
        let known = reasons::ALL.iter().map(|reason| reason.name);
        let hint = match nearest(&name, known.clone()) {
            Some(like) => format!("did you mean `{like}`?"),
            None => format!("the reasons are {}", known.collect::<Vec<_>>().join(", ")),
        };
        Failure::new(Code::Usage, format!("there is no reason `{}`; {hint}", name.escape_debug()))
    })
}
