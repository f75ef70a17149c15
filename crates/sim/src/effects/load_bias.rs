//! Load bias: weight, counterbalance or preload that the load signal does not show.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Terms, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct LoadBias;

/// Force, N.
struct Offset<T> {
    force: T,
}

impl<T: Real> Offset<T> {
    fn new(values: &[T]) -> Self {
        Offset { force: values[0] }
    }
}

impl<T: Real> Law<T> for Offset<T> {
    #[inline(always)]
    fn act(&self, _memory: &[T], _moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        terms.force += self.force;
    }
}

impl Effect for LoadBias {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "load_bias",
            parameters: &[Parameter {
                name: "force_n",
                unit: "N",
                neutral: 0.0,
                range: (-5e3, 5e3),
                source: "the weight of 500 kg of tooling",
            }],
            law: "force += force_n",
            signature: "pressure difference is off by the same amount in every phase",
            equation: Equation::Force,
        }
    }
    built_by!(Offset::new);
}
