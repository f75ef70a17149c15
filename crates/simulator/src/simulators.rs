//! Simulators at work: as many as there are threads, warm from run to run, counted, and each run only once.

use std::collections::hash_map::DefaultHasher;
use std::collections::{BTreeMap, HashMap};
use std::hash::{Hash, Hasher};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use seepd_gap::BinnedSignals;
use seepd_gap::record::binned;
use seepd_gap::simulated_axis::EffectValues;
use seepd_signals::Signal;
use seepd_sim::cycle::DriveSample;
use seepd_sim::effects;
use seepd_sim::ports::{PortInput, PortLoop, PortOutput, SteppedPlant};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::child::{ChildError, LineChild};
use crate::demand;
use crate::fmu::{FmuError, UnpackedFmu};
use crate::spec::{Exchange, ProcessSpec, SimulatorSpec};

/// Most answers that are kept, of some 20 KB each.
const MOST_KEPT: usize = 4000;

/// Why a run failed.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RunError {
    /// The program is of no use any more.
    #[error(transparent)]
    Child(#[from] ChildError),
    /// An answer that is none.
    #[error("the simulator's answer is not JSON ({error}): `{line}`")]
    NotJson {
        /// What is wrong.
        error: serde_json::Error,
        /// The answer's beginning.
        line: String,
    },
    /// The simulator says that it cannot.
    #[error("the simulator says: {0}")]
    Refused(String),
    /// The host of an FMU says that it cannot.
    #[error("{0}")]
    Hosted(String),
    /// A signal that it should have answered with.
    #[error("the simulator's answer has no `{0}`")]
    Missing(&'static str),
    /// A signal of another length.
    #[error("the simulator's `{signal}` has {found} values; the run has {expected}")]
    Length {
        /// Signal.
        signal: &'static str,
        /// Its values.
        found: usize,
        /// Ticks of the run.
        expected: usize,
    },
    /// A value that is no number.
    #[error("the simulator's `{signal}` is no number at {at_s:.3} s")]
    NotANumber {
        /// Signal.
        signal: &'static str,
        /// Time in the run, s.
        at_s: f64,
    },
    /// The FMU is of no use.
    #[error(transparent)]
    Fmu(#[from] FmuError),
    /// Nothing to ask.
    #[error("the file names no simulator")]
    None,
}

/// How much may be simulated.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Budget {
    /// Most runs.
    pub runs: Option<usize>,
    /// Longest time.
    pub time: Option<Duration>,
}

/// What was simulated.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RunCounts {
    /// Runs of the simulator.
    pub runs: usize,
    /// Runs that were asked for again and answered from memory.
    pub repeated: usize,
    /// Runs that failed.
    pub failed: usize,
    /// The first failure, in a sentence.
    pub first_failure: Option<String>,
    /// Time in the simulator, all of its processes together, s.
    pub seconds: f64,
}

/// A user's simulators, shared by all machines that are simulated with them.
#[derive(Debug)]
pub struct Simulators {
    folder: PathBuf,
    /// The program and arguments that host an FMU.
    host: Vec<String>,
    unpacked: Mutex<Option<Arc<UnpackedFmu>>>,
    idle: Mutex<Vec<Worker>>,
    answers: Mutex<HashMap<u64, BinnedSignals>>,
    counts: Mutex<RunCounts>,
    begun: AtomicUsize,
    budget: Budget,
    since: Instant,
}

/// One process.
struct Worker {
    child: LineChild,
    time: Duration,
    /// The drive that the host of an FMU has, by its content.
    drive: Option<u64>,
}

impl std::fmt::Debug for Worker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Worker").finish_non_exhaustive()
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Simulators {
    /// Simulators that run in a folder; nothing is started yet. `host` is the program, with its arguments, that calls
    /// [`crate::fmu::serve`].
    #[expect(
        clippy::disallowed_methods,
        reason = "a budget of minutes is of the wall clock; results do not depend on it otherwise"
    )]
    pub fn new(folder: PathBuf, host: Vec<String>, budget: Budget) -> Self {
        Simulators {
            folder,
            host,
            unpacked: Mutex::default(),
            idle: Mutex::default(),
            answers: Mutex::default(),
            counts: Mutex::default(),
            begun: AtomicUsize::new(0),
            budget,
            since: Instant::now(),
        }
    }

    /// What was simulated so far.
    pub fn counts(&self) -> RunCounts {
        locked(&self.counts).clone()
    }

    /// Whether the budget is used up.
    #[expect(clippy::disallowed_methods, reason = "a budget of minutes is of the wall clock")]
    pub fn is_spent(&self) -> bool {
        self.budget.runs.is_some_and(|most| self.begun.load(Ordering::Relaxed) >= most)
            || self.budget.time.is_some_and(|most| self.since.elapsed() >= most)
    }

    /// What a simulator shows along a drive after the first `warm_up` ticks, in bins.
    ///
    /// # Errors
    /// [`RunError`]; it is counted as well.
    pub fn run(
        &self,
        spec: &SimulatorSpec,
        drive: &[DriveSample],
        warm_up: usize,
        signals: &[Signal],
    ) -> Result<BinnedSignals, RunError> {
        let key = content(spec, drive, warm_up, signals);
        if let Some(answer) = locked(&self.answers).get(&key) {
            locked(&self.counts).repeated += 1;
            return Ok(answer.clone());
        }
        self.begun.fetch_add(1, Ordering::Relaxed);
        let (bins, seconds) = self.simulated(spec, drive, warm_up, signals);
        let mut counts = locked(&self.counts);
        counts.runs += 1;
        counts.seconds += seconds;
        if let Err(error) = &bins {
            counts.failed += 1;
            counts.first_failure.get_or_insert_with(|| error.to_string());
        }
        drop(counts);
        let bins = bins?;
        let mut answers = locked(&self.answers);
        if answers.len() < MOST_KEPT {
            answers.insert(key, bins.clone());
        }
        Ok(bins)
    }

    #[expect(clippy::disallowed_methods, reason = "what a run costs is told; nothing else depends on it")]
    fn simulated(
        &self,
        spec: &SimulatorSpec,
        drive: &[DriveSample],
        warm_up: usize,
        signals: &[Signal],
    ) -> (Result<BinnedSignals, RunError>, f64) {
        let begin = Instant::now();
        let result = self.worker(spec).and_then(|mut worker| {
            let result = worker.run(spec, drive, warm_up, signals);
            // A process that has ended or hangs is not asked again.
            if !matches!(result, Err(RunError::Child(_) | RunError::NotJson { .. })) {
                locked(&self.idle).push(worker);
            }
            result
        });
        (result, begin.elapsed().as_secs_f64())
    }

    fn worker(&self, spec: &SimulatorSpec) -> Result<Worker, RunError> {
        if let Some(worker) = locked(&self.idle).pop() {
            return Ok(worker);
        }
        let time = Duration::from_secs_f64(spec.timeout_s());
        if let Some(process) = &spec.process {
            let own = process.folder.as_ref();
            let folder = own.map_or_else(|| self.folder.clone(), |own| self.folder.join(own));
            let child = LineChild::start(&process.command, &folder, &[])?;
            return Ok(Worker { child, time, drive: None });
        }
        let unpacked = self.unpacked(spec)?;
        let child = unpacked.start(spec, time)?;
        Ok(Worker { child, time, drive: None })
    }

    /// The FMU, unpacked once.
    fn unpacked(&self, spec: &SimulatorSpec) -> Result<Arc<UnpackedFmu>, RunError> {
        let mut unpacked = locked(&self.unpacked);
        if let Some(there) = &*unpacked {
            return Ok(Arc::clone(there));
        }
        let fmu = spec.fmu.as_ref().ok_or(RunError::None)?;
        let made = Arc::new(UnpackedFmu::new(&self.folder.join(&fmu.file), &self.host)?);
        *unpacked = Some(Arc::clone(&made));
        Ok(made)
    }
}

/// A key for everything that an answer depends on.
fn content(spec: &SimulatorSpec, drive: &[DriveSample], warm_up: usize, signals: &[Signal]) -> u64 {
    let mut hasher = DefaultHasher::new();
    for (name, parameter) in &spec.parameters {
        (name, parameter.start.to_bits()).hash(&mut hasher);
    }
    for (effect, values) in &spec.with {
        effect.hash(&mut hasher);
        for (name, value) in values {
            (name, value.to_bits()).hash(&mut hasher);
        }
    }
    (content_of(drive), warm_up, signals).hash(&mut hasher);
    hasher.finish()
}

/// A key for a drive.
fn content_of(drive: &[DriveSample]) -> u64 {
    let mut hasher = DefaultHasher::new();
    for sample in drive {
        (sample.demand_m.to_bits(), sample.load_n.to_bits()).hash(&mut hasher);
    }
    hasher.finish()
}

/// What a program is asked with a whole run.
#[derive(Serialize)]
struct RunMessage<'a> {
    period_s: f64,
    parameters: HashMap<&'a str, f64>,
    demand: Vec<f64>,
    load: Vec<f64>,
}

/// What the host of an FMU is asked. It answers with bins: a tenth of the time of a run in C would go into texts of a value a tick.
#[derive(Serialize, Deserialize)]
pub(crate) struct HostedRun {
    pub(crate) parameters: BTreeMap<String, f64>,
    pub(crate) with: EffectValues,
    /// `None`: that of the run before.
    pub(crate) drive: Option<HostedDrive>,
    pub(crate) warm_up: usize,
    pub(crate) signals: Vec<Signal>,
}

/// A drive, tick by tick.
#[derive(Serialize, Deserialize)]
pub(crate) struct HostedDrive {
    /// Time in the duty cycle of the first tick, s.
    pub(crate) start_s: f64,
    pub(crate) demand: Vec<f64>,
    pub(crate) load: Vec<f64>,
}

/// What a program that goes tick by tick is asked.
#[derive(Serialize)]
#[serde(rename_all = "snake_case")]
enum StepMessage<'a> {
    Start { period_s: f64, parameters: HashMap<&'a str, f64>, demand: f64, load: f64 },
    Step { reference: f64, load: f64, dt_s: f64 },
}

/// What the host of an FMU answers.
#[derive(Default, Serialize, Deserialize)]
pub(crate) struct Hosted {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) error: Option<String>,
    #[serde(default)]
    pub(crate) bins: BinnedSignals,
}

#[derive(Deserialize)]
struct Series {
    error: Option<String>,
    #[serde(flatten)]
    signals: HashMap<String, Vec<Option<f64>>>,
}

#[derive(Deserialize)]
struct Values {
    error: Option<String>,
    velocity: Option<f64>,
    #[serde(flatten)]
    signals: HashMap<String, Option<f64>>,
}

impl Worker {
    fn run(
        &mut self,
        spec: &SimulatorSpec,
        drive: &[DriveSample],
        warm_up: usize,
        signals: &[Signal],
    ) -> Result<BinnedSignals, RunError> {
        let series = match &spec.process {
            Some(process) if process.exchange == Exchange::Step => {
                self.tick_by_tick(spec, process, drive, signals)?
            }
            Some(_) => self.whole_run(spec, drive, signals)?,
            None => return self.hosted(spec, drive, warm_up, signals),
        };
        Ok(series.iter().map(|values| binned(&values[warm_up..])).collect())
    }

    fn asked<T: for<'de> Deserialize<'de>>(&mut self, message: &impl Serialize) -> Result<T, RunError> {
        let text = serde_json::to_string(message)
            .map_err(|error| RunError::NotJson { error, line: String::new() })?;
        let line = self.child.ask(text, self.time)?;
        serde_json::from_str(&line)
            .map_err(|error| RunError::NotJson { error, line: line.chars().take(80).collect() })
    }

    fn whole_run(
        &mut self,
        spec: &SimulatorSpec,
        drive: &[DriveSample],
        signals: &[Signal],
    ) -> Result<Vec<Vec<f64>>, RunError> {
        let demand: Vec<f64> = drive.iter().map(|sample| sample.demand_m).collect();
        let message = RunMessage {
            period_s: spec.tick_s(),
            parameters: told(spec),
            demand: demand::reaching(&spec.with, &demand, spec.tick_s()),
            load: drive.iter().map(|sample| sample.load_n).collect(),
        };
        let answer = self.asked(&message)?;
        series_of(answer, spec, drive.len(), signals)
    }

    /// Laws at the ports run in the host of an FMU, and what is seen of a run comes back in bins.
    fn hosted(
        &mut self,
        spec: &SimulatorSpec,
        drive: &[DriveSample],
        warm_up: usize,
        signals: &[Signal],
    ) -> Result<BinnedSignals, RunError> {
        let key = content_of(drive);
        let is_there = self.drive.replace(key) == Some(key);
        let drive = (!is_there).then(|| HostedDrive {
            start_s: drive.first().map_or(0.0, |first| first.at_s),
            demand: drive.iter().map(|sample| sample.demand_m).collect(),
            load: drive.iter().map(|sample| sample.load_n).collect(),
        });
        let message = HostedRun {
            parameters: told(spec).into_iter().map(|(name, value)| (name.to_owned(), value)).collect(),
            with: spec.with.clone(),
            drive,
            warm_up,
            signals: signals.to_vec(),
        };
        let answer: Hosted = self.asked(&message)?;
        match answer.error {
            Some(error) => Err(RunError::Hosted(error)),
            None => Ok(answer.bins),
        }
    }

    fn tick_by_tick(
        &mut self,
        spec: &SimulatorSpec,
        process: &ProcessSpec,
        drive: &[DriveSample],
        signals: &[Signal],
    ) -> Result<Vec<Vec<f64>>, RunError> {
        let around = around(spec);
        let mut series = vec![Vec::with_capacity(drive.len()); signals.len()];
        let mut plant = AskedPlant { worker: self, spec, process };
        around.run(&mut plant, drive, 0, |_, shown| {
            for (signal, values) in signals.iter().zip(&mut series) {
                values.push(shown.get(*signal));
            }
        })?;
        Ok(series)
    }
}

/// An answer's signals, checked.
fn series_of(
    mut answer: Series,
    spec: &SimulatorSpec,
    ticks: usize,
    signals: &[Signal],
) -> Result<Vec<Vec<f64>>, RunError> {
    if let Some(error) = answer.error {
        return Err(RunError::Refused(error));
    }
    let mut series = Vec::with_capacity(signals.len());
    for signal in signals {
        let name = signal.name();
        let values = answer.signals.remove(name).ok_or(RunError::Missing(name))?;
        if values.len() != ticks {
            return Err(RunError::Length { signal: name, found: values.len(), expected: ticks });
        }
        let number = |(tick, value): (usize, Option<f64>)| {
            let at_s = tick as f64 * spec.tick_s();
            value.ok_or(RunError::NotANumber { signal: name, at_s })
        };
        series.push(values.into_iter().enumerate().map(number).collect::<Result<Vec<f64>, RunError>>()?);
    }
    Ok(series)
}

/// The loop around a simulator, with the laws at its ports.
pub(crate) fn around(spec: &SimulatorSpec) -> PortLoop {
    PortLoop::new(spec.controller.as_ref(), spec.tick_s(), |effect| {
        // What is inside does not act at a port as well.
        let given = spec.with.get(effect.key()).filter(|_| !spec.inside.contains_key(effect.key()));
        let value = |name: &str| given.and_then(|values| values.get(name)).copied();
        effect.parameters().iter().map(|p| value(p.name).unwrap_or(p.neutral)).collect()
    })
}

/// The simulator's parameters, with those that are effects.
fn told(spec: &SimulatorSpec) -> HashMap<&str, f64> {
    let calibrated = spec.parameters.iter().map(|(name, parameter)| (name.as_str(), parameter.start));
    let effects = spec.effects.iter().map(|(key, effect)| {
        let given = spec.with.get(key).and_then(|values| values.values().next());
        (effect.parameter.as_str(), given.copied().unwrap_or(effect.neutral))
    });
    let inside = spec.inside.iter().filter_map(|(key, variables)| Some((effects::find(key)?, variables)));
    let inside = inside.flat_map(|(effect, variables)| {
        let given = spec.with.get(effect.key());
        effect.parameters().iter().filter_map(move |parameter| {
            let value = given.and_then(|values| values.get(parameter.name)).copied();
            Some((variables.get(parameter.name)?.as_str(), value.unwrap_or(parameter.neutral)))
        })
    });
    calibrated.chain(effects).chain(inside).collect()
}

/// A program that is asked tick by tick.
struct AskedPlant<'a> {
    worker: &'a mut Worker,
    spec: &'a SimulatorSpec,
    process: &'a ProcessSpec,
}

impl AskedPlant<'_> {
    fn asked(&mut self, message: &StepMessage<'_>) -> Result<PortOutput, RunError> {
        let answer: Values = self.worker.asked(message)?;
        if let Some(error) = answer.error {
            return Err(RunError::Refused(error));
        }
        let mut output = PortOutput::NOTHING;
        output.velocity_m_per_s = answer.velocity.unwrap_or(f64::NAN);
        for name in &self.process.outputs {
            let Some(signal) = Signal::from_name(name) else { continue };
            let value = answer.signals.get(name).ok_or(RunError::Missing(signal.name()))?;
            output.values[signal as usize] =
                value.ok_or(RunError::NotANumber { signal: signal.name(), at_s: f64::NAN })?;
        }
        Ok(output)
    }
}

impl SteppedPlant for AskedPlant<'_> {
    type Error = RunError;

    fn start(&mut self, first: &DriveSample) -> Result<PortOutput, RunError> {
        let (spec, load) = (self.spec, first.load_n);
        let start = StepMessage::Start {
            period_s: spec.tick_s(),
            parameters: told(spec),
            demand: first.demand_m,
            load,
        };
        self.asked(&start)
    }

    fn step(&mut self, input: &PortInput) -> Result<PortOutput, RunError> {
        self.asked(&StepMessage::Step { reference: input.reference, load: input.load_n, dt_s: input.dt_s })
    }
}
