//! Return back pressure: filter, cooler or narrow pipe in the return line.

use super::{Effect, EffectInfo, Equation, Law, Moment, Openings, Parameter, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct ReturnBackPressure;

/// Pressure over flow squared, Pa s²/m⁶.
struct BackPressure<T> {
    k: T,
}

impl<T: Real> BackPressure<T> {
    fn new(values: &[T]) -> Self {
        BackPressure { k: values[0] }
    }

    /// Land and line in series: q = K √(Δp − k q²) is q = K / √(1 + k K²) · √Δp.
    #[inline(always)]
    fn in_series(&self, opening: T) -> T {
        opening / (T::splat(1.0) + self.k * opening * opening).sqrt()
    }
}

impl<T: Real> Law<T> for BackPressure<T> {
    #[inline(always)]
    fn open(&self, moment: &Moment<'_, T>, openings: &mut Openings<T>) {
        let u = moment.spool;
        openings.rod = u.where_positive(self.in_series(openings.rod), openings.rod);
        openings.cap = u.where_positive(openings.cap, self.in_series(openings.cap));
    }
}

impl Effect for ReturnBackPressure {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "return_back_pressure",
            parameters: &[Parameter {
                name: "k_pa_s2_per_m6",
                unit: "Pa s2/m6",
                neutral: 0.0,
                range: (0.0, 1.5e12),
                source: "1.5 MPa at 1e-3 m³/s: a return filter at its bypass",
            }],
            law: "return pressure p_r + k_pa_s2_per_m6 · q² behind the metering-out land, in series with it",
            signature: "the outlet chamber stands higher in fast strokes; nothing in the holds",
            equation: Equation::Rod,
        }
    }
    built_by!(BackPressure::new);
}
