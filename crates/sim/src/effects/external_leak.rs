//! External leak: a weeping rod seal or fitting, chamber to ambient; laminar through a long gap, as an orifice through a crack or a scratch.

use super::turbulent_leak::REFERENCE_PA;
use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Terms, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct ExternalLeak;

/// Conductances at the reference, m³/(s Pa), and half of what the exponent of the pressure is beyond 1.
struct Leak<T> {
    cap: T,
    rod: T,
    half_beyond_linear: T,
}

impl<T: Real> Leak<T> {
    fn new(values: &[T]) -> Self {
        let half_beyond_linear = T::splat(0.5) * (values[2] - T::splat(1.0));
        Leak { cap: values[0], rod: values[1], half_beyond_linear }
    }

    /// Pressure to its exponent, over the reference to what that is beyond 1; regularised as the plant's orifices are.
    #[inline(always)]
    fn to_the_exponent(&self, pressure: T, dp_t_squared: T) -> T {
        let over_reference =
            (pressure * pressure + dp_t_squared) * T::splat(1.0 / (REFERENCE_PA * REFERENCE_PA));
        pressure * over_reference.pow(self.half_beyond_linear)
    }
}

impl<T: Real> Law<T> for Leak<T> {
    #[inline(always)]
    fn act(&self, _memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        let (state, dp_t_squared) = (moment.state, moment.plant.dp_t_squared);
        terms.cap_flow -= self.cap * self.to_the_exponent(state.p_1, dp_t_squared);
        terms.rod_flow -= self.rod * self.to_the_exponent(state.p_2, dp_t_squared);
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
                Parameter {
                    name: "exponent",
                    unit: "1",
                    neutral: 1.0,
                    range: (0.5, 1.0),
                    source: "0.5 is a sharp edge, 1 a long narrow gap",
                },
            ],
            law: "cap flow −= cap_m3_per_s_pa · 7 MPa · (p_1 / 7 MPa)^exponent, rod flow alike with p_2 (to ambient, gauge 0), regularised below \
                  dp_t; laminar where the exponent is 1",
            signature: "holds need a steady command towards the leaking chamber; that chamber's pressure sags",
            equation: Equation::Rod,
        }
    }
    built_by!(Leak::new);
}
