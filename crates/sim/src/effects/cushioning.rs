//! Cushioning: end cushions that throttle the outlet over the last millimetres.

use super::{Effect, EffectInfo, Equation, Law, Moment, Openings, Parameter, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct Cushioning;

/// Length, m, and share of the outlet that is left at the stop.
struct Cushion<T> {
    length: T,
    ratio: T,
}

impl<T: Real> Cushion<T> {
    fn new(values: &[T]) -> Self {
        Cushion { length: values[0], ratio: values[1] }
    }

    /// Share of the outlet that is open at a distance from the stop.
    #[inline(always)]
    fn share(&self, distance: T) -> T {
        let (zero, one) = (T::splat(0.0), T::splat(1.0));
        let way = (distance / self.length).max(zero).min(one);
        self.length.where_positive(self.ratio + (one - self.ratio) * way, one)
    }
}

impl<T: Real> Law<T> for Cushion<T> {
    #[inline(always)]
    fn open(&self, moment: &Moment<'_, T>, openings: &mut Openings<T>) {
        let one = T::splat(1.0);
        let (x, u) = (moment.state.x, moment.spool);
        openings.rod = openings.rod * u.where_positive(self.share(moment.plant.stroke - x), one);
        openings.cap = openings.cap * u.where_positive(one, self.share(x));
    }
}

impl Effect for Cushioning {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "cushioning",
            parameters: &[
                Parameter {
                    name: "length_m",
                    unit: "m",
                    neutral: 0.0,
                    range: (0.0, 0.03),
                    source: "cushions of standard cylinders (ISO 6020) are 15 to 30 mm long",
                },
                Parameter {
                    name: "flow_ratio",
                    unit: "1",
                    neutral: 1.0,
                    range: (0.05, 1.0),
                    source: "adjustable throttles close to a twentieth",
                },
            ],
            law: "return k_v of the chamber before the stop · (flow_ratio + (1 − flow_ratio) · distance / length_m) within length_m of it",
            signature: "strokes slow down before the end stops; nothing elsewhere",
            equation: Equation::Cap,
        }
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[0] == 0.0 || values[1] == 1.0
    }
    built_by!(Cushion::new);
}
