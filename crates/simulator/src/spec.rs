//! The file that describes a user's simulator: what it is, what it is asked, what may be calibrated, and the duty cycle.

use std::collections::BTreeMap;
use std::path::PathBuf;

use seepd_gap::simulated_axis::EffectValues;
use seepd_settings::{FormatError, UnknownKey, parse_toml};
use seepd_signals::Signal;
use seepd_sim::ports::{Port, port_of};
use seepd_sim::{Controller, DutyCycle, effects};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::demand;

/// A user's simulator: the content of a plant file with `kind = "simulator"`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatorSpec {
    /// `simulator`.
    pub kind: Kind,
    /// Length of a tick of the controller, s; with a `[controller]` it is that one's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub period_s: Option<f64>,
    /// What the axis can travel, m.
    pub stroke_m: f64,
    /// The drive's largest force, N: ranges of forces go with it.
    #[serde(default = "nominal_force_n")]
    pub full_force_n: f64,
    /// A program that is asked on its standard input.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub process: Option<ProcessSpec>,
    /// An FMU for co-simulation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fmu: Option<FmuSpec>,
    /// Parameters that calibration may change, by the simulator's names.
    #[serde(default)]
    pub parameters: BTreeMap<String, ParameterSpec>,
    /// Effects that are parameters of the simulator.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub effects: BTreeMap<String, OwnEffectSpec>,
    /// Effects of the catalogue that the simulator has inside: its parameter for each of an effect's.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub inside: BTreeMap<String, BTreeMap<String, String>>,
    /// Values of effects at the simulator's ports, inside of it, and of its own.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub with: EffectValues,
    /// The controller, where the simulator has none inside.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub controller: Option<Controller>,
    /// The duty cycle.
    pub cycle: DutyCycle,
}

/// The kind of plant file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A user's simulator.
    Simulator,
}

/// A program that speaks JSON lines.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProcessSpec {
    /// Program and arguments.
    pub command: Vec<String>,
    /// What a message is.
    #[serde(default)]
    pub exchange: Exchange,
    /// Signals that it answers with.
    #[serde(default = "command_and_position")]
    pub outputs: Vec<String>,
    /// Whether it takes a load.
    #[serde(default = "yes")]
    pub load: bool,
    /// Longest time for an answer, s.
    #[serde(default = "a_minute")]
    pub timeout_s: f64,
    /// Folder in which it runs; the plant file's where none is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
}

/// An FMU, and which of its variables are which signals. Values of variables are in their own units, SI where none is stated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FmuSpec {
    /// The file; relative to the plant file.
    pub file: PathBuf,
    /// Inputs by our names: `command` (or `demand`, with the controller inside of the model) and `load`.
    pub inputs: BTreeMap<String, FmuVariable>,
    /// Outputs by our names: signals, and `velocity`.
    pub outputs: BTreeMap<String, FmuVariable>,
    /// Start values of further variables.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub set: BTreeMap<String, f64>,
    /// The parameter that is the position at the start, m, if it has one: a run begins where its drive does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_position: Option<String>,
    /// The parameter that is the time in the duty cycle at the start, s, if it has one: for what happens at a time of the cycle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_time: Option<String>,
    /// Libraries that are loaded before the model's, such as `libpython3.11.so.1.0`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub preload: Vec<String>,
    /// Longest time for a run, s.
    #[serde(default = "a_minute")]
    pub timeout_s: f64,
}

/// A variable of an FMU.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum FmuVariable {
    /// By its name.
    Name(String),
    /// With a factor from its value in SI to ours, such as −1 for a load that is positive in the retracting direction.
    Scaled {
        /// Its name.
        variable: String,
        /// Ours over its.
        scale: f64,
    },
}

impl FmuVariable {
    /// Its name.
    pub fn name(&self) -> &str {
        match self {
            FmuVariable::Name(name) | FmuVariable::Scaled { variable: name, .. } => name,
        }
    }

    /// Ours over its value in SI.
    pub fn scale(&self) -> f64 {
        match self {
            FmuVariable::Name(_) => 1.0,
            FmuVariable::Scaled { scale, .. } => *scale,
        }
    }
}

/// What a message to a program is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Exchange {
    /// A whole run.
    #[default]
    Run,
    /// A tick.
    Step,
}

/// A parameter that calibration may change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ParameterSpec {
    /// Its value in the simulator.
    pub start: f64,
    /// Least and largest value; a quarter and four times the start where none are given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bounds: Option<[f64; 2]>,
    /// How well it is known: standard deviation of its logarithm, or in its own unit where its bounds are not both positive.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma: Option<f64>,
    /// A change that is small, in its own unit, for a parameter whose bounds are not both positive; a fifth of what lies between them where
    /// none is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<f64>,
    /// Whether logs hardly tell it: no effect is then called for it, and a calibration leaves it.
    #[serde(default, skip_serializing_if = "is_not")]
    pub hardly_told: bool,
    /// Symbol in reports; the name where none is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub symbol: Option<String>,
    /// Whether wear changes it: it is then fitted in every machine, and no gap.
    #[serde(default, skip_serializing_if = "is_not")]
    pub wear: bool,
}

/// An effect that is a parameter of the simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OwnEffectSpec {
    /// The simulator's parameter.
    pub parameter: String,
    /// Its value without the effect.
    pub neutral: f64,
    /// Least and largest value.
    pub range: [f64; 2],
    /// Its unit.
    #[serde(default = "one")]
    pub unit: String,
    /// What the effect is, in a sentence.
    #[serde(default)]
    pub law: String,
}

fn nominal_force_n() -> f64 {
    NOMINAL_FORCE_N
}

/// Force of the piston for which the catalogue of effects states its ranges, N: that of the nominal press at 16 MPa.
pub const NOMINAL_FORCE_N: f64 = 50e3;
/// Stroke for which the catalogue states its ranges, m.
pub const NOMINAL_STROKE_M: f64 = 0.5;

fn command_and_position() -> Vec<String> {
    vec!["command".into(), "position".into()]
}

fn yes() -> bool {
    true
}

fn is_not(value: &bool) -> bool {
    !value
}

fn a_minute() -> f64 {
    60.0
}

fn one() -> String {
    "1".into()
}

/// Why a file is refused.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum SimulatorError {
    /// Not TOML, a key that does not exist, or a value of the wrong type.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// A value outside of what it may be.
    #[error("`{key}` is {value}; {expected}")]
    Value {
        /// Dotted key.
        key: String,
        /// The value that was given.
        value: f64,
        /// What it must be.
        expected: &'static str,
    },
    /// A name that does not exist.
    #[error("`{table}`: {unknown}")]
    UnknownName {
        /// Dotted key of the table.
        table: String,
        /// The name, with those that there are.
        #[source]
        unknown: UnknownKey,
    },
    /// A key that is missing.
    #[error("`{table}` has no `{key}`")]
    Missing {
        /// Dotted key of the table.
        table: String,
        /// The key.
        key: &'static str,
    },
    /// A table or key that is missing, or that does not go with another.
    #[error("{0}")]
    Combination(&'static str),
    /// A parameter that stands twice.
    #[error("parameter `{0}` is calibrated and an effect's: leave it out of [parameters]")]
    Twice(String),
    /// TOML cannot express a value.
    #[error("the simulator's file cannot be written as TOML: {0}")]
    Unwritable(String),
}

impl SimulatorSpec {
    /// Reads and checks the text of a file.
    ///
    /// # Errors
    /// [`SimulatorError`] naming the key.
    pub fn from_toml(text: &str) -> Result<Self, SimulatorError> {
        let spec: SimulatorSpec = parse_toml(text)?;
        spec.check()?;
        Ok(spec)
    }

    /// The file's text.
    ///
    /// # Errors
    /// [`SimulatorError::Unwritable`] where TOML cannot express a value (none of a checked file's).
    pub fn to_toml(&self) -> Result<String, SimulatorError> {
        toml::to_string_pretty(self).map_err(|error| SimulatorError::Unwritable(error.to_string()))
    }

    /// Whether a plant file is of this kind.
    pub fn is_kind(text: &str) -> bool {
        let kind = text.lines().filter_map(|line| line.split_once('=')).find(|(key, _)| key.trim() == "kind");
        kind.is_some_and(|(_, value)| value.trim().trim_matches('"').starts_with("simulator"))
    }

    /// Length of a tick, s.
    pub fn tick_s(&self) -> f64 {
        let controllers = self.controller.as_ref().map(|controller| controller.period_s);
        controllers.or(self.period_s).unwrap_or(1e-3)
    }

    /// Signals that are compared, command and position first.
    pub fn signals(&self) -> Vec<Signal> {
        let of_process = self.process.iter().flat_map(|process| &process.outputs);
        let outputs = of_process.chain(self.fmu.iter().flat_map(|fmu| fmu.outputs.keys()));
        let mut signals: Vec<Signal> = outputs.filter_map(|name| Signal::from_name(name)).collect();
        if self.controller.is_some() {
            signals.push(Signal::Command);
        }
        signals.sort_by_key(|signal| match signal {
            Signal::Command => 0,
            Signal::Position => 1,
            other => 2 + *other as usize,
        });
        signals.dedup();
        signals
    }

    /// Whether the simulator goes tick by tick, so that something outside of it can answer to what it shows.
    pub fn is_stepped(&self) -> bool {
        self.fmu.is_some() || self.process.as_ref().is_some_and(|process| process.exchange == Exchange::Step)
    }

    /// Whether it takes a load.
    fn takes_load(&self) -> bool {
        self.fmu.as_ref().is_some_and(|fmu| fmu.inputs.contains_key("load"))
            || self.process.as_ref().is_some_and(|process| process.load)
    }

    /// Longest time for an answer, s.
    pub fn timeout_s(&self) -> f64 {
        let of_fmu = self.fmu.as_ref().map(|fmu| fmu.timeout_s);
        of_fmu.or(self.process.as_ref().map(|process| process.timeout_s)).unwrap_or_else(a_minute)
    }

    /// Whether a port is there.
    pub fn has(&self, port: Port) -> bool {
        match port {
            Port::Command | Port::Controller => self.controller.is_some(),
            Port::Position => self.is_stepped(),
            Port::Load => self.is_stepped() && self.takes_load(),
        }
    }

    /// What could not be tried for want of a port, with what the port asks for.
    pub fn without_port(&self) -> Vec<(Port, Vec<&'static str>)> {
        let ports = [Port::Command, Port::Controller, Port::Position, Port::Load];
        let missing = ports.into_iter().filter(|port| !self.has(*port));
        let at = |port: Port| {
            let keys = effects::ALL.iter().map(|effect| effect.key());
            let elsewhere = |key: &&str| port_of(key) == Some(port) && !self.inside.contains_key(*key);
            (port, keys.filter(elsewhere).collect())
        };
        missing.map(at).filter(|(_, effects): &(_, Vec<_>)| !effects.is_empty()).collect()
    }

    fn check(&self) -> Result<(), SimulatorError> {
        let positive = "it must be positive";
        let mut numbers = vec![
            ("stroke_m", self.stroke_m),
            ("full_force_n", self.full_force_n),
            ("cycle.period_s", self.cycle.period_s),
        ];
        numbers.extend(self.period_s.map(|value| ("period_s", value)));
        numbers.extend(self.controller.as_ref().map(|c| ("controller.period_s", c.period_s)));
        numbers.extend(self.process.as_ref().map(|p| ("process.timeout_s", p.timeout_s)));
        numbers.extend(self.fmu.as_ref().map(|fmu| ("fmu.timeout_s", fmu.timeout_s)));
        for (key, value) in numbers {
            if !(value.is_finite() && value > 0.0) {
                return Err(SimulatorError::Value { key: key.into(), value, expected: positive });
            }
        }
        if self.cycle.period_s < 20.0 * self.tick_s() {
            let expected = "a duty cycle has 20 ticks or more";
            return Err(SimulatorError::Value {
                key: "cycle.period_s".into(),
                value: self.cycle.period_s,
                expected,
            });
        }
        if self.cycle.moves.is_empty() {
            return Err(SimulatorError::Combination(
                "cycle.moves is empty: a machine that never moves has no duty cycle",
            ));
        }
        if self.cycle.has_open_loop() {
            return Err(SimulatorError::Combination(
                "cycle.moves has an `open_loop`: a simulator of yours is position controlled all along; leave the table out",
            ));
        }
        self.check_simulator()?;
        self.check_inside()?;
        for (name, parameter) in &self.parameters {
            parameter.check(name)?;
        }
        for (name, effect) in &self.effects {
            effect.check(name)?;
            if self.parameters.contains_key(&effect.parameter) {
                return Err(SimulatorError::Twice(effect.parameter.clone()));
            }
        }
        for name in self.with.keys() {
            if !self.effects.contains_key(name)
                && effects::find(name).is_none()
                && demand::find(name).is_none()
            {
                let known: Vec<&str> = self.effects.keys().map(String::as_str).collect();
                return Err(SimulatorError::UnknownName {
                    table: "with".into(),
                    unknown: UnknownKey::new(name, &known),
                });
            }
        }
        Ok(())
    }

    /// Effects inside are the catalogue's, with all of their parameters but those that have a usual value: what a simulator lacks of these
    /// stays at it.
    fn check_inside(&self) -> Result<(), SimulatorError> {
        for (name, variables) in &self.inside {
            let Some(effect) = effects::find(name) else {
                let known: Vec<&str> = effects::ALL.iter().map(|effect| effect.key()).collect();
                return Err(SimulatorError::UnknownName {
                    table: "inside".into(),
                    unknown: UnknownKey::new(name, &known),
                });
            };
            let known: Vec<&str> = effect.parameters().iter().map(|parameter| parameter.name).collect();
            known_names(&format!("inside.{name}"), variables.keys(), &known)?;
            let needed = effect.parameters().iter().filter(|parameter| parameter.neutral == 0.0);
            if let Some(missing) = needed.map(|of| of.name).find(|name| !variables.contains_key(*name)) {
                return Err(SimulatorError::Missing { table: format!("inside.{name}"), key: missing });
            }
            if let Some(twice) = variables.values().find(|variable| self.parameters.contains_key(*variable)) {
                return Err(SimulatorError::Twice(twice.clone()));
            }
        }
        Ok(())
    }

    fn check_simulator(&self) -> Result<(), SimulatorError> {
        if self.controller.is_none() && self.period_s.is_none() {
            return Err(SimulatorError::Combination(
                "without [controller] the file says how long a tick is: period_s = 0.001, for instance",
            ));
        }
        match (&self.process, &self.fmu) {
            (Some(process), None) => self.check_process(process),
            (None, Some(fmu)) => self.check_fmu(fmu),
            (None, None) => Err(SimulatorError::Combination(
                "there is no simulator: [process] names a program that is asked, [fmu] an FMU",
            )),
            (Some(_), Some(_)) => {
                Err(SimulatorError::Combination("there are two simulators: keep either [process] or [fmu]"))
            }
        }
    }

    fn check_fmu(&self, fmu: &FmuSpec) -> Result<(), SimulatorError> {
        let reference = self.reference();
        if !fmu.inputs.contains_key(reference) {
            return Err(SimulatorError::Combination(match self.controller {
                Some(_) => "fmu.inputs has no command: with a [controller] the model takes its command",
                None => "fmu.inputs has no demand: without [controller] the model takes the demand",
            }));
        }
        known_names("fmu.inputs", fmu.inputs.keys(), &[reference, "load"])?;
        let mut outputs: Vec<&str> = Signal::ALL.iter().map(|signal| signal.name()).collect();
        outputs.push(VELOCITY);
        known_names("fmu.outputs", fmu.outputs.keys(), &outputs)?;
        if !fmu.outputs.contains_key(Signal::Position.name()) {
            return Err(SimulatorError::Combination("fmu.outputs has no position"));
        }
        Ok(())
    }

    /// What the simulator is driven by: its command, or the demand where it has the controller inside.
    pub fn reference(&self) -> &'static str {
        let signal = if self.controller.is_some() { Signal::Command } else { Signal::Demand };
        signal.name()
    }

    fn check_process(&self, process: &ProcessSpec) -> Result<(), SimulatorError> {
        if process.command.first().is_none_or(String::is_empty) {
            return Err(SimulatorError::Combination("process.command is empty: name program and arguments"));
        }
        if self.controller.is_some() && process.exchange == Exchange::Run {
            return Err(SimulatorError::Combination(
                "a [controller] outside of the simulator needs it tick by tick: set process.exchange = \"step\"",
            ));
        }
        let signals: Vec<&str> = Signal::ALL.iter().map(|signal| signal.name()).collect();
        known_names("process.outputs", process.outputs.iter(), &signals)?;
        if !process.outputs.iter().any(|name| name == Signal::Position.name()) {
            return Err(SimulatorError::Combination("process.outputs has no position"));
        }
        Ok(())
    }
}

/// The output that is a velocity, m/s, and no signal of a log.
pub const VELOCITY: &str = "velocity";

fn known_names<'n>(
    table: &str,
    names: impl Iterator<Item = &'n String>,
    known: &[&str],
) -> Result<(), SimulatorError> {
    for name in names {
        if !known.contains(&name.as_str()) {
            let unknown = UnknownKey::new(name, known);
            return Err(SimulatorError::UnknownName { table: table.into(), unknown });
        }
    }
    Ok(())
}

impl ParameterSpec {
    /// Least and largest value.
    pub fn bounds(&self) -> (f64, f64) {
        match self.bounds {
            Some([low, high]) => (low, high),
            None => (self.start / 4.0, self.start * 4.0),
        }
    }

    fn check(&self, name: &str) -> Result<(), SimulatorError> {
        let refused = |key: &str, value, expected| {
            Err(SimulatorError::Value { key: format!("parameters.{name}.{key}"), value, expected })
        };
        let (low, high) = self.bounds();
        if !self.start.is_finite() {
            return refused("start", self.start, "it must be a number");
        }
        if self.bounds.is_none() && self.start <= 0.0 {
            return refused("start", self.start, "a parameter that is not positive needs bounds");
        }
        if !(low.is_finite() && high.is_finite() && low < high) {
            return refused("bounds", low, "bounds are two numbers, the smaller one first");
        }
        if !(low..=high).contains(&self.start) {
            return refused("start", self.start, "it must lie within its bounds");
        }
        for (key, value) in [("sigma", self.sigma), ("unit", self.unit)] {
            if let Some(value) = value.filter(|value| !(value.is_finite() && *value > 0.0)) {
                return refused(key, value, "it must be positive");
            }
        }
        Ok(())
    }
}

impl OwnEffectSpec {
    fn check(&self, name: &str) -> Result<(), SimulatorError> {
        let [low, high] = self.range;
        let refused = |key: &str, value, expected| {
            Err(SimulatorError::Value { key: format!("effects.{name}.{key}"), value, expected })
        };
        if !(low.is_finite() && high.is_finite() && low < high) {
            return refused("range", low, "a range is two numbers, the smaller one first");
        }
        if !self.neutral.is_finite() {
            return refused("neutral", self.neutral, "it must be a number");
        }
        if effects::find(name).is_some() || demand::find(name).is_some() {
            return Err(SimulatorError::Combination(
                "an effect of your own may not have the name of one of the catalogue",
            ));
        }
        Ok(())
    }
}
