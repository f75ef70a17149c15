//! A second, small plant: an electric positioning axis – drive and screw push a mass on a guide, a proportional position loop around a
//! proportional velocity loop commands the drive.
//!
//! ```text
//! M dv/dt = F_max u − F_v v − effects          u = clamp(k_v (k_p (x_demand − x) − v), −1, 1)
//! ```
//!
//! `u`, the drive's command, is a share of full command; the mapping scales volts. Semi-implicit steps: friction near standstill is stiff.

use std::collections::BTreeMap;

use seepd_settings::parse_toml;
use serde::{Deserialize, Serialize};

use crate::cycle::{DriveSample, DutyCycle};
use crate::effects::{EffectInfo, Equation, Parameter};
use crate::spec::{SpecError, refuse_open_loop, unknown_name};

/// The machine: the content of a plant file with `kind = "electric_axis"`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ElectricAxis {
    /// `electric_axis`.
    pub kind: Kind,
    /// Plant parameters.
    pub plant: ElectricPlant,
    /// Controller gains and period.
    pub controller: Cascade,
    /// Duty cycle.
    pub cycle: DutyCycle,
    /// Effects by key, each with its parameters by name.
    #[serde(default)]
    pub effects: BTreeMap<String, BTreeMap<String, f64>>,
}

/// The kind of plant file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// An electric positioning axis.
    ElectricAxis,
}

/// Parameters of mass, guide and drive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ElectricPlant {
    /// Moved mass with the drive's inertia, kg.
    pub mass_kg: f64,
    /// Viscous friction, N s/m.
    pub viscous_friction_n_s_per_m: f64,
    /// Force at full command, N.
    pub full_force_n: f64,
    /// Stroke, m.
    pub stroke_m: f64,
}

/// The cascaded controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cascade {
    /// Gain of the position loop, 1/s.
    pub position_gain_per_s: f64,
    /// Gain of the velocity loop, full command a m/s.
    pub velocity_gain_s_per_m: f64,
    /// Period, s.
    pub period_s: f64,
    /// Steps of the plant in a period.
    pub steps_per_period: usize,
}

/// Speed over which friction changes sign, m/s.
const TRANSITION_SPEED_M_PER_S: f64 = 1e-3;

const SOURCE: &str =
    "guides and screws need to a fifth of a drive's force; of a drive of 1 kN, for others in proportion";

macro_rules! parameter {
    ($name:literal, $unit:literal, $neutral:expr, $low:expr, $high:expr) => {
        Parameter { name: $name, unit: $unit, neutral: $neutral, range: ($low, $high), source: SOURCE }
    };
}

/// What can be added to the axis.
pub static CATALOGUE: [EffectInfo; 5] = [
    EffectInfo {
        key: "coulomb_friction",
        parameters: &[parameter!("force_n", "N", 0.0, 0.0, 300.0)],
        law: "force −= force_n · tanh(v / 1 mm/s)",
        signature: "the command steps at every reversal by the same amount at every speed",
        equation: Equation::Force,
    },
    EffectInfo {
        key: "stribeck_friction",
        parameters: &[
            parameter!("force_n", "N", 0.0, 0.0, 300.0),
            parameter!("static_force_n", "N", 0.0, 0.0, 450.0),
            parameter!("stribeck_speed_m_per_s", "m/s", 0.0, 5e-3, 0.1),
        ],
        law: "force −= (F_c + max(F_s − F_c, 0) e^(−(v / v_s)²)) tanh(v / 1 mm/s)",
        signature: "as Coulomb friction, with a peak as each stroke begins and ends",
        equation: Equation::Force,
    },
    EffectInfo {
        key: "force_offset",
        parameters: &[parameter!("force_n", "N", 0.0, -200.0, 200.0)],
        law: "force += force_n: weight of an inclined axis, a cable's pull, a drive's zero",
        signature: "the command is off by the same amount in every phase",
        equation: Equation::Force,
    },
    EffectInfo {
        key: "asymmetric_friction",
        parameters: &[parameter!("difference_n", "N", 0.0, -200.0, 200.0)],
        law: "friction of difference_n forward where it is positive, of −difference_n backward where it is negative; none the other way",
        signature: "the command is off by the same amount in all motion one way, and right the other way and at rest",
        equation: Equation::Force,
    },
    EffectInfo {
        key: "position_friction",
        parameters: &[
            parameter!("force_n", "N", 0.0, 0.0, 300.0),
            parameter!("slope_n_per_m", "N/m", 0.0, -1000.0, 1000.0),
        ],
        law: "Coulomb friction of force_n in mid-stroke that grows by slope_n_per_m along the stroke, never negative",
        signature: "the command's steps at reversal differ from end to end of the stroke",
        equation: Equation::Force,
    },
];

/// Numbers of the effects, neutral where none is given.
struct Effects {
    coulomb_n: f64,
    dynamic_n: f64,
    static_n: f64,
    stribeck_speed: f64,
    offset_n: f64,
    forward_n: f64,
    backward_n: f64,
    mid_n: f64,
    slope: f64,
}

/// What is logged at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ElectricSignals {
    /// Drive command, share of full command.
    pub command: f64,
    /// Position, m.
    pub position_m: f64,
}

impl ElectricAxis {
    /// Reads and checks the text of a plant file.
    ///
    /// # Errors
    /// [`SpecError`] naming the key.
    pub fn from_toml(text: &str) -> Result<Self, SpecError> {
        let axis: ElectricAxis = parse_toml(text)?;
        axis.check()?;
        Ok(axis)
    }

    /// The file's text.
    ///
    /// # Errors
    /// [`SpecError::Unwritable`] where TOML cannot express a value (none of a checked axis's).
    pub fn to_toml(&self) -> Result<String, SpecError> {
        Ok(toml::to_string_pretty(self)?)
    }

    /// Whether a plant file is of this kind.
    pub fn is_kind(text: &str) -> bool {
        text.lines().any(|line| {
            line.split_once('=').is_some_and(|(key, value)| {
                key.trim() == "kind" && value.trim().trim_matches('"').starts_with("electric_axis")
            })
        })
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`SpecError`] for the first thing that is wrong.
    pub fn check(&self) -> Result<(), SpecError> {
        let positive = [
            ("plant.mass_kg", self.plant.mass_kg),
            ("plant.full_force_n", self.plant.full_force_n),
            ("plant.stroke_m", self.plant.stroke_m),
            ("controller.position_gain_per_s", self.controller.position_gain_per_s),
            ("controller.velocity_gain_s_per_m", self.controller.velocity_gain_s_per_m),
            ("controller.period_s", self.controller.period_s),
            ("controller.steps_per_period", self.controller.steps_per_period as f64),
            ("cycle.period_s", self.cycle.period_s),
        ];
        let expected = |what: &str| what.to_owned();
        for (key, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(SpecError::Value {
                    line: None,
                    key: key.into(),
                    value,
                    expected: expected("it must be positive"),
                });
            }
        }
        let value = self.plant.viscous_friction_n_s_per_m;
        if !(value.is_finite() && value >= 0.0) {
            let key = "plant.viscous_friction_n_s_per_m".into();
            return Err(SpecError::Value {
                line: None,
                key,
                value,
                expected: expected("it must not be negative"),
            });
        }
        if self.cycle.moves.is_empty() {
            return Err(SpecError::NoMoves);
        }
        refuse_open_loop(&self.cycle, "an electric axis")?;
        let (period_s, controller_period_s) = (self.cycle.period_s, self.controller.period_s);
        if period_s < 20.0 * controller_period_s {
            return Err(SpecError::ShortCycle { period_s, controller_period_s });
        }
        for (key, values) in &self.effects {
            let known: Vec<&str> = CATALOGUE.iter().map(|info| info.key).collect();
            let info = CATALOGUE
                .iter()
                .find(|info| info.key == key)
                .ok_or_else(|| unknown_name("effects".into(), key, &known))?;
            for name in values.keys() {
                let known: Vec<&str> = info.parameters.iter().map(|parameter| parameter.name).collect();
                if !known.contains(&name.as_str()) {
                    return Err(unknown_name(format!("effects.{key}"), name, &known));
                }
            }
        }
        Ok(())
    }

    fn numbers(&self) -> Effects {
        let of = |effect: &str, parameter: &str| {
            self.effects.get(effect).and_then(|values| values.get(parameter)).copied().unwrap_or(0.0)
        };
        Effects {
            coulomb_n: of("coulomb_friction", "force_n"),
            dynamic_n: of("stribeck_friction", "force_n"),
            static_n: of("stribeck_friction", "static_force_n"),
            stribeck_speed: of("stribeck_friction", "stribeck_speed_m_per_s").max(1e-4),
            offset_n: of("force_offset", "force_n"),
            forward_n: of("asymmetric_friction", "difference_n").max(0.0),
            backward_n: (-of("asymmetric_friction", "difference_n")).max(0.0),
            mid_n: of("position_friction", "force_n"),
            slope: of("position_friction", "slope_n_per_m"),
        }
    }

    /// Runs the axis along a drive, from rest at its first demand, and hands each tick to `sink` with its number.
    pub fn follow(&self, drive: &[DriveSample], mut sink: impl FnMut(usize, ElectricSignals)) {
        let machine = ElectricMachine::new(self);
        let mut state = ElectricState::at_rest(drive.first().map_or(0.0, |sample| sample.demand_m));
        for (tick, sample) in drive.iter().enumerate() {
            let command = machine.command(&state, sample.demand_m);
            sink(tick, ElectricSignals { command, position_m: state.position_m });
            machine.run(&mut state, command, sample.load_n);
        }
    }
}

/// What changes while an axis runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ElectricState {
    /// Position, m.
    pub position_m: f64,
    /// Velocity, m/s.
    pub velocity_m_per_s: f64,
}

impl ElectricState {
    /// At rest at a position, m.
    pub fn at_rest(position_m: f64) -> Self {
        ElectricState { position_m, velocity_m_per_s: 0.0 }
    }
}

/// An axis, advanced a tick at a time: parameters only, what changes is in an [`ElectricState`].
pub struct ElectricMachine {
    plant: ElectricPlant,
    controller: Cascade,
    effects: Effects,
    /// Longest step, s.
    step_s: f64,
}

impl ElectricMachine {
    /// The machine of a file.
    pub fn new(axis: &ElectricAxis) -> Self {
        let controller = axis.controller.clone();
        let step_s = controller.period_s / controller.steps_per_period.max(1) as f64;
        ElectricMachine { plant: axis.plant.clone(), controller, effects: axis.numbers(), step_s }
    }

    /// The controller's command at a tick, share of full command.
    pub fn command(&self, state: &ElectricState, demand_m: f64) -> f64 {
        let speed = self.controller.position_gain_per_s * (demand_m - state.position_m);
        (self.controller.velocity_gain_s_per_m * (speed - state.velocity_m_per_s)).clamp(-1.0, 1.0)
    }

    /// The plant from one tick to the next under a held command and load.
    pub fn run(&self, state: &mut ElectricState, command: f64, load_n: f64) {
        let steps = self.controller.steps_per_period.max(1);
        self.advance(state, command, load_n, (steps, self.step_s));
    }

    /// As [`run`](Self::run), over any time, s, in steps that are no longer than its own. One period gives the bits of `run`.
    pub fn run_for(&self, state: &mut ElectricState, command: f64, load_n: f64, over_s: f64) {
        let period_s = self.controller.period_s;
        if (over_s - period_s).abs() <= SAME_PERIOD * period_s {
            return self.run(state, command, load_n);
        }
        let steps = (over_s / self.step_s * (1.0 - SAME_PERIOD)).ceil().max(1.0);
        self.advance(state, command, load_n, (steps as usize, over_s / steps));
    }

    fn advance(&self, state: &mut ElectricState, command: f64, load_n: f64, (steps, h): (usize, f64)) {
        let (plant, effects) = (&self.plant, &self.effects);
        let ElectricState { position_m: mut x, velocity_m_per_s: mut v } = *state;
        for _ in 0..steps {
            // Friction is linear in the new speed within the transition: m (v' − v)/h = F − c v', with c = F_v + size/transition.
            let size = effects.friction_n(v, x - 0.5 * plant.stroke_m);
            let slope = size * slope_of_direction(v);
            let rest = size * direction(v) - slope * v;
            let push = plant.full_force_n * command + effects.offset_n + load_n - rest;
            let resistance = plant.viscous_friction_n_s_per_m + slope;
            v = (v + h / plant.mass_kg * push) / (1.0 + h / plant.mass_kg * resistance);
            x += h * v;
        }
        *state = ElectricState { position_m: x, velocity_m_per_s: v };
    }
}

/// Share of a period by which a step may differ from it and be meant as one.
const SAME_PERIOD: f64 = 1e-9;

fn direction(v: f64) -> f64 {
    libm::tanh(v / TRANSITION_SPEED_M_PER_S)
}

fn slope_of_direction(v: f64) -> f64 {
    let t = direction(v);
    (1.0 - t * t) / TRANSITION_SPEED_M_PER_S
}

impl Effects {
    /// Size of the friction force at a speed and a distance from mid-stroke, N.
    fn friction_n(&self, v: f64, from_middle_m: f64) -> f64 {
        let over = v / self.stribeck_speed;
        let stribeck = self.dynamic_n + (self.static_n - self.dynamic_n).max(0.0) * libm::exp(-over * over);
        let directed = if v > 0.0 { self.forward_n } else { self.backward_n };
        let placed = (self.mid_n + self.slope * from_middle_m).max(0.0);
        self.coulomb_n + stribeck + directed + placed
    }
}
