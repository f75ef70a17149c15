//! `seepd evaluate`: what estimates and flags are worth on logs that know the truth.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use indicatif::ProgressBar;
use seepd_logs::{LogMapping, Selection, SignalMapping, bytes_of, record};
use seepd_monitor::pipeline::Pipeline;
use seepd_signals::Signal;
#[cfg(feature = "train")]
use seepd_train::{Spread, plant_causes};

use super::reading::{BaselineArguments, ReadingArguments};
#[cfg(feature = "train")]
use super::simulate::read_plant;
use crate::cli::Outcome;
use crate::config::AxisConfig;
#[cfg(feature = "train")]
use crate::evaluation::causes;
use crate::evaluation::record::MachineRecord;
use crate::evaluation::{Conditions, Evaluation};
use crate::failure::{Code, Failure};
#[cfg(feature = "train")]
use crate::html::cause_evaluation::CausePage;
use crate::html::evaluation::EvaluationPage;
use crate::output::{Outputs, OverwriteArguments};
#[cfg(feature = "train")]
use crate::progress::Steps;
use crate::progress::{byte_bar, counting, warn};
#[cfg(feature = "train")]
use crate::sink::evaluation::cause_table;
use crate::sink::evaluation::write_tables;
use crate::sink::terminal::{listed, print};

/// Compare estimates and flags with the truth in the logs
///
/// Each log is the record of one machine. The truth is the area or the flow of the leak, from a simulator or a flow meter; the
/// estimates never see it. Simulated logs have it on /axis/truth.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  seepd evaluate press-*.mcap\n  \
                        seepd evaluate --learn-cycles 50 --html evaluation.html press-*.mcap\n  \
                        seepd evaluate --causes 10 --html causes.html\n  \
                        seepd evaluate --truth leak_lpm --truth-unit lpm --json rig.csv")]
pub struct EvaluateArguments {
    /// Logs; a folder or a quoted pattern is one machine's record
    #[cfg_attr(feature = "train", arg(required_unless_present = "causes", value_name = "LOG"))]
    #[cfg_attr(not(feature = "train"), arg(required = true, value_name = "LOG"))]
    logs: Vec<PathBuf>,
    #[cfg(feature = "train")]
    #[command(flatten)]
    causes: CauseArguments,
    #[command(flatten)]
    reading: ReadingArguments,
    #[command(flatten)]
    baseline: BaselineArguments,
    /// Read the logs one after the other, as the record of one machine
    #[arg(long)]
    one_machine: bool,
    /// Field, column or DBC signal that has the truth
    #[arg(long, value_name = "FIELD", num_args = 0..=1, default_value = "leak_area", default_missing_value = "leak_area")]
    truth: String,
    /// Topic of the truth [default: /axis/truth beside /axis/signals]
    #[arg(long, value_name = "TOPIC")]
    truth_topic: Option<String>,
    /// Unit of the truth
    #[arg(long, value_enum, default_value_t = TruthUnit::M2)]
    truth_unit: TruthUnit,
    /// Flow from which a machine counts as leaking, L/min at the reference pressure difference
    #[arg(long, value_name = "LPM", default_value_t = 0.005)]
    onset_lpm: f64,
    /// Cycles within which a leak has to be found
    #[arg(long, value_name = "N", default_value_t = 30)]
    within_cycles: usize,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Write the tables and curves as one HTML page
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    #[command(flatten)]
    overwrite: OverwriteArguments,
}

/// The arguments of a check of named causes.
#[cfg(feature = "train")]
#[derive(Debug, Args)]
struct CauseArguments {
    /// Check named causes instead, on N simulated machines of the series for each cause: no logs are read
    #[arg(long, value_name = "N", conflicts_with = "logs", value_parser = clap::value_parser!(u16).range(1..=1000))]
    causes: Option<u16>,
    /// Plant file of the model, with --causes [default: the nominal press]
    #[arg(long, value_name = "FILE", requires = "causes")]
    plant: Option<PathBuf>,
    /// Seed of machines, sizes and noise, with --causes
    #[arg(long, value_name = "S", default_value_t = 1, requires = "causes")]
    seed: u64,
}

/// How the truth is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum TruthUnit {
    /// Area, m²
    M2,
    /// Area, mm²
    Mm2,
    /// Flow at the reference pressure difference, L/min
    Lpm,
}

impl TruthUnit {
    fn in_m2(self, lpm_per_m2: f64) -> f64 {
        match self {
            TruthUnit::M2 => 1.0,
            TruthUnit::Mm2 => 1e-6,
            TruthUnit::Lpm => 1.0 / lpm_per_m2,
        }
    }
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] for arguments, configuration, logs, missing truth or output.
pub fn run(arguments: &EvaluateArguments) -> Result<Outcome, Failure> {
    #[cfg(feature = "train")]
    if let Some(each) = arguments.causes.causes {
        return run_causes(arguments, usize::from(each));
    }
    let claim = |config: &AxisConfig| {
        let logs = arguments.logs.iter().map(PathBuf::as_path);
        let inputs = logs.chain(arguments.reading.files(config)).chain(arguments.baseline.file());
        Outputs::new(arguments.overwrite, inputs).claim_any(arguments.html.as_ref())
    };
    let (evaluation, html) = evaluated(arguments, claim)?;
    if let Some(html) = html {
        html.write(EvaluationPage { evaluation: &evaluation }.render())?;
    }
    let mut text = Vec::new();
    let written = if arguments.json {
        serde_json::to_writer(&mut text, &evaluation).map_err(io::Error::from).and_then(|()| writeln!(text))
    } else {
        write_tables(&mut text, &evaluation)
    };
    written.map_err(|error| Failure::writing(Path::new("standard output"), error))?;
    print(&text)?;
    Ok(Outcome::Good)
}

/// Evaluates; `begin` is called once the arguments are known to be good, before the logs are read.
///
/// # Errors
/// As [`run`], and what `begin` gives.
pub fn evaluated<T>(
    arguments: &EvaluateArguments,
    begin: impl FnOnce(&AxisConfig) -> Result<T, Failure>,
) -> Result<(Evaluation, T), Failure> {
    if !(arguments.onset_lpm.is_finite() && arguments.onset_lpm >= 0.0) {
        return Err(Failure::new(
            Code::Usage,
            format!("--onset-lpm is {}; it must be 0 or more", arguments.onset_lpm),
        ));
    }
    if arguments.logs.iter().any(|log| log == Path::new("-")) {
        return Err(Failure::new(
            Code::Usage,
            "standard input cannot be evaluated, as each log is read twice: name a file",
        ));
    }
    if arguments.within_cycles == 0 {
        return Err(Failure::new(Code::Usage, "--within-cycles is 0; it must be 1 or more"));
    }
    let (config, duty_cycles) = arguments.reading.load()?;
    if config.is_relative() {
        let text = "an axis without a model (`monitor.kind = \"relative\"`) gives no sizes that could be held against the truth";
        return Err(Failure::new(Code::Usage, text));
    }
    let begun = begin(&config)?;
    let monitor = config.monitor(duty_cycles);
    let conditions = Conditions {
        reference_dp_pa: config.reference_dp_pa,
        lpm_per_m2: monitor.flow_lpm(1.0),
        onset_lpm: arguments.onset_lpm,
        within_cycles: arguments.within_cycles,
    };
    let machines: Vec<&[PathBuf]> =
        if arguments.one_machine { vec![&arguments.logs] } else { arguments.logs.chunks(1).collect() };
    let bytes = arguments.logs.iter().map(|log| bytes_of(log));
    // Each log is read twice.
    let bar = byte_bar(2 * bytes.sum::<u64>(), "evaluating");
    let mut records = Vec::with_capacity(machines.len());
    for logs in machines {
        let mut pipeline = Pipeline::new(monitor.clone())?;
        arguments.baseline.apply(&mut pipeline, &config)?;
        let mut record = estimate(logs, &config, &mut pipeline, &bar)?;
        lay_truth_beside(&mut record, logs, arguments, &config, &conditions, &bar)?;
        warn_of_leaking_baseline(&record, &conditions);
        records.push(record);
    }
    bar.finish_and_clear();
    let evaluation = Evaluation::of(&records, conditions);
    if evaluation.sizes.is_empty() {
        return Err(nothing_to_judge(&evaluation));
    }
    if evaluation.without_truth > 0 {
        warn(&format!(
            "{} of {} cycles have no known truth; they are left out of all figures",
            evaluation.without_truth, evaluation.cycles
        ));
    }
    Ok((evaluation, begun))
}

/// Checks named causes on simulated machines of the series.
#[cfg(feature = "train")]
fn run_causes(arguments: &EvaluateArguments, each: usize) -> Result<Outcome, Failure> {
    let CauseArguments { plant, seed, .. } = &arguments.causes;
    let (config, duty_cycles) = arguments.reading.load()?;
    let Some(first) = duty_cycles.first().filter(|_| duty_cycles.len() == 1) else {
        let text = "--causes takes one model: the configuration has several duty cycles, or none";
        return Err(Failure::new(Code::Usage, text));
    };
    let inputs = arguments.reading.files(&config).chain(plant.as_deref());
    let html = Outputs::new(arguments.overwrite, inputs).claim_any(arguments.html.as_ref())?;
    let spec = read_plant(plant.as_deref())?;
    let file = first.model.file();
    if (spec.cycle.period_s - file.cycle.period_s).abs() > 1e-6 {
        let (plant_s, model_s) = (spec.cycle.period_s, file.cycle.period_s);
        let text = format!(
            "the plant's cycle takes {plant_s} s, the model reads one of {model_s} s; name the model's plant file with --plant"
        );
        return Err(Failure::new(Code::Configuration, text));
    }
    let planted = plant_causes(&spec, &Spread::default(), each, *seed);
    let steps = Steps::begin(planted.len() as u64, "watching");
    let evaluation = causes::evaluate(&first.model, &planted, *seed, |machines| {
        (0..machines).for_each(|_| steps.one_more());
    })?;
    drop(steps);
    if let Some(html) = html {
        html.write(CausePage { evaluation: &evaluation }.render())?;
    }
    let text = if arguments.json {
        serde_json::to_string(&evaluation).map_err(|error| Failure::new(Code::Internal, error.to_string()))?
            + "\n"
    } else {
        cause_table(&evaluation)
    };
    print(text.as_bytes())?;
    Ok(Outcome::Good)
}

/// First pass: cycles and what is said of them.
fn estimate(
    logs: &[PathBuf],
    config: &AxisConfig,
    pipeline: &mut Pipeline,
    bar: &ProgressBar,
) -> Result<MachineRecord, Failure> {
    let name = logs.first().map(|log| seepd_logs::log_name(log)).unwrap_or_default();
    let mut record = MachineRecord::new(name);
    let notes = record::each_sample(logs, &config.log_mapping(), counting(bar), |sample| {
        pipeline.push(sample, &mut |event| record.take(event));
        Ok::<(), Failure>(())
    })?;
    pipeline.finish(&mut |event| record.take(event));
    notes.iter().for_each(|note| warn(note));
    Ok(record)
}

/// Second pass: the truth, read as the command was before, so that every source gives it.
fn lay_truth_beside(
    record: &mut MachineRecord,
    logs: &[PathBuf],
    arguments: &EvaluateArguments,
    config: &AxisConfig,
    conditions: &Conditions,
    bar: &ProgressBar,
) -> Result<(), Failure> {
    let mapping = SignalMapping {
        topic: arguments.truth_topic.clone().unwrap_or_else(|| truth_topic(config)),
        field: arguments.truth.clone(),
        scale: arguments.truth_unit.in_m2(conditions.lpm_per_m2),
        ..SignalMapping::default()
    };
    let mapping = LogMapping {
        signals: BTreeMap::from([(Signal::Command, mapping)]),
        selection: Selection::default(),
        ..config.log_mapping()
    };
    record::each_sample(logs, &mapping, counting(bar), |sample| {
        if let Some(area_m2) = sample.get(Signal::Command) {
            record.take_truth(sample.time_ns, area_m2);
        }
        Ok(())
    })
    .map(drop)
    .map_err(|failure: Failure| {
        let text = format!("{}; name the truth with --truth and --truth-topic", failure.message);
        Failure::new(failure.code, text)
    })
}

/// Where the truth of the signals' axis is.
fn truth_topic(config: &AxisConfig) -> String {
    let named = config.log_mapping().places().into_iter().find(|(signal, _)| *signal == Signal::Command);
    let axis = named.and_then(|(_, mapping)| Some(mapping.topic.strip_suffix("/signals")?.to_owned()));
    format!("{}/truth", axis.unwrap_or_else(|| "*".into()))
}

/// Tells of a baseline that was learned from a machine that leaked by then: what is relative to it does not count that leak.
fn warn_of_leaking_baseline(record: &MachineRecord, conditions: &Conditions) {
    if let Some(leak_m2) = record.leak_while_learning_m2()
        && conditions.leaked_while_learning(record)
    {
        warn(&format!(
            "{}: its baseline was learned while the truth was a leak of up to {:.3} L/min, which is missing from estimates relative to it; \
             learn the baseline from healthy cycles and name it with --baseline",
            record.name,
            leak_m2 * conditions.lpm_per_m2
        ));
    }
}

fn nothing_to_judge(evaluation: &Evaluation) -> Failure {
    let Evaluation { cycles, without_truth, rejected, .. } = evaluation;
    let why = if *cycles == 0 {
        "no cycle was found in the logs".to_owned()
    } else if without_truth == cycles {
        format!("no truth lies within any of the {cycles} cycles; do truth and signals have the same time?")
    } else {
        format!("none of the {cycles} cycles has an estimate ({})", listed(rejected))
    };
    Failure::data(format!("nothing to evaluate: {why}"))
}
