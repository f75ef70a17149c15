//! `seepd init`: a first configuration, from what is on the bus or in a log.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use seepd_logs::can::dbc::Dbc;
use seepd_logs::survey::LogSurvey;

use super::inspect::{is_interface, look};
use crate::cli::Outcome;
use crate::config::DaemonConfig;
use crate::failure::{Code, Failure};
use crate::output::{Outputs, OverwriteArguments};
use crate::sink::plain::{self, one_line};

/// Listen on a CAN interface and write a first configuration
///
/// Listens on the interface (or reads a log), works out where the signals are, and writes a configuration for `run`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  seepd init can0 --dbc press.dbc --out /etc/seepd/seepd.toml\n  seepd init can0 --seconds 20 --axis press-1\n  seepd init press-1.mcap --out seepd.toml"
)]
pub struct InitArguments {
    /// CAN interface, such as can0, or a log
    #[arg(value_name = "INTERFACE")]
    place: PathBuf,
    /// DBC file that describes the frames
    #[arg(long, value_name = "FILE")]
    dbc: Option<PathBuf>,
    /// Name of the axis
    #[arg(long, default_value = "press-1", value_name = "NAME")]
    axis: String,
    /// How long to listen, s; a duty cycle or more
    #[arg(long, default_value_t = 12.0, value_name = "S")]
    seconds: f64,
    /// Configuration to write
    #[arg(long, default_value = "/etc/seepd/seepd.toml", value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: OverwriteArguments,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] where nothing is heard, or the file is there already or cannot be written.
pub fn run(arguments: &InitArguments) -> Result<Outcome, Failure> {
    let inputs = [Some(&arguments.place), arguments.dbc.as_ref()].into_iter().flatten();
    let target = Outputs::new(arguments.overwrite, inputs.map(PathBuf::as_path)).claim(&arguments.out)?;
    let dbc = arguments.dbc.as_deref().map(Dbc::read).transpose()?;
    let found = look(&arguments.place, None, dbc.as_ref(), arguments.seconds)?;
    let text = configuration(arguments, &found);
    DaemonConfig::parse(&text).map_err(|message| {
        Failure::new(
            Code::Usage,
            format!("the configuration that follows from these arguments is not valid: {message}"),
        )
    })?;
    target.write(text)?;
    let mut out = plain::stderr();
    // Where nobody reads this, the file still counts.
    let _ = writeln!(out, "{}: {} identifiers or topics seen", found.file, found.topics.len());
    for topic in &found.topics {
        let rate = topic.rate_hz.map_or(String::new(), |rate| format!(" at {rate:.1} Hz"));
        let bits =
            topic.changing_bits.as_ref().map_or(String::new(), |bits| format!(", changing bits {bits}"));
        let _ = writeln!(out, "  {} {}{rate}{bits}", one_line(&topic.topic), one_line(&topic.schema));
    }
    let path = arguments.out.display();
    let _ = writeln!(
        out,
        "wrote {path}; look it over, then run `seepd check {path}` and `seepd run --config {path}`"
    );
    Ok(Outcome::Good)
}

fn configuration(arguments: &InitArguments, found: &LogSurvey) -> String {
    let quoted = |path: &Path| toml::Value::from(path.display().to_string()).to_string();
    let absolute = |path: &Path| fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let place = arguments.place.display().to_string();
    let mut text = format!(
        "# Written by `seepd init {}`. docs/configuration.md describes every key.\n",
        one_line(&place)
    );
    text += &format!("axis = {}\n", toml::Value::from(arguments.axis.as_str()));
    text += "# model = \"press-1.json\"   # without it, the embedded model of the nominal press\n";
    if let Some(dbc) = &arguments.dbc {
        text += &format!("dbc = {}\n", quoted(&absolute(dbc)));
    }
    text += &found.time_toml();
    text += "\n[source]\n";
    if is_interface(&place) {
        text += &format!("can = {}\n", toml::Value::from(place.as_str()));
    } else {
        text += &format!("log = {}\n", quoted(&absolute(&arguments.place)));
    }
    text += "stale_after_s = 2.0\n\n";
    // The interface is named once, under [source].
    text += &found
        .mapping_toml()
        .lines()
        .filter(|line| !(is_interface(&place) && line.starts_with("topic = ")))
        .fold(String::new(), |text, line| text + line + "\n");
    text += "[http]\nlisten = \"127.0.0.1:8600\"\n\n[recording]\ntotal_mb = 2000.0\n\n";
    text += "# [mqtt]\n# host = \"broker.example\"\n# tls = true\n# username = \"seepd\"\n# password_file = \"mqtt-password\"\n";
    text
}
