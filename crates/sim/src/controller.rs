//! The 1 kHz PID position controller whose output is the PID valve command.

use serde::{Deserialize, Serialize};

use crate::real::Real;

/// Gains and period: the `[controller]` table of `plant.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Controller {
    /// Proportional gain, 1/m.
    #[serde(alias = "Kp")]
    pub kp: f64,
    /// Integral gain, 1/(m s).
    #[serde(alias = "Ki")]
    pub ki: f64,
    /// Derivative gain on the measured position, s/m.
    #[serde(alias = "Kd")]
    pub kd: f64,
    /// Period, s.
    pub period_s: f64,
    /// RK4 steps of the plant in a period.
    pub steps_per_period: usize,
}

impl Default for Controller {
    fn default() -> Self {
        Controller { kp: 12.0, ki: 15.0, kd: 0.0, period_s: 1e-3, steps_per_period: 10 }
    }
}

/// The controller of one machine or of several in lanes.
#[derive(Debug, Clone)]
pub(crate) struct Pid<T> {
    pub(crate) kp: T,
    pub(crate) ki_period: T,
    pub(crate) kd_per_period: T,
}

/// What the controller remembers from tick to tick.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PidState<T> {
    /// Integrator, share of full command.
    integral: T,
    /// Position at the last tick, m.
    position: T,
}

impl<T: Real> Pid<T> {
    pub(crate) fn new(machines: &[&Controller]) -> Self {
        let each = |value: &dyn Fn(&Controller) -> f64| {
            T::from_lanes(|lane| value(machines[lane.min(machines.len() - 1)]))
        };
        Pid {
            kp: each(&|c| c.kp),
            ki_period: each(&|c| c.ki * c.period_s),
            kd_per_period: each(&|c| c.kd / c.period_s),
        }
    }

    pub(crate) fn start(&self, position: T) -> PidState<T> {
        PidState { integral: T::splat(0.0), position }
    }

    /// One tick: the command in shares of full command. The integrator stands while the output is saturated
    /// and the error would drive it further (conditional integration).
    #[inline(always)]
    pub(crate) fn tick(&self, state: &mut PidState<T>, demand: T, position: T) -> T {
        let one = T::splat(1.0);
        let e = demand - position;
        let increment = self.ki_period * e;
        let integrated = state.integral + increment;
        let others = self.kp * e - self.kd_per_period * (position - state.position);
        let u = others + integrated;
        // Saturated, and with the error's sign: |u| > 1 and u e > 0.
        let driven_further =
            (u.abs() - one).where_positive((u * e).where_positive(one, T::splat(0.0)), T::splat(0.0));
        state.integral = driven_further.where_positive(state.integral, integrated);
        state.position = position;
        (others + state.integral).max(-one).min(one)
    }
}
