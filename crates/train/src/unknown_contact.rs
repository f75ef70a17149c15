//! A contact that nobody knows of: where a log has no load, training machines differ in it.
//!
//! What a piston runs into at the end of its way is felt in the hold that follows, of which its strokes say little.

use seepd_sim::MachineSpec;
use seepd_sim::cycle::sum_of_loads;
use seepd_sim::noise::Noise;

/// Share of the machines that nothing presses against.
const FREE: f64 = 0.5;
/// Largest force, share of the piston's largest.
const LARGEST: f64 = 0.45;
/// Moves that end this near to the furthest place, share of the cycle's way, touch.
const TOUCHING: f64 = 0.02;
/// Share of a move's time after which it presses, and by which the next one has let go.
const PRESSES_FROM: f64 = 0.85;
const GONE_BY: f64 = 0.3;

/// Gives a machine a contact where its piston is out furthest, or none.
pub(crate) fn put_on(spec: &mut MachineSpec, noise: &mut Noise) {
    let (drawn, size) = (noise.uniform(0.0, 1.0), noise.uniform(0.0, LARGEST));
    if drawn < FREE {
        return;
    }
    let force_n = -size * spec.plant.cap_area_m2 * spec.plant.relief_pressure_pa;
    let (low_m, high_m) = spec.cycle.reach_m();
    let touches = |to_m: f64| if high_m - to_m <= TOUCHING * (high_m - low_m) { force_n } else { 0.0 };
    let levels: Vec<f64> = spec.cycle.moves.iter().map(|stroke| touches(stroke.to_m)).collect();
    let comes = |level: f64| if level == 0.0 { (0.0, GONE_BY) } else { (PRESSES_FROM, 1.0) };
    let contact = spec.cycle.load_by_moves(&levels, comes);
    spec.cycle.load = sum_of_loads(&[(1.0, &spec.cycle.load), (1.0, &contact)]);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half of the machines are free; the others are pressed against where they are out furthest, and nowhere else.
    #[test]
    fn a_contact_presses_where_the_piston_is_out_furthest() {
        let plan = MachineSpec::default();
        let largest_n = plan.plant.cap_area_m2 * plan.plant.relief_pressure_pa;
        let mut noise = Noise::new(7, 1);
        let beside = |spec: &MachineSpec, at_s: f64| spec.cycle.load_n(at_s) - plan.cycle.load_n(at_s);
        let mut pressed = 0;
        for _ in 0..400 {
            let mut spec = plan.clone();
            put_on(&mut spec, &mut noise);
            if spec == plan {
                continue;
            }
            pressed += 1;
            // `extend` ends at 2.5 s, 30 mm before `press` does at 4 s; `retract` begins at 6 s.
            assert!((-LARGEST * largest_n..0.0).contains(&beside(&spec, 5.0)));
            for at_s in [0.2, 2.9, 7.5] {
                assert!(beside(&spec, at_s).abs() < 1e-9, "{at_s}");
            }
        }
        assert!((170..230).contains(&pressed), "{pressed}");
    }
}
