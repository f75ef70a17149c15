//! The catalogue of effects: what a real machine has and the nominal plant lacks.
//!
//! One effect is one file and its line in [`ALL`]. An effect at its neutral value leaves the plant bit-identical. [`Effect`]
//! describes and builds; the [`Law`] it builds acts at one or more sites:
//!
//! - in the constants, once ([`Law::adjust`]);
//! - between the true position and the measured one, once a controller tick ([`Law::sense`]);
//! - between the controller's output and the spool, once a plant step ([`Law::spool`]);
//! - in the balances, at every evaluation of the equations: openings of the valve ([`Law::open`]), flows and forces ([`Law::act`]),
//!   compliance ([`Law::soften`]);
//! - in states of its own, once a plant step ([`Law::advance`]).

mod accumulator;
mod command_delay;
mod command_quantisation;
mod controller_clock;
mod controller_gains;
mod coulomb_friction;
mod cushioning;
mod entrained_air;
mod external_leak;
mod hose_volume;
mod load_bias;
mod oil_viscosity;
mod position_lag;
mod position_quantisation;
mod position_scale;
mod position_sine;
mod pressure_friction;
mod pump_slip;
mod return_back_pressure;
mod shared_supply;
mod spring_load;
mod stribeck_friction;
mod structure_compliance;
mod turbulent_leak;
mod valve_asymmetry;
mod valve_bias;
mod valve_curve;
mod valve_deadband;
mod valve_flow_shape;
mod valve_hysteresis;
mod valve_lag;
mod valve_overlap;
mod valve_port_ratio;
mod valve_rate_limit;
mod valve_wear;

pub(crate) use valve_curve::ValveCurve;
pub(crate) use valve_deadband::ValveDeadband;
pub(crate) use valve_flow_shape::ValveFlowShape;
pub(crate) use valve_overlap::ValveOverlap;

use crate::controller::Pid;
use crate::learned;
use crate::plant::{Plant, State};
use crate::real::{Lanes, Real};
use crate::spec::MachineSpec;

/// Every effect, in the order in which signals run: command to spool, spool to flows, flows to forces, position to measurement. Laws act in
/// this order; `structure_compliance` comes after the forces, which it divides.
pub const ALL: &[&dyn Effect] = &[
    &command_quantisation::CommandQuantisation,
    &command_delay::CommandDelay,
    &valve_hysteresis::ValveHysteresis,
    &valve_rate_limit::ValveRateLimit,
    &valve_lag::ValveLag,
    &valve_bias::ValveBias,
    &ValveDeadband,
    &ValveFlowShape,
    &valve_asymmetry::ValveAsymmetry,
    &valve_wear::ValveWear,
    &cushioning::Cushioning,
    &return_back_pressure::ReturnBackPressure,
    &coulomb_friction::CoulombFriction,
    &stribeck_friction::StribeckFriction,
    &pressure_friction::PressureFriction,
    &spring_load::SpringLoad,
    &load_bias::LoadBias,
    &structure_compliance::StructureCompliance,
    &external_leak::ExternalLeak,
    &turbulent_leak::TurbulentLeak,
    &entrained_air::EntrainedAir,
    &hose_volume::HoseVolume,
    &oil_viscosity::OilViscosity,
    &pump_slip::PumpSlip,
    &accumulator::Accumulator,
    &shared_supply::SharedSupply,
    &position_scale::PositionScale,
    &position_sine::PositionSine,
    &position_lag::PositionLag,
    &position_quantisation::PositionQuantisation,
    &controller_gains::ControllerGains,
    &controller_clock::ControllerClock,
];

/// Laws of parts as they are bought: a plant file may have them and a calibration fit them; what has changed on a machine is none of them.
pub const OF_DATA_SHEETS: &[&dyn Effect] = &[&ValveOverlap, &ValveCurve, &valve_port_ratio::ValvePortRatio];

/// Every law that a plant file may have: the catalogue's, in their order, then those of data sheets and those that were learned from a log.
pub fn every() -> impl Iterator<Item = &'static dyn Effect> {
    let learned = learned::ALL.iter().map(|law| *law as &dyn Effect);
    ALL.iter().chain(OF_DATA_SHEETS).copied().chain(learned)
}

/// The effect of that key, if the catalogue has it.
pub fn find(key: &str) -> Option<&'static dyn Effect> {
    ALL.iter().copied().find(|effect| effect.key() == key)
}

/// The catalogue as a Markdown text: law, signature, and each parameter with unit, neutral value, range and source.
pub fn reference() -> String {
    let mut text = String::from(
        "# Effects\n\nWhat the simulator can add to the nominal plant: in a plant file as a table `[effects.KEY]`, on the command line as \
         `--with KEY.PARAMETER=VALUE`. An effect at its neutral value changes no bit. \
         Ranges are the nominal press's; on a machine of another size those of forces, volumes, flows and pressures are larger or smaller by \
         octaves. Written by `seepd simulate --list-effects`.\n",
    );
    for effect in ALL {
        text += &entry(effect.info());
    }
    text += "\n# Laws of data sheets\n\nParts as they are bought. A plant file has them like effects, and `seepd adopt` fits them; a diagnosis \
         does not take them for what has changed.\n";
    for effect in OF_DATA_SHEETS {
        text += &entry(effect.info());
    }
    text
}

/// A law's section of the reference.
fn entry(info: &EffectInfo) -> String {
    let mut text = format!(
        "\n## {}\n\nLaw: {}.\n\nSeen: {}. First disturbs: {}.\n\n| parameter | unit | neutral | range | source |\n|---|---|---|---|---|\n",
        info.key,
        info.law,
        info.signature,
        info.equation.name()
    );
    for parameter in info.parameters {
        let (low, high) = parameter.range;
        text += &format!(
            "| `{}` | {} | {} | {} … {} | {} |\n",
            parameter.name,
            parameter.unit,
            number(parameter.neutral),
            number(low),
            number(high),
            parameter.source
        );
    }
    text
}

fn number(value: f64) -> String {
    if value == 0.0 || (1e-3..1e5).contains(&value.abs()) {
        let text = format!("{value:.6}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        format!("{value:e}")
    }
}

/// The balance that an effect disturbs first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Equation {
    /// Flow balance of the supply node.
    Supply,
    /// Flow balance at the valve's inlet.
    Inlet,
    /// Flow balance of the cap chamber.
    Cap,
    /// Flow balance of the rod chamber.
    Rod,
    /// Forces on the moved mass.
    Force,
    /// Controller: demand and position to command.
    Controller,
    /// Sensing.
    Sensor,
}

impl Equation {
    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Equation::Supply => "supply",
            Equation::Inlet => "inlet",
            Equation::Cap => "cap",
            Equation::Rod => "rod",
            Equation::Force => "force",
            Equation::Controller => "controller",
            Equation::Sensor => "sensor",
        }
    }
}

/// A parameter of an effect.
#[derive(Debug, Clone, Copy)]
pub struct Parameter {
    /// Name with its unit as suffix, as in `--with effect.parameter=value`.
    pub name: &'static str,
    /// SI unit; "1" for shares.
    pub unit: &'static str,
    /// Value at which the effect vanishes.
    pub neutral: f64,
    /// Plausible range on the nominal press; on a machine of another size [`Size::range_of`](crate::Size::range_of) has it. Values outside
    /// are refused.
    pub range: (f64, f64),
    /// Where the range comes from.
    pub source: &'static str,
}

/// What an effect is.
#[derive(Debug)]
pub struct EffectInfo {
    /// Key in files, on the command line and in reports.
    pub key: &'static str,
    /// Parameters in their order in `values`.
    pub parameters: &'static [Parameter],
    /// The law in a sentence, with its equation and source.
    pub law: &'static str,
    /// What it does to the signals, in words.
    pub signature: &'static str,
    /// The balance that it disturbs first.
    pub equation: Equation,
}

impl EffectInfo {
    /// Whether a parameter is when an event begins, or how long it lasts.
    pub fn is_time(&self, parameter: usize) -> bool {
        self.parameters
            .get(parameter)
            .is_some_and(|parameter| matches!(parameter.name, "start_s" | "duration_s"))
    }

    /// Whether these values, in the order of the parameters, leave the machine as it is.
    pub fn is_neutral(&self, values: &[f64]) -> bool {
        self.parameters.iter().zip(values).all(|(parameter, value)| *value == parameter.neutral)
    }
}

/// An effect: its description, and the way to its law.
pub trait Effect: Sync {
    /// The description.
    fn info(&self) -> &'static EffectInfo;
    /// The law of one machine; `values` in the order of [`Effect::parameters`].
    fn scalar(&self, values: &[f64]) -> Box<dyn Law<f64>>;
    /// The law of several machines in lanes.
    fn lanes(&self, values: &[Lanes]) -> Box<dyn Law<Lanes>>;

    /// Whether these values leave the plant as it is.
    fn is_neutral(&self, values: &[f64]) -> bool {
        self.info().is_neutral(values)
    }
    /// Key in files, on the command line and in reports.
    fn key(&self) -> &'static str {
        self.info().key
    }
    /// Parameters in their order in `values`.
    fn parameters(&self) -> &'static [Parameter] {
        self.info().parameters
    }
}

/// What laws may change once, before anything runs.
#[derive(Debug)]
pub struct Constants<'a, T> {
    /// The plant's coefficients.
    pub plant: &'a mut Plant<T>,
    /// The controller's coefficients.
    pub(crate) pid: &'a mut Pid<T>,
    /// Length of a plant step, s.
    pub dt: &'a mut T,
    /// Whether a law changes the control error.
    pub(crate) corrects_errors: &'a mut bool,
}

impl<T> Constants<'_, T> {
    /// Has [`Law::correct`] asked: a loop without such laws computes the error as it always did, to the bit.
    pub fn correct_errors(&mut self) {
        *self.corrects_errors = true;
    }
}

/// Where a law is asked within a controller period.
#[derive(Debug, Clone, Copy)]
pub struct Substep<T> {
    /// Controller ticks since the start.
    pub tick: u64,
    /// Plant step within the period, from 0.
    pub index: usize,
    /// Plant steps in a period.
    pub steps: usize,
    /// Length of a plant step, s.
    pub dt: T,
    /// Controller period, s.
    pub period: T,
}

/// What a law of sensing knows.
#[derive(Debug, Clone, Copy)]
pub struct Sensing<T> {
    /// Controller period, s.
    pub period: T,
}

/// The plant at one evaluation of its equations.
#[derive(Debug, Clone, Copy)]
pub struct Moment<'a, T> {
    /// The states.
    pub state: &'a State<T>,
    /// The plant.
    pub plant: &'a Plant<T>,
    /// Spool position, share of full opening.
    pub spool: T,
    /// Load, N, before its scale.
    pub load: T,
    /// Leak area, m².
    pub a_leak: T,
    /// Time in the duty cycle, s.
    pub at: T,
}

/// Coefficients of the valve's flows at its two ports under the present spool, m³/s/√Pa: the cap port meets the inlet while the spool is
/// positive, else the return; the rod port the other way.
#[derive(Debug, Clone, Copy)]
pub struct Openings<T> {
    /// Of the cap port.
    pub cap: T,
    /// Of the rod port.
    pub rod: T,
}

/// How many times softer each volume is than planned, 1 or more.
#[derive(Debug, Clone, Copy)]
pub struct Softening<T> {
    /// Supply node.
    pub supply: T,
    /// Valve inlet.
    pub inlet: T,
    /// Cap chamber.
    pub cap: T,
    /// Rod chamber.
    pub rod: T,
}

/// The right-hand sides of the balances, before the division by compliance and mass.
#[derive(Debug, Clone, Copy)]
pub struct Terms<T> {
    /// Net flow into the supply node, m³/s.
    pub supply_flow: T,
    /// Net flow into the valve's inlet node, m³/s.
    pub inlet_flow: T,
    /// Net flow into the cap chamber, m³/s.
    pub cap_flow: T,
    /// Net flow into the rod chamber, m³/s.
    pub rod_flow: T,
    /// Net force on the mass, N.
    pub force: T,
}

/// An effect's law with its parameters: immutable; what it remembers is handed to it.
pub trait Law<T: Real>: Send + Sync {
    /// How many numbers it remembers; they start at 0.
    fn memory(&self) -> usize {
        0
    }

    /// Whether it acts within the balances: by [`Law::open`], [`Law::act`] or [`Law::soften`]. Machines without such a law run faster.
    fn is_in_balances(&self) -> bool {
        true
    }

    /// Whether it softens volumes by [`Law::soften`], which is asked of no machine without such a law.
    fn softens(&self) -> bool {
        false
    }

    /// Whether its spool moves step by step, so that what it does depends on the plant's steps.
    fn goes_by_steps(&self) -> bool {
        false
    }

    /// Whether it has states of its own, which [`Law::advance`] advances.
    fn has_states(&self) -> bool {
        false
    }

    /// Changes constants, once.
    fn adjust(&self, _constants: &mut Constants<'_, T>) {}

    /// What the controller takes for the control error, m; asked where [`Constants::correct_errors`] was called.
    fn correct(&self, error: T) -> T {
        error
    }

    /// The measured position at a controller tick, given what the laws before it make of the true one.
    fn sense(&self, _memory: &mut [T], position: T, _sensing: &Sensing<T>) -> T {
        position
    }

    /// The spool's position during a plant step, given the command sent to it.
    fn spool(&self, _memory: &mut [T], command: T, _substep: &Substep<T>) -> T {
        command
    }

    /// Changes the valve's openings.
    fn open(&self, _moment: &Moment<'_, T>, _openings: &mut Openings<T>) {}

    /// Adds its terms to the balances.
    fn act(&self, _memory: &[T], _moment: &Moment<'_, T>, _terms: &mut Terms<T>) {}

    /// Softens the volumes.
    fn soften(&self, _moment: &Moment<'_, T>, _softening: &mut Softening<T>) {}

    /// Advances states of its own over a plant step; `moment` and `terms` are those at its start.
    fn advance(&self, _memory: &mut [T], _moment: &Moment<'_, T>, _terms: &Terms<T>, _dt: T) {}
}

/// Speed over which friction changes sign, m/s: a fiftieth of the default cycle's fastest stroke, so that every move is far outside of it,
/// and slow enough for RK4 at 8 kN on 250 kg (rate 8e3/(250 · 5e-3) = 6.4e3 1/s).
const TRANSITION_SPEED_M_PER_S: f64 = 5e-3;

/// The direction of a speed, −1 … 1: its sign, smooth around 0.
#[inline(always)]
pub(crate) fn direction<T: Real>(speed: T) -> T {
    (speed * T::splat(1.0 / TRANSITION_SPEED_M_PER_S)).tanh()
}

/// Slope of all friction over speed where the piston stands, N·s/m: around 0 friction is viscous, and as stiff as it ever is. Pressure
/// friction counts as with the relief pressure on one side of the piston.
pub(crate) fn friction_at_standstill_n_s_per_m(machine: &MachineSpec) -> f64 {
    let value = |effect: &str, parameter: &str| {
        machine.effects.get(effect).and_then(|values| values.get(parameter)).copied().unwrap_or(0.0)
    };
    let stribeck = value("stribeck_friction", "force_n").max(value("stribeck_friction", "static_force_n"));
    // Absent: as with the others.
    let creep_speed = value("stribeck_friction", stribeck_friction::CREEP);
    let firmness = if creep_speed > 0.0 { TRANSITION_SPEED_M_PER_S / creep_speed } else { 1.0 };
    let pressed = machine.plant.cap_area_m2 * machine.plant.relief_pressure_pa;
    let force_n = value("coulomb_friction", "force_n")
        + firmness * stribeck
        + value("pressure_friction", "coefficient") * pressed
        + learned::largest_friction_n(machine);
    force_n / TRANSITION_SPEED_M_PER_S
}

/// Builds a law for both number types from one generic constructor `fn(&[T]) -> impl Law<T>`.
macro_rules! built_by {
    ($constructor:path) => {
        fn scalar(&self, values: &[f64]) -> Box<dyn crate::effects::Law<f64>> {
            Box::new($constructor(values))
        }
        fn lanes(&self, values: &[crate::real::Lanes]) -> Box<dyn crate::effects::Law<crate::real::Lanes>> {
            crate::simd::law_in_lanes($constructor(values))
        }
    };
}
use built_by;
