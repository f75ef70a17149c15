//! `seepd gap predict`: what a machine without a controller does under recorded commands, beside what it did.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::Args;
use seepd_gap::prediction::{PredictedSignal, Prediction, predict, rms};
use seepd_signals::Signal;

use super::gap::read_runs;
use super::reading::MappingArguments;
use super::simulate::read_any_plant;
use crate::cli::Outcome;
use crate::failure::{Code, Failure};
use crate::output::{Output, Outputs, OverwriteArguments};
use crate::sink::terminal::print;

/// Simulate recorded commands of a machine without a controller, and hold what they did against it
///
/// Nothing is fitted: each run is simulated from its first sample to its last, and errors are told of the times at which the piston moves,
/// beside the scatter of runs with the same command.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  seepd gap predict run-3v.csv --plant as-it-is.toml --config servo.toml --out predicted"
)]
pub struct PredictArguments {
    /// Logs of the runs
    #[arg(value_name = "LOG", required = true)]
    logs: Vec<PathBuf>,
    /// Plant file of the machine
    #[arg(long, value_name = "FILE")]
    plant: PathBuf,
    #[command(flatten)]
    mapping: MappingArguments,
    /// Write what is simulated into this folder, one CSV file a run
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    overwrite: OverwriteArguments,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] for plant, configuration, runs or output.
pub fn run(arguments: &PredictArguments) -> Result<Outcome, Failure> {
    let spec = read_any_plant(Some(&arguments.plant))?;
    if !spec.controller.is_none() {
        let what = "gap predict drives a plant by recorded commands: set `[controller] kind = \"none\"`";
        return Err(Failure::configuration(&arguments.plant, what));
    }
    let config = arguments.mapping.load()?;
    let outputs = claimed(arguments, &config)?;
    let (runs, _) = read_runs(&arguments.logs, &config, &spec)?;
    let predictions = runs
        .iter()
        .map(|run| predict(run, &spec).map_err(|error| Failure::data(error.to_string())))
        .collect::<Result<Vec<Prediction>, Failure>>()?;
    for (output, prediction) in outputs.iter().zip(&predictions) {
        output.write(table_of(prediction))?;
    }
    print(report(&predictions).as_bytes())?;
    Ok(Outcome::Good)
}

/// A file for each run, where a folder is named.
fn claimed(arguments: &PredictArguments, config: &crate::config::AxisConfig) -> Result<Vec<Output>, Failure> {
    let Some(folder) = &arguments.out else { return Ok(Vec::new()) };
    let names: Vec<&std::ffi::OsStr> = arguments.logs.iter().filter_map(|log| log.file_stem()).collect();
    if names.iter().collect::<BTreeSet<_>>().len() < arguments.logs.len() {
        let what = "--out: two of the runs would be written into the same file; rename one";
        return Err(Failure::new(Code::Usage, what));
    }
    std::fs::create_dir_all(folder).map_err(|error| Failure::writing(folder, error))?;
    let logs = arguments.logs.iter().map(PathBuf::as_path);
    let read = logs.chain([arguments.plant.as_path()]).chain(arguments.mapping.files(config));
    let mut outputs = Outputs::new(arguments.overwrite, read);
    names.into_iter().map(|name| outputs.claim(&folder.join(Path::new(name)).with_extension("csv"))).collect()
}

/// Time, command and every simulated signal, as CSV.
fn table_of(prediction: &Prediction) -> String {
    let units = |name: &str| match name {
        "position" => "position_m".to_owned(),
        "speed" => "speed_m_per_s".to_owned(),
        pressure => format!("{pressure}_pa"),
    };
    let names: Vec<String> = prediction.signals.iter().map(|signal| units(signal.name)).collect();
    let mut text = format!("t_s,command,{}\n", names.join(","));
    for (tick, command) in prediction.command.iter().enumerate() {
        text += &format!("{:.6},{command}", tick as f64 * prediction.tick_s);
        for signal in &prediction.signals {
            let value = signal.simulated[tick];
            text +=
                &if signal.name.starts_with("p_") { format!(",{value:.0}") } else { format!(",{value:.6}") };
        }
        text.push('\n');
    }
    text
}

/// A signal's unit on the terminal, and how many of it an SI unit is.
fn shown_in(name: &str) -> (&'static str, f64) {
    match name {
        "position" => ("mm", 1e3),
        "speed" => ("mm/s", 1e3),
        _ => ("bar", 1e-5),
    }
}

fn report(predictions: &[Prediction]) -> String {
    let width = predictions.iter().map(|one| one.name.len()).max().unwrap_or(0).max(3);
    let mut text = format!(
        "{:<width$}  {:<9} {:>9} {:>9} {:>9}  while the piston moves: RMS and mean of recorded less simulated, and RMS between runs with the same command\n",
        "run", "signal", "error", "mean", "scatter"
    );
    for prediction in predictions {
        let known = [Signal::Position.name(), "speed"];
        let shown = |signal: &&PredictedSignal| signal.recorded.is_some() || known.contains(&signal.name);
        for signal in prediction.signals.iter().filter(shown) {
            let (unit, scale) = shown_in(signal.name);
            let told =
                |value: Option<f64>| value.map_or("–".to_owned(), |value| format!("{:.2}", scale * value));
            text += &format!(
                "{:<width$}  {:<9} {:>9} {:>9} {:>9}  {unit}\n",
                prediction.name,
                signal.name,
                told(signal.error(&prediction.moves)),
                told(signal.bias(&prediction.moves)),
                told(scatter(predictions, prediction, signal)),
            );
        }
    }
    text
}

/// RMS over the other runs with the same command of what a signal is apart from this run's, over √2, as it is of two.
fn scatter(all: &[Prediction], one: &Prediction, signal: &PredictedSignal) -> Option<f64> {
    let own = signal.recorded.as_ref()?;
    let squares: Vec<f64> = all
        .iter()
        .filter(|other| other.name != one.name && same_command(&other.command, &one.command))
        .filter_map(|other| other.signals.iter().find(|of| of.name == signal.name)?.recorded.as_ref())
        .filter_map(|other| Some(0.5 * rms(own, other, &one.moves)?.powi(2)))
        .collect();
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

fn same_command(a: &[f64], b: &[f64]) -> bool {
    let different = a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() > 0.01).count();
    different * 50 <= a.len() && a.len().abs_diff(b.len()) * 10 <= a.len()
}
