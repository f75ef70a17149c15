//! `plant.toml`: the machine as a file – plant, controller, duty cycle, effects.

use std::collections::BTreeMap;

use seepd_settings::{FormatError, UnknownKey, parse_toml};
use serde::{Deserialize, Serialize};

use crate::controller::{Controller, Pid};
use crate::cycle::{DutyCycle, Move};
use crate::effects::{self, Constants, Effect, Law, Parameter};
use crate::integration::RK4_STABILITY_LIMIT;
use crate::learned;
use crate::plant::{Motion, Plant, PlantParameters};
use crate::real::Real;
use crate::sensor::{self, SensorError};
use crate::size::Size;

/// A plant that asks for more steps in a period has a number that is decades off.
const ABSURD_STEPS: usize = 1_000_000;
/// Keys of the controller's table that say nothing where there is none.
const OF_A_CONTROLLER: [&str; 6] =
    ["kp", "ki", "kd", "velocity_feed_forward_s_per_m", "dead_band_compensation", "integral_window_m"];
/// Share by which a value may be beyond its bound and be meant as at it.
const SAME_BOUND: f64 = 1e-9;
/// Most steps in a period that are taken unasked.
const MOST_STEPS: usize = 250;

/// A machine: the content of `plant.toml`. Every table and key has a default, the nominal plant's.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MachineSpec {
    /// Plant parameters.
    pub plant: PlantParameters,
    /// Controller gains and period.
    pub controller: Controller,
    /// Duty cycle.
    pub cycle: DutyCycle,
    /// Effects by key, each with its parameters by name.
    pub effects: BTreeMap<String, BTreeMap<String, f64>>,
    /// Least and largest value of plant parameters that a diagnosis may calibrate, by key or symbol; absent: its own bounds.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub bounds: BTreeMap<String, [f64; 2]>,
    /// How far the pressure transducers are off in the logs that the machine was fitted to, by signal: predictions show what they show.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub sensors: BTreeMap<String, SensorError>,
}

/// Why a plant file is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SpecError {
    /// Not TOML, a key that does not exist, or a value of the wrong type.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// A value outside of what it may be.
    #[error("{}`{key}` is {}; {expected}", at_line(*.line), readable(*.value))]
    Value {
        /// Line in the file, from 1, where it could be found.
        line: Option<usize>,
        /// Dotted key.
        key: String,
        /// The value that was given.
        value: f64,
        /// What it must be.
        expected: String,
    },
    /// An effect, a parameter of an effect, or a plant parameter in the bounds that does not exist.
    #[error("{}{table}: {unknown}", at_line(*.line))]
    UnknownName {
        /// Line in the file, from 1, where it could be found.
        line: Option<usize>,
        /// Table that names it.
        table: String,
        /// The name, with those that there are.
        #[source]
        unknown: UnknownKey,
    },
    /// The duty cycle has no moves.
    #[error("cycle.moves is empty: a machine that never moves has no duty cycle")]
    NoMoves,
    /// A move of a plant that cannot begin open loop.
    #[error(
        "cycle.moves[{index}].open_loop: {plant} is position controlled all along; leave the table out, or describe the machine as a press"
    )]
    OpenLoop {
        /// Index of the move.
        index: usize,
        /// What cannot.
        plant: &'static str,
    },
    /// The duty cycle is shorter than 20 controller periods.
    #[error(
        "cycle.period_s is {period_s}; it must be 20 controller periods of {controller_period_s} s or more"
    )]
    ShortCycle {
        /// Period of the cycle, s.
        period_s: f64,
        /// Period of the controller, s.
        controller_period_s: f64,
    },
    /// Not an assignment to an effect's parameter.
    #[error("`{0}` is not of the form effect.parameter=value")]
    Assignment(String),
    /// An assignment of something that is no number.
    #[error("`{value}` in `{assignment}` is not a number")]
    NotANumber {
        /// What stands for a number.
        value: String,
        /// The whole assignment.
        assignment: String,
    },
    /// TOML cannot express a value.
    #[error("the plant cannot be written as TOML: {0}")]
    Unwritable(#[from] toml::ser::Error),
    /// The fixed step is too long for the plant.
    #[error(
        "the plant's fastest eigenvalue, {eigenvalue_per_s:.0} 1/s, is unstable at {steps} RK4 steps per period \
         (step · eigenvalue = {product:.2} > {RK4_STABILITY_LIMIT}); set controller.steps_per_period to {needed} or more"
    )]
    UnstableStep {
        /// Fastest eigenvalue at standstill, 1/s.
        eigenvalue_per_s: f64,
        /// Steps in a controller period.
        steps: usize,
        /// Step times eigenvalue.
        product: f64,
        /// Steps that would do.
        needed: usize,
    },
}

fn at_line(line: Option<usize>) -> String {
    line.map_or(String::new(), |line| format!("line {line}: "))
}

/// First line that assigns the key's last part or opens its table.
fn line_of(text: &str, key: &str) -> Option<usize> {
    let name = key.rsplit('.').next().unwrap_or(key);
    text.lines()
        .position(|line| {
            let line = line.trim_start();
            line.strip_prefix(name).is_some_and(|rest| rest.trim_start().starts_with('='))
                || (line.starts_with('[') && line.contains(name))
                || line.contains(&format!("{name} ="))
        })
        .map(|index| index + 1)
}

impl MachineSpec {
    /// Reads and checks the text of a `plant.toml`.
    ///
    /// # Errors
    /// [`SpecError`] naming line and key.
    pub fn from_toml(text: &str) -> Result<Self, SpecError> {
        let spec: MachineSpec = parse_toml(text)?;
        spec.check().map_err(|error| error.located(text))?;
        Ok(spec)
    }

    /// The file's text; every value is written out.
    ///
    /// # Errors
    /// [`SpecError::Unwritable`] where TOML cannot express a value (none of a checked machine's).
    pub fn to_toml(&self) -> Result<String, SpecError> {
        if !self.controller.is_none() {
            return Ok(toml::to_string_pretty(self)?);
        }
        // A machine without a controller has no gains and no duty cycle.
        let mut table = toml::Table::try_from(self)?;
        table.remove("cycle");
        if let Some(toml::Value::Table(controller)) = table.get_mut("controller") {
            OF_A_CONTROLLER.iter().for_each(|key| drop(controller.remove(*key)));
        }
        Ok(toml::to_string_pretty(&table)?)
    }

    /// The effect's parameters in their order; neutral where not given.
    pub fn effect_values(&self, effect: &dyn Effect) -> Vec<f64> {
        let given = self.effects.get(effect.key());
        effect
            .parameters()
            .iter()
            .map(|parameter| given.and_then(|g| g.get(parameter.name)).copied().unwrap_or(parameter.neutral))
            .collect()
    }

    /// The bounds that the file gives for a plant parameter.
    pub fn bounds_of(&self, key: &str) -> Option<(f64, f64)> {
        let symbol = PlantParameters::ALL.iter().find(|info| info.key == key)?.symbol;
        self.bounds.get(key).or_else(|| self.bounds.get(symbol)).map(|[low, high]| (*low, *high))
    }

    fn steps_for(&self, eigenvalue_per_s: f64) -> usize {
        (eigenvalue_per_s * self.controller.period_s / RK4_STABILITY_LIMIT).ceil() as usize
    }

    /// The plant's fastest motion as its effects make it: some stiffen it, some soften it.
    fn motion_with_effects(&self) -> Motion {
        let mut plant = Plant::<f64>::new(&[&self.plant]);
        let mut pid = Pid::new(&[&self.controller]);
        let mut dt = self.controller.period_s;
        let mut corrects_errors = false;
        for law in self.laws() {
            law.adjust(&mut Constants {
                plant: &mut plant,
                pid: &mut pid,
                dt: &mut dt,
                corrects_errors: &mut corrects_errors,
            });
        }
        plant.motion()
    }

    /// The laws of the effects that it has.
    fn laws(&self) -> impl Iterator<Item = Box<dyn Law<f64>>> {
        effects::every()
            .filter(|effect| self.effects.contains_key(effect.key()))
            .filter_map(|effect| f64::law(effect, &self.effect_values(effect)))
    }

    /// The same with the friction at standstill, which damps oscillations there, and not under way.
    pub(crate) fn motion(&self) -> Motion {
        let motion = self.motion_with_effects();
        let friction = effects::friction_at_standstill_n_s_per_m(self);
        if friction == 0.0 {
            return motion;
        }
        let mut standing = self.clone();
        standing.plant.viscous_friction_n_s_per_m += friction;
        let fastest_per_s = standing.motion_with_effects().fastest_per_s.max(motion.fastest_per_s);
        Motion { fastest_per_s, ..motion }
    }

    /// Steps of RK4 in a controller period that keep a plant stable that moves like this: half of the file's where they do.
    pub(crate) fn least_steps(&self, motion: &Motion) -> usize {
        let half = self.controller.steps_per_period.div_ceil(2);
        half.max(self.steps_for(motion.fastest_per_s).min(MOST_STEPS))
    }

    /// Steps in a controller period that laws ask for: half of the file's where one goes by them, all of them where one has states of its
    /// own.
    pub(crate) fn steps_of_laws(&self) -> usize {
        let own = self.controller.steps_per_period;
        let of_law = |law: Box<dyn Law<f64>>| match (law.has_states(), law.goes_by_steps()) {
            (true, _) => own,
            (false, true) => own.div_ceil(2),
            (false, false) => 1,
        };
        self.laws().map(of_law).max().unwrap_or(1)
    }

    /// Steps in a controller period with which plant and effects are stable: the file's, or more where these make the plant stiffer.
    pub fn stable_steps(&self) -> usize {
        let needed = self.steps_for(self.motion_with_effects().fastest_per_s);
        // What went out of bounds stays there whatever the step.
        self.controller.steps_per_period.max(needed.min(MOST_STEPS))
    }

    /// The machine with as many steps as it needs.
    pub fn with_stable_steps(&self) -> Self {
        let mut spec = self.clone();
        spec.controller.steps_per_period = self.stable_steps();
        spec
    }

    /// Sets an effect's parameter given as `effect.parameter=value`, as on the command line.
    ///
    /// ```
    /// use seepd_sim::{MachineSpec, SpecError};
    ///
    /// let mut spec = MachineSpec::default();
    /// spec.set_effect("coulomb_friction.force_n=500")?;
    /// assert_eq!(spec.effects["coulomb_friction"]["force_n"], 500.0);
    ///
    /// let error = spec.set_effect("valve_deadband.half_width=0.5").unwrap_err();
    /// assert!(matches!(error, SpecError::Value { value: 0.5, .. }));
    /// # Ok::<(), SpecError>(())
    /// ```
    ///
    ///
    /// # Errors
    /// [`SpecError`] naming the nearest known effect or parameter, or the admitted range.
    pub fn set_effect(&mut self, assignment: &str) -> Result<(), SpecError> {
        let parts = assignment.split_once('=').and_then(|(path, value)| Some((path.split_once('.')?, value)));
        let Some(((effect, parameter), value)) = parts else {
            return Err(SpecError::Assignment(assignment.to_owned()));
        };
        let value: f64 = value.trim().parse().map_err(|_| SpecError::NotANumber {
            value: value.to_owned(),
            assignment: assignment.to_owned(),
        })?;
        self.effects.entry(effect.trim().into()).or_default().insert(parameter.trim().into(), value);
        let size = Size::of(self);
        self.check_effects(|parameter| size.range_of(parameter))
    }

    /// Checks every value, and that the plant is stable at its step.
    ///
    /// # Errors
    /// [`SpecError`] for the first thing that is wrong.
    pub fn check(&self) -> Result<(), SpecError> {
        self.check_as(Size::of(self))
    }

    /// Checks as [`MachineSpec::check`] does, with the effects' ranges of a machine of that size: of the one whose parameters these vary,
    /// since a size goes by octaves.
    ///
    /// # Errors
    /// [`SpecError`] for the first thing that is wrong.
    pub fn check_as(&self, size: Size) -> Result<(), SpecError> {
        for info in PlantParameters::ALL {
            let value = self.plant.get(info.key).unwrap_or(f64::NAN);
            if !(value.is_finite() && value >= info.minimum) {
                let expected =
                    if info.minimum > 0.0 { "it must be positive" } else { "it must not be negative" };
                return Err(value_error(
                    format!("plant.{}", info.key),
                    value,
                    format!("{expected}, in {}", info.unit),
                ));
            }
        }
        self.check_bounds()?;
        self.check_sensors()?;
        self.check_controller()?;
        if !self.controller.is_none() {
            self.check_cycle()?;
        }
        self.check_effects(|parameter| size.admitted_in_a_file(parameter))?;
        self.check_stability()
    }

    fn check_bounds(&self) -> Result<(), SpecError> {
        for (name, [low, high]) in &self.bounds {
            let Some(info) = PlantParameters::ALL.iter().find(|info| info.key == name || info.symbol == name)
            else {
                let known: Vec<&str> = PlantParameters::ALL.iter().map(|info| info.key).collect();
                return Err(unknown_name("bounds".into(), name, &known));
            };
            in_range(format!("bounds.{name}"), *low, info.minimum, f64::MAX)?;
            in_range(format!("bounds.{name}"), *high, *low, f64::MAX)?;
            let value = self.plant.get(info.key).unwrap_or(f64::NAN);
            // A fit that ends at a bound comes back from its logarithm with a last bit more.
            let (low, high) = (low - low.abs() * SAME_BOUND, high + high.abs() * SAME_BOUND);
            in_range(format!("plant.{}", info.key), value, low, high)?;
        }
        Ok(())
    }

    fn check_sensors(&self) -> Result<(), SpecError> {
        for (name, error) in &self.sensors {
            if !sensor::WITH_ERRORS.contains(&name.as_str()) {
                return Err(unknown_name("sensors".into(), name, &sensor::WITH_ERRORS));
            }
            in_range(format!("sensors.{name}.gain"), error.gain, -0.5, 0.5)?;
            in_range(format!("sensors.{name}.zero"), error.zero, -1e8, 1e8)?;
        }
        Ok(())
    }

    fn check_controller(&self) -> Result<(), SpecError> {
        let c = &self.controller;
        for (key, value, low, high) in [
            ("kp", c.kp, 0.0, 1e6),
            ("ki", c.ki, 0.0, 1e6),
            ("kd", c.kd, 0.0, 1e6),
            ("velocity_feed_forward_s_per_m", c.velocity_feed_forward_s_per_m, 0.0, 1e3),
            ("dead_band_compensation", c.dead_band_compensation, 0.0, 0.5),
            ("integral_window_m", c.integral_window_m, 0.0, 1e3),
            ("period_s", c.period_s, 1e-5, 0.1),
            ("log_every", c.log_every as f64, 1.0, 1000.0),
            ("steps_per_period", c.steps_per_period as f64, 1.0, 1000.0),
        ] {
            in_range(format!("controller.{key}"), value, low, high)?;
        }
        Ok(())
    }

    fn check_cycle(&self) -> Result<(), SpecError> {
        let cycle = &self.cycle;
        in_range("cycle.period_s".into(), cycle.period_s, 0.1, 3600.0)?;
        in_range(
            "cycle.period_s / controller.period_s".into(),
            cycle.period_s / self.controller.period_s,
            20.0,
            1e7,
        )?;
        if cycle.moves.is_empty() {
            return Err(SpecError::NoMoves);
        }
        let mut time = 0.0;
        for (index, stroke) in cycle.moves.iter().enumerate() {
            in_range(format!("cycle.moves[{index}].from_s"), stroke.from_s, time, cycle.period_s)?;
            in_range(
                format!("cycle.moves[{index}].to_s"),
                stroke.to_s,
                stroke.from_s + 1e-3,
                cycle.period_s,
            )?;
            in_range(format!("cycle.moves[{index}].to_m"), stroke.to_m, 0.0, self.plant.stroke_m)?;
            check_course(index, &stroke.course)?;
            check_open_loop(index, stroke)?;
            in_range(format!("cycle.moves[{index}].wait_s"), stroke.wait_s, 0.0, cycle.period_s)?;
            time = stroke.to_s;
        }
        let mut time = 0.0;
        for (index, corner) in cycle.load.iter().enumerate() {
            in_range(format!("cycle.load[{index}].at_s"), corner.at_s, time, cycle.period_s)?;
            in_range(format!("cycle.load[{index}].force_n"), corner.force_n, -1e9, 1e9)?;
            time = corner.at_s;
        }
        Ok(())
    }

    fn check_effects(&self, range_of: impl Fn(&Parameter) -> (f64, f64)) -> Result<(), SpecError> {
        for (key, values) in &self.effects {
            let Some(effect) = effects::every().find(|effect| effect.key() == key) else {
                let known: Vec<&str> = effects::every().map(|effect| effect.key()).collect();
                return Err(unknown_name("effects".into(), key, &known));
            };
            if learned::find(key).is_some() {
                check_ends(key, values)?;
            }
            for (name, value) in values {
                let parameters = effect.parameters();
                let Some(parameter) = parameters.iter().find(|parameter| parameter.name == name) else {
                    let known: Vec<&str> = parameters.iter().map(|parameter| parameter.name).collect();
                    return Err(unknown_name(format!("effects.{key}"), name, &known));
                };
                if *value != parameter.neutral {
                    let (low, high) = range_of(parameter);
                    in_range(format!("effects.{key}.{name}"), *value, low, high)?;
                }
            }
        }
        Ok(())
    }

    /// The complaint of a plant that no step is short enough for: a number is decades off, most likely the one that is furthest from the
    /// nominal plant's.
    fn furthest_from_nominal(&self) -> SpecError {
        let nominal = PlantParameters::default();
        let decades_off = |key: &str| match (self.plant.get(key), nominal.get(key)) {
            (Some(value), Some(usual)) if value > 0.0 && usual > 0.0 => (value / usual).log10().abs(),
            _ => 0.0,
        };
        let key = PlantParameters::ALL
            .iter()
            .map(|info| info.key)
            .max_by(|a, b| decades_off(a).total_cmp(&decades_off(b)))
            .unwrap_or_default();
        let usual = nominal.get(key).unwrap_or(f64::NAN);
        let expected = format!("no step is short enough for such a plant; the nominal press has {usual}");
        value_error(format!("plant.{key}"), self.plant.get(key).unwrap_or(f64::NAN), expected)
    }

    fn check_stability(&self) -> Result<(), SpecError> {
        let eigenvalue_per_s = self.motion_with_effects().fastest_per_s;
        let steps = self.controller.steps_per_period;
        let product = eigenvalue_per_s * self.controller.period_s / steps as f64;
        if product <= RK4_STABILITY_LIMIT {
            return Ok(());
        }
        let needed = self.steps_for(eigenvalue_per_s);
        if needed > ABSURD_STEPS {
            return Err(self.furthest_from_nominal());
        }
        Err(SpecError::UnstableStep { eigenvalue_per_s, steps, product, needed })
    }
}

impl SpecError {
    /// Adds the line in the file's text where the error's key stands.
    fn located(mut self, text: &str) -> Self {
        match &mut self {
            SpecError::Value { line, key, .. } => *line = line_of(text, key),
            SpecError::UnknownName { line, unknown, .. } => *line = line_of(text, &unknown.key),
            _ => {}
        }
        self
    }
}

/// Checks that a learned curve's argument runs upwards.
fn check_ends(key: &str, values: &BTreeMap<String, f64>) -> Result<(), SpecError> {
    let end = |name: &str| values.get(name).copied().unwrap_or(0.0);
    if end("from") < end("to") {
        return Ok(());
    }
    let expected = format!("it must be above `from`, which is {}", readable(end("from")));
    Err(value_error(format!("effects.{key}.to"), end("to"), expected))
}

/// Checks that a move's course leads from its start to its end.
fn check_course(index: usize, course: &[f64]) -> Result<(), SpecError> {
    let key = |at: usize| format!("cycle.moves[{index}].course[{at}]");
    for (at, share) in course.iter().enumerate() {
        in_range(key(at), *share, -0.5, 1.5)?;
    }
    let (Some(first), Some(last)) = (course.first(), course.last()) else { return Ok(()) };
    in_range(key(0), *first, 0.0, 0.0)?;
    in_range(key(course.len() - 1), *last, 1.0, 1.0)
}

/// Most values of a course of the command: with more of them a file is no longer one to read.
const MOST_COMMANDS: usize = 10_000;

/// Checks that an open-loop part lies within its move, with time for position control after it.
fn check_open_loop(index: usize, stroke: &Move) -> Result<(), SpecError> {
    let Some(open) = &stroke.open_loop else { return Ok(()) };
    let key = |name: &str| format!("cycle.moves[{index}].open_loop.{name}");
    in_range(key("to_s"), open.to_s, stroke.from_s + 1e-3, stroke.to_s - 1e-3)?;
    in_range(key("command (its values)"), open.command.len() as f64, 1.0, MOST_COMMANDS as f64)?;
    open.command
        .iter()
        .enumerate()
        .try_for_each(|(at, command)| in_range(key(&format!("command[{at}]")), *command, -1.0, 1.0))
}

/// Refuses moves that begin open loop, for a plant that cannot.
///
/// # Errors
/// [`SpecError::OpenLoop`] for the first such move.
pub fn refuse_open_loop(cycle: &DutyCycle, plant: &'static str) -> Result<(), SpecError> {
    match cycle.moves.iter().position(|stroke| stroke.open_loop.is_some()) {
        Some(index) => Err(SpecError::OpenLoop { index, plant }),
        None => Ok(()),
    }
}

/// A number without a row of noughts.
fn readable(value: f64) -> String {
    if value == 0.0 || (1e-4..1e9).contains(&value.abs()) { value.to_string() } else { format!("{value:e}") }
}

fn value_error(key: String, value: f64, expected: String) -> SpecError {
    SpecError::Value { line: None, key, value, expected }
}

pub(crate) fn unknown_name(table: String, name: &str, known: &[&str]) -> SpecError {
    SpecError::UnknownName { line: None, table, unknown: UnknownKey::new(name, known) }
}

fn in_range(key: String, value: f64, low: f64, high: f64) -> Result<(), SpecError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(value_error(key, value, format!("it must lie in {low} … {high}")))
}
