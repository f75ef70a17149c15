//! Causes that the catalogue has no name for; they exist in the planter only.

use serde::{Deserialize, Serialize};

/// A cause without a name in the catalogue.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Foreign {
    /// A guide that jams around a position: force against the motion, N, at a place, m, over a width, m.
    Jam {
        /// Force, N.
        force_n: f64,
        /// Where, m.
        at_m: f64,
        /// How wide, m.
        width_m: f64,
    },
    /// Drag with the square of the speed, N s²/m².
    Drag {
        /// Coefficient, N s²/m².
        coefficient: f64,
    },
    /// A counterbalance valve in the rod line: pressure that it takes to open, Pa.
    Counterbalance {
        /// Opening pressure, Pa.
        pressure_pa: f64,
    },
    /// The controller shapes its demand by its slope, s.
    DemandLead {
        /// Lead, s.
        lead_s: f64,
    },
    /// A machine nearby shakes the load.
    Shaking {
        /// Force, N.
        force_n: f64,
        /// Frequency, Hz.
        frequency_hz: f64,
    },
    /// The integrator is limited, share of full command.
    IntegralLimit {
        /// Limit.
        limit: f64,
    },
    /// Another proportional gain while the position is ahead.
    DirectionalGain {
        /// Factor.
        factor: f64,
    },
    /// A dither on the spool that someone left on.
    Dither {
        /// Amplitude, share of full opening.
        amplitude: f64,
        /// Frequency, Hz.
        frequency_hz: f64,
    },
    /// A load that works on a lever: it goes with the sine of the way.
    Lever {
        /// Force, N.
        force_n: f64,
        /// Way of a whole turn, m.
        turn_m: f64,
    },
    /// A pump that regulates: it gives less from a pressure on, m³/(s Pa).
    Regulator {
        /// Pressure from which on, Pa.
        from_pa: f64,
        /// Flow lost for each pascal above, m³/(s Pa).
        slope_m3_per_s_pa: f64,
    },
}

impl Foreign {
    /// Each kind once, at a strength between 0 and 1.
    pub fn all(strength: f64) -> Vec<Foreign> {
        let s = strength.clamp(0.0, 1.0);
        vec![
            Foreign::Jam { force_n: 1e3 + 5e3 * s, at_m: 0.25, width_m: 0.02 },
            Foreign::Drag { coefficient: 1e4 + 8e4 * s },
            Foreign::Counterbalance { pressure_pa: 4e5 + 2.5e6 * s },
            Foreign::DemandLead { lead_s: 0.01 + 0.05 * s },
            Foreign::Shaking { force_n: 300.0 + 2e3 * s, frequency_hz: 1.5 },
            Foreign::IntegralLimit { limit: 0.004 * (1.0 - 0.8 * s) },
            Foreign::DirectionalGain { factor: 1.15 + 0.6 * s },
            Foreign::Dither { amplitude: 0.01 + 0.05 * s, frequency_hz: 2.5 },
            Foreign::Lever { force_n: 500.0 + 4e3 * s, turn_m: 0.2 },
            Foreign::Regulator { from_pa: 1.58e7, slope_m3_per_s_pa: 5e-10 + 2e-9 * s },
        ]
    }

    /// Name in the truth.
    pub fn name(self) -> &'static str {
        match self {
            Foreign::Jam { .. } => "jam",
            Foreign::Drag { .. } => "drag",
            Foreign::Counterbalance { .. } => "counterbalance",
            Foreign::DemandLead { .. } => "demand_lead",
            Foreign::Shaking { .. } => "shaking",
            Foreign::IntegralLimit { .. } => "integral_limit",
            Foreign::DirectionalGain { .. } => "directional_gain",
            Foreign::Dither { .. } => "dither",
            Foreign::Lever { .. } => "lever",
            Foreign::Regulator { .. } => "regulator",
        }
    }

    /// Force on the load, N.
    pub(crate) fn force(self, x: f64, v: f64, at_s: f64) -> f64 {
        match self {
            Foreign::Jam { force_n, at_m, width_m } => {
                -force_n * (-((x - at_m) / width_m).powi(2)).exp() * (v / 3e-3).tanh()
            }
            Foreign::Drag { coefficient } => -coefficient * v * v.abs(),
            Foreign::Shaking { force_n, frequency_hz } => {
                force_n * (std::f64::consts::TAU * frequency_hz * at_s).sin()
            }
            Foreign::Lever { force_n, turn_m } => force_n * (std::f64::consts::TAU * x / turn_m).sin(),
            _ => 0.0,
        }
    }

    /// Pressure that the rod line holds back, Pa.
    pub(crate) fn rod_back_pressure(self) -> f64 {
        if let Foreign::Counterbalance { pressure_pa } = self { pressure_pa } else { 0.0 }
    }

    /// What the controller takes for the demand, m.
    pub(crate) fn demand(self, demand_m: f64, slope_m_per_s: f64) -> f64 {
        if let Foreign::DemandLead { lead_s } = self { demand_m + lead_s * slope_m_per_s } else { demand_m }
    }

    /// The integrator after its limit.
    pub(crate) fn integral(self, integral: f64) -> f64 {
        if let Foreign::IntegralLimit { limit } = self { integral.clamp(-limit, limit) } else { integral }
    }

    /// Factor on the proportional gain.
    pub(crate) fn gain(self, error_m: f64) -> f64 {
        match self {
            Foreign::DirectionalGain { factor } if error_m < 0.0 => factor,
            _ => 1.0,
        }
    }

    /// What is added to the spool.
    pub(crate) fn spool(self, at_s: f64) -> f64 {
        match self {
            Foreign::Dither { amplitude, frequency_hz } => {
                amplitude * (std::f64::consts::TAU * frequency_hz * at_s).sin()
            }
            _ => 0.0,
        }
    }

    /// Flow that the pump does not give, m³/s.
    pub(crate) fn pump_loss(self, p_s: f64) -> f64 {
        match self {
            Foreign::Regulator { from_pa, slope_m3_per_s_pa } => slope_m3_per_s_pa * (p_s - from_pa).max(0.0),
            _ => 0.0,
        }
    }
}
