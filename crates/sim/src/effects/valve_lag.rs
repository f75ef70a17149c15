//! Valve lag: the spool follows the command like a mass on a spring.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Substep, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct ValveLag;

/// Angular frequency, 1/s, and damping ratio.
struct SecondOrder<T> {
    omega: T,
    damping: T,
}

impl<T: Real> SecondOrder<T> {
    fn new(values: &[T]) -> Self {
        SecondOrder { omega: values[0] * T::splat(std::f64::consts::TAU), damping: values[1] }
    }
}

impl<T: Real> Law<T> for SecondOrder<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    fn goes_by_steps(&self) -> bool {
        true
    }

    /// Spool position, and speed in 1/s.
    fn memory(&self) -> usize {
        2
    }

    #[inline(always)]
    fn spool(&self, memory: &mut [T], command: T, substep: &Substep<T>) -> T {
        // Semi-implicit: at 60 Hz and 0.1 ms steps ω dt is 0.04, far from where it would ring by itself.
        let pull = self.omega * self.omega * (command - memory[0]);
        let rate = memory[1] + (pull - T::splat(2.0) * self.damping * self.omega * memory[1]) * substep.dt;
        memory[1] = self.omega.where_positive(rate, T::splat(0.0));
        memory[0] = self.omega.where_positive(memory[0] + memory[1] * substep.dt, command);
        memory[0]
    }
}

impl Effect for ValveLag {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_lag",
            parameters: &[
                Parameter {
                    name: "natural_frequency_hz",
                    unit: "Hz",
                    neutral: 0.0,
                    range: (5.0, 60.0),
                    source: "data sheets of proportional valves: −90° at 5 to 60 Hz; 0 means no lag",
                },
                Parameter {
                    name: "damping",
                    unit: "1",
                    neutral: 0.7,
                    range: (0.5, 1.0),
                    source: "data sheets of proportional valves: little overshoot",
                },
            ],
            law: "d²s/dt² = ω² (u − s) − 2 damping ω ds/dt with ω = 2π natural_frequency_hz; 0 Hz: s = u",
            signature: "position lags the simulation in every stroke and rounds its corners; nothing changes in the holds",
            equation: Equation::Cap,
        }
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[0] == 0.0
    }
    built_by!(SecondOrder::new);
}
