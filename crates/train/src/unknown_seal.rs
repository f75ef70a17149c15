//! The law by which a worn seal leaks, where nobody knows it: a scratch is an orifice, an even gap is laminar, most wear is between them.
//!
//! The article's leak is an orifice. Between an orifice and a gap lies every exponent of the pressure difference from 0.5 to 1 (Merritt,
//! Hydraulic Control Systems, 1967, chapter 3); what they share is the flow at the pressure difference at which leaks are given.

use seepd_sim::PlantParameters;
use seepd_sim::noise::Noise;

/// Share of the machines whose seals leak as an orifice does.
const ORIFICES: f64 = 0.5;
/// Pressure difference at which a leak's flow is given, Pa.
const REFERENCE_PA: f64 = 7e6;

/// The laminar share of a machine's leak at the reference pressure difference.
pub(crate) fn laminar_share(noise: &mut Noise) -> f64 {
    let (drawn, share) = (noise.uniform(0.0, 1.0), noise.uniform(0.0, 1.0));
    if drawn < ORIFICES { 0.0 } else { share }
}

/// Takes the laminar share of a leak into the seal's resistance; gives the area that is left of the leak, m².
pub(crate) fn with_gap(plant: &mut PlantParameters, leak_area_m2: f64, laminar_share: f64) -> f64 {
    if laminar_share > 0.0 {
        let gap_m3_per_s = laminar_share * plant.orifice_flow_m3_per_s(leak_area_m2, REFERENCE_PA);
        let conductance = 1.0 / plant.seal_resistance_pa_s_per_m3 + gap_m3_per_s / REFERENCE_PA;
        plant.seal_resistance_pa_s_per_m3 = 1.0 / conductance;
    }
    (1.0 - laminar_share) * leak_area_m2
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At the reference pressure difference a leak is as large under every law; at a quarter of it an orifice still passes half, a gap a
    /// quarter.
    #[test]
    fn a_leak_is_as_large_under_every_law() {
        let healthy = PlantParameters::default();
        let leak_area_m2 = 1e-6;
        let flow = |laminar_share: f64, dp_pa: f64| {
            let mut plant = healthy.clone();
            let area_m2 = with_gap(&mut plant, leak_area_m2, laminar_share);
            let gap = 1.0 / plant.seal_resistance_pa_s_per_m3 - 1.0 / healthy.seal_resistance_pa_s_per_m3;
            plant.orifice_flow_m3_per_s(area_m2, dp_pa) + gap * dp_pa
        };
        let whole = healthy.orifice_flow_m3_per_s(leak_area_m2, REFERENCE_PA);
        for share in [0.0, 0.3, 1.0] {
            assert!((flow(share, REFERENCE_PA) / whole - 1.0).abs() < 1e-9, "{share}");
            let quarter = flow(share, 0.25 * REFERENCE_PA) / whole;
            assert!((quarter - (0.5 - 0.25 * share)).abs() < 1e-9, "{share}: {quarter}");
        }
    }

    #[test]
    fn half_of_the_machines_have_orifices() {
        let mut noise = Noise::new(3, 1);
        let shares: Vec<f64> = (0..2000).map(|_| laminar_share(&mut noise)).collect();
        // Three standard errors of a share of 0.5: 3.4 %.
        let orifices = shares.iter().filter(|share| **share == 0.0).count() as f64 / 2000.0;
        assert!((orifices - 0.5).abs() < 0.034, "{orifices}");
        assert!(shares.iter().all(|share| (0.0..=1.0).contains(share)));
    }
}
