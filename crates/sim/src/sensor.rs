//! How far sensors are off: what a diagnosis found of the transducers of the logs that it was given.

use serde::{Deserialize, Serialize};

/// Signals of which a plant file may say how far their sensor is off.
pub(crate) const WITH_ERRORS: [&str; 4] = ["p_supply", "p_inlet", "p_cap", "p_rod"];

/// How far a sensor is off.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorError {
    /// Shown over true, less 1.
    pub gain: f64,
    /// Shown at 0, SI.
    pub zero: f64,
}

impl SensorError {
    /// What is shown of what is there.
    pub fn shown(self, there: f64) -> f64 {
        (1.0 + self.gain) * there + self.zero
    }

    /// What was there when this was shown.
    pub fn there(self, shown: f64) -> f64 {
        (shown - self.zero) / (1.0 + self.gain)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_what_is_shown_was_there() {
        let error = SensorError { gain: 0.004, zero: -3e4 };
        assert!((error.shown(5e6) - (1.004 * 5e6 - 3e4)).abs() < 1e-6);
        assert!((error.there(error.shown(5e6)) - 5e6).abs() < 1e-6);
    }
}
