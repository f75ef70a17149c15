//! `seepd learn-baseline`: the healthy machine as it is when it is commissioned.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use seepd_model::Model;
use seepd_monitor::baseline::{Baseline, BaselineFile, MOST_CYCLES};
use seepd_monitor::pipeline::{DutyCycle, Pipeline};
use seepd_monitor::reason::LEARNING_BASELINE;
use seepd_monitor::relative::{RelativeBaseline, RelativeError};

use super::reading::{ReadingArguments, check_cycles, each_sample};
use crate::advice::advice;
use crate::baseline_file;
use crate::cli::Outcome;
use crate::config::AxisConfig;
use crate::failure::{Code, Failure};
use crate::output::{Output, Outputs, OverwriteArguments};
use crate::progress::warn;
use crate::quantity::{mm2, mm2_interval};
use crate::sink::terminal::{listed, print};

/// Learn the baseline of a healthy machine, so that estimates are relative to it
///
/// A baseline cancels what does not change: the machine's own valve null, gain and friction, and the leakage past a healthy seal. What
/// changes later (oil temperature, load, supply pressure) is told from a leak by its pattern over the phases, as far as training knows it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  seepd learn-baseline --out press-1.baseline.json monday.mcap\n  \
                        seepd replay --baseline press-1.baseline.json friday.mcap\n  \
                        seepd learn-baseline --seal-replaced --out press-1.baseline.json tuesday.mcap")]
pub struct LearnBaselineArguments {
    /// Logs of the healthy machine, or folders or patterns of them
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// File to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// The seal has been replaced: add a baseline to the file, from which estimates count; the older ones stay in it
    #[arg(long, conflicts_with = "force")]
    seal_replaced: bool,
    /// Why the baseline is learned, in a few words [default: `commissioning`, or `seal replaced`]
    #[arg(long, value_name = "TEXT")]
    occasion: Option<String>,
    #[command(flatten)]
    overwrite: OverwriteArguments,
    /// Duty cycle whose baseline is learned, where the configuration has several
    #[arg(long, value_name = "NAME")]
    duty_cycle: Option<String>,
    /// Use only the first N usable cycles
    #[arg(long, value_name = "N", default_value_t = MOST_CYCLES)]
    cycles: usize,
    #[command(flatten)]
    reading: ReadingArguments,
    /// Print the baseline as one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] for arguments, configuration, logs, or cycles that make no baseline.
pub fn run(arguments: &LearnBaselineArguments) -> Result<Outcome, Failure> {
    let (learned, out) = learned(arguments, |config| claim(arguments, config))?;
    out.write(learned.file.clone())?;
    learned.remarks().iter().for_each(|remark| warn(remark));
    print(&learned.told(arguments)?)?;
    Ok(Outcome::Good)
}

/// A baseline as it was learned.
pub struct Learned {
    /// What its file is to hold.
    pub file: String,
    what: What,
}

enum What {
    OfModel(Arc<Model>, Box<Baseline>),
    Relative(Box<RelativeBaseline>),
}

impl Learned {
    /// What a person should know before trusting it.
    pub fn remarks(&self) -> &[String] {
        match &self.what {
            What::OfModel(_, baseline) => &baseline.remarks,
            What::Relative(baseline) => &baseline.remarks,
        }
    }

    /// What the command prints.
    fn told(&self, arguments: &LearnBaselineArguments) -> Result<Vec<u8>, Failure> {
        match &self.what {
            What::OfModel(model, baseline) => tell(arguments, model, baseline),
            What::Relative(_) if arguments.json => Ok(self.file.clone().into_bytes()),
            What::Relative(baseline) => Ok(describe_relative(&arguments.out, baseline).into_bytes()),
        }
    }
}

/// Learns; `begin` is called once the arguments are known to be good, before the logs are read.
///
/// # Errors
/// As [`run`], and what `begin` gives.
pub fn learned<T>(
    arguments: &LearnBaselineArguments,
    begin: impl FnOnce(&AxisConfig) -> Result<T, Failure>,
) -> Result<(Learned, T), Failure> {
    check_cycles("--cycles", arguments.cycles)?;
    let (config, duty_cycles) = arguments.reading.load()?;
    if config.is_relative() {
        return learned_relative(arguments, &config, begin);
    }
    let which = chosen(arguments.duty_cycle.as_deref(), &duty_cycles)?;
    let model = Arc::clone(&duty_cycles[which].model);
    let mut file = record_of(arguments, &config, &model)?;
    let begun = begin(&config)?;
    let usual = if arguments.seal_replaced { "seal replaced" } else { "commissioning" };
    let occasion = arguments.occasion.as_deref().unwrap_or(usual);
    let baseline = learn(arguments, &config, (duty_cycles, which), occasion)?;
    file.baselines.push(baseline.clone());
    let text = file.to_json().map_err(|error| Failure::writing(&arguments.out, error))?;
    Ok((Learned { file: text, what: What::OfModel(model, Box::new(baseline)) }, begun))
}

/// Learns the baseline of an axis without a model: its duty cycle too.
fn learned_relative<T>(
    arguments: &LearnBaselineArguments,
    config: &AxisConfig,
    begin: impl FnOnce(&AxisConfig) -> Result<T, Failure>,
) -> Result<(Learned, T), Failure> {
    if arguments.seal_replaced {
        let text = "--seal-replaced adds to a record, and the baseline of an axis without a model is a single one; --force replaces it";
        return Err(Failure::new(Code::Usage, text));
    }
    let begun = begin(config)?;
    let mut pipeline = Pipeline::new(config.monitor(Vec::new()))?;
    let occasion = arguments.occasion.as_deref().unwrap_or("commissioning");
    if let Some(monitor) = pipeline.relative_mut() {
        monitor.learn(occasion, arguments.cycles);
    }
    read_logs(arguments, config, &mut pipeline)?;
    let learned = pipeline
        .relative()
        .map_or(Err(RelativeError::NoCycle), |monitor| monitor.baseline_so_far(&config.axis));
    let baseline = learned.map_err(|error| no_baseline(&error, arguments, config, &pipeline))?;
    let text = baseline.to_json().map_err(|error| Failure::writing(&arguments.out, error))?;
    Ok((Learned { file: text, what: What::Relative(Box::new(baseline)) }, begun))
}

fn describe_relative(path: &Path, baseline: &RelativeBaseline) -> String {
    let mut text = format!(
        "{}: baseline of {} cycles ({}), {} left out; without a model: it tells that something has changed, and no size\n\
         the command repeats every {:.2} s, at {} Hz\n",
        path.display(),
        baseline.cycles,
        baseline.occasion,
        baseline.left_out,
        baseline.cycle.period_s,
        baseline.sample_rate_hz
    );
    for (phase, feature) in baseline.cycle.phases.iter().zip(&baseline.features) {
        text.push_str(&format!(
            "  {:<10} {:>7.2} … {:>7.2} s {:>9.5} ± {:.5}\n",
            phase.name, phase.from_s, phase.to_s, feature.mean, feature.deviation
        ));
    }
    text
}

/// Index of the duty cycle whose baseline is learned.
fn chosen(name: Option<&str>, duty_cycles: &[DutyCycle]) -> Result<usize, Failure> {
    let known: Vec<&str> = duty_cycles.iter().filter_map(|duty_cycle| duty_cycle.name.as_deref()).collect();
    let usage = |text: String| Err(Failure::new(Code::Usage, text));
    match name {
        None if duty_cycles.len() == 1 => Ok(0),
        None => usage(format!(
            "--duty-cycle is missing; the configuration has the duty cycles {}",
            known.join(", ")
        )),
        Some(name) => match known.iter().position(|known| *known == name) {
            Some(index) => Ok(index),
            None if known.is_empty() => {
                usage(format!("--duty-cycle {name}: the configuration has no [[duty_cycles]]"))
            }
            None => usage(format!("--duty-cycle {name}: the configuration has only {}", known.join(", "))),
        },
    }
}

/// The file's record so far.
fn record_of(
    arguments: &LearnBaselineArguments,
    config: &AxisConfig,
    model: &Model,
) -> Result<BaselineFile, Failure> {
    let path = &arguments.out;
    match (arguments.seal_replaced, path.exists()) {
        (true, _) => baseline_file::read(path, &config.axis, model),
        (false, true) if !arguments.overwrite.force => Err(Failure::new(
            Code::Usage,
            format!(
                "{}: is there already; --seal-replaced adds a baseline to it, --force begins a new file",
                path.display()
            ),
        )),
        _ => Ok(BaselineFile::new(&config.axis, model)),
    }
}

/// The file to write. What it holds may be what the configuration names as baseline: it is read before it is written.
fn claim(arguments: &LearnBaselineArguments, config: &AxisConfig) -> Result<Output, Failure> {
    let force = arguments.overwrite.force || arguments.seal_replaced;
    let beside =
        arguments.reading.files(config).filter(|file| !config.baseline_files().contains(&Some(*file)));
    let inputs = arguments.logs.iter().map(PathBuf::as_path).chain(beside);
    Outputs::new(OverwriteArguments { force }, inputs).claim(&arguments.out)
}

fn learn(
    arguments: &LearnBaselineArguments,
    config: &AxisConfig,
    (duty_cycles, which): (Vec<DutyCycle>, usize),
    occasion: &str,
) -> Result<Baseline, Failure> {
    let mut pipeline = Pipeline::new(config.monitor(duty_cycles))?;
    pipeline.monitors_mut()[which]
        .learn(occasion, arguments.cycles)
        .map_err(|error| Failure::new(Code::Configuration, error.to_string()))?;
    read_logs(arguments, config, &mut pipeline)?;
    let monitor = &pipeline.monitors()[which];
    match (monitor.baseline(), monitor.learner()) {
        (Some(baseline), _) => Ok(baseline.clone()),
        (None, Some(learner)) => learner
            .baseline(monitor.model())
            .map_err(|error| no_baseline(&error, arguments, config, &pipeline)),
        (None, None) => Err(Failure::data("no baseline could be learned".to_owned())),
    }
}

fn read_logs(
    arguments: &LearnBaselineArguments,
    config: &AxisConfig,
    pipeline: &mut Pipeline,
) -> Result<(), Failure> {
    each_sample(&arguments.logs, &config.log_mapping(), "learning", |sample| {
        pipeline.push(sample, &mut |_| ());
    })?;
    pipeline.finish(&mut |_| ());
    Ok(())
}

/// Why there is no baseline: what became of the cycles, or, where hardly any could be used, what to do.
fn no_baseline(
    error: &dyn std::error::Error,
    arguments: &LearnBaselineArguments,
    config: &AxisConfig,
    pipeline: &Pipeline,
) -> Failure {
    let summary = pipeline.summary();
    let mut rejected = summary.rejected.clone();
    let has_learned = rejected.remove(LEARNING_BASELINE).is_some();
    let more = if summary.cycles == 0 && !has_learned {
        let source = config.command_source(arguments.logs.first().map(PathBuf::as_path));
        let duty_cycles = &pipeline.config().duty_cycles;
        format!(". {}", advice(&summary, &pipeline.observation(), duty_cycles, &source))
    } else if rejected.is_empty() {
        String::new()
    } else {
        format!(" (rejected: {})", listed(&rejected))
    };
    Failure::data(format!("no baseline could be learned: {error}{more}"))
}

fn tell(arguments: &LearnBaselineArguments, model: &Model, baseline: &Baseline) -> Result<Vec<u8>, Failure> {
    let mut out = Vec::new();
    let result = if arguments.json {
        serde_json::to_writer(&mut out, baseline).map_err(io::Error::from).and_then(|()| writeln!(out))
    } else {
        describe(&mut out, &arguments.out, model, baseline)
    };
    result.map_err(|error| Failure::writing(Path::new("standard output"), error))?;
    Ok(out)
}

fn describe(out: &mut impl Write, path: &Path, model: &Model, baseline: &Baseline) -> io::Result<()> {
    writeln!(
        out,
        "{}: baseline of {} cycles ({}), {} left out",
        path.display(),
        baseline.cycles,
        baseline.occasion,
        baseline.left_out
    )?;
    writeln!(
        out,
        "cycles repeat within {} mm² of leak (standard deviation); noise of the command {:.4}; load {}",
        mm2(baseline.residual_deviation_m2),
        baseline.noise,
        baseline.load_n.map_or("not measured".to_owned(), |load_n| format!("{load_n:.0} N on average"))
    )?;
    writeln!(
        out,
        "leak of these cycles by the model alone: {} mm² ({})",
        mm2(baseline.absolute_leak_area_m2),
        mm2_interval(baseline.absolute_interval90_m2)
    )?;
    for ((phase, mean), deviation) in
        model.file().cycle.phases.iter().zip(&baseline.mean).zip(&baseline.deviation)
    {
        writeln!(out, "  {:<10} {mean:>9.5} ± {deviation:.5}", phase.name)?;
    }
    Ok(())
}
