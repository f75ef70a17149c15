//! `seepd bound`: how small a leak the command can show at all.

use std::path::PathBuf;

use clap::Args;
use seepd_model::causes::{Causes, KnownConditions};
use seepd_monitor::MonitorConfig;
use serde::Serialize;

use crate::cli::Outcome;
use crate::config::{embedded_model, load_model};
use crate::failure::{Code, Failure};
use crate::sink::terminal::print;

/// Standard deviations at which a leak stands out: one in 10,000 healthy readings reaches 3.72, and nine in ten leaks of that size plus
/// 1.28 do.
const FOUND_FROM: f64 = 3.72 + 1.28;
/// Cycles after the change whose mean is taken.
const CYCLES: [u32; 5] = [1, 3, 10, 30, 100];

/// Tell how small a leak the command can show at all
///
/// The Cramér–Rao bound: no estimate that knows the phases' means and rises alone, however it is made, scatters less than this. A leak
/// counts as found where a healthy machine is taken for one in 10,000 readings, and such a leak is missed in one of ten.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  seepd bound --noise 0.003 --baseline-cycles 50")]
pub struct BoundArguments {
    /// Model [default: the embedded one]
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Noise of the command, standard deviation, share of full command
    #[arg(long, value_name = "SHARE", default_value_t = 0.003)]
    noise: f64,
    /// Cycles of the baseline
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..))]
    baseline_cycles: u32,
    /// Print one line of JSON for each number of cycles
    #[arg(long)]
    json: bool,
}

/// `seepd.bound/1`: what the mean of some cycles can show.
#[derive(Debug, Serialize)]
struct Bound {
    schema: &'static str,
    /// Cycles.
    cycles: u32,
    /// Least standard deviation of the leak's area, m²: with load, oil and supply anywhere within their ordinary range, and with them
    /// known.
    deviation_m2: f64,
    deviation_known_m2: f64,
    /// Smallest leak found, L/min, in either case.
    found_lpm: f64,
    found_known_lpm: f64,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] for a noise that is none, and for a model that cannot be read or names no causes.
pub fn run(arguments: &BoundArguments) -> Result<Outcome, Failure> {
    if !(arguments.noise > 0.0 && arguments.noise < 1.0) {
        let text = format!("--noise is {}; it must lie between 0 and 1", arguments.noise);
        return Err(Failure::new(Code::Usage, text));
    }
    let model = arguments.model.as_deref().map_or_else(embedded_model, load_model)?;
    let none = || Failure::new(Code::Configuration, "the model names no causes; train it again: seepd train");
    let config = MonitorConfig::new("", model);
    let model = config.duty_cycles.first().map(|duty_cycle| &duty_cycle.model).ok_or_else(none)?;
    let causes = model.causes().ok_or_else(none)?;
    let bounds: Option<Vec<Bound>> =
        CYCLES.iter().map(|cycles| bound(causes, &config, arguments, *cycles)).collect();
    let bounds = bounds.ok_or_else(none)?;
    let text: String = if arguments.json {
        bounds.iter().map(|bound| serde_json::to_string(bound).unwrap_or_default() + "\n").collect()
    } else {
        table(&bounds)
    };
    print(text.as_bytes())?;
    Ok(Outcome::Good)
}

fn bound(causes: &Causes, config: &MonitorConfig, arguments: &BoundArguments, cycles: u32) -> Option<Bound> {
    let averaged = 1.0 / f64::from(cycles) + 1.0 / f64::from(arguments.baseline_cycles);
    let least = |conditions| causes.least_leak_deviation_m2(arguments.noise * averaged.sqrt(), conditions);
    let (deviation_m2, deviation_known_m2) = (least(KnownConditions::No)?, least(KnownConditions::Yes)?);
    let found = |deviation_m2: f64| config.flow_lpm(FOUND_FROM * deviation_m2);
    Some(Bound {
        schema: "seepd.bound/1",
        cycles,
        deviation_m2,
        deviation_known_m2,
        found_lpm: found(deviation_m2),
        found_known_lpm: found(deviation_known_m2),
    })
}

fn table(bounds: &[Bound]) -> String {
    let head = "            load, oil and supply unknown      known\n\
                cycles      deviation     found        deviation     found\n";
    let row = |bound: &Bound| {
        format!(
            "{:<12}{:.5} mm²   {:.4} L/min  {:.5} mm²   {:.4} L/min\n",
            bound.cycles,
            1e6 * bound.deviation_m2,
            bound.found_lpm,
            1e6 * bound.deviation_known_m2,
            bound.found_known_lpm
        )
    };
    head.to_owned() + &bounds.iter().map(row).collect::<String>()
}
