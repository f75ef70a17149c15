//! Valve bias: a valve's null that is off: spring, amplifier or sensor out of adjustment.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Substep, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct ValveBias;

/// Offset, share of full command.
struct Bias<T> {
    offset: T,
}

impl<T: Real> Bias<T> {
    fn new(values: &[T]) -> Self {
        Bias { offset: values[0] }
    }
}

impl<T: Real> Law<T> for Bias<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    #[inline(always)]
    fn spool(&self, _memory: &mut [T], command: T, _substep: &Substep<T>) -> T {
        command + self.offset
    }
}

impl Effect for ValveBias {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_bias",
            parameters: &[Parameter {
                name: "offset",
                unit: "1",
                neutral: 0.0,
                range: (-0.05, 0.05),
                source: "null shifts of proportional valves: to 5 % of full command over temperature and life",
            }],
            law: "spool = u + offset",
            signature: "the command is off by the same amount in every phase, holds included",
            equation: Equation::Cap,
        }
    }
    built_by!(Bias::new);
}
