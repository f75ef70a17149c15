//! Valve flow shape: metering notches whose opening is not in proportion to the spool.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Substep, built_by};
use crate::real::Real;

/// See the [module](self).
pub(crate) struct ValveFlowShape;

/// Exponent of the opening.
struct Shape<T> {
    exponent: T,
}

impl<T: Real> Shape<T> {
    fn new(values: &[T]) -> Self {
        Shape { exponent: values[0] }
    }
}

/// Below this opening the law is linear: powers below 1 are infinitely steep at 0.
const LINEAR_BELOW: f64 = 1e-4;

impl<T: Real> Law<T> for Shape<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    #[inline(always)]
    fn spool(&self, _memory: &mut [T], command: T, _substep: &Substep<T>) -> T {
        command * command.abs().max(T::splat(LINEAR_BELOW)).pow(self.exponent - T::splat(1.0))
    }
}

impl Effect for ValveFlowShape {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_flow_shape",
            parameters: &[Parameter {
                name: "exponent",
                unit: "1",
                neutral: 1.0,
                range: (0.7, 2.0),
                source: "progressive and degressive notches in data sheets of proportional valves",
            }],
            law: "spool = u |u|^(exponent − 1), linear below 1e-4",
            signature: "strokes at middle speed need another command than the simulation; fast ones and holds hardly",
            equation: Equation::Cap,
        }
    }
    built_by!(Shape::new);
}
