//! Valve asymmetry: lands of different width: valves for cylinders of unequal areas, or one worn edge.

use super::{Effect, EffectInfo, Equation, Law, Moment, Openings, Parameter, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct ValveAsymmetry;

/// Ratios of the lands to the inlet land of the cap side.
struct Lands<T> {
    b_side: T,
    return_side: T,
}

impl<T: Real> Lands<T> {
    fn new(values: &[T]) -> Self {
        Lands { b_side: values[0], return_side: values[1] }
    }
}

impl<T: Real> Law<T> for Lands<T> {
    #[inline(always)]
    fn open(&self, moment: &Moment<'_, T>, openings: &mut Openings<T>) {
        let one = T::splat(1.0);
        openings.cap = openings.cap * moment.spool.where_positive(one, self.return_side);
        openings.rod = openings.rod * self.b_side * moment.spool.where_positive(self.return_side, one);
    }
}

impl Effect for ValveAsymmetry {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_asymmetry",
            parameters: &[
                Parameter {
                    name: "b_side_ratio",
                    unit: "1",
                    neutral: 1.0,
                    range: (0.7, 1.3),
                    source: "valves for 2 : 1 cylinders have 0.5; worn edges and tolerances within 30 %",
                },
                Parameter {
                    name: "return_ratio",
                    unit: "1",
                    neutral: 1.0,
                    range: (0.7, 1.3),
                    source: "metering-out edges are ground within 30 % of the metering-in edges",
                },
            ],
            law: "k_v of P→A: 1, P→B: b_side_ratio, A→T: return_ratio, B→T: b_side_ratio · return_ratio",
            signature: "extending and retracting need different factors on the command; pressures shift between the chambers",
            equation: Equation::Cap,
        }
    }
    built_by!(Lands::new);
}
