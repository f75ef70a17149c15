//! Laws without a name: a function of one signal at one place of the machine, by its values at knots.
//!
//! The catalogue has causes that somebody has described. What none of them explains can still be *where* (a force, a flow, the valve, the
//! sensor) and *along what* (speed, position, pressure, time): such a law is a piecewise linear curve over that argument, constant beyond
//! its ends. `seepd gap` learns it from a log; in a plant file it is a table `[effects.learned_…]` like any effect, which `simulate`,
//! `train` and
//! `gap` know. With all values at 0 it changes no bit.

use std::sync::LazyLock;

use crate::effects::direction;
use crate::effects::{
    Constants, Effect, EffectInfo, Equation, Law, Moment, Openings, Parameter, Sensing, Substep, Terms,
};
use crate::real::{Lanes, Real};
use crate::simd::law_in_lanes;
use crate::spec::MachineSpec;

/// Where a learned law acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Site {
    /// A force on the piston, positive outwards, N.
    Force,
    /// A force against the motion, N.
    Friction,
    /// Added to the spool's position, share of full opening.
    Spool,
    /// Added to the opening of the valve's rod port, share of what it is.
    RodPort,
    /// A flow past the piston, cap → rod, m³/s.
    Seal,
    /// A flow into the cap chamber, m³/s.
    CapFlow,
    /// A flow into the rod chamber, m³/s.
    RodFlow,
    /// A flow into the supply, m³/s.
    Supply,
    /// Added to the measured position, m.
    Sensor,
    /// Added to the control error, m.
    Controller,
}

impl Site {
    /// The place in words.
    pub const fn name(self) -> &'static str {
        match self {
            Site::Force => "force on the piston",
            Site::Friction => "force against the motion",
            Site::Spool => "valve opening",
            Site::RodPort => "opening of the rod port",
            Site::Seal => "flow past the piston",
            Site::CapFlow => "flow into the cap chamber",
            Site::RodFlow => "flow into the rod chamber",
            Site::Supply => "flow into the supply",
            Site::Sensor => "measured position",
            Site::Controller => "control error",
        }
    }

    const fn equation(self) -> Equation {
        match self {
            Site::Force | Site::Friction => Equation::Force,
            Site::Spool | Site::Seal | Site::CapFlow => Equation::Cap,
            Site::RodPort | Site::RodFlow => Equation::Rod,
            Site::Supply => Equation::Supply,
            Site::Sensor => Equation::Sensor,
            Site::Controller => Equation::Controller,
        }
    }
}

/// What a learned law depends on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Argument {
    /// Speed of the piston, m/s; of the sensor's reading where the law is the sensor's.
    Speed,
    /// Position, m.
    Position,
    /// Command, share of full command.
    Command,
    /// Difference of the chambers' pressures, cap less rod, Pa.
    PressureDifference,
    /// Pressure of the cap chamber, Pa.
    CapPressure,
    /// Pressure of the rod chamber, Pa.
    RodPressure,
    /// Pressure of the supply, Pa.
    SupplyPressure,
    /// Control error, m.
    ControlError,
    /// Time in the duty cycle, s.
    Time,
}

impl Argument {
    /// The argument in words.
    pub const fn name(self) -> &'static str {
        match self {
            Argument::Speed => "speed",
            Argument::Position => "position",
            Argument::Command => "command",
            Argument::PressureDifference => "pressure difference",
            Argument::CapPressure => "cap pressure",
            Argument::RodPressure => "rod pressure",
            Argument::SupplyPressure => "supply pressure",
            Argument::ControlError => "control error",
            Argument::Time => "time in the cycle",
        }
    }

    /// Its SI unit.
    pub const fn unit(self) -> &'static str {
        match self {
            Argument::Speed => "m/s",
            Argument::Position | Argument::ControlError => "m",
            Argument::Command => "1",
            Argument::PressureDifference
            | Argument::CapPressure
            | Argument::RodPressure
            | Argument::SupplyPressure => "Pa",
            Argument::Time => "s",
        }
    }
}

/// A law to be learned: where, along what, with its description.
#[derive(Debug)]
pub struct LearnedLaw {
    /// Where it acts.
    pub site: Site,
    /// What it depends on.
    pub argument: Argument,
    info: EffectInfo,
}

impl LearnedLaw {
    /// How many values its curve has.
    pub const fn knots(&self) -> usize {
        self.info.parameters.len() - ENDS
    }
}

/// Parameters before the values: the ends of the argument.
const ENDS: usize = 2;
/// Knots of a curve, and of one over the time in the cycle.
const KNOTS: usize = 13;
const KNOTS_OF_TIME: usize = 61;

/// `from`, `to`, and the names of the values.
const NAMES: [&str; ENDS + KNOTS_OF_TIME] = [
    "from", "to", "at_00", "at_01", "at_02", "at_03", "at_04", "at_05", "at_06", "at_07", "at_08", "at_09",
    "at_10", "at_11", "at_12", "at_13", "at_14", "at_15", "at_16", "at_17", "at_18", "at_19", "at_20",
    "at_21", "at_22", "at_23", "at_24", "at_25", "at_26", "at_27", "at_28", "at_29", "at_30", "at_31",
    "at_32", "at_33", "at_34", "at_35", "at_36", "at_37", "at_38", "at_39", "at_40", "at_41", "at_42",
    "at_43", "at_44", "at_45", "at_46", "at_47", "at_48", "at_49", "at_50", "at_51", "at_52", "at_53",
    "at_54", "at_55", "at_56", "at_57", "at_58", "at_59", "at_60",
];

/// Both ends of an argument, then values of a curve, each within a range either way.
const fn parameters<const N: usize>(argument: &'static str, unit: &'static str, most: f64) -> [Parameter; N] {
    let source = "learned from a log";
    let end = Parameter { name: "", unit: argument, neutral: 0.0, range: (-1e9, 1e9), source };
    let mut all = [end; N];
    let mut index = 0;
    while index < N {
        if index >= ENDS {
            all[index].unit = unit;
            all[index].range = (-most, most);
        }
        all[index].name = NAMES[index];
        index += 1;
    }
    all
}

macro_rules! law {
    ($key:literal, $site:ident, $argument:ident, $knots:expr, $unit:literal, $most:expr, $law:literal) => {
        LearnedLaw {
            site: Site::$site,
            argument: Argument::$argument,
            info: EffectInfo {
                key: $key,
                parameters: {
                    const ALL: &[Parameter] =
                        &parameters::<{ ENDS + $knots }>(Argument::$argument.unit(), $unit, $most);
                    ALL
                },
                law: $law,
                signature: "whatever the curve says",
                equation: Site::$site.equation(),
            },
        }
    };
}

/// Largest values that a file may have, far above what is plausible on the nominal press.
const FORCE_N: f64 = 2e5;
const FLOW_M3_PER_S: f64 = 1e-2;

static FORCE_OVER_SPEED: LearnedLaw =
    law!("learned_force_over_speed", Force, Speed, KNOTS, "N", FORCE_N, "force += f(v)");
static FORCE_OVER_POSITION: LearnedLaw =
    law!("learned_force_over_position", Force, Position, KNOTS, "N", FORCE_N, "force += f(x)");
static FORCE_OVER_TIME: LearnedLaw = law!(
    "learned_force_over_time",
    Force,
    Time,
    KNOTS_OF_TIME,
    "N",
    FORCE_N,
    "force += f(time in the cycle)"
);
static FRICTION_OVER_POSITION: LearnedLaw = law!(
    "learned_friction_over_position",
    Friction,
    Position,
    KNOTS,
    "N",
    FORCE_N,
    "force −= f(x) tanh(v / 5 mm/s)"
);
static FRICTION_OVER_PRESSURE: LearnedLaw = law!(
    "learned_friction_over_pressure",
    Friction,
    PressureDifference,
    KNOTS,
    "N",
    FORCE_N,
    "force −= f(p_1 − p_2) tanh(v / 5 mm/s)"
);
static SPOOL_OVER_COMMAND: LearnedLaw =
    law!("learned_spool_over_command", Spool, Command, KNOTS, "1", 2.0, "spool = u + f(u)");
static ROD_PORT_OVER_COMMAND: LearnedLaw = law!(
    "learned_rod_port_over_command",
    RodPort,
    Command,
    KNOTS,
    "1",
    10.0,
    "opening of the rod port = k_v |u| max(1 + f(u), 0)"
);
static SEAL_OVER_PRESSURE: LearnedLaw = law!(
    "learned_seal_over_pressure",
    Seal,
    PressureDifference,
    KNOTS,
    "m3/s",
    FLOW_M3_PER_S,
    "flow cap → rod += f(p_1 − p_2)"
);
static SEAL_OVER_POSITION: LearnedLaw = law!(
    "learned_seal_over_position",
    Seal,
    Position,
    KNOTS,
    "m3/s",
    FLOW_M3_PER_S,
    "flow cap → rod += f(x) (p_1 − p_2) / 10 MPa"
);
static CAP_FLOW_OVER_PRESSURE: LearnedLaw = law!(
    "learned_cap_flow_over_pressure",
    CapFlow,
    CapPressure,
    KNOTS,
    "m3/s",
    FLOW_M3_PER_S,
    "cap flow += f(p_1)"
);
static ROD_FLOW_OVER_PRESSURE: LearnedLaw = law!(
    "learned_rod_flow_over_pressure",
    RodFlow,
    RodPressure,
    KNOTS,
    "m3/s",
    FLOW_M3_PER_S,
    "rod flow += f(p_2)"
);
static SUPPLY_OVER_PRESSURE: LearnedLaw = law!(
    "learned_supply_over_pressure",
    Supply,
    SupplyPressure,
    KNOTS,
    "m3/s",
    FLOW_M3_PER_S,
    "supply flow += f(p_s)"
);
static SUPPLY_OVER_TIME: LearnedLaw = law!(
    "learned_supply_over_time",
    Supply,
    Time,
    KNOTS_OF_TIME,
    "m3/s",
    FLOW_M3_PER_S,
    "supply flow += f(time in the cycle)"
);
static SENSOR_OVER_POSITION: LearnedLaw =
    law!("learned_sensor_over_position", Sensor, Position, KNOTS, "m", 1.0, "measured = x + f(x)");
static SENSOR_OVER_SPEED: LearnedLaw = law!(
    "learned_sensor_over_speed",
    Sensor,
    Speed,
    KNOTS,
    "m",
    1.0,
    "measured = x + f(speed of x between ticks)"
);
static CONTROLLER_OVER_ERROR: LearnedLaw = law!(
    "learned_controller_over_error",
    Controller,
    ControlError,
    KNOTS,
    "m",
    1.0,
    "e = demand − measured + f(demand − measured)"
);

/// Every law that can be learned.
pub static ALL: [&LearnedLaw; 16] = [
    &SPOOL_OVER_COMMAND,
    &ROD_PORT_OVER_COMMAND,
    &FORCE_OVER_SPEED,
    &FORCE_OVER_POSITION,
    &FORCE_OVER_TIME,
    &FRICTION_OVER_POSITION,
    &FRICTION_OVER_PRESSURE,
    &SEAL_OVER_PRESSURE,
    &SEAL_OVER_POSITION,
    &CAP_FLOW_OVER_PRESSURE,
    &ROD_FLOW_OVER_PRESSURE,
    &SUPPLY_OVER_PRESSURE,
    &SUPPLY_OVER_TIME,
    &SENSOR_OVER_POSITION,
    &SENSOR_OVER_SPEED,
    &CONTROLLER_OVER_ERROR,
];

/// Those of a machine without a controller: nothing acts on its error, and its runs have no time in common.
pub fn of_open_loop() -> &'static [&'static LearnedLaw] {
    static OPEN_LOOP: LazyLock<Vec<&LearnedLaw>> = LazyLock::new(|| {
        let acts = |law: &&LearnedLaw| law.site != Site::Controller && law.argument != Argument::Time;
        ALL.into_iter().filter(acts).collect()
    });
    &OPEN_LOOP
}

/// The largest friction of a machine's learned laws, N.
pub(crate) fn largest_friction_n(machine: &MachineSpec) -> f64 {
    let largest = |law: &&LearnedLaw| {
        let values = machine.effect_values(*law as &dyn Effect);
        values[ENDS..].iter().fold(0.0, |largest: f64, value| largest.max(value.abs()))
    };
    let frictions = ALL.iter().filter(|law| law.site == Site::Friction);
    frictions.filter(|law| machine.effects.contains_key(law.info.key)).map(largest).sum()
}

/// The law of that key.
pub fn find(key: &str) -> Option<&'static LearnedLaw> {
    ALL.iter().copied().find(|law| law.info.key == key)
}

impl Effect for LearnedLaw {
    fn info(&self) -> &'static EffectInfo {
        // Laws are statics of this file; a reference to one outlives everything.
        ALL.iter().find(|law| law.info.key == self.info.key).map_or(&ALL[0].info, |law| &law.info)
    }
    fn scalar(&self, values: &[f64]) -> Box<dyn Law<f64>> {
        Box::new(Acting::new(self, values))
    }
    fn lanes(&self, values: &[Lanes]) -> Box<dyn Law<Lanes>> {
        law_in_lanes(Acting::new(self, values))
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[ENDS..].iter().all(|value| *value == 0.0)
    }
}

/// A piecewise linear function, constant beyond its ends.
struct Curve<T> {
    from: T,
    /// Knots per unit of the argument.
    per_unit: T,
    values: Vec<T>,
}

impl<T: Real> Curve<T> {
    fn new(values: &[T]) -> Self {
        let (from, to) = (values[0], values[1]);
        let knots = values.len() - ENDS;
        // Neutral lanes have no ends.
        let width = (to - from).max(T::splat(1e-12));
        Curve { from, per_unit: T::splat((knots - 1) as f64) / width, values: values[ENDS..].to_vec() }
    }

    #[inline(always)]
    fn at(&self, argument: T) -> T {
        let last = T::splat((self.values.len() - 1) as f64);
        let place = ((argument - self.from) * self.per_unit).max(T::splat(0.0)).min(last);
        T::from_lanes(|lane| {
            let place = place.lane(lane);
            if !place.is_finite() {
                return 0.0;
            }
            let knot = (place as usize).min(self.values.len() - 2);
            let share = place - knot as f64;
            let (low, high) = (self.values[knot].lane(lane), self.values[knot + 1].lane(lane));
            low + (high - low) * share
        })
    }
}

/// A law with its curve.
struct Acting<T> {
    site: Site,
    argument: Argument,
    curve: Curve<T>,
}

/// Pressure difference at which a curve of the flow past the piston over the position is read, Pa.
const SEAL_PRESSURE_PA: f64 = 1e7;

impl<T: Real> Acting<T> {
    fn new(law: &LearnedLaw, values: &[T]) -> Self {
        Acting { site: law.site, argument: law.argument, curve: Curve::new(values) }
    }

    /// The curve at what the plant's equations know.
    #[inline(always)]
    fn in_the_plant(&self, moment: &Moment<'_, T>) -> T {
        let state = moment.state;
        self.curve.at(match self.argument {
            Argument::Speed => state.v,
            Argument::Position => state.x,
            Argument::PressureDifference => state.p_1 - state.p_2,
            Argument::CapPressure => state.p_1,
            Argument::RodPressure => state.p_2,
            Argument::SupplyPressure => state.p_s,
            Argument::Time => moment.at,
            Argument::Command => moment.spool,
            Argument::ControlError => T::splat(0.0),
        })
    }
}

impl<T: Real> Law<T> for Acting<T> {
    /// The position at the last tick, and whether there was one.
    fn memory(&self) -> usize {
        if self.site == Site::Sensor && self.argument == Argument::Speed { 2 } else { 0 }
    }

    fn is_in_balances(&self) -> bool {
        !matches!(self.site, Site::Spool | Site::Sensor | Site::Controller)
    }

    fn adjust(&self, constants: &mut Constants<'_, T>) {
        if self.site == Site::Controller {
            constants.correct_errors();
        }
    }

    fn correct(&self, error: T) -> T {
        if self.site == Site::Controller { error + self.curve.at(error) } else { error }
    }

    #[inline(always)]
    fn sense(&self, memory: &mut [T], position: T, sensing: &Sensing<T>) -> T {
        if self.site != Site::Sensor {
            return position;
        }
        if self.argument == Argument::Position {
            return position + self.curve.at(position);
        }
        let before = memory[1].where_positive(memory[0], position);
        memory[0] = position;
        memory[1] = T::splat(1.0);
        position + self.curve.at((position - before) / sensing.period)
    }

    #[inline(always)]
    fn spool(&self, _memory: &mut [T], command: T, _substep: &Substep<T>) -> T {
        if self.site == Site::Spool { command + self.curve.at(command) } else { command }
    }

    #[inline(always)]
    fn open(&self, moment: &Moment<'_, T>, openings: &mut Openings<T>) {
        if self.site == Site::RodPort {
            openings.rod = openings.rod * (T::splat(1.0) + self.in_the_plant(moment)).max(T::splat(0.0));
        }
    }

    #[inline(always)]
    fn act(&self, _memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        match self.site {
            Site::Force => terms.force += self.in_the_plant(moment),
            Site::Friction => terms.force -= self.in_the_plant(moment) * direction(moment.state.v),
            Site::Seal => {
                let flow = self.in_the_plant(moment);
                let flow = match self.argument {
                    Argument::Position => {
                        flow * (moment.state.p_1 - moment.state.p_2) * T::splat(1.0 / SEAL_PRESSURE_PA)
                    }
                    _ => flow,
                };
                terms.cap_flow -= flow;
                terms.rod_flow += flow;
            }
            Site::CapFlow => terms.cap_flow += self.in_the_plant(moment),
            Site::RodFlow => terms.rod_flow += self.in_the_plant(moment),
            Site::Supply => terms.supply_flow += self.in_the_plant(moment),
            Site::Spool | Site::RodPort | Site::Sensor | Site::Controller => {}
        }
    }
}
