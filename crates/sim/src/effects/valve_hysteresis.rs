//! Valve hysteresis: magnetic hysteresis and friction of a proportional valve's solenoid and spool.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Substep, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct ValveHysteresis;

/// Full width of the play, share of full command.
struct Play<T> {
    width: T,
}

impl<T: Real> Play<T> {
    fn new(values: &[T]) -> Self {
        Play { width: values[0] }
    }
}

impl<T: Real> Law<T> for Play<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    fn memory(&self) -> usize {
        1
    }

    #[inline(always)]
    fn spool(&self, memory: &mut [T], command: T, _substep: &Substep<T>) -> T {
        let half = self.width * T::splat(0.5);
        memory[0] = memory[0].max(command - half).min(command + half);
        memory[0]
    }
}

impl Effect for ValveHysteresis {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_hysteresis",
            parameters: &[Parameter {
                name: "width",
                unit: "1",
                neutral: 0.0,
                range: (0.0, 0.08),
                source: "data sheets of proportional valves without spool feedback: 3 to 8 % of full command",
            }],
            law: "spool = play of full width `width` (Krasnosel’skii & Pokrovskii): it moves only when the command pushes it",
            signature: "the command overshoots by the width at every change of direction; a small limit cycle in the holds",
            equation: Equation::Cap,
        }
    }
    built_by!(Play::new);
}
