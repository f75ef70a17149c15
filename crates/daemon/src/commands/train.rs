//! `seepd train`: a model from a simulated machine.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use clap::Args;
use seepd_sim::MachineSpec;
use seepd_sim::series::Tolerances;
use seepd_train::relative::{RelativeAccuracy, RelativeReport};
use seepd_train::report::{Accuracy, NoiseLine, Report};
use seepd_train::train::Stage;
use seepd_train::{Portions, Share, Spread, TrainError, Trained, TrainingSettings};
use serde::Serialize;

use super::simulate::read_plant;
use crate::cli::Outcome;
use crate::failure::{Code, Failure};
use crate::output::{Output, Outputs, OverwriteArguments};
use crate::progress::Steps;
use crate::quantity::mm2;
use crate::sink::terminal::print;

/// Train a model on a simulated machine
///
/// The model is measured on other simulated machines. Machines differ by ± 5 % in their parameters and load; their leaks are 0, or
/// between 0.005 and 10 mm². The same seed gives the same bytes.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  seepd train --out model.json\n  seepd train --plant press-3.toml --out press-3.json --seed 2\n\n\
                        On several machines, to the same bytes:\n  seepd train --share 1/2 --out one.share\n  seepd train --share 2/2 --out two.share\n  \
                        seepd train --shares one.share two.share --out model.json\n\n\
                        The embedded model is rebuilt by\n  seepd train --out crates/daemon/assets/model.json"
)]
pub struct TrainArguments {
    /// Model to write; with --share, what the share came to
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Only simulate the I-th of N shares of the machines, for --shares: most of a training's time, spread over so many computers
    #[arg(long, value_name = "I/N", value_parser = share, conflicts_with_all = ["data", "json", "shares"])]
    share: Option<Share>,
    /// Take what --share made elsewhere with the same options; what is missing is simulated here
    #[arg(long, value_name = "FILE", num_args = 1..)]
    shares: Vec<PathBuf>,
    /// Write the observations that were learned from as CSV (features, leak_area_m2), for trees of other tools
    #[arg(long, value_name = "FILE")]
    data: Option<PathBuf>,
    /// Print the report as one JSON object
    #[arg(long)]
    json: bool,
    /// Plant file instead of the nominal press
    #[arg(long, value_name = "FILE")]
    plant: Option<PathBuf>,
    /// Seed of machines, noise, trees and search
    #[arg(long, default_value_t = 1, value_name = "S")]
    seed: u64,
    /// Simulated machines to learn from
    #[arg(long, default_value_t = TrainingSettings::default().observations, value_name = "N")]
    observations: usize,
    /// Simulated machines to measure on
    #[arg(long, default_value_t = TrainingSettings::default().held_out, value_name = "N")]
    held_out: usize,
    /// Trials of the hyperparameter search
    #[arg(long, default_value_t = TrainingSettings::default().trials, value_name = "N")]
    trials: usize,
    /// Simulated machines from which the comparison with a baseline is learned, six cycles each
    #[arg(long, default_value_t = TrainingSettings::default().relative_machines, value_name = "N")]
    compared: usize,
    /// Simulated machines at each size of each cause that the model is to name beside leaks; 0: it names none
    #[arg(long, default_value_t = TrainingSettings::default().cause_machines, value_name = "N")]
    causes: usize,
    /// Simulated machines that calibrate intervals
    #[arg(long, default_value_t = TrainingSettings::default().calibrated_on, value_name = "N")]
    calibration: usize,
    /// Measure more: estimates relative to a baseline on 8,192 machines instead of half of --held-out, and the article's experiment with
    /// noise, with the filter and without it
    #[arg(long)]
    full: bool,
    /// Parameters of the machines differ within ± this share
    #[arg(long, default_value_t = Spread::default().parameters.share, value_name = "SHARE")]
    parameter_spread: f64,
    /// Loads differ within ± this share
    #[arg(long, default_value_t = Spread::default().load, value_name = "SHARE")]
    load_spread: f64,
    #[command(flatten)]
    overwrite: OverwriteArguments,
}

/// Machines that `--full` measures relative estimates on.
const FULL_TEST: usize = 8192;

/// Runs the command.
///
/// # Errors
/// [`Failure`] for arguments, plant file, training or output.
pub fn run(arguments: &TrainArguments) -> Result<Outcome, Failure> {
    if arguments.share.is_some() {
        let claim = || Outputs::new(arguments.overwrite, arguments.plant.as_deref()).claim(&arguments.out);
        let (simulated, out) = share_simulated(arguments, claim)?;
        out.write(&simulated)?;
        return Ok(Outcome::Good);
    }
    let claim = || {
        let mut outputs = Outputs::new(arguments.overwrite, arguments.plant.as_deref());
        Ok((outputs.claim(&arguments.out)?, outputs.claim_any(arguments.data.as_ref())?))
    };
    let (trained, (out, data)) = trained(arguments, claim)?;
    out.write(&trained.json)?;
    if let Some(data) = data {
        write_data(&data, &trained)?;
    }
    let mut report = Vec::new();
    if arguments.json {
        report = json_report(&arguments.out.display().to_string(), &trained)?.into_bytes();
        report.push(b'\n');
    } else {
        print_report(&mut report, arguments, &trained)
            .map_err(|error| Failure::writing("standard output".as_ref(), error))?;
    }
    print(&report)?;
    Ok(Outcome::Good)
}

/// The report as one JSON object, `seepd.training/1`.
///
/// # Errors
/// None that is known.
pub fn json_report(model: &str, trained: &Trained) -> Result<String, Failure> {
    let told = JsonReport {
        schema: "seepd.training/1",
        model: model.to_owned(),
        trees: trained.model.ensemble().trees(),
        nodes: trained.model.ensemble().nodes(),
        features: trained.model.feature_names(),
        out_of_bag_rms: trained.found.out_of_bag_rms,
        report: &trained.report,
        relative: &trained.relative,
    };
    serde_json::to_string(&told)
        .map_err(|error| Failure::new(Code::Internal, format!("writing the report as JSON: {error}")))
}

/// Trains; `begin` is called once the arguments are known to be good, before the work.
///
/// # Errors
/// As [`run`], and what `begin` gives.
pub fn trained<T>(
    arguments: &TrainArguments,
    begin: impl FnOnce() -> Result<T, Failure>,
) -> Result<(Trained, T), Failure> {
    let (spec, settings) = asked_for(arguments)?;
    let mut portions = Portions::default();
    for path in &arguments.shares {
        let bytes = std::fs::read(path).map_err(|error| Failure::reading(path, &error))?;
        portions.add(&spec, &settings, &bytes).map_err(|error| refused(path, &error))?;
    }
    let begun = begin()?;
    let trained = with_progress(&spec, &settings, portions).map_err(|error| failure(&error))?;
    Ok((trained, begun))
}

/// Simulates the share that the arguments ask for; `begin` as for [`trained`].
///
/// # Errors
/// As [`run`], and what `begin` gives.
pub fn share_simulated<T>(
    arguments: &TrainArguments,
    begin: impl FnOnce() -> Result<T, Failure>,
) -> Result<(Vec<u8>, T), Failure> {
    let (spec, settings) = asked_for(arguments)?;
    let Some(share) = arguments.share else {
        return Err(Failure::new(Code::Usage, "which share? --share 1/8 is the first of eight"));
    };
    let begun = begin()?;
    let simulated = each_stage(|tell| seepd_train::simulate_share(&spec, &settings, share, tell));
    Ok((simulated.map_err(|error| failure(&error))?, begun))
}

/// `3/8`.
fn share(text: &str) -> Result<Share, String> {
    let parts = text.split_once('/').and_then(|(number, of)| Some((number.parse().ok()?, of.parse().ok()?)));
    parts
        .and_then(|(number, of)| Share::new(number, of))
        .ok_or_else(|| format!("{text:?} is no share; 3/8 is the third of eight"))
}

/// A share that cannot be taken.
fn refused(path: &Path, error: &TrainError) -> Failure {
    Failure::new(Code::Data, format!("{}: {error}", path.display()))
}

/// The machine and what is asked of its training.
fn asked_for(arguments: &TrainArguments) -> Result<(MachineSpec, TrainingSettings), Failure> {
    let limits = [
        ("--observations", arguments.observations as f64, 100.0, 1e6),
        ("--held-out", arguments.held_out as f64, 100.0, 1e6),
        ("--compared", arguments.compared as f64, 50.0, 1e6),
        ("--causes", arguments.causes as f64, 0.0, 1e4),
        ("--calibration", arguments.calibration as f64, 50.0, 1e6),
        ("--trials", arguments.trials as f64, 1.0, 1000.0),
        ("--parameter-spread", arguments.parameter_spread, 0.0, 0.3),
        ("--load-spread", arguments.load_spread, 0.0, 0.9),
    ];
    for (name, value, low, high) in limits {
        if !(low..=high).contains(&value) {
            return Err(Failure::new(
                Code::Usage,
                format!("{name} is {value}; it must lie in {low} … {high}"),
            ));
        }
    }
    let spec = read_plant(arguments.plant.as_deref())?;
    let settings = TrainingSettings {
        seed: arguments.seed,
        observations: arguments.observations,
        held_out: arguments.held_out,
        trials: arguments.trials,
        spread: Spread {
            parameters: Tolerances::even(arguments.parameter_spread),
            load: arguments.load_spread,
            ..Spread::default()
        },
        relative_machines: arguments.compared,
        cause_machines: arguments.causes,
        calibrated_on: arguments.calibration,
        noise_table: arguments.full,
        tested_on: if arguments.full { FULL_TEST } else { arguments.held_out / 2 },
        ..TrainingSettings::default()
    };
    Ok((spec, settings))
}

/// `seepd.training/1`: what was trained and what it is worth on machines that it has not seen.
#[derive(Serialize)]
struct JsonReport<'a> {
    schema: &'static str,
    model: String,
    trees: usize,
    nodes: usize,
    features: &'a [String],
    /// In ln(area + offset).
    out_of_bag_rms: f64,
    #[serde(flatten)]
    report: &'a Report,
    relative: &'a RelativeReport,
}

fn write_data(out: &Output, trained: &Trained) -> Result<(), Failure> {
    let mut file = out.create()?;
    write_rows(&mut file, trained).map_err(|error| Failure::writing(out.path(), error))?;
    file.finish()
}

fn write_rows(out: &mut impl Write, trained: &Trained) -> Result<(), csv::Error> {
    let mut writer = csv::Writer::from_writer(out);
    let names = trained.model.feature_names().iter().map(String::as_str);
    writer.write_record(names.chain(["leak_area_m2"]))?;
    for (index, leak_area_m2) in trained.learned.target.iter().enumerate() {
        let features = trained.learned.columns.iter().map(|column| column[index]);
        writer.write_record(features.chain([*leak_area_m2]).map(|value| value.to_string()))?;
    }
    writer.flush().map_err(csv::Error::from)
}

/// Trains, and shows how far it is.
pub(super) fn with_progress(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    portions: Portions,
) -> Result<Trained, TrainError> {
    each_stage(|tell| seepd_train::train_with(spec, settings, portions, tell))
}

/// Shows how far each stage of the work is.
fn each_stage<T>(work: impl FnOnce(&mut dyn FnMut(Stage, usize, usize)) -> T) -> T {
    let mut progress: Option<((Stage, usize), Steps)> = None;
    work(&mut |now, done, all| {
        // The last stage's bar goes before the next one's comes.
        progress = progress.take().filter(|(stage, _)| *stage == (now, all));
        let (_, steps) = progress.get_or_insert_with(|| ((now, all), Steps::begin(all as u64, name_of(now))));
        steps.set(done as u64);
    })
}

fn name_of(stage: Stage) -> &'static str {
    match stage {
        Stage::Simulate => "simulating",
        Stage::Compare => "comparing",
        Stage::Causes => "naming causes",
        Stage::Search => "searching",
        Stage::Measure => "measuring",
    }
}

fn failure(error: &TrainError) -> Failure {
    let code = match error {
        TrainError::NoStroke
        | TrainError::Spec(_)
        | TrainError::Unrecognised { .. }
        | TrainError::Comparison { .. } => Code::Configuration,
        TrainError::NotAShare | TrainError::ForeignShare | TrainError::Share(_) => Code::Data,
        _ => Code::Internal,
    };
    Failure::new(code, error.to_string())
}

fn print_report(out: &mut impl Write, arguments: &TrainArguments, trained: &Trained) -> io::Result<()> {
    let params = trained.found.params;
    writeln!(
        out,
        "{}: {} trees, {} nodes, {} features, {} bytes",
        arguments.out.display(),
        trained.model.ensemble().trees(),
        trained.model.ensemble().nodes(),
        trained.model.feature_names().len(),
        trained.json.len()
    )?;
    writeln!(
        out,
        "found in {} trials: {} learners, at least {} observations a leaf, {:.0} % of the features a split; \
         out-of-bag RMS {:.4} in ln(area + 0.02 mm²)",
        trained.found.trials,
        params.learners,
        params.least_leaf,
        100.0 * params.feature_share,
        trained.found.out_of_bag_rms
    )?;
    print_accuracy(out, &trained.report)?;
    trained.report.noise_table.as_ref().map_or(Ok(()), |table| print_noise_table(out, table))?;
    print_relative(out, &trained.relative)
}

fn print_relative(out: &mut impl Write, report: &RelativeReport) -> io::Result<()> {
    writeln!(
        out,
        "\nRelative to the machine's own baseline, on {} cycles of machines not used for anything else \
         (intervals calibrated on {}):",
        report.machines, report.calibrated_on
    )?;
    writeln!(
        out,
        "{:>7} {:>5}  {:^26}  {:>8}  {:^32}  {:>11}  {:>6}",
        "noise", "load", "median error by mm²", "above", "coverage of 90 % by mm²", "healthy sd", "new"
    )?;
    writeln!(
        out,
        "{:>7} {:>5}  {:>8} {:>8} {:>8}  {:>8}  {:>7} {:>8} {:>7} {:>7}  {:>11}",
        "", "", "0.05…", "0.1…", "1…10", "1 L/min", "all", "0.05…", "0.1…", "1…10", "mm²"
    )?;
    for (known, accuracies) in [("no", &report.command), ("yes", &report.load)] {
        for accuracy in accuracies {
            print_relative_line(out, known, accuracy)?;
        }
    }
    Ok(())
}

fn print_relative_line(out: &mut impl Write, known: &str, accuracy: &RelativeAccuracy) -> io::Result<()> {
    write!(out, "{:>7} {known:>5} ", accuracy.noise)?;
    for decade in &accuracy.decades {
        write!(out, " {:>6.2} %", 100.0 * decade.median_relative_error)?;
    }
    write!(
        out,
        "  {:>6.2} %  {:>5.1} % ",
        100.0 * accuracy.median_error_above_1_lpm,
        100.0 * accuracy.coverage
    )?;
    for decade in &accuracy.decades {
        write!(out, " {:>5.1} %", 100.0 * decade.coverage)?;
    }
    writeln!(
        out,
        "  {:>11}  {:>4.1} %",
        mm2(accuracy.healthy_deviation_m2),
        100.0 * accuracy.out_of_distribution
    )
}

fn print_accuracy(out: &mut impl Write, report: &Report) -> io::Result<()> {
    writeln!(
        out,
        "\nOn {} machines that it has not seen, by noise of the command:",
        report.accuracy.machines
    )?;
    writeln!(
        out,
        "{:>7} {:>9} {:>9}  {:^26}  {:>10}  {:>11}  {:>7}",
        "noise", "R² area", "R² ln", "median error by mm²", "coverage", "largest at", "new"
    )?;
    writeln!(
        out,
        "{:>7} {:>9} {:>9}  {:>8} {:>8} {:>8}  {:>10}  {:>11}",
        "", "", "", "0.05…", "0.1…", "1…10", "of 90 %", "leak 0, mm²"
    )?;
    for accuracy in &report.by_noise {
        print_accuracy_line(out, accuracy)?;
    }
    Ok(())
}

fn print_accuracy_line(out: &mut impl Write, accuracy: &Accuracy) -> io::Result<()> {
    let errors: Vec<f64> =
        accuracy.decades.iter().map(|decade| 100.0 * decade.median_relative_error).collect();
    writeln!(
        out,
        "{:>7} {:>9.5} {:>9.5}  {:>6.2} % {:>6.2} % {:>6.2} %  {:>8.1} %  {:>11}  {:>5.1} %",
        accuracy.noise,
        accuracy.r2_area,
        accuracy.r2_transformed,
        errors[0],
        errors[1],
        errors[2],
        100.0 * accuracy.coverage,
        mm2(accuracy.largest_healthy_m2),
        100.0 * accuracy.out_of_distribution
    )
}

fn print_noise_table(out: &mut impl Write, table: &[NoiseLine]) -> io::Result<()> {
    writeln!(out, "\nThe article's experiment: learned at noise 0.001, tested at each level:")?;
    writeln!(
        out,
        "{:>7}  {:^33}  {:^50}",
        "", "mean absolute error, mm²", "largest change of a feature over its range"
    )?;
    writeln!(
        out,
        "{:>7}  {:>16} {:>16}  {:>24} {:>25}",
        "noise", "with filter", "without", "with filter", "without"
    )?;
    for line in table {
        let change = |which: usize| {
            format!("{:.2} % {}", 100.0 * line.largest_feature_change[which], line.feature[which])
        };
        writeln!(
            out,
            "{:>7}  {:>16} {:>16}  {:>24} {:>25}",
            line.noise,
            mm2(line.mean_absolute_error_m2[0]),
            mm2(line.mean_absolute_error_m2[1]),
            change(0),
            change(1)
        )?;
    }
    Ok(())
}
