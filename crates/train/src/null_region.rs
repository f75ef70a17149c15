//! The valve near its null, where a healthy log says nothing of it.
//!
//! Rounded edges pass more oil there than in proportion to the command, an overlap of a few thousandths passes less: data sheets leave the
//! flow gain of the null region open between half and twice the rated one (ISO 10770-1 measures it by itself). A leak is sized by the
//! command that holds against it, and a small one is held within that region.

use seepd_sim::PlantParameters;

/// Drop over a valve's loop at which its flow is rated, Pa.
const RATED_PA: f64 = 7e6;
/// Leak, as a share of the valve's rated flow, over which the null region fades, and the share of its deviation that stays.
const REGION: f64 = 0.02;
const STAYS: f64 = 0.2;

/// Leak that a valve in proportion would have to hold against for the command that this one takes, m²; its flow gain is off by `1 / (1 +
/// deviation)` at the null.
pub(crate) fn leak_as_held_m2(plant: &PlantParameters, leak_area_m2: f64, deviation: f64) -> f64 {
    let rated_m3_per_s = plant.valve_m3_per_s_sqrt_pa * (0.5 * RATED_PA).sqrt();
    let share = plant.orifice_flow_m3_per_s(leak_area_m2, RATED_PA) / rated_m3_per_s;
    leak_area_m2 * (1.0 + deviation * (STAYS + (1.0 - STAYS) * (-share / REGION).exp()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_leaks_are_held_in_the_null_region_and_large_ones_beyond_it() {
        let plant = PlantParameters::default();
        let rated_m3_per_s = plant.valve_m3_per_s_sqrt_pa * 3.5e6_f64.sqrt();
        let gain = |share: f64, deviation: f64| {
            let area_m2 = share * rated_m3_per_s / plant.orifice_flow_m3_per_s(1.0, 7e6);
            leak_as_held_m2(&plant, area_m2, deviation) / area_m2
        };
        assert!((gain(1e-6, 0.3) - 1.3).abs() < 1e-4);
        assert!((gain(0.2, 0.3) - 1.06).abs() < 1e-4 && (gain(0.2, -0.3) - 0.94).abs() < 1e-4);
        assert_eq!(gain(0.01, 0.0), 1.0);
    }
}
