//! Stribeck friction: seals and guides that stick more at rest than in motion.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Terms, built_by, direction};
use crate::real::Real;

/// See the [module](self).
pub(super) struct StribeckFriction;

/// Forces at speed and at rest, N, and the speed between them, m/s.
struct Stribeck<T> {
    force: T,
    static_force: T,
    speed: T,
}

impl<T: Real> Stribeck<T> {
    fn new(values: &[T]) -> Self {
        // Neutral lanes have no speed.
        Stribeck { force: values[0], static_force: values[1], speed: values[2].max(T::splat(1e-4)) }
    }
}

impl<T: Real> Law<T> for Stribeck<T> {
    #[inline(always)]
    fn act(&self, _memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        let v = moment.state.v;
        let share = v / self.speed;
        let added = (self.static_force - self.force).max(T::splat(0.0)) * (-(share * share)).exp();
        let sign = direction(v);
        terms.force -= (self.force + added) * sign;
    }
}

impl Effect for StribeckFriction {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "stribeck_friction",
            parameters: &[
                Parameter {
                    name: "force_n",
                    unit: "N",
                    neutral: 0.0,
                    range: (0.0, 5e3),
                    source: "Jelali & Kroll, Hydraulic Servo-systems (2003), ch. 4: as Coulomb friction",
                },
                Parameter {
                    name: "static_force_n",
                    unit: "N",
                    neutral: 0.0,
                    range: (0.0, 8e3),
                    source: "Jelali & Kroll, Hydraulic Servo-systems (2003), ch. 4: to 1.6 times the force in motion",
                },
                Parameter {
                    name: "stribeck_speed_m_per_s",
                    unit: "m/s",
                    neutral: 0.0,
                    range: (5e-3, 0.1),
                    source: "Armstrong-Hélouvry, Control of Machines with Friction (1991): 5 to 100 mm/s for lubricated seals",
                },
            ],
            law: "force −= (F_c + max(F_s − F_c, 0) e^(−(v / v_s)²)) tanh(v / 5 mm/s)",
            signature: "pressure difference peaks as each stroke begins and ends, more than it steps at reversal",
            equation: Equation::Force,
        }
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[0] == 0.0 && values[1] == 0.0
    }
    built_by!(Stribeck::new);
}
