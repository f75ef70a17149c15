//! Accumulator: a gas accumulator at the supply that the plan leaves out.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Softening, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct Accumulator;

/// Gas volume, m³, and precharge, Pa gauge.
struct GasSpring<T> {
    volume: T,
    precharge: T,
}

/// Atmospheric pressure, Pa, and the polytropic exponent of nitrogen within seconds.
const ATMOSPHERE_PA: f64 = 101_325.0;
const POLYTROPIC: f64 = 1.3;

impl<T: Real> GasSpring<T> {
    fn new(values: &[T]) -> Self {
        GasSpring { volume: values[0], precharge: values[1] }
    }
}

impl<T: Real> Law<T> for GasSpring<T> {
    fn softens(&self) -> bool {
        true
    }

    #[inline(always)]
    fn soften(&self, moment: &Moment<'_, T>, softening: &mut Softening<T>) {
        let p = moment.state.p_s;
        // V = V_0 (p_0 / p)^(1/n) above the precharge; its compliance −dV/dp beside V_s / β.
        let (p, p_0) = (p + T::splat(ATMOSPHERE_PA), self.precharge + T::splat(ATMOSPHERE_PA));
        let gas = self.volume * (p_0 / p).pow(T::splat(1.0 / POLYTROPIC));
        let compliance = (p - p_0).where_positive(gas / (p * T::splat(POLYTROPIC)), T::splat(0.0));
        softening.supply = softening.supply * (T::splat(1.0) + compliance * moment.plant.beta_over_v_s);
    }
}

impl Effect for Accumulator {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "accumulator",
            parameters: &[
                Parameter {
                    name: "volume_m3",
                    unit: "m3",
                    neutral: 0.0,
                    range: (0.0, 4e-3),
                    source: "bladder accumulators of 0.5 to 4 L",
                },
                Parameter {
                    name: "precharge_pa",
                    unit: "Pa",
                    neutral: 9e6,
                    range: (5e6, 1.5e7),
                    source: "half to nine tenths of the working pressure",
                },
            ],
            law: "gas spring of volume_m3 at precharge_pa, exponent 1.3, beside the volume V_s",
            signature: "the supply pressure follows draws of flow slowly and smoothly",
            equation: Equation::Supply,
        }
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[0] == 0.0
    }
    built_by!(GasSpring::new);
}
