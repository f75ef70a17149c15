//! `seepd gap`: where simulator and machine differ, and which effect explains it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, Subcommand};
use seepd_gap::report::Diagnosis;
use seepd_gap::{
    CalibrationProblem, Diagnosable, DiagnosisSettings, Log, Record, RecordError, Run, SimulatedAxis,
    cannot_tell, diagnose,
};
use seepd_logs::open;
use seepd_settings::UnknownKey;
use seepd_settings::side_file;
use seepd_signals::Signal;
use seepd_sim::electric::ElectricAxis;
use seepd_sim::{DutyCycle, MachineSpec, PlantParameters, SensorError};
use seepd_simulator::{ParameterSet, SimulatorAxis};

use super::blind::BlindArguments;
use super::gap_report::report;
use super::next_test::{self, TestFiles};
use super::predict::PredictArguments;
use super::reading::MappingArguments;
use super::simulate::{read_any_plant, read_plant};
use super::user_simulator::{self, SimulatorArguments};
use crate::cli::Outcome;
use crate::config::AxisConfig;
use crate::failure::{Code, Failure};
use crate::html::gap::GapPage;
use crate::output::{Output, Outputs, OverwriteArguments};
use crate::progress::Steps;
use crate::sink::terminal::print;

pub use super::gap_report::headline;

/// Find where simulator and machine differ, and which effect explains it
///
/// Says where log and simulator differ, which effect that the simulator lacks explains it and how likely that is, and how far the
/// difference shrinks once the effect is added; or that nothing in the catalogue explains the log.
///
/// The log must have the command and the position; demand, load and pressures help. Signals are mapped as in `replay`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
#[command(after_help = "Examples:\n  seepd gap press-3.mcap --plant press-3.toml\n  \
                        seepd gap press-3.mcap --json diagnosis.json --html gap.html --emit-plant as-it-is.toml")]
pub struct GapArguments {
    #[command(subcommand)]
    blind: Option<Other>,
    /// Log, or a folder or a pattern of logs; of a machine without a controller as many runs as there are
    #[arg(value_name = "LOG", required = true)]
    logs: Vec<PathBuf>,
    /// Plant file instead of the nominal press
    #[arg(long, value_name = "FILE")]
    plant: Option<PathBuf>,
    #[command(flatten)]
    mapping: MappingArguments,
    /// Write the diagnosis as JSON (seepd.gap/1); `-`: to standard output, instead of the report
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the diagnosis as one HTML page with plots
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Write the plant file with the calibrated parameters and the chosen effects
    #[arg(long, value_name = "FILE")]
    emit_plant: Option<PathBuf>,
    /// Say which short test, or which further sensor, would tell the remaining explanations apart
    #[arg(long)]
    next_test: bool,
    /// The same, and write the test into this folder: its demand (CSV) and its plant file
    #[arg(long, value_name = "DIR")]
    emit_test: Option<PathBuf>,
    /// Diagnose this log of a test together with the first one
    #[arg(long, value_name = "LOG", requires = "test_plant")]
    also: Option<PathBuf>,
    /// Plant file whose duty cycle is the test's
    #[arg(long, value_name = "FILE", requires = "also")]
    test_plant: Option<PathBuf>,
    /// Write the calibrated parameters and the chosen effects as a parameter set (SSP 1.0, .ssv), which tools that have FMUs read
    #[arg(long, value_name = "FILE")]
    emit_ssv: Option<PathBuf>,
    /// Leave this effect out of the catalogue; may be repeated
    #[arg(long, value_name = "EFFECT", value_parser = known_effect)]
    without: Vec<String>,
    /// Threads [default: one a core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    #[command(flatten)]
    simulator: SimulatorArguments,
    #[command(flatten)]
    overwrite: OverwriteArguments,
}

#[derive(Debug, Subcommand)]
enum Other {
    /// Simulate recorded commands of a machine without a controller, and hold what they did against it
    Predict(Box<PredictArguments>),
    /// Check the diagnosis on logs whose cause is withheld from it
    Blind(Box<BlindArguments>),
}

impl GapArguments {
    /// The record of a test, if one is named.
    fn test_record<A: PlantFile>(&self, config: &AxisConfig, spec: &A) -> Result<Option<Record>, Failure> {
        let (Some(log), Some(plant)) = (&self.also, &self.test_plant) else { return Ok(None) };
        let cycle = read_plant(Some(plant))?.cycle;
        let spec = spec.with_cycle(&cycle).ok_or_else(|| {
            Failure::new(Code::Usage, "--also: the duty cycle of a simulator of yours cannot be changed here")
        })?;
        let (values, _) = read(log, config, &spec)?;
        record_named(log, &values, &spec).map(Some)
    }
}

/// The record of a log whose name a refusal says.
fn record_named<A: PlantFile>(path: &Path, log: &Log, spec: &A) -> Result<Record, Failure> {
    Record::new(log, spec).map_err(|error| Failure::data(format!("{}: {error}", seepd_logs::log_name(path))))
}

fn known_effect(key: &str) -> Result<String, String> {
    if seepd_sim::effects::find(key).is_some() {
        return Ok(key.to_owned());
    }
    let known: Vec<&str> = seepd_sim::effects::ALL.iter().map(|effect| effect.key()).collect();
    Err(UnknownKey::new(key, &known).to_string())
}

/// Most cycles that are read: more add nothing but memory, a megabyte each.
const MOST_CYCLES: f64 = 120.0;

/// Runs the command.
///
/// # Errors
/// [`Failure`] for plant, configuration, log or output.
pub fn run(arguments: &GapArguments) -> Result<Outcome, Failure> {
    match &arguments.blind {
        Some(Other::Blind(arguments)) => return super::blind::run(arguments),
        Some(Other::Predict(arguments)) => return super::predict::run(arguments),
        None => {}
    }
    let claim = |_: &Path, config: &AxisConfig| GapOutputs::claim(arguments, config);
    let (diagnosed, path, outputs) = diagnosed(arguments, claim)?;
    if let Some((demand, plant)) = &outputs.test {
        let test = diagnosed.test_files?;
        demand.write(test.demand)?;
        plant.write(test.plant)?;
    }
    if let Some(emit_plant) = &outputs.emit_plant {
        emit_plant.write(diagnosed.plant_file?)?;
    }
    if let Some(emit_ssv) = &outputs.emit_ssv {
        let name = path.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        emit_ssv.write(diagnosed.parameter_set.to_ssv(&name))?;
    }
    write(&outputs, path, diagnosed.plant.as_ref(), &diagnosed.diagnosis)
}

/// A log's diagnosis with the machine as diagnosed.
pub struct Diagnosed {
    /// The diagnosis.
    pub diagnosis: Diagnosis,
    /// The plant file of the machine as diagnosed, as new.
    pub plant_file: Result<String, Failure>,
    /// The next test.
    pub(crate) test_files: Result<TestFiles, Failure>,
    /// The same by the names that its FMU has.
    pub parameter_set: ParameterSet,
    /// Where there is a plant to say how leaks flow.
    pub plant: Option<PlantParameters>,
}

/// Diagnoses; `begin` is called with log and configuration once the arguments are known to be good, before the log is read.
///
/// # Errors
/// As [`run`], and what `begin` gives.
#[expect(
    clippy::disallowed_methods,
    reason = "how long a diagnosis took is part of it; nothing else depends on it"
)]
pub fn diagnosed<T>(
    arguments: &GapArguments,
    begin: impl FnOnce(&Path, &AxisConfig) -> Result<T, Failure>,
) -> Result<(Diagnosed, &Path, T), Failure> {
    let start = Instant::now();
    let Some(path) = arguments.logs.first() else {
        return Err(Failure::new(Code::Usage, "there is no log to diagnose: name one"));
    };
    let config = arguments.mapping.load()?;
    let (begun, mut diagnosed) = if let Some(axis) = arguments.simulator.axis(arguments.plant.as_deref())? {
        (begin(path, &config)?, diagnosed_on(arguments, &config, &axis)?)
    } else if let Some(axis) = arguments.plant.as_deref().map(electric_axis).transpose()?.flatten() {
        (begin(path, &config)?, diagnosed_on(arguments, &config, &axis)?)
    } else {
        let spec = read_any_plant(arguments.plant.as_deref())?;
        let begun = begin(path, &config)?;
        let diagnosed = diagnosed_on(arguments, &config, &spec)?;
        (begun, Diagnosed { plant: Some(spec.plant), ..diagnosed })
    };
    diagnosed.diagnosis.seconds = start.elapsed().as_secs_f64();
    Ok((diagnosed, path, begun))
}

/// The least-squares problem that a log and a press are, for methods of others. Without `signals` all that the log has are compared.
///
/// # Errors
/// [`Failure`] for plant, configuration or log, and for what is no press with a controller.
pub fn calibration_problem(
    arguments: &GapArguments,
    signals: Option<&[Signal]>,
) -> Result<CalibrationProblem<MachineSpec>, Failure> {
    let [path] = arguments.logs.as_slice() else {
        return Err(Failure::new(Code::Usage, "a calibration problem is of one log; name one"));
    };
    let spec = read_plant(arguments.plant.as_deref())?;
    let (log, _) = read(path, &arguments.mapping.load()?, &spec)?;
    let log = match signals {
        Some(signals) => log.with_only(signals),
        None => log,
    };
    let record = record_named(path, &log, &spec)?;
    Ok(CalibrationProblem::new(record, spec, &arguments.without))
}

/// The electric axis of a plant file, if it is one.
fn electric_axis(path: &Path) -> Result<Option<ElectricAxis>, Failure> {
    let text = side_file::read_text(path).map_err(|error| Failure::reading(path, &error))?;
    let axis = ElectricAxis::is_kind(&text).then(|| ElectricAxis::from_toml(&text)).transpose();
    axis.map_err(|error| Failure::configuration(path, error))
}

/// The record of an axis's log, or of the runs of one without a controller.
fn record_of<A: PlantFile>(
    arguments: &GapArguments,
    config: &AxisConfig,
    spec: &A,
) -> Result<(Result<Record, RecordError>, Vec<String>), Failure> {
    if spec.is_open_loop() {
        if arguments.also.is_some() || arguments.next_test || arguments.emit_test.is_some() {
            let what = "--next-test, --emit-test and --also ask for a duty cycle; the machine of the plant file has no controller that could follow one";
            return Err(Failure::new(Code::Usage, what));
        }
        let (runs, notes) = read_runs(&arguments.logs, config, spec)?;
        return Ok((Record::of_runs(&runs, spec), notes));
    }
    let [path] = arguments.logs.as_slice() else {
        let what = "several logs are diagnosed together only where the plant file has `[controller] kind = \"none\"`; name one";
        return Err(Failure::new(Code::Usage, what));
    };
    let (log, notes) = read(path, config, spec)?;
    let record = Record::new(&log, spec);
    let record = match arguments.test_record(config, spec)? {
        Some(test) => record.and_then(|record| record.with_test(&test)),
        None => record,
    };
    Ok((record, notes))
}

/// Reads runs, each by its file's name, and what there is to know of them.
///
/// # Errors
/// [`Failure`] where one cannot be read.
pub(super) fn read_runs<A: SimulatedAxis>(
    paths: &[PathBuf],
    config: &AxisConfig,
    spec: &A,
) -> Result<(Vec<Run>, Vec<String>), Failure> {
    let mut notes: Vec<String> = Vec::new();
    let mut runs = Vec::with_capacity(paths.len());
    for path in paths {
        let (log, of_run) = read(path, config, spec)?;
        let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        notes.extend(of_run.into_iter().map(|note| format!("{name}: {note}")));
        runs.push(Run { name, log });
    }
    Ok((runs, notes))
}

fn diagnosed_on<A: PlantFile>(
    arguments: &GapArguments,
    config: &AxisConfig,
    spec: &A,
) -> Result<Diagnosed, Failure> {
    let (record, notes) = record_of(arguments, config, spec)?;
    let steps = Steps::begin(seepd_gap::diagnosis::STEPS as u64, "diagnosing");
    let settings = DiagnosisSettings {
        without: arguments.without.clone(),
        next_test: arguments.next_test || arguments.emit_test.is_some(),
        ..DiagnosisSettings::default()
    };
    let answered = pool(arguments.threads)?
        .install(|| answer(record, spec, &settings, &mut |done| steps.set(done as u64)));
    drop(steps);
    let (mut diagnosis, machine) = answered.map_err(|error| match (&error, arguments.logs.first()) {
        (RecordError::InRun { .. }, _) | (_, None) => Failure::data(error.to_string()),
        (_, Some(path)) => Failure::data(format!("{}: {error}", path.display())),
    })?;
    diagnosis.notes.extend(notes);
    diagnosis.notes.extend(spec.notes());
    if settings.next_test && diagnosis.next_test.is_none() {
        diagnosis
            .notes
            .push("no test is proposed: no other explanation is likely enough to be told from".into());
    }
    let test_files = next_test::files(&machine, diagnosis.next_test.as_ref());
    // Runs are foretold by the machine as it is.
    let machine =
        if machine.is_open_loop() { machine.with_sensors(&diagnosis.sensors) } else { as_new(machine) };
    let parameter_set = machine.parameter_set();
    diagnosis.notes.extend(parameter_set.additions.iter().cloned());
    Ok(Diagnosed { diagnosis, plant_file: text_of(&machine), parameter_set, test_files, plant: None })
}

/// Where a diagnosis goes.
struct GapOutputs {
    json: Option<JsonOutput>,
    html: Option<Output>,
    emit_plant: Option<Output>,
    /// Demand and plant file of the next test.
    test: Option<(Output, Output)>,
    emit_ssv: Option<Output>,
}

enum JsonOutput {
    /// In the place of the report.
    Standard,
    File(Output),
}

impl GapOutputs {
    fn claim(arguments: &GapArguments, config: &AxisConfig) -> Result<Self, Failure> {
        let plants = [&arguments.plant, &arguments.test_plant, &arguments.also];
        let named = plants.into_iter().filter_map(|path| path.as_deref());
        let named = named.chain(arguments.mapping.files(config));
        let logs = arguments.logs.iter().map(PathBuf::as_path);
        let mut outputs = Outputs::new(arguments.overwrite, logs.chain(named));
        let json = match &arguments.json {
            Some(path) if path == Path::new("-") => Some(JsonOutput::Standard),
            Some(path) => Some(JsonOutput::File(outputs.claim(path)?)),
            None => None,
        };
        let html = outputs.claim_any(arguments.html.as_ref())?;
        let test = match &arguments.emit_test {
            Some(folder) => Some((
                outputs.claim(&folder.join("next-test.csv"))?,
                outputs.claim(&folder.join("next-test.toml"))?,
            )),
            None => None,
        };
        let emit_plant = outputs.claim_any(arguments.emit_plant.as_ref())?;
        let emit_ssv = outputs.claim_any(arguments.emit_ssv.as_ref())?;
        Ok(GapOutputs { json, html, emit_plant, emit_ssv, test })
    }
}

/// The pool of threads that a diagnosis runs in.
///
/// # Errors
/// [`Failure`] where the system gives no threads.
pub(super) fn pool(threads: Option<u16>) -> Result<rayon::ThreadPool, Failure> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.map_or(0, usize::from))
        .build()
        .map_err(|error| Failure::new(Code::Internal, error.to_string()))
}

/// Diagnoses a record. Where something is wrong with its signals, the answer is that nothing can be told: a program that asked gets the
/// safe one.
///
/// # Errors
/// [`RecordError`] for a log that holds too little.
pub(super) fn answer<A: Diagnosable>(
    record: Result<Record, RecordError>,
    spec: &A,
    settings: &DiagnosisSettings,
    tell: &mut dyn FnMut(usize),
) -> Result<(Diagnosis, A), RecordError> {
    match record {
        Ok(record) => Ok(diagnose(&record, spec, settings, tell)),
        Err(error @ (RecordError::Units { .. } | RecordError::Mismatch(_))) => {
            Ok((cannot_tell(error.to_string()), spec.clone()))
        }
        Err(error) => Err(error),
    }
}

/// An axis that can be written as a plant file.
pub(super) trait PlantFile: Diagnosable {
    /// The file's text.
    fn text(&self) -> Result<String, String>;
    /// The same axis with another duty cycle, if it can have one.
    fn with_cycle(&self, _cycle: &DutyCycle) -> Option<Self> {
        None
    }
    /// The same axis with transducers that are off by so much, if its plant file can say so.
    fn with_sensors(self, _sensors: &BTreeMap<&'static str, SensorError>) -> Self {
        self
    }
    /// Its values by the names that its FMU has.
    fn parameter_set(&self) -> ParameterSet;
    /// What there is to say of it after a diagnosis.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }
}

impl PlantFile for MachineSpec {
    fn with_cycle(&self, cycle: &DutyCycle) -> Option<Self> {
        Some(MachineSpec { cycle: cycle.clone(), ..self.clone() })
    }

    fn with_sensors(self, sensors: &BTreeMap<&'static str, SensorError>) -> Self {
        let sensors = sensors.iter().map(|(signal, error)| ((*signal).to_owned(), *error)).collect();
        MachineSpec { sensors, ..self }
    }

    fn text(&self) -> Result<String, String> {
        self.with_stable_steps().to_toml().map_err(|error| error.to_string())
    }

    fn parameter_set(&self) -> ParameterSet {
        ParameterSet::of_press(self)
    }
}

impl PlantFile for ElectricAxis {
    fn with_cycle(&self, cycle: &DutyCycle) -> Option<Self> {
        Some(ElectricAxis { cycle: cycle.clone(), ..self.clone() })
    }

    fn text(&self) -> Result<String, String> {
        self.to_toml().map_err(|error| error.to_string())
    }

    fn parameter_set(&self) -> ParameterSet {
        ParameterSet::of_electric_axis(self)
    }
}

impl PlantFile for SimulatorAxis {
    fn text(&self) -> Result<String, String> {
        self.spec().to_toml().map_err(|error| error.to_string())
    }

    fn parameter_set(&self) -> ParameterSet {
        ParameterSet::of_simulator(self.spec())
    }

    fn notes(&self) -> Vec<String> {
        user_simulator::notes(self)
    }
}

/// The machine as diagnosed, as new: without what wear has done to it.
fn as_new<A: PlantFile>(mut machine: A) -> A {
    if let Some(wear) = machine.wear() {
        machine.set_parameter(&wear.key, wear.bounds.0);
    }
    machine
}

fn text_of(machine: &impl PlantFile) -> Result<String, Failure> {
    machine.text().map_err(|error| Failure::new(Code::Internal, error))
}

/// The plant file of the machine as diagnosed, as new.
///
/// # Errors
/// [`Failure`] where it cannot be written as TOML.
pub(super) fn emitted<A: PlantFile>(machine: A) -> Result<String, Failure> {
    text_of(&as_new(machine))
}

fn write(
    outputs: &GapOutputs,
    log: &Path,
    plant: Option<&PlantParameters>,
    diagnosis: &Diagnosis,
) -> Result<Outcome, Failure> {
    if let Some(html) = &outputs.html {
        let log = seepd_logs::log_name(log);
        let page = GapPage { log: &log, headline: &headline(diagnosis), diagnosis, plant };
        html.write(page.render())?;
    }
    if let Some(json) = &outputs.json {
        let mut text = serde_json::to_string_pretty(diagnosis).map_err(|error| {
            Failure::new(Code::Internal, format!("writing the diagnosis as JSON: {error}"))
        })?;
        text.push('\n');
        match json {
            JsonOutput::Standard => {
                print(text.as_bytes())?;
                return Ok(Outcome::Good);
            }
            JsonOutput::File(file) => file.write(text)?,
        }
    }
    print(report(plant, diagnosis).as_bytes())?;
    Ok(Outcome::Good)
}

/// Reads a log's signals, one value a controller tick, and what there is to know of it.
///
/// # Errors
/// [`Failure`] where it cannot be read.
pub(super) fn read<A: SimulatedAxis>(
    path: &Path,
    config: &AxisConfig,
    spec: &A,
) -> Result<(Log, Vec<String>), Failure> {
    let mut notes = Vec::new();
    let mut source = open(path, &config.log_mapping())?;
    let period_ns = spec.tick_s() * 1e9;
    let most = (MOST_CYCLES * spec.duty_cycle().period_s / spec.tick_s()) as usize;
    let mut log = Log::default();
    let mut first_ns = None;
    while let Some(sample) = source.next_sample()? {
        let first_ns = *first_ns.get_or_insert(sample.time_ns);
        let tick = (sample.time_ns.saturating_sub(first_ns) as f64 / period_ns).round();
        if tick < 0.0 {
            continue;
        }
        let tick = tick as usize;
        if tick >= most {
            notes.push(format!("only the first {MOST_CYCLES} cycles are used"));
            break;
        }
        for signal in Signal::ALL {
            if let Some(value) = sample.get(signal) {
                let values = &mut log.values[signal as usize];
                if values.len() <= tick {
                    values.resize(tick + 1, f64::NAN);
                }
                values[tick] = value;
            }
        }
    }
    notes.extend(source.notes());
    let length = log.len();
    for values in log.values.iter_mut().filter(|values| !values.is_empty()) {
        values.resize(length, f64::NAN);
    }
    Ok((log, notes))
}
