//! The position controller: what is logged is what it sends to the valve.

use serde::{Deserialize, Serialize};

/// Command before compensation within which the jump over the dead band grows, share of full command.
const JUMP_WITHIN: f64 = 5e-3;

/// Proportional, integral and derivative gain, feed-forward, and a jump over the valve's dead band.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Controller {
    /// Proportional gain, 1/m.
    pub kp_per_m: f64,
    /// Integral gain, 1/(m s); 0 without one.
    pub ki_per_m_s: f64,
    /// Derivative gain on the measured position, s/m; 0 without one.
    pub kd_s_per_m: f64,
    /// Command per speed of the demand, s/m; 0 without one.
    pub feed_forward_s_per_m: f64,
    /// Height of the jump around the null, share of full command; 0 without one.
    pub jump: f64,
    /// Period of its task, s.
    pub period_s: f64,
}

/// What the controller keeps.
#[derive(Debug, Clone)]
pub(super) struct ControllerState {
    integral: f64,
    position_m: f64,
}

impl ControllerState {
    pub(super) fn at(position_m: f64) -> Self {
        ControllerState { integral: 0.0, position_m }
    }
}

impl Controller {
    /// The command of a tick.
    pub(super) fn tick(
        &self,
        state: &mut ControllerState,
        demand_m: f64,
        demand_m_per_s: f64,
        position_m: f64,
    ) -> f64 {
        let error_m = demand_m - position_m;
        let speed = (position_m - state.position_m) / self.period_s;
        state.position_m = position_m;
        let direct =
            self.kp_per_m * error_m - self.kd_s_per_m * speed + self.feed_forward_s_per_m * demand_m_per_s;
        let integral = state.integral + self.ki_per_m_s * error_m * self.period_s;
        // It stops where it would drive a full command further.
        if (direct + integral).abs() < 1.0 || (direct + integral) * error_m < 0.0 {
            state.integral = integral;
        }
        let plain = direct + state.integral;
        (plain + self.jump * (plain / JUMP_WITHIN).clamp(-1.0, 1.0)).clamp(-1.0, 1.0)
    }
}
