//! `seepd inspect`: what a log holds, and the mapping that would read it.

use std::fs::File;
use std::io::{self, Write};
use std::path::PathBuf;

use clap::Args;

use crate::can::dbc::Dbc;
use crate::cli::Outcome;
use crate::failure::{Code, Failure};
use crate::progress::byte_bar;
use crate::sink::terminal::print;
use crate::source::survey::{LogSurvey, survey};

/// Shows a log's topics, rates, gaps, encodings and numeric fields with their ranges, guesses which are the command,
/// position, demand, pressures and load, and prints the mapping that would read them.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  seepd inspect press-1.mcap\n  seepd inspect press-1.mcap > seepd.toml   # the mapping alone\n  \
                        seepd inspect --dbc press.dbc candump.log\n  seepd inspect --json press-1.mcap | jq .topics"
)]
pub struct InspectArguments {
    /// Log: MCAP, CSV with a header row, or candump
    #[arg(value_name = "LOG")]
    log: PathBuf,
    /// Print one JSON object instead
    #[arg(long)]
    json: bool,
    /// Name of a CSV file's time column, in seconds
    #[arg(long, default_value = "t_s", value_name = "COLUMN")]
    time_column: String,
    /// DBC file that describes a CAN log's frames
    #[arg(long, value_name = "FILE")]
    dbc: Option<PathBuf>,
}

/// Runs the command: the overview goes to standard error, the mapping to standard output, ready for a file.
///
/// # Errors
/// [`Failure`] where the log cannot be read.
pub fn run(arguments: &InspectArguments) -> Result<Outcome, Failure> {
    let file = File::open(&arguments.log).map_err(|error| Failure::reading(&arguments.log, &error))?;
    let name = arguments.log.display().to_string();
    let bytes = file.metadata().map_or(0, |facts| facts.len());
    let bar = byte_bar(bytes, "inspecting");
    let dbc = arguments.dbc.as_deref().map(Dbc::read).transpose()?;
    let found = survey(bar.wrap_read(file), &name, &arguments.time_column, dbc.as_ref())?;
    bar.finish_and_clear();
    if arguments.json {
        let text = serde_json::to_string_pretty(&found).map_err(|error| {
            Failure::new(Code::Internal, format!("writing the overview as JSON: {error}"))
        })?;
        print(format!("{text}\n").as_bytes())?;
    } else {
        // Nobody reads the overview where standard error is closed; the mapping still counts.
        let _ = print_overview(&found);
        if let Some(dbc) = &arguments.dbc {
            print(format!("dbc = {}\n\n", toml::Value::from(dbc.display().to_string())).as_bytes())?;
        }
        print(found.mapping_toml().as_bytes())?;
    }
    Ok(Outcome::Good)
}

fn print_overview(found: &LogSurvey) -> io::Result<()> {
    let mut out = io::stderr().lock();
    writeln!(out, "{}: {}", found.file, found.kind)?;
    for topic in &found.topics {
        write!(out, "\n{} ({}", topic.topic, topic.encoding)?;
        if !topic.schema.is_empty() {
            write!(out, ", {}", topic.schema)?;
        }
        write!(out, "): {} messages", topic.messages)?;
        if let Some(rate) = topic.rate_hz {
            write!(out, " at {rate:.1} Hz over {:.1} s", topic.duration_s)?;
        }
        if topic.gaps > 0 {
            write!(out, ", {} gaps, the longest {:.3} s", topic.gaps, topic.longest_gap_s)?;
        }
        writeln!(out)?;
        if let Some(problem) = &topic.problem {
            writeln!(out, "  {problem}")?;
        }
        if topic.unreadable > 0 {
            writeln!(out, "  {} messages do not fit their schema", topic.unreadable)?;
        }
        for field in &topic.fields {
            let guess = field.guess.as_ref().map_or(String::new(), |guess| format!("  ← {guess}"));
            let (least, largest) = (number(field.least), number(field.largest));
            writeln!(out, "  {:<28} {least:>12} … {largest:<12}{guess}", field.path)?;
        }
    }
    for note in &found.notes {
        writeln!(out, "\n{note}")?;
    }
    writeln!(out)
}

/// Five significant digits or so, whatever the size.
fn number(value: f64) -> String {
    if value == 0.0 || (1e-3..1e6).contains(&value.abs()) {
        format!("{value:.4}")
    } else {
        format!("{value:.4e}")
    }
}
