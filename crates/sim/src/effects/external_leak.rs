//! External leak: a weeping rod seal or fitting, chamber to ambient, laminar.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Terms, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct ExternalLeak;

/// Conductances, m³/(s Pa).
struct Leak<T> {
    cap: T,
    rod: T,
}

impl<T: Real> Leak<T> {
    fn new(values: &[T]) -> Self {
        Leak { cap: values[0], rod: values[1] }
    }
}

impl<T: Real> Law<T> for Leak<T> {
    #[inline(always)]
    fn act(&self, _memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        let state = moment.state;
        terms.cap_flow -= self.cap * state.p_1;
        terms.rod_flow -= self.rod * state.p_2;
    }
}

/// Range of both conductances.
const RANGE: (f64, f64) = (0.0, 1e-11);
const SOURCE: &str = "1e-11 m³/(s Pa) passes 6 L/min at 10 MPa, above which a machine is stopped on sight";

impl Effect for ExternalLeak {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "external_leak",
            parameters: &[
                Parameter {
                    name: "cap_m3_per_s_pa",
                    unit: "m3/(s Pa)",
                    neutral: 0.0,
                    range: RANGE,
                    source: SOURCE,
                },
                Parameter {
                    name: "rod_m3_per_s_pa",
                    unit: "m3/(s Pa)",
                    neutral: 0.0,
                    range: RANGE,
                    source: SOURCE,
                },
            ],
            law: "cap flow −= cap_m3_per_s_pa · p_1, rod flow −= rod_m3_per_s_pa · p_2 (laminar gap to ambient, gauge 0)",
            signature: "holds need a steady command towards the leaking chamber; that chamber's pressure sags",
            equation: Equation::Rod,
        }
    }
    built_by!(Leak::new);
}
