//! `seepd check`: are these files what the program can use?

use std::path::{Path, PathBuf};

use clap::Args;
use seepd_logs::{frame_decoder, open};
use seepd_monitor::baseline::UNNAMED_AXIS;
use seepd_monitor::pipeline::DutyCycle;
use seepd_settings::side_file;
use serde::Serialize;

use crate::baseline_file;
use crate::cli::Outcome;
use crate::config::{AxisConfig, DaemonConfig, load_model};
use crate::failure::{Code, Failure};
use crate::progress::warn;
use crate::repair_log;
use crate::sink::terminal::print;

/// Check plant, model and configuration files
///
/// Names the line, the key and the nearest known key of what is wrong. JSON is a model; TOML with a table `[plant]`, `[controller]`,
/// `[cycle]`, `[effects]`, `[bounds]`, `[process]` or `[fmu]` is a plant, with `[[repairs]]` a repair log; other TOML is a configuration.
/// The model and the baseline of a configuration are checked too, and whether the log that it names has the mapped signals; so are the
/// variables that a plant file names of its FMU, of which nothing is run. Every file is checked, even after one that is wrong.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  seepd check plant.toml model.json seepd.toml")]
pub struct CheckArguments {
    /// Files to check
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Print one line of JSON for each file
    #[arg(long)]
    json: bool,
}

/// `seepd.check/1`: what was found of a file.
#[derive(Debug, Serialize)]
struct CheckedFile {
    schema: &'static str,
    file: String,
    kind: &'static str,
    good: bool,
    /// What it is, or what is wrong with it.
    message: String,
    /// What a good configuration allows and should be known.
    remarks: Vec<String>,
}

/// What a good file is.
struct Good {
    message: String,
    remarks: Vec<String>,
}

impl From<String> for Good {
    fn from(message: String) -> Self {
        Good { message, remarks: Vec::new() }
    }
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] with the first wrong file's code, once all files have been told of.
pub fn run(arguments: &CheckArguments) -> Result<Outcome, Failure> {
    let mut wrong: Vec<Failure> = Vec::new();
    for path in &arguments.files {
        let (kind, result) = check(path);
        if arguments.json {
            let (message, remarks) = match &result {
                Ok(good) => (good.message.clone(), good.remarks.clone()),
                Err(failure) => (failure.message.clone(), Vec::new()),
            };
            let finding = CheckedFile {
                schema: "seepd.check/1",
                file: path.display().to_string(),
                kind,
                good: result.is_ok(),
                message,
                remarks,
            };
            let line = serde_json::to_string(&finding).unwrap_or_default();
            print(format!("{line}\n").as_bytes())?;
        } else if let Ok(good) = &result {
            let place = path.display();
            let remarks: String =
                good.remarks.iter().map(|remark| format!("{place}: remark: {remark}\n")).collect();
            print(format!("{place}: good {kind}: {}\n{remarks}", good.message).as_bytes())?;
        }
        wrong.extend(result.err());
    }
    let Some(code) = wrong.first().map(|first| first.code) else { return Ok(Outcome::Good) };
    let last = wrong.pop().map_or(String::new(), |failure| failure.message);
    wrong.iter().for_each(|failure| warn(&failure.message));
    Err(Failure::new(code, last))
}

/// The file's kind, and what it is or what is wrong with it.
fn check(path: &Path) -> (&'static str, Result<Good, Failure>) {
    // A damaged model is one all the same.
    let lossy = |_| side_file::read(path).map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    let text = match side_file::read_text(path).or_else(lossy) {
        Ok(text) => text,
        Err(error) => return ("file", Err(Failure::reading(path, &error))),
    };
    if text.trim_start().starts_with('{') {
        ("model", check_model(path).map(Good::from))
    } else if is_plant(&text) {
        ("plant", check_plant(path, &text))
    } else if text.lines().any(|line| line.trim() == "[[repairs]]") {
        ("repair log", check_repairs(path).map(Good::from))
    } else {
        ("configuration", check_configuration(path))
    }
}

fn is_plant(text: &str) -> bool {
    let tables = ["plant", "controller", "cycle", "effects", "bounds", "process", "fmu"];
    text.lines().any(|line| {
        let name = line.trim().trim_start_matches('[').split(['.', ']']).next().unwrap_or_default();
        line.trim().starts_with('[') && tables.contains(&name)
    })
}

fn check_repairs(path: &Path) -> Result<String, Failure> {
    // An axis without a name has the entries of all.
    let repairs = repair_log::read(path, UNNAMED_AXIS)?;
    Ok(format!("{} entries", repairs.len()))
}

fn check_model(path: &Path) -> Result<String, Failure> {
    let model = load_model(path)?;
    Ok(format!(
        "{} trees, {} features, {} Hz, cycle of {} s",
        model.ensemble().trees(),
        model.feature_names().len(),
        model.file().sample_rate_hz,
        model.file().cycle.period_s
    ))
}

#[cfg(feature = "gap")]
fn check_simulator(path: &Path, text: &str) -> Result<Good, Failure> {
    let spec = seepd_simulator::SimulatorSpec::from_toml(text)
        .map_err(|error| Failure::configuration(path, error))?;
    let remarks = match &spec.fmu {
        // A relative name is meant from the plant file.
        Some(fmu) => {
            let file = path.parent().unwrap_or(Path::new("")).join(&fmu.file);
            seepd_simulator::fmu::check(&spec, &file).map_err(|error| Failure::configuration(path, error))?
        }
        None => Vec::new(),
    };
    let message = format!(
        "simulator of your own, cycle of {} s, {} parameters, {} effects of its own",
        spec.cycle.period_s,
        spec.parameters.len(),
        spec.effects.len()
    );
    Ok(Good { message, remarks })
}

#[cfg(feature = "simulate")]
fn check_plant(path: &Path, text: &str) -> Result<Good, Failure> {
    if seepd_sim::electric::ElectricAxis::is_kind(text) {
        let axis = seepd_sim::electric::ElectricAxis::from_toml(text)
            .map_err(|error| Failure::configuration(path, error))?;
        return Ok(
            format!("electric axis of {} kg, cycle of {} s", axis.plant.mass_kg, axis.cycle.period_s).into()
        );
    }
    #[cfg(feature = "gap")]
    if seepd_simulator::SimulatorSpec::is_kind(text) {
        return check_simulator(path, text);
    }
    let spec =
        seepd_sim::MachineSpec::from_toml(text).map_err(|error| Failure::configuration(path, error))?;
    let effects: Vec<&str> = spec.effects.keys().map(String::as_str).collect();
    let effects = if effects.is_empty() { "none".to_owned() } else { effects.join(", ") };
    let steps = format!("{} RK4 steps per {} s", spec.controller.steps_per_period, spec.controller.period_s);
    let moved = match spec.controller.is_none() {
        true => "a machine without a controller".to_owned(),
        false => format!("cycle of {} s with {} moves", spec.cycle.period_s, spec.cycle.moves.len()),
    };
    Ok(format!("{moved}, {steps}, effects: {effects}").into())
}

#[cfg(not(feature = "simulate"))]
fn check_plant(path: &Path, _text: &str) -> Result<Good, Failure> {
    Err(Failure::new(
        Code::Usage,
        format!("{}: this build has no simulator and cannot check plant files", path.display()),
    ))
}

fn check_configuration(path: &Path) -> Result<Good, Failure> {
    let config = DaemonConfig::read(path)?;
    let mut axes = Vec::new();
    for axis in &config.axes {
        let of_axis = |failure: Failure| {
            Failure::new(
                Code::Configuration,
                format!("{}: axis {}: {}", path.display(), axis.axis, failure.message),
            )
        };
        let duty_cycles = axis.load_models().map_err(of_axis)?;
        for (duty_cycle, baseline) in duty_cycles.iter().zip(axis.baseline_files()) {
            baseline
                .map(|file| baseline_file::read(file, &axis.axis, &duty_cycle.model))
                .transpose()
                .map_err(of_axis)?;
        }
        if let Some(file) = axis.baseline.file.as_deref().filter(|_| axis.is_relative()) {
            baseline_file::read_relative(file, &axis.axis).map_err(of_axis)?;
        }
        if let Some(file) = &axis.repairs {
            repair_log::read(file, &axis.axis).map_err(of_axis)?;
        }
        if axis.dbc.is_some() || axis.source.can.is_some() {
            frame_decoder(&axis.log_mapping()).map_err(Failure::from).map_err(of_axis)?;
        }
        if let Some(log) = axis.source.log.as_deref().filter(|log| log.is_file()) {
            let first = open(log, &axis.log_mapping()).and_then(|mut source| source.next_sample());
            first.map_err(Failure::from).map_err(of_axis)?;
        }
        axes.push(format!(
            "axis {}, {} mapped signals, {}",
            axis.axis,
            axis.signals.len(),
            measure(axis, &duty_cycles)
        ));
    }
    check_sinks(&config)?;
    Ok(Good { message: axes.join("; "), remarks: config.remarks() })
}

/// What the axis's cycles are measured against.
fn measure(axis: &AxisConfig, duty_cycles: &[DutyCycle]) -> String {
    if axis.is_relative() {
        return "watched relative to its own healthy cycles (no model, so no sizes)".to_owned();
    }
    duty_cycles.iter().map(described).collect::<Vec<_>>().join(", ")
}

fn described(DutyCycle { name, model }: &DutyCycle) -> String {
    let of_duty_cycle = name.as_ref().map_or(String::new(), |name| format!("duty cycle {name}: "));
    format!("{of_duty_cycle}model of {} trees", model.ensemble().trees())
}

/// Whether the files that the sinks need can be read.
#[cfg(feature = "live")]
fn check_sinks(config: &DaemonConfig) -> Result<(), Failure> {
    let wrong = |failure: Failure| Failure::new(Code::Configuration, failure.message);
    crate::live::check_sinks(config).map_err(wrong)
}

#[cfg(not(feature = "live"))]
fn check_sinks(_config: &DaemonConfig) -> Result<(), Failure> {
    Ok(())
}
