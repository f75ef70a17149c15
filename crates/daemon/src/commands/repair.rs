//! `seepd repair`: what was done to the machine.

use std::path::{Path, PathBuf};

use clap::builder::PossibleValuesParser;
use clap::{Args, Subcommand};
use seepd_monitor::repair::{Repair, RepairKind};

use crate::cli::Outcome;
use crate::config::{AxisConfig, DaemonConfig};
use crate::failure::{Code, Failure};
use crate::repair_log;
use crate::sink::terminal::print;

/// Keep the repair log: what was done to the machine, when, and by whom
///
/// Estimates count from a replaced seal on, an adjusted valve's shift is told as such, and an entry that the data contradict is told. The
/// daemon hears of an entry within five seconds; replays read the log with `--repairs`, or where the configuration names it (`repairs`).
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  seepd repair add seal_replaced --who \"M. Huber\" --note \"kit 7\" --file press-1.repairs.toml\n  \
                        seepd repair add valve_adjusted --at \"2026-03-01 14:30\" --config seepd.toml --axis press-1\n  \
                        seepd repair list --config seepd.toml\n  seepd replay --repairs press-1.repairs.toml monday.mcap"
)]
pub struct RepairArguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Add an entry
    Add(AddArguments),
    /// Show the entries, the oldest first
    List(ListArguments),
}

#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  seepd repair add seal_replaced --who \"M. Huber\" --file press-1.repairs.toml"
)]
struct AddArguments {
    /// What was done
    #[arg(value_name = "WHAT", value_parser = PossibleValuesParser::new(RepairKind::ALL.map(RepairKind::name)))]
    what: String,
    /// When: a date in UTC or with an offset, or seconds of a log without dates (`600 s`) [default: now]
    #[arg(long, value_name = "TIME")]
    at: Option<String>,
    /// Who did it
    #[arg(long, value_name = "NAME")]
    who: Option<String>,
    /// What else there is to say
    #[arg(long, value_name = "TEXT")]
    note: Option<String>,
    #[command(flatten)]
    place: PlaceArguments,
}

#[derive(Debug, Args)]
#[command(after_help = "Example:\n  seepd repair list --file press-1.repairs.toml")]
struct ListArguments {
    #[command(flatten)]
    place: PlaceArguments,
    /// Print one line of JSON for each entry
    #[arg(long)]
    json: bool,
}

/// The arguments that say where the log is.
#[derive(Debug, Args)]
struct PlaceArguments {
    /// The repair log
    #[arg(long, value_name = "FILE", conflicts_with = "config", required_unless_present = "config")]
    file: Option<PathBuf>,
    /// Configuration that names it, or whose daemon keeps it in its state folder
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Axis that was repaired; of a configuration with one axis, that
    #[arg(long, value_name = "NAME")]
    axis: Option<String>,
}

impl PlaceArguments {
    /// The log's file, and the axis.
    fn find(&self) -> Result<(PathBuf, String), Failure> {
        let axis = self.axis.clone().unwrap_or_else(|| AxisConfig::default().axis);
        if let Some(file) = &self.file {
            return Ok((file.clone(), axis));
        }
        let path = self.config.as_deref().unwrap_or(Path::new("seepd.toml"));
        let config = DaemonConfig::read(path)?;
        let folder = state_folder(&config);
        let axis = config
            .into_axis(self.axis.as_deref())
            .map_err(|what| Failure::new(Code::Usage, format!("{}: {what}", path.display())))?;
        let file = axis.repairs.clone().unwrap_or_else(|| repair_log::default_path(&folder, &axis.axis));
        Ok((file, axis.axis))
    }
}

#[cfg(feature = "live")]
fn state_folder(config: &DaemonConfig) -> PathBuf {
    crate::live::state_folder(config)
}

#[cfg(not(feature = "live"))]
fn state_folder(config: &DaemonConfig) -> PathBuf {
    config.state_dir.clone().unwrap_or_else(|| "seepd-state".into())
}

/// The time now, where this build has a clock that was set.
fn now_ns() -> Option<i64> {
    #[cfg(feature = "live")]
    return crate::clock::wall_ns();
    #[cfg(not(feature = "live"))]
    None
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] for arguments, configuration, or a file that cannot be read or written.
pub fn run(arguments: &RepairArguments) -> Result<Outcome, Failure> {
    match &arguments.action {
        Action::Add(arguments) => add(arguments),
        Action::List(arguments) => list(arguments),
    }
}

fn add(arguments: &AddArguments) -> Result<Outcome, Failure> {
    let usage = |text: String| Failure::new(Code::Usage, text);
    let what = RepairKind::of_name(&arguments.what)
        .ok_or_else(|| usage(format!("there is no repair `{}`", arguments.what.escape_debug())))?;
    let at_ns = match &arguments.at {
        Some(text) => repair_log::parse_time(text).map_err(|what| usage(format!("--at: {what}")))?,
        None => {
            now_ns().ok_or_else(|| usage("this machine's clock is not set; say when with --at".into()))?
        }
    };
    let (who, note) = (arguments.who.clone(), arguments.note.clone());
    repair_log::check_texts(who.as_deref(), note.as_deref()).map_err(|what| usage(format!("--{what}")))?;
    let (file, axis) = arguments.place.find()?;
    // A file with a fault would hide the entry: it is mended first.
    repair_log::read(&file, &axis)?;
    let repair = Repair { at_ns, what, who, note };
    repair_log::append(&file, &repair, &axis).map_err(|error| Failure::writing(&file, error))?;
    print(format!("{}: added: {}\n", file.display(), line(&repair)).as_bytes())?;
    Ok(Outcome::Good)
}

fn list(arguments: &ListArguments) -> Result<Outcome, Failure> {
    let (file, axis) = arguments.place.find()?;
    let repairs = repair_log::read(&file, &axis)?;
    let text: String = if arguments.json {
        repairs.iter().map(|repair| serde_json::to_string(repair).unwrap_or_default() + "\n").collect()
    } else if repairs.is_empty() {
        format!("{}: no entries\n", file.display())
    } else {
        repairs.iter().map(|repair| line(repair) + "\n").collect()
    };
    print(text.as_bytes())?;
    Ok(Outcome::Good)
}

fn line(repair: &Repair) -> String {
    let more = [&repair.who, &repair.note].into_iter().flatten().map(|text| format!("  {text}"));
    let more: String = more.collect();
    format!("{}  {}{more}", repair_log::time_text(repair.at_ns), repair.what.name())
}
