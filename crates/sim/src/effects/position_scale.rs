//! Position scale: a position sensor whose scale is off.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Sensing, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct PositionScale;

/// Reading over truth.
struct ScaleFactor<T> {
    factor: T,
}

impl<T: Real> ScaleFactor<T> {
    fn new(values: &[T]) -> Self {
        ScaleFactor { factor: values[0] }
    }
}

impl<T: Real> Law<T> for ScaleFactor<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    #[inline(always)]
    fn sense(&self, _memory: &mut [T], position: T, _sensing: &Sensing<T>) -> T {
        position * self.factor
    }
}

impl Effect for PositionScale {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "position_scale",
            parameters: &[Parameter {
                name: "factor",
                unit: "1",
                neutral: 1.0,
                range: (0.95, 1.05),
                source: "wrong scaling of a transducer card, or a belt drive worn",
            }],
            law: "measured = factor · x",
            signature: "strokes are longer or shorter than measured: volumes and speeds are off by the factor",
            equation: Equation::Sensor,
        }
    }
    built_by!(ScaleFactor::new);
}
