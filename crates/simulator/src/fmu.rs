//! An FMU as the simulator: unpacked once, and hosted by processes that may die.
//!
//! Whoever hosts one is this very program, started again: [`serve`] loads the model, runs the loop around it tick by tick, and answers each
//! run with one line. What the model prints goes to the standard error, where it cannot spoil an answer.

use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use seepd_fmi::{Causality, Fmu, Instance, InstanceError, ModelDescription};
use seepd_gap::record::binned;
use seepd_sim::cycle::DriveSample;
use seepd_sim::ports::{PortInput, PortOutput, SteppedPlant};
use serde::{Deserialize, Serialize};
use serde_json::json;
use tempfile::TempDir;
use thiserror::Error;

use crate::child::LineChild;
use crate::confinement;
use crate::mapping::{FmuMapping, MappingError, named, remarks};
use crate::simulators::{Hosted, HostedDrive, HostedRun, RunError, around};
use crate::spec::SimulatorSpec;

/// Why an FMU cannot be the simulator.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FmuError {
    /// The file cannot be read.
    #[error("{}: {error}", .file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// Not an FMU that can be used.
    #[error("{}: {error}", .file.display())]
    Archive {
        /// The file.
        file: PathBuf,
        /// Why.
        error: seepd_fmi::FmuError,
    },
    /// The system cannot confine it.
    #[error("{}: an FMU is foreign code and runs on Linux alone, where a process is confined to a folder; name a program of yours instead", .file.display())]
    Unconfined {
        /// The file.
        file: PathBuf,
    },
    /// No place to unpack it.
    #[error("there is no place to unpack the FMU: {0}")]
    Place(std::io::Error),
    /// A name that the model has not, or has as something else.
    #[error(transparent)]
    Mapping(#[from] MappingError),
    /// A value that is no number.
    #[error("the simulator's `{signal}` is no number at {at_s:.3} s")]
    NotANumber {
        /// Signal.
        signal: &'static str,
        /// Time in the run, s.
        at_s: f64,
    },
    /// The model does not run.
    #[error(transparent)]
    Instance(#[from] InstanceError),
}

/// The platform of this program, by its name in FMI 3.
pub fn platform() -> String {
    let system = match std::env::consts::OS {
        "macos" => "darwin",
        other => other,
    };
    format!("{}-{system}", std::env::consts::ARCH)
}

/// Holds a plant file against its FMU, of which nothing is run: variables, units, a binary for this machine. Remarks are what is allowed
/// and should be known.
///
/// # Errors
/// [`FmuError`] for an FMU that `gap` would refuse.
pub fn check(spec: &SimulatorSpec, file: &Path) -> Result<Vec<String>, FmuError> {
    let (fmu, _) = read(file)?;
    FmuMapping::new(spec, &fmu.description)?;
    Ok(remarks(spec, &fmu.description))
}

fn open(file: &Path) -> Result<File, FmuError> {
    File::open(file).map_err(|error| FmuError::File { file: file.to_owned(), error })
}

fn in_archive(file: &Path, error: seepd_fmi::FmuError) -> FmuError {
    FmuError::Archive { file: file.to_owned(), error }
}

/// What an FMU says of itself, and the place in it of its library for this machine.
fn read(file: &Path) -> Result<(Fmu, PathBuf), FmuError> {
    let fmu = Fmu::read(open(file)?).map_err(|error| in_archive(file, error))?;
    let library = fmu.binary(&platform()).map_err(|error| in_archive(file, error))?.into();
    Ok((fmu, library))
}

/// An FMU in a folder of its own, which goes when this does.
#[derive(Debug)]
pub(crate) struct UnpackedFmu {
    folder: TempDir,
    library: PathBuf,
    host: Vec<String>,
}

impl UnpackedFmu {
    /// Reads and unpacks an FMU; nothing of it is loaded.
    pub(crate) fn new(file: &Path, host: &[String]) -> Result<Self, FmuError> {
        let (_, library) = read(file)?;
        if !confinement::IS_KNOWN {
            return Err(FmuError::Unconfined { file: file.to_owned() });
        }
        let folder = tempfile::Builder::new().prefix("seepd-fmu-").tempdir().map_err(FmuError::Place)?;
        Fmu::unpack(open(file)?, folder.path()).map_err(|error| in_archive(file, error))?;
        Ok(UnpackedFmu { library: folder.path().join(library), host: host.to_vec(), folder })
    }

    /// Starts a host of it.
    pub(crate) fn start(&self, spec: &SimulatorSpec, time: Duration) -> Result<LineChild, RunError> {
        let beside = self.library.parent().unwrap_or(Path::new("/"));
        let mut variables = vec![
            ("LD_LIBRARY_PATH", beside.display().to_string()),
            ("TMPDIR", self.folder.path().display().to_string()),
        ];
        if let Some(fmu) = spec.fmu.as_ref().filter(|fmu| !fmu.preload.is_empty()) {
            variables.push(("LD_PRELOAD", fmu.preload.join(":")));
        }
        let mut child = LineChild::start(&self.host, self.folder.path(), &variables)?;
        let model = HostedModel {
            folder: self.folder.path().to_owned(),
            library: self.library.clone(),
            spec: spec.clone(),
        };
        let text = serde_json::to_string(&model)
            .map_err(|error| RunError::NotJson { error, line: String::new() })?;
        let line = child.ask(text, time)?;
        let answer: Ready = serde_json::from_str(&line)
            .map_err(|error| RunError::NotJson { error, line: line.chars().take(80).collect() })?;
        answer.error.map_or(Ok(child), |error| Err(RunError::Hosted(error)))
    }
}

/// The first line that a host is sent.
#[derive(Serialize, Deserialize)]
struct HostedModel {
    folder: PathBuf,
    library: PathBuf,
    spec: SimulatorSpec,
}

#[derive(Deserialize)]
struct Ready {
    error: Option<String>,
}

/// Hosts an FMU: answers lines of the standard input on the standard output until there are no more.
///
/// # Errors
/// An I/O error of these two.
pub fn serve() -> std::io::Result<()> {
    let mut answers = confinement::begin()?;
    let mut lines = BufReader::new(std::io::stdin()).lines();
    let Some(first) = lines.next() else { return Ok(()) };
    let hosted = serde_json::from_str::<HostedModel>(&first?).map_err(std::io::Error::other)?;
    confinement::close(&hosted.folder);
    let mut model = match HostedFmu::new(&hosted) {
        Ok(model) => model,
        Err(error) => {
            let told = format!("{error}{}", advice(&error));
            return writeln!(answers, "{}", json!({ "error": told }));
        }
    };
    writeln!(answers, "{}", json!({}))?;
    for line in lines {
        let asked = serde_json::from_str::<HostedRun>(&line?).map_err(std::io::Error::other)?;
        let answer = model
            .run(&hosted.spec, asked)
            .unwrap_or_else(|error| Hosted { error: Some(error.to_string()), ..Hosted::default() });
        let mut text = serde_json::to_string(&answer).map_err(std::io::Error::other)?;
        text.push('\n');
        answers.write_all(text.as_bytes())?;
    }
    Ok(())
}

/// What to do about a library that cannot be loaded, where that is known: models made of Python have its symbols, and not its library.
fn advice(error: &FmuError) -> &'static str {
    let FmuError::Instance(InstanceError::Load { reason, .. }) = error else { return "" };
    let is_python = reason.split_once("undefined symbol: ").is_some_and(|(_, symbol)| symbol.contains("Py"));
    if is_python {
        "; name Python's library: fmu.preload = [\"libpython3.11.so.1.0\"] for Python 3.11"
    } else {
        ""
    }
}

/// A loaded model with its variables.
struct HostedFmu {
    instance: Instance,
    remake: (PathBuf, PathBuf),
    description: ModelDescription,
    mapping: FmuMapping,
    now_s: f64,
    fresh: bool,
    parameters: Vec<(u32, f64)>,
    latency: usize,
    /// What the model was last asked to follow.
    drive: Vec<DriveSample>,
}

#[expect(unsafe_code, reason = "foreign code is what this process is for; it is confined and may die")]
fn instance(
    folder: &Path,
    library: &Path,
    description: &ModelDescription,
) -> Result<Instance, InstanceError> {
    // SAFETY: nothing can promise what foreign code does; `serve` has given it a process with limits.
    unsafe { Instance::new(folder, library, description) }
}

impl HostedFmu {
    fn new(hosted: &HostedModel) -> Result<Self, FmuError> {
        let (folder, spec) = (&hosted.folder, &hosted.spec);
        let file = folder.join("modelDescription.xml");
        let text =
            std::fs::read_to_string(&file).map_err(|error| FmuError::File { file: file.clone(), error })?;
        let description = ModelDescription::parse(&text)
            .map_err(|error| FmuError::Archive { file, error: seepd_fmi::FmuError::Description(error) })?;
        let mapping = FmuMapping::new(spec, &description)?;
        let mut hosted = HostedFmu {
            instance: instance(folder, &hosted.library, &description)?,
            remake: (folder.clone(), hosted.library.clone()),
            mapping,
            now_s: 0.0,
            fresh: true,
            parameters: Vec::new(),
            latency: 0,
            drive: Vec::new(),
            description,
        };
        hosted.latency = hosted.measured_latency(spec)?;
        Ok(hosted)
    }

    /// Steps by which the model's answer to its input comes later than that of the step that had it: tools may put a step of delay between.
    fn measured_latency(&mut self, spec: &SimulatorSpec) -> Result<usize, FmuError> {
        let at = spec.cycle.demand_m(0.0);
        let still = if spec.controller.is_some() { 0.0 } else { at };
        let drive = DriveSample::new(0.0, at, 0.0);
        let mut answers = Vec::new();
        for pulse in [0.0, PULSE] {
            self.start(&drive)?;
            let mut shown = Vec::new();
            for step in 0..MOST_LATENCY {
                let reference = still + if step == 0 { pulse } else { 0.0 };
                let output = self.step(&PortInput { reference, load_n: 0.0, dt_s: spec.tick_s() })?;
                shown.push(output);
            }
            answers.push(shown);
        }
        let differs = |step: &usize| {
            let [still, pulsed] = [0, 1].map(|run| answers[run][*step]);
            still.values.iter().zip(pulsed.values).any(|(a, b)| a.to_bits() != b.to_bits())
        };
        Ok((0..MOST_LATENCY).find(differs).unwrap_or(0))
    }

    fn run(&mut self, spec: &SimulatorSpec, asked: HostedRun) -> Result<Hosted, FmuError> {
        let mut machine = spec.clone();
        machine.with = asked.with;
        self.parameters.clear();
        for (name, value) in &asked.parameters {
            let found = named(&self.description, "parameters", name, Causality::Parameter)?;
            self.parameters.push((found.reference, *value));
        }
        let period_s = machine.tick_s();
        if let Some(drive) = asked.drive {
            self.drive = samples(&drive, period_s);
        }
        let drive = std::mem::take(&mut self.drive);
        let mut series = vec![Vec::with_capacity(drive.len()); asked.signals.len()];
        let latency = if machine.controller.is_none() { self.latency } else { 0 };
        let ran = around(&machine).run(self, &drive, latency, |_, shown| {
            for (signal, values) in asked.signals.iter().zip(&mut series) {
                values.push(shown.get(*signal));
            }
        });
        self.drive = drive;
        ran?;
        for (signal, values) in asked.signals.iter().zip(&series) {
            if let Some(tick) = values.iter().position(|value| !value.is_finite()) {
                let at_s = tick as f64 * period_s;
                return Err(FmuError::NotANumber { signal: signal.name(), at_s });
            }
        }
        let seen = |values: &Vec<f64>| binned(values.get(asked.warm_up..).unwrap_or_default());
        Ok(Hosted { error: None, bins: series.iter().map(seen).collect() })
    }

    fn shown(&mut self) -> Result<PortOutput, FmuError> {
        let references: Vec<u32> = self.mapping.outputs.iter().map(|(_, mapped)| mapped.reference).collect();
        let mut values = vec![f64::NAN; references.len()];
        self.instance.get(&references, &mut values)?;
        let mut output = PortOutput::NOTHING;
        for ((signal, mapped), value) in self.mapping.outputs.iter().zip(values) {
            match signal {
                Some(signal) => output.values[*signal as usize] = mapped.ours(value),
                None => output.velocity_m_per_s = mapped.ours(value),
            }
        }
        Ok(output)
    }
}

/// A drive's ticks, with the load linear between them; their time runs on over the end of the cycle that they began in.
fn samples(drive: &HostedDrive, period_s: f64) -> Vec<DriveSample> {
    let ends = drive.load.iter().skip(1).chain(drive.load.last());
    let ticks = drive.demand.iter().zip(&drive.load).zip(ends).enumerate();
    ticks
        .map(|(tick, ((demand_m, load_n), load_end_n))| DriveSample {
            load_end_n: *load_end_n,
            ..DriveSample::new(drive.start_s + tick as f64 * period_s, *demand_m, *load_n)
        })
        .collect()
}

/// Steps in which an answer is looked for, and the pulse that asks for it.
const MOST_LATENCY: usize = 4;
const PULSE: f64 = 0.01;

impl SteppedPlant for HostedFmu {
    type Error = FmuError;

    fn start(&mut self, first: &DriveSample) -> Result<PortOutput, FmuError> {
        if !self.fresh && self.instance.reset().is_err() {
            // Many models cannot be reset: another instance does as well.
            self.instance = instance(&self.remake.0, &self.remake.1, &self.description)?;
        }
        (self.fresh, self.now_s) = (false, 0.0);
        for (reference, value) in self.mapping.set.iter().chain(&self.parameters) {
            self.instance.set(&[*reference], &[*value])?;
        }
        let FmuMapping { start_position, start_time, .. } = &self.mapping;
        for (place, value) in [(start_position, first.demand_m), (start_time, first.at_s)] {
            if let Some(place) = place {
                self.instance.set(&[place.reference], &[place.its(value)])?;
            }
        }
        self.instance.enter_initialization()?;
        if let Some(load) = &self.mapping.load {
            self.instance.set(&[load.reference], &[load.its(first.load_n)])?;
        }
        self.instance.exit_initialization()?;
        self.shown()
    }

    fn step(&mut self, input: &PortInput) -> Result<PortOutput, FmuError> {
        let reference = &self.mapping.reference;
        self.instance.set(&[reference.reference], &[reference.its(input.reference)])?;
        if let Some(load) = &self.mapping.load {
            self.instance.set(&[load.reference], &[load.its(input.load_n)])?;
        }
        self.instance.step(self.now_s, input.dt_s)?;
        self.now_s += input.dt_s;
        self.shown()
    }
}
