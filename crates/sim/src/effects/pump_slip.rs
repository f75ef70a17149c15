//! Pump slip: internal leakage of a worn pump.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Terms, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct PumpSlip;

/// Conductance, m³/(s Pa).
struct Slip<T> {
    leakage: T,
}

impl<T: Real> Slip<T> {
    fn new(values: &[T]) -> Self {
        Slip { leakage: values[0] }
    }
}

impl<T: Real> Law<T> for Slip<T> {
    #[inline(always)]
    fn act(&self, _memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        terms.supply_flow -= self.leakage * moment.state.p_s;
    }
}

impl Effect for PumpSlip {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "pump_slip",
            parameters: &[Parameter {
                name: "leakage_m3_per_s_pa",
                unit: "m3/(s Pa)",
                neutral: 0.0,
                range: (0.0, 3e-11),
                source: "a worn pump of 90 L/min loses a third at 16 MPa",
            }],
            law: "supply flow −= leakage_m3_per_s_pa · p_s",
            signature: "the supply pressure is lower, as with a smaller pump; while the relief valve is open nothing else",
            equation: Equation::Supply,
        }
    }
    built_by!(Slip::new);
}
