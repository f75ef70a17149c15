//! Where a command that reads logs finds the signals, the model and the baseline.

use std::io;
use std::path::{Path, PathBuf};

use clap::Args;
use seepd_logs::{LogMapping, Selection, bytes_of, record};
use seepd_monitor::baseline::{Baseline, LEAST_CYCLES, MOST_CYCLES};
use seepd_monitor::pipeline::{DutyCycle, Pipeline};
use seepd_monitor::relative::RelativeMonitor;
use seepd_monitor::repair::Repair;
use seepd_signals::Sample;

use crate::baseline_file;
use crate::config::{AxisConfig, DaemonConfig};
use crate::failure::{Code, Failure};
use crate::progress::{byte_bar, counting, warn};
use crate::repair_log;

/// The arguments that say where the signals are.
#[derive(Debug, Args)]
pub struct MappingArguments {
    /// Configuration with signal mapping, model and alarm thresholds
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Axis that the log is of, where the configuration has several
    #[arg(long, value_name = "NAME", requires = "config")]
    axis: Option<String>,
    /// Topic of the signals, where the log has several axes; in a CAN log the interface
    #[arg(long, value_name = "TOPIC")]
    topic: Option<String>,
    /// DBC file that describes the frames of a CAN log
    #[arg(long, value_name = "FILE")]
    dbc: Option<PathBuf>,
    /// Field, column or DBC signal (`Signal` or `Message.Signal`) of the command
    #[arg(long, value_name = "FIELD")]
    command: Option<String>,
    /// Factor that makes the command a share of full command, such as 0.01 for per cent [default: that of the unit in the DBC file, else 1]
    #[arg(long, value_name = "FACTOR", allow_negative_numbers = true)]
    scale: Option<f64>,
    /// Turn the command's sign: where a positive command retracts
    #[arg(long)]
    invert: bool,
    /// Rows a second of a CSV file without a time column, Hz
    #[arg(long, value_name = "HZ")]
    sample_rate: Option<f64>,
}

impl MappingArguments {
    /// The files that a command with these arguments reads beside its logs.
    pub fn files<'a>(&'a self, config: &'a AxisConfig) -> impl Iterator<Item = &'a Path> {
        self.config.as_deref().into_iter().chain(config.files())
    }

    /// The axis's configuration with what the command line says on top.
    ///
    /// # Errors
    /// [`Failure`] of the file, or where it has several axes and none or another one is named.
    pub fn load(&self) -> Result<AxisConfig, Failure> {
        let mut config = match &self.config {
            Some(path) => DaemonConfig::read(path)?
                .into_axis(self.axis.as_deref())
                .map_err(|what| Failure::new(Code::Usage, format!("{}: {what}", path.display())))?,
            None => AxisConfig::default(),
        };
        if self.scale.is_some_and(|scale| !scale.is_finite() || scale == 0.0) {
            return Err(Failure::new(Code::Usage, "--scale must be a number other than 0"));
        }
        if let Some(rate_hz) = self.sample_rate.filter(|rate| !(0.1..=1e6).contains(rate)) {
            return Err(Failure::new(
                Code::Usage,
                format!("--sample-rate is {rate_hz}; it must lie in 0.1 … 1e6 Hz"),
            ));
        }
        let (topic, command) = (self.topic.clone(), self.command.clone());
        config.selection = Selection { topic, command, scale: self.scale, invert: self.invert };
        config.sample_rate_hz = self.sample_rate.or(config.sample_rate_hz);
        config.dbc = self.dbc.clone().or(config.dbc);
        Ok(config)
    }
}

/// The arguments of commands that estimate.
#[derive(Debug, Args)]
pub struct ReadingArguments {
    #[command(flatten)]
    mapping: MappingArguments,
    /// Model to use instead of that of the configuration or the embedded one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
}

impl ReadingArguments {
    /// The files that a command with these arguments reads beside its logs.
    pub fn files<'a>(&'a self, config: &'a AxisConfig) -> impl Iterator<Item = &'a Path> {
        self.mapping.files(config)
    }

    /// The axis's configuration with what the command line says on top, and each duty cycle's model.
    ///
    /// # Errors
    /// [`Failure`] of either file.
    pub fn load(&self) -> Result<(AxisConfig, Vec<DutyCycle>), Failure> {
        let mut config = self.mapping.load()?;
        if let Some(path) = &self.model {
            if config.is_relative() {
                let text = "--model cannot be used: `monitor.kind` of the configuration is `relative`, which takes none";
                return Err(Failure::new(Code::Usage, text));
            }
            if !config.duty_cycles.is_empty() {
                let text = "--model cannot be used: the configuration has several duty cycles, each with its own model";
                return Err(Failure::new(Code::Usage, text));
            }
            config.model = Some(path.clone());
        }
        let duty_cycles = config.load_models()?;
        Ok((config, duty_cycles))
    }
}

/// What a command's estimates are relative to.
#[derive(Debug, Args)]
pub struct BaselineArguments {
    /// Baseline of the machine, from `learn-baseline`; estimates are then relative to it
    #[arg(long, value_name = "FILE", conflicts_with = "learn_cycles")]
    baseline: Option<PathBuf>,
    /// Learn the baseline from the first N cycles, and compare the rest with it
    #[arg(long, value_name = "N")]
    learn_cycles: Option<usize>,
}

impl BaselineArguments {
    /// The file that is named, if one is.
    pub fn file(&self) -> Option<&Path> {
        self.baseline.as_deref()
    }

    /// Takes the baselines that command line or configuration name, and gives the files' records, one a duty cycle.
    ///
    /// # Errors
    /// [`Failure`] of the file, or of the count of cycles.
    pub fn apply(&self, pipeline: &mut Pipeline, config: &AxisConfig) -> Result<Vec<Vec<Baseline>>, Failure> {
        if let Some(monitor) = pipeline.relative_mut() {
            self.apply_relative(monitor, config)?;
            return Ok(Vec::new());
        }
        if let Some(cycles) = self.learn_cycles {
            check_cycles("--learn-cycles", cycles)?;
            pipeline
                .learn("first cycles", cycles)
                .map_err(|error| Failure::new(Code::Configuration, error.to_string()))?;
            return Ok(vec![Vec::new(); pipeline.monitors().len()]);
        }
        let mut files = config.baseline_files();
        if let Some(path) = &self.baseline {
            if files.len() > 1 {
                let text = "--baseline cannot be used: the configuration has several duty cycles; name their baselines there";
                return Err(Failure::new(Code::Usage, text));
            }
            files = vec![Some(path)];
        }
        let mut records = Vec::new();
        for (monitor, path) in pipeline.monitors_mut().iter_mut().zip(files) {
            let Some(path) = path else {
                records.push(Vec::new());
                continue;
            };
            let file = baseline_file::read(path, &config.axis, monitor.model())?;
            let Some(baseline) = file.newest() else {
                return Err(Failure::configuration(
                    path,
                    "the file has no baseline; learn one with `seepd learn-baseline`",
                ));
            };
            monitor.follow(baseline.clone());
            records.push(file.baselines);
        }
        Ok(records)
    }

    fn apply_relative(&self, monitor: &mut RelativeMonitor, config: &AxisConfig) -> Result<(), Failure> {
        if let Some(cycles) = self.learn_cycles {
            check_cycles("--learn-cycles", cycles)?;
            monitor.learn("first cycles", cycles);
            return Ok(());
        }
        let Some(path) = self.baseline.as_deref().or(config.baseline.file.as_deref()) else { return Ok(()) };
        let baseline = baseline_file::read_relative(path, &config.axis)?;
        monitor.follow(baseline).map_err(|error| Failure::configuration(path, error))
    }
}

/// Where a command reads what was done to the machine.
#[derive(Debug, Args)]
pub struct RepairsArguments {
    /// Repair log of the machine, from `seepd repair`; estimates count from a replaced seal on [default: that of the configuration]
    #[arg(long, value_name = "FILE")]
    repairs: Option<PathBuf>,
}

impl RepairsArguments {
    /// The file that is named, if one is.
    pub fn file(&self) -> Option<&Path> {
        self.repairs.as_deref()
    }

    /// The entries, the oldest first.
    ///
    /// # Errors
    /// [`Failure`] of the file; one that the command line names must be there.
    pub fn read(&self, config: &AxisConfig) -> Result<Vec<Repair>, Failure> {
        if let Some(path) = self.repairs.as_deref().filter(|path| !path.exists()) {
            return Err(Failure::reading(path, &io::ErrorKind::NotFound.into()));
        }
        let path = self.repairs.as_deref().or(config.repairs.as_deref());
        path.map_or(Ok(Vec::new()), |path| repair_log::read(path, &config.axis))
    }
}

/// Checks how many cycles a baseline is to have.
///
/// # Errors
/// [`Failure`] that names the option.
pub fn check_cycles(option: &str, cycles: usize) -> Result<(), Failure> {
    if (LEAST_CYCLES..=MOST_CYCLES).contains(&cycles) {
        return Ok(());
    }
    let text = format!(
        "{option} is {cycles}; a baseline takes {LEAST_CYCLES} … {MOST_CYCLES} cycles, and 50 are a good number"
    );
    Err(Failure::new(Code::Usage, text))
}

/// Hands every sample of the logs, read as one record, to `take`, with a progress bar and the notes of each log.
///
/// # Errors
/// [`Failure`] where a log cannot be read.
pub(super) fn each_sample(
    logs: &[PathBuf],
    mapping: &LogMapping,
    what: &'static str,
    mut take: impl FnMut(&Sample),
) -> Result<(), Failure> {
    let sizes = logs.iter().map(|log| bytes_of(log)).sum();
    let bar = byte_bar(sizes, what);
    let notes = record::each_sample(logs, mapping, counting(&bar), |sample| {
        take(sample);
        Ok::<(), Failure>(())
    })?;
    bar.finish_and_clear();
    notes.iter().for_each(|note| warn(note));
    Ok(())
}
