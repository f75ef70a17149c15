//! `seepd adopt`: from a user's log to a watched machine.
//!
//! Each step leaves its file in the folder, says what it found, and can be run again from there after the file has been edited.

pub(crate) mod capability;
mod files;
mod questions;
pub(crate) mod told;

use std::io::{self, IsTerminal};
use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, ValueEnum};
use seepd_adopt::adoption::{Adoption, AdoptionError, adopt};
use seepd_adopt::duty_cycle::{FoundCycle, find_duty_cycle};
use seepd_adopt::machine_data::MachineData;
use seepd_adopt::recording::{Recorder, Recording};
use seepd_adopt::signals::{Hints, SignalProposal, propose};
use seepd_adopt::training::TrainingBasis;
use seepd_logs::LogMapping;
use seepd_logs::can::dbc::Dbc;
use seepd_logs::columns::{Columns, Known};
use seepd_model::Model;
use seepd_monitor::baseline::{BaselineFile, MOST_CYCLES};
use seepd_monitor::pipeline::{DutyCycle, Pipeline};
use seepd_signals::Signal;
use seepd_train::{Portions, TrainError, Trained};

use super::reading::each_sample;
use super::train::with_progress;
use crate::cli::Outcome;
use crate::config::{AxisConfig, load_model};
use crate::failure::{Code, Failure};
use crate::html::adopt::AdoptPage;
use crate::output::OverwriteArguments;
use crate::progress::warn;
use crate::sink::terminal::{listed, print};
use capability::Capability;
use files::Folder;

/// Adopt a machine: from its log and its data sheet to a configuration, a plant, a model and a baseline
///
/// Works in steps: signals, duty cycle, machine data, calibration, model, baseline. Each step says what it found and leaves its file in the
/// folder. Edit a file and run the rest again with --from. What nobody knows may stay unknown; it makes the intervals wider.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  seepd adopt press.mcap --out press-3\n  \
                        seepd adopt --machine machine.toml monday.csv tuesday.csv --out press-3\n  \
                        seepd adopt press.mcap --out press-3 --from model   # after editing press-3/plant.toml\n  \
                        seepd replay --config press-3/seepd.toml today.mcap")]
pub struct AdoptArguments {
    /// Logs of the machine, healthy as far as you know; a folder or a pattern is read as one
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Folder for what comes of it
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// What can be read off data sheets [default: machine.toml in the folder, where there is one; else you are asked on a terminal]
    #[arg(long, value_name = "FILE")]
    machine: Option<PathBuf>,
    /// Configuration whose mapping says where signals are; those that it leaves out are looked for
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// DBC file that describes the frames of a CAN log
    #[arg(long, value_name = "FILE")]
    dbc: Option<PathBuf>,
    /// Name of the axis [default: the name in machine.toml, or the folder's]
    #[arg(long, value_name = "NAME")]
    axis: Option<String>,
    /// Step to begin with; earlier ones are taken from the folder
    #[arg(long, value_name = "STEP", default_value = "signals")]
    from: Step,
    /// Train with a sixth of the machines, for a first look: intervals are wider
    #[arg(long)]
    quick: bool,
    /// Copy configuration, plant, model and baseline to /etc/seepd afterwards; over files that are there only with --force
    #[arg(long)]
    install: bool,
    #[command(flatten)]
    overwrite: OverwriteArguments,
    /// Print the result as one JSON object
    #[arg(long)]
    json: bool,
}

/// Share of the machines with which `--quick` trains.
const QUICK: f64 = 1.0 / 6.0;

/// The steps that one can begin with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
enum Step {
    /// Which column is which signal
    Signals,
    /// The duty cycle, the machine's data and the calibration
    Cycle,
    /// Training, with the plant file of the folder
    Model,
    /// The baseline, with the model of the folder
    Baseline,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] in one sentence: what was seen and what to do. What was found so far stays in the folder.
pub fn run(arguments: &AdoptArguments) -> Result<Outcome, Failure> {
    let folder = Folder::open(&arguments.out, arguments.overwrite.force || arguments.from > Step::Signals)?;
    let known = known_machine(arguments, &folder)?;
    let (mut config, proposal) = signals(arguments, &folder, known.as_ref())?;
    let machine = known.map_or_else(|| ask_machine(&folder), Ok)?;
    config.axis = arguments.axis.clone().or_else(|| machine.name.clone()).unwrap_or_else(|| folder.name());
    let described = if arguments.from <= Step::Cycle {
        Some(describe(arguments, &folder, (&mut config, proposal), &machine)?)
    } else {
        None
    };
    let (model, trained) = model(arguments, &folder, described.as_ref())?;
    let baseline = baseline(arguments, &folder, &config, &model)?;
    let capability = Capability::of(&model, &baseline, trained.as_ref());
    let plant = folder.read_plant()?;
    config.alarm = capability.alarm(&plant);
    folder.write_config(&config)?;
    let page = AdoptPage {
        axis: &config.axis,
        described: described.as_ref(),
        plant: &plant,
        mapping: &config.signals,
        baseline: &baseline,
        capability: &capability,
        trained: trained.as_ref(),
    };
    folder.write("adopt.html", page.render())?;
    let text = if arguments.json {
        told::json(&config.axis, described.as_ref(), &capability)?
    } else {
        told::result(&folder, &capability)
    };
    print(text.as_bytes())?;
    if arguments.install {
        folder.install(arguments.overwrite)?;
    }
    Ok(Outcome::Good)
}

/// What the log and the data sheet gave.
pub(crate) struct Described {
    pub(crate) recording: Recording,
    pub(crate) found: FoundCycle,
    pub(crate) adoption: Adoption,
    pub(crate) proposal: SignalProposal,
}

/// Step 1: where the signals are, as a configuration without a model.
fn signals(
    arguments: &AdoptArguments,
    folder: &Folder,
    machine: Option<&MachineData>,
) -> Result<(AxisConfig, SignalProposal), Failure> {
    if arguments.from > Step::Signals {
        return Ok((folder.read_config()?, SignalProposal::default()));
    }
    let mut config = match &arguments.config {
        Some(path) => files::read_config(path)?,
        None => AxisConfig::default(),
    };
    config.dbc = arguments.dbc.clone().or(config.dbc);
    let known = Known { dbc: config.dbc.as_deref().map(Dbc::read).transpose()?, ..Known::default() };
    let columns = Columns::of_file(&arguments.logs[0], &known)?;
    let proposal = propose(&columns, &hints(machine, &config));
    told::signals(&arguments.logs[0], &columns, &proposal);
    if let Some(refusal) = &proposal.refusal {
        return Err(Failure::data(refusal.clone()));
    }
    let proposal = questions::answered(proposal, &columns)?;
    let mapping: LogMapping = proposal.mapping(&columns).ok_or_else(|| {
        Failure::data(
            "no column is a valve command for sure; name it in a configuration: `seepd adopt --config`"
                .to_owned(),
        )
    })?;
    config.time_column = mapping.time_column;
    config.time_unit = mapping.time_unit;
    config.signals = mapping.signals;
    folder.write_mapping(&config)?;
    Ok((config, proposal))
}

fn hints(machine: Option<&MachineData>, config: &AxisConfig) -> Hints {
    Hints {
        stroke_m: machine.and_then(|data| data.cylinder.stroke_mm).map(|stroke| 1e-3 * stroke.value()),
        supply_pa: machine.and_then(|data| data.supply.relief_bar).map(|pressure| 1e5 * pressure.value()),
        given: config.signals.clone(),
    }
}

/// Step 3's input: what the user has written down, in the file that is named or in the folder's. The folder has it from then on.
fn known_machine(arguments: &AdoptArguments, folder: &Folder) -> Result<Option<MachineData>, Failure> {
    let of_folder = folder.path("machine.toml");
    if let Some(path) = arguments.machine.as_ref().filter(|path| **path != of_folder) {
        let data = files::read_machine(path)?;
        folder.copy(path, "machine.toml")?;
        return Ok(Some(data));
    }
    of_folder.exists().then(|| files::read_machine(&of_folder)).transpose()
}

/// Step 3's input where nothing is written down: asked for on a terminal, else unknown.
fn ask_machine(folder: &Folder) -> Result<MachineData, Failure> {
    if io::stdin().is_terminal() && io::stderr().is_terminal() {
        let data = questions::machine()?;
        folder.write("machine.toml", files::machine_toml(&data)?)?;
        return Ok(data);
    }
    warn(
        "no machine.toml is named, so that the machine's size is taken from the log as far as it shows it; a form lies in the folder",
    );
    folder.write("machine.toml", files::MACHINE_FORM)?;
    Ok(MachineData::default())
}

/// Steps 2 to 4: duty cycle, plant, calibration.
fn describe(
    arguments: &AdoptArguments,
    folder: &Folder,
    (config, proposal): (&mut AxisConfig, SignalProposal),
    machine: &MachineData,
) -> Result<Described, Failure> {
    let recording = record_of(arguments, &config.log_mapping())?;
    let found = find_duty_cycle(&recording, machine.overlap().unwrap_or(0.0))
        .map_err(|error| Failure::data(format!("{error}. {}", told::WITHOUT_A_CYCLE)))?;
    told::cycle(&recording, &found);
    let mut adoption = adopt(&recording, &found, machine).map_err(|error| failure(&error))?;
    let basis = TrainingBasis::of(&adoption, &found);
    adoption.spec = basis.with_steps_for_all(&adoption.spec);
    if adoption.position_offset_m != 0.0 {
        for signal in [Signal::Position, Signal::Demand] {
            if let Some(mapping) = config.signals.get_mut(&signal) {
                mapping.offset += adoption.position_offset_m;
            }
        }
    }
    told::machine(&adoption);
    let plant = adoption.spec.to_toml().map_err(|error| Failure::new(Code::Internal, error.to_string()))?;
    folder.write("plant.toml", files::plant_toml(&plant, &adoption))?;
    folder.write_basis(&basis)?;
    Ok(Described { recording, found, adoption, proposal })
}

fn failure(error: &AdoptionError) -> Failure {
    let code = match error {
        AdoptionError::Data(_) => Code::Configuration,
        _ => Code::Data,
    };
    Failure::new(code, error.to_string())
}

/// The logs on one time grid, one after the other.
fn record_of(arguments: &AdoptArguments, mapping: &LogMapping) -> Result<Recording, Failure> {
    let mut recorder = Recorder::default();
    each_sample(&arguments.logs, mapping, "reading", |sample| recorder.take(sample))?;
    let recording = recorder.finish().map_err(|error| Failure::data(error.to_string()))?;
    if recording.beyond > 0 {
        warn(&format!(
            "duty cycle and calibration are of the first {} samples; {} more follow",
            recording.log.len(),
            recording.beyond
        ));
    }
    Ok(recording)
}

/// Step 5: the model; `Trained` where it was trained just now.
fn model(
    arguments: &AdoptArguments,
    folder: &Folder,
    described: Option<&Described>,
) -> Result<(Arc<Model>, Option<Trained>), Failure> {
    if arguments.from == Step::Baseline {
        return Ok((load_model(&folder.path("model.json"))?, None));
    }
    let spec = match described {
        Some(described) => described.adoption.spec.clone(),
        None => folder.read_plant()?,
    };
    let effort = if arguments.quick { QUICK } else { 1.0 };
    let basis = folder.read_basis()?;
    let spec = basis.with_steps_for_all(&spec);
    let settings = basis.settings(&spec, effort);
    let trained =
        with_progress(&spec, &settings, Portions::default()).map_err(|error| training_failure(&error))?;
    folder.write("model.json", &trained.json)?;
    let model = load_model(&folder.path("model.json"))?;
    Ok((model, Some(trained)))
}

fn training_failure(error: &TrainError) -> Failure {
    let help = "without a model, `[monitor] kind = \"relative\"` still says that something has changed";
    Failure::data(format!("no model could be trained for this machine: {error}; {help}"))
}

/// Step 6: the baseline of the logs' cycles.
fn baseline(
    arguments: &AdoptArguments,
    folder: &Folder,
    config: &AxisConfig,
    model: &Arc<Model>,
) -> Result<BaselineFile, Failure> {
    let duty_cycle = DutyCycle { name: None, model: Arc::clone(model) };
    let mut pipeline = Pipeline::new(config.monitor(vec![duty_cycle]))?;
    pipeline.monitors_mut()[0]
        .learn("adoption", MOST_CYCLES)
        .map_err(|error| Failure::new(Code::Configuration, error.to_string()))?;
    each_sample(&arguments.logs, &config.log_mapping(), "learning", |sample| {
        pipeline.push(sample, &mut |_| ());
    })?;
    pipeline.finish(&mut |_| ());
    let monitor = &pipeline.monitors()[0];
    let baseline = match (monitor.baseline(), monitor.learner()) {
        (Some(baseline), _) => Ok(baseline.clone()),
        (None, Some(learner)) => learner.baseline(monitor.model()).map_err(|error| error.to_string()),
        (None, None) => Err("no cycle was read".to_owned()),
    };
    let rejected = pipeline.summary().rejected;
    let baseline = baseline.map_err(|what| {
        let rejected =
            if rejected.is_empty() { String::new() } else { format!(" (rejected: {})", listed(&rejected)) };
        Failure::data(format!(
            "plant and model are in the folder, but no baseline could be learned: {what}{rejected}"
        ))
    })?;
    told::baseline(&baseline, rejected.values().sum());
    let mut file = BaselineFile::new(&config.axis, model);
    file.baselines.push(baseline);
    let json = file.to_json().map_err(|error| Failure::writing(&folder.path("baseline.json"), error))?;
    folder.write("baseline.json", json)?;
    Ok(file)
}
