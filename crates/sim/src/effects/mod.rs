//! The catalogue of effects: what a real machine has and the nominal plant lacks.
//!
//! One effect is one file and its line in [`ALL`]. An effect at its neutral value leaves the plant
//! bit-identical. [`Effect`] describes and builds; the [`Law`] it builds acts, at one or more of two sites:
//! between the controller's output and the spool ([`Law::spool`], once a plant step), or in the balances
//! ([`Law::act`], at every evaluation of the equations).

mod command_delay;
mod coulomb_friction;
mod external_leak;
mod valve_deadband;

use crate::plant::State;
use crate::real::{Lanes, Real};

/// Every effect, in the order of reports and of the generated documentation.
pub const ALL: &[&dyn Effect] = &[
    &valve_deadband::ValveDeadband,
    &command_delay::CommandDelay,
    &coulomb_friction::CoulombFriction,
    &external_leak::ExternalLeak,
];

/// The effect of that key, if the catalogue has it.
pub fn find(key: &str) -> Option<&'static dyn Effect> {
    ALL.iter().copied().find(|effect| effect.key() == key)
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

/// A parameter of an effect.
#[derive(Debug, Clone, Copy)]
pub struct Parameter {
    /// Name with its unit as suffix, as in `--with effect.parameter=value`.
    pub name: &'static str,
    /// SI unit; "1" for shares.
    pub unit: &'static str,
    /// Value at which the effect vanishes.
    pub neutral: f64,
    /// Plausible range; values outside are refused.
    pub range: (f64, f64),
    /// Where the range comes from.
    pub source: &'static str,
}

/// An effect: its description, and the way to its law.
pub trait Effect: Sync {
    /// Key in files, on the command line and in reports.
    fn key(&self) -> &'static str;
    /// Parameters in their order in `values`.
    fn parameters(&self) -> &'static [Parameter];
    /// The law in a sentence, with its equation and source.
    fn law_text(&self) -> &'static str;
    /// What it does to the signals, in words.
    fn signature(&self) -> &'static str;
    /// The balance that it disturbs first.
    fn equation(&self) -> Equation;
    /// The law of one machine; `values` in the order of [`Effect::parameters`].
    fn scalar(&self, values: &[f64]) -> Box<dyn Law<f64>>;
    /// The law of several machines in lanes.
    fn lanes(&self, values: &[Lanes]) -> Box<dyn Law<Lanes>>;

    /// Whether these values leave the plant as it is.
    fn is_neutral(&self, values: &[f64]) -> bool {
        self.parameters().iter().zip(values).all(|(parameter, value)| *value == parameter.neutral)
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

    /// The spool's position during a plant step, given the command sent to it.
    fn spool(&self, _memory: &mut [T], command: T, _substep: &Substep<T>) -> T {
        command
    }

    /// Adds its terms to the balances.
    fn act(&self, _memory: &[T], _state: &State<T>, _terms: &mut Terms<T>) {}
}

/// Builds a law for both number types from one generic constructor `fn(&[T]) -> impl Law<T>`.
macro_rules! built_by {
    ($constructor:path) => {
        fn scalar(&self, values: &[f64]) -> Box<dyn crate::effects::Law<f64>> {
            Box::new($constructor(values))
        }
        fn lanes(&self, values: &[crate::real::Lanes]) -> Box<dyn crate::effects::Law<crate::real::Lanes>> {
            Box::new($constructor(values))
        }
    };
}
use built_by;
