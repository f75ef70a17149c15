//! Command quantisation: a digital-to-analogue converter or a fieldbus word of few bits between controller and spool.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Substep, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct CommandQuantisation;

/// Step, share of full command.
struct Steps<T> {
    step: T,
}

impl<T: Real> Steps<T> {
    fn new(values: &[T]) -> Self {
        Steps { step: values[0] }
    }
}

impl<T: Real> Law<T> for Steps<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    #[inline(always)]
    fn spool(&self, _memory: &mut [T], command: T, _substep: &Substep<T>) -> T {
        let rounded = (command / self.step).map(libm::round) * self.step;
        self.step.where_positive(rounded, command)
    }
}

impl Effect for CommandQuantisation {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "command_quantisation",
            parameters: &[Parameter {
                name: "step",
                unit: "1",
                neutral: 0.0,
                range: (1.0 / 4096.0, 1.0 / 256.0),
                source: "converters of 9 to 13 bits over ± full command",
            }],
            law: "spool = step · round(u / step)",
            signature: "the spool moves in steps while the command glides; holds hunt between two steps",
            equation: Equation::Cap,
        }
    }
    built_by!(Steps::new);
}
