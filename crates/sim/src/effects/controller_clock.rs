//! Controller clock: a controller whose ticks are not as long as its gains and time stamps assume.

use super::{Constants, Effect, EffectInfo, Equation, Law, Parameter, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct ControllerClock;

/// True length of a tick that is taken for 1 ms, s.
struct Clock<T> {
    period: T,
}

/// The period that the controller assumes, s; for controllers of another period the ratio counts.
const ASSUMED_S: f64 = 1e-3;

impl<T: Real> Clock<T> {
    fn new(values: &[T]) -> Self {
        Clock { period: values[0] }
    }
}

impl<T: Real> Law<T> for Clock<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    fn adjust(&self, constants: &mut Constants<'_, T>) {
        *constants.dt = *constants.dt * (self.period / T::splat(ASSUMED_S));
    }
}

impl Effect for ControllerClock {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "controller_clock",
            parameters: &[Parameter {
                name: "period_s",
                unit: "s",
                neutral: 1e-3,
                range: (0.9e-3, 1.1e-3),
                source: "a task cycle that is set 10 % off, or timers without a quartz",
            }],
            law: "each tick lasts period_s / 1 ms times the planned period; integrator, derivative and time stamps assume the plan",
            signature: "the machine seems faster or slower than the simulation in all that it does, strokes and settling alike",
            equation: Equation::Controller,
        }
    }
    built_by!(Clock::new);
}
