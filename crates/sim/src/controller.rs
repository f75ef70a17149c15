//! The 1 kHz PID position controller whose output is the PID valve command.

use serde::{Deserialize, Serialize};

use crate::real::Real;

/// What makes the command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ControllerKind {
    /// A PID position controller.
    #[default]
    Pid,
    /// Nothing within the machine: the recorded command drives the plant, and there is no demand.
    None,
}

/// Gains and period: the `[controller]` table of `plant.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Controller {
    /// What makes the command.
    #[serde(skip_serializing_if = "is_usual")]
    pub kind: ControllerKind,
    /// Proportional gain, 1/m.
    #[serde(alias = "Kp")]
    pub kp: f64,
    /// Integral gain, 1/(m s).
    #[serde(alias = "Ki")]
    pub ki: f64,
    /// Derivative gain on the measured position, s/m.
    #[serde(alias = "Kd")]
    pub kd: f64,
    /// Velocity feed-forward: command per speed of the demand, s/m.
    #[serde(skip_serializing_if = "is_zero")]
    pub velocity_feed_forward_s_per_m: f64,
    /// Jump of the command over the valve's dead band, share of full command.
    #[serde(skip_serializing_if = "is_zero")]
    pub dead_band_compensation: f64,
    /// Position error below which the integrator works, m; it holds what it has beyond. 0: it always works.
    #[serde(skip_serializing_if = "is_zero")]
    pub integral_window_m: f64,
    /// Period, s.
    pub period_s: f64,
    /// Periods from one command in the log to the next.
    #[serde(skip_serializing_if = "is_one")]
    pub log_every: usize,
    /// RK4 steps of the plant in a period.
    pub steps_per_period: usize,
}

/// What a file leaves out.
pub(crate) fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

fn is_usual(kind: &ControllerKind) -> bool {
    *kind == ControllerKind::default()
}

fn is_one(value: &usize) -> bool {
    *value == 1
}

/// Command, before the jump, at which the compensation of the dead band is whole, share of full command: below it, it is a steep line, so
/// that the command does not chatter at rest.
const COMPENSATED_FROM: f64 = 0.003;

/// Time constants after which the integrator's start is forgotten.
const FORGOTTEN: f64 = 3.0;

impl Default for Controller {
    fn default() -> Self {
        Controller {
            kind: ControllerKind::Pid,
            kp: 12.0,
            ki: 15.0,
            kd: 0.0,
            velocity_feed_forward_s_per_m: 0.0,
            dead_band_compensation: 0.0,
            integral_window_m: 0.0,
            period_s: 1e-3,
            log_every: 1,
            steps_per_period: 10,
        }
    }
}

impl Controller {
    /// Whether the machine is driven open loop.
    pub fn is_none(&self) -> bool {
        self.kind == ControllerKind::None
    }

    /// Time from one command in the log to the next, s.
    pub fn log_period_s(&self) -> f64 {
        self.period_s * self.log_every as f64
    }

    /// Position error from which on the integrator stands, m.
    fn integrates_below_m(&self) -> f64 {
        if self.integral_window_m > 0.0 { self.integral_window_m } else { f64::MAX }
    }

    /// What the control law gave before the jump over the dead band.
    pub fn uncompensated(&self, command: f64) -> f64 {
        uncompensated(command, self.dead_band_compensation)
    }

    /// What it must have been asked for, m, tick by tick, to give those commands at those positions: the PID law with its feed-forward solved
    /// for the error. What the integrator held at the start is forgotten with Kp/Ki, where the demand came from with the feed-forward over Kp;
    /// until then, or for three tenths of a cycle of that length, NaN. An integrator with a window forgets within it only.
    pub fn asked_m(&self, command: &[f64], position_m: &[f64], cycle_s: f64) -> Vec<f64> {
        let of_the_integrator_s = if self.ki > 0.0 { self.kp / self.ki } else { 0.0 };
        let of_the_demand_s = self.velocity_feed_forward_s_per_m / self.kp.max(f64::MIN_POSITIVE);
        let unsure_s = (FORGOTTEN * of_the_integrator_s.max(of_the_demand_s)).min(0.3 * cycle_s);
        let unsure = (unsure_s / self.period_s) as usize;
        let (mut integral, mut before) = (0.0, position_m.first().copied().unwrap_or(0.0));
        let mut asked_before = before;
        let per_step = self.velocity_feed_forward_s_per_m / self.period_s;
        let of = |(tick, (u, x)): (usize, (&f64, &f64))| {
            if !(u.is_finite() && x.is_finite()) {
                return f64::NAN;
            }
            let braking = self.kd * (x - before) / self.period_s;
            let u = self.uncompensated(*u);
            let of_no_error = u - integral + braking - per_step * (x - asked_before);
            let error_with =
                |ki: f64| of_no_error / (self.kp + ki * self.period_s + per_step).max(f64::MIN_POSITIVE);
            let integrating = error_with(self.ki);
            let ki = if integrating.abs() < self.integrates_below_m() { self.ki } else { 0.0 };
            let error = error_with(ki);
            integral += ki * self.period_s * error;
            before = *x;
            asked_before = x + error;
            if tick < unsure { f64::NAN } else { asked_before }
        };
        command.iter().zip(position_m).enumerate().map(of).collect()
    }
}

/// A command without the jump of that size over the dead band.
fn uncompensated<T: Real>(command: T, jump: T) -> T {
    let small = command / (T::splat(1.0) + jump / T::splat(COMPENSATED_FROM));
    let with_sign = command.where_positive(jump, -jump);
    (T::splat(COMPENSATED_FROM) - small.abs()).where_positive(small, command - with_sign)
}

/// The controller of one machine or of several in lanes.
#[derive(Debug, Clone)]
pub(crate) struct Pid<T> {
    pub(crate) kp: T,
    pub(crate) ki_period: T,
    pub(crate) kd_per_period: T,
    /// Command per step of the demand, 1/m.
    feed_forward_per_period: T,
    dead_band_compensation: T,
    /// Error from which on the integrator stands, m.
    integrates_below: T,
    /// Whether there is any of the three in any lane.
    is_extended: bool,
}

/// What the controller remembers from tick to tick.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PidState<T> {
    /// Integrator, share of full command.
    integral: T,
    /// Position at the last tick, m.
    position: T,
    /// Demand at the last tick, m.
    demand: T,
}

impl<T: Real> PidState<T> {
    /// In each lane the other state where `is_other` is positive.
    pub(crate) fn or_where_positive(&self, is_other: T, other: &Self) -> Self {
        PidState {
            integral: is_other.where_positive(other.integral, self.integral),
            position: is_other.where_positive(other.position, self.position),
            demand: is_other.where_positive(other.demand, self.demand),
        }
    }
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
            feed_forward_per_period: each(&|c| c.velocity_feed_forward_s_per_m / c.period_s),
            dead_band_compensation: each(&|c| c.dead_band_compensation),
            integrates_below: each(&Controller::integrates_below_m),
            is_extended: machines.iter().any(|c| {
                c.velocity_feed_forward_s_per_m != 0.0
                    || c.dead_band_compensation != 0.0
                    || c.integral_window_m != 0.0
            }),
        }
    }

    pub(crate) fn start(&self, position: T) -> PidState<T> {
        PidState { integral: T::splat(0.0), position, demand: position }
    }

    /// One tick: the command in shares of full command. The integrator stands while the output is saturated
    /// and the error would drive it further (conditional integration).
    #[inline(always)]
    pub(crate) fn tick(&self, state: &mut PidState<T>, demand: T, position: T) -> T {
        let one = T::splat(1.0);
        let e = demand - position;
        let mut increment = self.ki_period * e;
        if self.is_extended {
            increment = (self.integrates_below - e.abs()).where_positive(increment, T::splat(0.0));
        }
        let integrated = state.integral + increment;
        let mut others = self.kp * e - self.kd_per_period * (position - state.position);
        if self.is_extended {
            others += self.feed_forward_per_period * (demand - state.demand);
            state.demand = demand;
        }
        let u = others + integrated;
        // Saturated, and with the error's sign: |u| > 1 and u e > 0.
        let driven_further =
            (u.abs() - one).where_positive((u * e).where_positive(one, T::splat(0.0)), T::splat(0.0));
        state.integral = driven_further.where_positive(state.integral, integrated);
        state.position = position;
        let output = others + state.integral;
        let jump = if self.is_extended { self.jump(output) } else { T::splat(0.0) };
        (output + jump).max(-one).min(one)
    }

    /// What the controller keeps while a command that is not its own acts: the integrator holds what goes on with that command, so that
    /// taking over is no jump.
    pub(crate) fn tracking(&self, before: &PidState<T>, command: T, position: T) -> PidState<T> {
        let moved = position - before.position;
        let held = uncompensated(command, self.dead_band_compensation)
            + (self.kd_per_period - self.feed_forward_per_period) * moved;
        let integral = self.ki_period.where_positive(held, T::splat(0.0));
        PidState { integral, position, demand: position }
    }

    /// What the compensation of the dead band adds.
    #[inline(always)]
    fn jump(&self, output: T) -> T {
        let one = T::splat(1.0);
        self.dead_band_compensation * (output * T::splat(1.0 / COMPENSATED_FROM)).max(-one).min(one)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn feed_forward_and_the_jump_over_the_dead_band_add_to_the_command() {
        let controller = Controller {
            kp: 2.0,
            ki: 0.0,
            velocity_feed_forward_s_per_m: 0.5,
            dead_band_compensation: 0.04,
            ..Controller::default()
        };
        let pid = Pid::<f64>::new(&[&controller]);
        let mut state = pid.start(0.1);
        // 2 mm in a tick of 1 ms are 2 m/s: 0.5 · 2 = 1 would saturate; 0.2 mm make 0.1, and the error 4e-4.
        let command = pid.tick(&mut state, 0.1002, 0.1);
        assert!((command - (0.1 + 4e-4 + 0.04)).abs() < 1e-12, "{command}");
        assert!((controller.uncompensated(command) - 0.1004).abs() < 1e-12);
        // At rest a small error is not made a jump.
        let command = pid.tick(&mut state, 0.1002, 0.1002 - 1e-4);
        assert!((command - (2e-4 + 0.04 * 2e-4 / 0.003)).abs() < 1e-12, "{command}");
        assert!((controller.uncompensated(command) - 2e-4).abs() < 1e-12);
    }

    /// Far from its target the integrator holds what it has; near it, it goes on.
    #[test]
    fn an_integrator_with_a_window_stands_where_the_error_is_larger() {
        let controller = Controller { kp: 2.0, ki: 100.0, integral_window_m: 1e-3, ..Controller::default() };
        let pid = Pid::<f64>::new(&[&controller]);
        let mut state = pid.start(0.1);
        // 0.5 mm for two ticks of 1 ms: 100 · 0.5 mm · 1 ms each.
        for ticks in 1..=2 {
            let command = pid.tick(&mut state, 0.1005, 0.1);
            assert!((command - (1e-3 + f64::from(ticks) * 5e-5)).abs() < 1e-12, "{command}");
        }
        let far = pid.tick(&mut state, 0.105, 0.1);
        assert!((far - (1e-2 + 1e-4)).abs() < 1e-12, "{far}");
    }

    /// The law turned round: along a demand that comes and goes and a position that follows it somehow, the demand is told by command and
    /// position, with each part of the law and with all of them.
    #[test]
    fn what_was_asked_for_is_told_by_command_and_position() {
        for (ki, kd, feed_forward) in [(0.0, 0.0, 0.0), (80.0, 0.0, 0.0), (0.0, 0.1, 3.2), (80.0, 0.1, 3.2)] {
            let controller = Controller {
                kp: 60.0,
                ki,
                kd,
                velocity_feed_forward_s_per_m: feed_forward,
                dead_band_compensation: 0.02,
                ..Controller::default()
            };
            let pid = Pid::<f64>::new(&[&controller]);
            let mut state = pid.start(0.1);
            let demand_m = |tick: usize| 0.1 + 0.01 * (1.0 - (tick as f64 * 2e-3).cos());
            let position_m: Vec<f64> =
                (0..20_000).map(|tick| demand_m(tick) - 1e-4 * (tick as f64 * 3e-3).sin()).collect();
            let command: Vec<f64> = position_m
                .iter()
                .enumerate()
                .map(|(tick, position_m)| pid.tick(&mut state, demand_m(tick), *position_m))
                .collect();
            assert!(command.iter().all(|u| u.abs() < 0.9));
            let asked_m = controller.asked_m(&command, &position_m, 20.0);
            let off_m = |(tick, asked_m): (usize, &f64)| (asked_m - demand_m(tick)).abs();
            let worst_m = asked_m.iter().enumerate().skip(6_000).map(off_m).fold(0.0, f64::max);
            // Time constants of 0.75 and 0.05 s are forgotten after 6 s to e^-8 of the start's 0.1 mm.
            assert!(worst_m < 2e-7, "{ki} {kd} {feed_forward}: {worst_m}");
            assert!(asked_m[6_000..].iter().all(|asked_m| asked_m.is_finite()));
        }
    }
}
