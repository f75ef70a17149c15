//! Shared supply: another consumer on the same pump in a part of the cycle.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Terms, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct SharedSupply;

/// Flow, m³/s, and when in the cycle, s.
struct Consumer<T> {
    flow: T,
    start: T,
    end: T,
}

/// Time over which the consumer opens and closes, s.
const RAMP_S: f64 = 0.02;

impl<T: Real> Consumer<T> {
    fn new(values: &[T]) -> Self {
        Consumer { flow: values[0], start: values[1], end: values[1] + values[2] }
    }
}

impl<T: Real> Law<T> for Consumer<T> {
    #[inline(always)]
    fn act(&self, _memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        let (zero, one, ramp) = (T::splat(0.0), T::splat(1.0), T::splat(1.0 / RAMP_S));
        let since = ((moment.at - self.start) * ramp).max(zero).min(one);
        let left = ((self.end - moment.at) * ramp).max(zero).min(one);
        // Never more than the node has: the consumer starves with the supply.
        let pressed = (moment.state.p_s * T::splat(1e-6)).max(zero).min(one);
        terms.supply_flow -= self.flow * since * left * pressed;
    }
}

impl Effect for SharedSupply {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "shared_supply",
            parameters: &[
                Parameter {
                    name: "flow_m3_per_s",
                    unit: "m3/s",
                    neutral: 0.0,
                    range: (0.0, 1e-3),
                    source: "two thirds of the pump",
                },
                Parameter {
                    name: "start_s",
                    unit: "s",
                    neutral: 0.0,
                    range: (0.0, 3600.0),
                    source: "within the cycle",
                },
                Parameter {
                    name: "duration_s",
                    unit: "s",
                    neutral: 0.0,
                    range: (0.0, 3600.0),
                    source: "within the cycle",
                },
            ],
            law: "supply flow −= flow_m3_per_s from start_s for duration_s in the cycle, with ramps of 20 ms",
            signature: "the supply pressure sags in one part of the cycle whatever the axis does",
            equation: Equation::Supply,
        }
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[0] == 0.0 || values[2] == 0.0
    }
    built_by!(Consumer::new);
}
