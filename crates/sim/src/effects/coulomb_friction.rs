//! Coulomb friction of seals and guides: a force against the motion that does not depend on its speed.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Terms, built_by, direction};
use crate::real::Real;

/// See the [module](self).
pub(super) struct CoulombFriction;

/// Force, N.
struct Coulomb<T> {
    force: T,
}

impl<T: Real> Coulomb<T> {
    fn new(values: &[T]) -> Self {
        Coulomb { force: values[0] }
    }
}

impl<T: Real> Law<T> for Coulomb<T> {
    #[inline(always)]
    fn act(&self, _memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        let state = moment.state;
        terms.force -= self.force * direction(state.v);
    }
}

impl Effect for CoulombFriction {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "coulomb_friction",
            parameters: &[Parameter {
                name: "force_n",
                unit: "N",
                neutral: 0.0,
                range: (0.0, 5e3),
                source: "Jelali & Kroll, Hydraulic Servo-systems (2003), ch. 4: to 10 % of the cylinder's force, 50 kN at 16 MPa",
            }],
            law: "force −= force_n · tanh(v / 5 mm/s) (regularised Coulomb law)",
            signature: "pressure difference steps by force over area at every reversal; same size at every speed",
            equation: Equation::Force,
        }
    }
    built_by!(Coulomb::new);
}
