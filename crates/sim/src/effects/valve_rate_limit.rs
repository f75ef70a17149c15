//! Valve rate limit: the spool's speed is limited by pilot flow or amplifier current.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Substep, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct ValveRateLimit;

/// Largest speed, share of full command a second.
struct RateLimit<T> {
    rate: T,
}

impl<T: Real> RateLimit<T> {
    fn new(values: &[T]) -> Self {
        RateLimit { rate: values[0] }
    }
}

impl<T: Real> Law<T> for RateLimit<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    fn goes_by_steps(&self) -> bool {
        true
    }

    fn memory(&self) -> usize {
        1
    }

    #[inline(always)]
    fn spool(&self, memory: &mut [T], command: T, substep: &Substep<T>) -> T {
        let most = self.rate * substep.dt;
        let moved = memory[0] + (command - memory[0]).max(-most).min(most);
        memory[0] = self.rate.where_positive(moved, command);
        memory[0]
    }
}

impl Effect for ValveRateLimit {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_rate_limit",
            parameters: &[Parameter {
                name: "rate_per_s",
                unit: "1/s",
                neutral: 0.0,
                range: (0.3, 50.0),
                source: "pilot-operated valves need 20 ms to 3 s for full travel; 0 means no limit",
            }],
            law: "|d spool/dt| ≤ rate_per_s; 0: no limit",
            signature: "fast strokes begin late and end late; nothing where the command moves slowly",
            equation: Equation::Cap,
        }
    }
    built_by!(RateLimit::new);
}
