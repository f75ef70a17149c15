//! Valve wear: eroded metering edges leak over all four lands around the centre.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Terms, built_by};
use crate::plant::sq;
use crate::real::Real;

/// See the [module](self).
pub(super) struct ValveWear;

/// Coefficient at the centre, m³/s/√Pa, and the command over which it decays.
struct Wear<T> {
    coefficient: T,
    decay: T,
}

/// Pressure difference at which the land's flow is stated, Pa.
const REFERENCE_PA: f64 = 7e6;

impl<T: Real> Wear<T> {
    fn new(values: &[T]) -> Self {
        // Neutral lanes have no decay length.
        let decay = values[1].max(T::splat(1e-3));
        Wear { coefficient: values[0] * T::splat(1.0 / REFERENCE_PA.sqrt()), decay }
    }
}

impl<T: Real> Law<T> for Wear<T> {
    #[inline(always)]
    fn act(&self, _memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        let (state, plant) = (moment.state, moment.plant);
        let k = self.coefficient * (-moment.spool.abs() / self.decay).exp();
        let land = |dp: T| sq(k, dp, plant.dp_t_squared);
        let (to_cap, to_rod) = (land(state.p_3 - state.p_1), land(state.p_3 - state.p_2));
        let (from_cap, from_rod) = (land(state.p_1 - plant.p_r), land(state.p_2 - plant.p_r));
        terms.inlet_flow -= to_cap + to_rod;
        terms.cap_flow += to_cap - from_cap;
        terms.rod_flow += to_rod - from_rod;
    }
}

impl Effect for ValveWear {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_wear",
            parameters: &[
                Parameter {
                    name: "land_flow_m3_per_s",
                    unit: "m3/s",
                    neutral: 0.0,
                    range: (0.0, 3e-5),
                    source: "a worn valve leaks to 2 L/min a land at 7 MPa",
                },
                Parameter {
                    name: "decay_command",
                    unit: "1",
                    neutral: 0.0,
                    range: (0.01, 0.2),
                    source: "underlap and erosion reach over 1 to 20 % of the travel",
                },
            ],
            law: "each land passes land_flow · √(Δp / 7 MPa) · e^(−|spool| / decay_command) beside its metered flow",
            signature: "chamber pressures in the holds go to half of the supply; the command near zero has less to do",
            equation: Equation::Cap,
        }
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[0] == 0.0
    }
    built_by!(Wear::new);
}
