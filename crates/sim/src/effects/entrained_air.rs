//! Entrained air: free air in the oil, which makes it soft at low pressure.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Softening, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct EntrainedAir;

/// Volume fraction of free gas at atmospheric pressure.
struct Air<T> {
    fraction: T,
}

/// Atmospheric pressure, Pa, and the polytropic exponent of bubbles between isothermal and adiabatic.
const ATMOSPHERE_PA: f64 = 101_325.0;
const POLYTROPIC: f64 = 1.2;

impl<T: Real> Air<T> {
    fn new(values: &[T]) -> Self {
        Air { fraction: values[0] }
    }
}

impl<T: Real> Law<T> for Air<T> {
    fn softens(&self) -> bool {
        true
    }

    #[inline(always)]
    fn soften(&self, moment: &Moment<'_, T>, softening: &mut Softening<T>) {
        let share = self.fraction * moment.plant.beta * T::splat(ATMOSPHERE_PA / POLYTROPIC);
        let one = T::splat(1.0);
        let of = |p: T| {
            let absolute = p.max(T::splat(0.0)) + T::splat(ATMOSPHERE_PA);
            one + share / (absolute * absolute)
        };
        let state = moment.state;
        softening.supply = softening.supply * of(state.p_s);
        softening.inlet = softening.inlet * of(state.p_3);
        softening.cap = softening.cap * of(state.p_1);
        softening.rod = softening.rod * of(state.p_2);
    }
}

impl Effect for EntrainedAir {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "entrained_air",
            parameters: &[Parameter {
                name: "fraction",
                unit: "1",
                neutral: 0.0,
                range: (0.0, 0.05),
                source: "Murrenhoff, Grundlagen der Fluidtechnik (2001): 1 to 5 % in running systems",
            }],
            law: "1/β_eff = 1/β + fraction · p_atm / (1.2 · p_abs²) in every volume",
            signature: "pressures build up late after each reversal, most in chambers at low pressure",
            equation: Equation::Cap,
        }
    }
    built_by!(Air::new);
}
