//! Position quantisation: a position transducer of coarse resolution.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Sensing, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct PositionQuantisation;

/// Step, m.
struct Grid<T> {
    step: T,
}

impl<T: Real> Grid<T> {
    fn new(values: &[T]) -> Self {
        Grid { step: values[0] }
    }
}

impl<T: Real> Law<T> for Grid<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    #[inline(always)]
    fn sense(&self, _memory: &mut [T], position: T, _sensing: &Sensing<T>) -> T {
        let rounded = (position / self.step).map(libm::round) * self.step;
        self.step.where_positive(rounded, position)
    }
}

impl Effect for PositionQuantisation {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "position_quantisation",
            parameters: &[Parameter {
                name: "step_m",
                unit: "m",
                neutral: 0.0,
                range: (1e-5, 5e-4),
                source: "encoders and 10 to 16 bit cards over the stroke; 0 means none",
            }],
            law: "measured = step_m · round(x / step_m)",
            signature: "command jumps by Kp times the step; position stands on a grid",
            equation: Equation::Sensor,
        }
    }
    built_by!(Grid::new);
}
