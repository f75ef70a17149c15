//! The one-dimensional Kalman filter that takes the noise off the command.

use serde::{Deserialize, Serialize};

/// Random-walk model `x' = x + w`, measurement `z = x + n`; `w` and `n` white with variances `q` and `r` in
/// squared shares of full command. The command is no random walk, and the article's figures (0.001 and 5) are
/// not its variances: their ratio sets a low-pass whose steady gain, 0.01404, means about 70 ms at 1 kHz.
///
/// ```
/// use seepd_features::{Kalman, KalmanState};
///
/// let kalman = Kalman::default();
/// let mut state = KalmanState::default();
/// for _ in 0..10_000 {
///     kalman.step(&mut state, 0.0);
/// }
/// // A step of the command by 1 moves the estimate by the steady gain.
/// assert!((kalman.step(&mut state, 1.0) - 0.01404).abs() < 1e-5);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kalman {
    /// Variance of the process noise in one sample period.
    pub q: f64,
    /// Variance of the measurement noise.
    pub r: f64,
}

impl Default for Kalman {
    /// The article's figures.
    fn default() -> Self {
        Kalman { q: 0.001, r: 5.0 }
    }
}

/// What the filter remembers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct KalmanState {
    estimate: f64,
    /// Variance of the estimate; `None` before the first sample.
    variance: Option<f64>,
    /// Gain for the next samples once it has converged: the variance's recursion then repeats itself.
    steady_gain: Option<f64>,
}

impl Kalman {
    /// One sample in, one estimate out; both shares of full command. The first sample is taken as it is.
    #[inline]
    pub fn step(&self, state: &mut KalmanState, command: f64) -> f64 {
        if let Some(gain) = state.steady_gain {
            state.estimate += gain * (command - state.estimate);
            return state.estimate;
        }
        self.converge(state, command)
    }

    fn converge(&self, state: &mut KalmanState, command: f64) -> f64 {
        let Some(variance) = state.variance else {
            state.estimate = command;
            state.variance = Some(self.r);
            return command;
        };
        let predicted = variance + self.q;
        let gain = predicted / (predicted + self.r);
        let updated = (1.0 - gain) * predicted;
        state.estimate += gain * (command - state.estimate);
        if libm::fabs(updated - variance) <= 1e-14 * variance {
            state.steady_gain = Some(gain);
        }
        state.variance = Some(updated);
        state.estimate
    }

    /// The gain to which the filter converges: `K = (−λ + √(λ² + 4 λ)) / 2` with `λ = q / r`, the positive root of the
    /// scalar Riccati equation `K² + λ K − λ = 0`.
    pub fn steady_gain(&self) -> f64 {
        let ratio = self.q / self.r;
        0.5 * (libm::sqrt(ratio * ratio + 4.0 * ratio) - ratio)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steady gain of the article's figures: λ = 2e-4, K = 0.0140425…
    #[test]
    fn analytic_steady_gain_is_the_riccati_root() {
        let kalman = Kalman::default();
        assert!((kalman.steady_gain() - 0.01404).abs() < 5e-6);
        let mut state = KalmanState::default();
        for _ in 0..5000 {
            kalman.step(&mut state, 0.0);
        }
        let before = kalman.step(&mut state, 0.0);
        let after = kalman.step(&mut state, 1.0);
        assert!((after - before - kalman.steady_gain()).abs() < 1e-10);
    }

    /// With the variance at r after the first sample and no process noise, the estimate is the plain mean.
    #[test]
    fn analytic_without_process_noise_it_is_the_mean() {
        let kalman = Kalman { q: 0.0, r: 1.0 };
        let mut state = KalmanState::default();
        let samples = [0.3, -0.1, 0.7, 0.2, 0.9];
        let mut last = 0.0;
        for sample in samples {
            last = kalman.step(&mut state, sample);
        }
        assert!((last - samples.iter().sum::<f64>() / 5.0).abs() < 1e-15);
    }

    /// A ramp of slope s is followed with the lag s (1 − K)/K of a first-order low-pass.
    #[test]
    fn analytic_ramp_lag_is_about_seventy_samples() {
        let kalman = Kalman::default();
        let mut state = KalmanState::default();
        let mut lag = 0.0;
        for sample in 0..20_000 {
            let command = f64::from(sample) * 1e-5;
            lag = (command - kalman.step(&mut state, command)) / 1e-5;
        }
        let gain = kalman.steady_gain();
        assert!((lag - (1.0 - gain) / gain).abs() < 1e-6, "{lag}");
        assert!((lag - 70.2).abs() < 0.1);
    }
}
