//! Spring load: springs, gas struts or elastic tooling that push back with the position.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Terms, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct SpringLoad;

/// Stiffness, N/m, and the position without force, m.
struct Spring<T> {
    stiffness: T,
    neutral_position: T,
}

impl<T: Real> Spring<T> {
    fn new(values: &[T]) -> Self {
        Spring { stiffness: values[0], neutral_position: values[1] }
    }
}

impl<T: Real> Law<T> for Spring<T> {
    #[inline(always)]
    fn act(&self, _memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        terms.force -= self.stiffness * (moment.state.x - self.neutral_position);
    }
}

impl Effect for SpringLoad {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "spring_load",
            parameters: &[
                Parameter {
                    name: "stiffness_n_per_m",
                    unit: "N/m",
                    neutral: 0.0,
                    range: (0.0, 6e4),
                    source: "the article's text names a spring load that its equation lacks; 60 kN/m is 30 kN over the stroke",
                },
                Parameter {
                    name: "neutral_position_m",
                    unit: "m",
                    neutral: 0.0,
                    range: (0.0, 0.5),
                    source: "anywhere along the stroke",
                },
            ],
            law: "force −= stiffness_n_per_m · (x − neutral_position_m)",
            signature: "pressure difference grows with the position, in holds and strokes alike",
            equation: Equation::Force,
        }
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[0] == 0.0
    }
    built_by!(Spring::new);
}
