//! Pressure friction: seals pressed on by the pressure they hold.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Terms, built_by, direction};
use crate::real::Real;

/// See the [module](self).
pub(super) struct PressureFriction;

/// Share of the pressure force.
struct SealForce<T> {
    coefficient: T,
}

impl<T: Real> SealForce<T> {
    fn new(values: &[T]) -> Self {
        SealForce { coefficient: values[0] }
    }
}

impl<T: Real> Law<T> for SealForce<T> {
    #[inline(always)]
    fn act(&self, _memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        let (state, plant) = (moment.state, moment.plant);
        let normal = (state.p_1 - state.p_2).abs() * plant.a_cap;
        let sign = direction(state.v);
        terms.force -= self.coefficient * normal * sign;
    }
}

impl Effect for PressureFriction {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "pressure_friction",
            parameters: &[Parameter {
                name: "coefficient",
                unit: "1",
                neutral: 0.0,
                range: (0.0, 0.1),
                source: "Jelali & Kroll, Hydraulic Servo-systems (2003), ch. 4: seals lose to 10 % of the pressure force",
            }],
            law: "force −= coefficient · |p_1 − p_2| A_cap · tanh(v / 5 mm/s)",
            signature: "friction that is larger in the press stroke than in the free strokes",
            equation: Equation::Force,
        }
    }
    built_by!(SealForce::new);
}
