//! Spring load: springs, gas struts or elastic tooling that push back with the position, and harder the further they are compressed where they
//! are progressive.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Terms, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct SpringLoad;

/// Stiffness, N/m, the position without force, m, and half of what the stiffness gains by way, 1/m.
struct Spring<T> {
    stiffness: T,
    neutral_position: T,
    half_progression: T,
}

impl<T: Real> Spring<T> {
    fn new(values: &[T]) -> Self {
        Spring {
            stiffness: values[0],
            neutral_position: values[1],
            half_progression: T::splat(0.5) * values[2],
        }
    }
}

impl<T: Real> Law<T> for Spring<T> {
    /// The factor of a spring that is not progressive is 1 to the bit.
    #[inline(always)]
    fn act(&self, _memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        let way = moment.state.x - self.neutral_position;
        terms.force -= self.stiffness * way * (T::splat(1.0) + self.half_progression * way.abs());
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
                Parameter {
                    name: "progression_per_m",
                    unit: "1/m",
                    neutral: 0.0,
                    range: (0.0, 20.0),
                    source: "progressive springs of dies and elastomer buffers: the stiffness grows to some ten times over the stroke",
                },
            ],
            law: "force −= stiffness_n_per_m · y · (1 + ½ progression_per_m · |y|), y = x − neutral_position_m",
            signature: "pressure difference grows with the position, in holds and strokes alike",
            equation: Equation::Force,
        }
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[0] == 0.0
    }
    built_by!(Spring::new);
}
