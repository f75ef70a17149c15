//! `seepd inspect`: what a log holds, and the mapping that would read it.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
#[cfg(feature = "live")]
use std::time::Duration;

use clap::Args;
use seepd_logs::bytes_of;
use seepd_logs::can::dbc::Dbc;
use seepd_logs::survey::{LogSurvey, survey_log, toml_text};

use crate::cli::Outcome;
use crate::failure::{Code, Failure};
use crate::progress::{byte_bar, counting};
use crate::sink::plain::{self, one_line};
use crate::sink::terminal::print;

/// Show what a log or a CAN bus has, and propose the mapping that reads it
///
/// Shows the topics of a log with their rates, gaps, encodings and numeric fields, guesses which fields are the command, position,
/// demand, pressures and load, and prints the mapping that reads them. Of an FMU it shows the variables, without running it, and prints a
/// plant file for `gap`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  seepd inspect press-1.mcap\n  seepd inspect press-1.mcap > seepd.toml   # the mapping alone\n  \
                        seepd inspect --dbc press.dbc candump.log\n  seepd inspect can0\n  seepd inspect --json press-1.mcap | jq .topics\n  \
                        seepd inspect press.fmu > plant.toml     # variables of a model, and a plant file"
)]
pub struct InspectArguments {
    /// Log, a folder or a pattern of logs, a CAN interface such as can0, or a model (FMU)
    #[arg(value_name = "LOG")]
    log: PathBuf,
    /// How long to listen on a CAN interface, s
    #[arg(long, default_value_t = 5.0, value_name = "S")]
    seconds: f64,
    /// Print one JSON object instead
    #[arg(long)]
    json: bool,
    /// Time column of a CSV file; its unit is what its name ends in, as in time_ms, else seconds [default: found by name and steps]
    #[arg(long, value_name = "COLUMN")]
    time_column: Option<String>,
    /// DBC file that describes the frames of a CAN log
    #[arg(long, value_name = "FILE")]
    dbc: Option<PathBuf>,
}

/// Runs the command: the overview goes to standard error, the mapping to standard output, ready for a file.
///
/// # Errors
/// [`Failure`] where the log cannot be read.
pub fn run(arguments: &InspectArguments) -> Result<Outcome, Failure> {
    #[cfg(feature = "gap")]
    if super::user_simulator::is_fmu(&arguments.log) {
        return super::user_simulator::inspect(&arguments.log);
    }
    let dbc = arguments.dbc.as_deref().map(Dbc::read).transpose()?;
    let found = look(&arguments.log, arguments.time_column.as_deref(), dbc.as_ref(), arguments.seconds)?;
    if arguments.json {
        let text = serde_json::to_string_pretty(&found).map_err(|error| {
            Failure::new(Code::Internal, format!("writing the overview as JSON: {error}"))
        })?;
        print(format!("{text}\n").as_bytes())?;
    } else {
        // Nobody reads the overview where standard error is closed; the mapping still counts.
        let _ = print_overview(&found);
        if let Some(dbc) = &arguments.dbc {
            print(format!("dbc = {}\n\n", toml_text(&dbc.display().to_string())).as_bytes())?;
        }
        print(found.time_toml().as_bytes())?;
        print(found.mapping_toml().as_bytes())?;
    }
    Ok(Outcome::Good)
}

/// Looks into a log, or listens on a CAN interface where there is one of that name and no such file.
///
/// # Errors
/// [`Failure`] where neither can be read.
pub(super) fn look(
    place: &Path,
    time_column: Option<&str>,
    dbc: Option<&Dbc>,
    seconds: f64,
) -> Result<LogSurvey, Failure> {
    let name = seepd_logs::log_name(place);
    if !place.exists() && is_interface(&name) {
        return listen(&name, dbc, seconds);
    }
    let bar = byte_bar(bytes_of(place), "inspecting");
    let found = survey_log(place, time_column, dbc, counting(&bar))?;
    bar.finish_and_clear();
    Ok(found)
}

/// Whether the name is a network interface's, or a socket's that takes frames.
pub(super) fn is_interface(name: &str) -> bool {
    name.starts_with("unix:") || (!name.contains('/') && Path::new("/sys/class/net").join(name).exists())
}

#[cfg(feature = "live")]
fn listen(interface: &str, dbc: Option<&Dbc>, seconds: f64) -> Result<LogSurvey, Failure> {
    use crate::clock::Clock;
    use crate::live::socketcan::FramePort;
    use seepd_logs::BusSurvey;

    if !(0.1..=3600.0).contains(&seconds) {
        return Err(Failure::new(Code::Usage, format!("--seconds is {seconds}; it must lie in 0.1 … 3600")));
    }
    let failed = |error: io::Error| Failure::new(Code::NoInput, format!("{interface}: {error}"));
    let clock = Clock::start();
    let mut bus = BusSurvey::new(dbc);
    super::run::runtime()?
        .block_on(async {
            let mut port = FramePort::open_filtered(interface, None, 4 << 20)?;
            let time = Duration::from_secs_f64(seconds);
            port.listen(&clock, time, |frame, time_ns| bus.take(interface.as_bytes(), frame, time_ns)).await
        })
        .map_err(failed)?;
    let found = bus.into_survey(interface);
    if found.topics.is_empty() {
        return Err(Failure::data(format!("{interface}: no frame came within {seconds} s")));
    }
    Ok(found)
}

#[cfg(not(feature = "live"))]
fn listen(interface: &str, _dbc: Option<&Dbc>, _seconds: f64) -> Result<LogSurvey, Failure> {
    Err(Failure::new(
        Code::Usage,
        format!("{interface}: this build cannot listen on an interface; name a log"),
    ))
}

fn print_overview(found: &LogSurvey) -> io::Result<()> {
    let mut out = plain::stderr();
    writeln!(out, "{}: {}", one_line(&found.file), found.kind)?;
    for topic in &found.topics {
        write!(out, "\n{} ({}", one_line(&topic.topic), one_line(&topic.encoding))?;
        if !topic.schema.is_empty() {
            write!(out, ", {}", one_line(&topic.schema))?;
        }
        write!(out, "): {} messages", topic.messages)?;
        if let Some(rate) = topic.rate_hz {
            write!(out, " at {rate:.1} Hz over {:.1} s", topic.duration_s)?;
        }
        if topic.gaps > 0 {
            write!(out, ", {} gaps, the longest {:.3} s", topic.gaps, topic.longest_gap_s)?;
        }
        writeln!(out)?;
        if let Some(bits) = &topic.changing_bits {
            writeln!(out, "  changing bits {bits}")?;
        }
        if let Some(problem) = &topic.problem {
            writeln!(out, "  {}", one_line(problem))?;
        }
        if topic.unreadable > 0 {
            writeln!(out, "  {} messages do not fit their schema", topic.unreadable)?;
        }
        for field in &topic.fields {
            let guess = field.guess.as_ref().map_or(String::new(), |guess| format!("  ← {guess}"));
            let (least, largest) = (number(field.least), number(field.largest));
            writeln!(out, "  {:<28} {least:>12} … {largest:<12}{guess}", one_line(&field.path))?;
        }
    }
    for note in &found.notes {
        writeln!(out, "\n{}", one_line(note))?;
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
