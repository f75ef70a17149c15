//! Turbulent leak: a leak whose flow law is not that of an orifice: long gaps are laminar.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Terms, built_by};
use crate::plant::sq;
use crate::real::Real;

/// See the [module](self).
pub(super) struct TurbulentLeak;

/// Exponent of the pressure difference, and what makes both laws pass the same at the reference.
struct LeakLaw<T> {
    exponent: T,
    at_reference: T,
}

/// Pressure difference at which leaks of every law pass the same, Pa.
pub(super) const REFERENCE_PA: f64 = 7e6;

impl<T: Real> LeakLaw<T> {
    fn new(values: &[T]) -> Self {
        let exponent = values[0];
        LeakLaw { exponent, at_reference: T::splat(REFERENCE_PA).pow(T::splat(0.5) - exponent) }
    }
}

impl<T: Real> Law<T> for LeakLaw<T> {
    #[inline(always)]
    fn act(&self, _memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        let plant = moment.plant;
        let dp = moment.state.p_1 - moment.state.p_2;
        let k = plant.k_leak_per_area * moment.a_leak;
        let orifice = sq(k, dp, plant.dp_t_squared);
        let magnitude = dp * dp + plant.dp_t_squared;
        let scale = self.at_reference * magnitude.pow(T::splat(0.5) * (self.exponent - T::splat(1.0)));
        let zero = T::splat(0.0);
        let more = (self.exponent - T::splat(0.5)).where_positive(k * dp * scale - orifice, zero);
        terms.cap_flow -= more;
        terms.rod_flow += more;
    }
}

impl Effect for TurbulentLeak {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "turbulent_leak",
            parameters: &[Parameter {
                name: "exponent",
                unit: "1",
                neutral: 0.5,
                range: (0.5, 1.0),
                source: "0.5 is a sharp edge, 1 a long narrow gap",
            }],
            law: "leak = C_d A √(2/ρ) · √(7 MPa) · (Δp / 7 MPa)^exponent, regularised below dp_t; equal to the orifice at 7 MPa",
            signature: "the leak's share differs between phases of high and of low pressure difference; nothing without a leak",
            equation: Equation::Cap,
        }
    }
    built_by!(LeakLaw::new);
}
