//! What a leak costs.

use serde::Serialize;

use crate::event::LPM_PER_M3_PER_S;

/// Hydraulic power that a leak turns into heat, and what that comes to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Loss {
    /// Δp · Q at the reference pressure difference, W.
    pub leak_power_w: f64,
    /// In the hours that the machine runs in a year, kWh. The pump's and the motor's own losses come on top.
    pub leak_energy_kwh_per_year: f64,
}

impl Loss {
    /// The loss by a leak of that flow, L/min, at a pressure difference, Pa.
    pub fn of(leak_flow_lpm: f64, pressure_difference_pa: f64, operating_hours_per_year: f64) -> Self {
        let leak_power_w = leak_flow_lpm / LPM_PER_M3_PER_S * pressure_difference_pa;
        Loss { leak_power_w, leak_energy_kwh_per_year: leak_power_w * operating_hours_per_year / 1000.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The hydraulic engineer's rule of thumb: p in bar times Q in L/min over 600 is kW.
    #[test]
    fn a_litre_a_minute_at_six_megapascals_is_a_hundred_watts() {
        let loss = Loss::of(1.0, 6e6, 2000.0);
        assert!((loss.leak_power_w - 100.0).abs() < 1e-9);
        assert!((loss.leak_energy_kwh_per_year - 200.0).abs() < 1e-9);
    }
}
