//! A contact that nobody knows of: where a log has no load, training machines differ in it.
//!
//! What a piston runs into at the end of its way is felt in the hold that follows, of which its strokes say little.

use seepd_sim::MachineSpec;
use seepd_sim::noise::Noise;

use crate::hold_force::HoldForce;

/// Share of the machines that nothing presses against.
const FREE: f64 = 0.5;
/// Largest force, share of the piston's largest.
const LARGEST: f64 = 0.45;

/// Gives a machine a contact where its piston is out furthest, or none.
pub(crate) fn put_on(spec: &mut MachineSpec, noise: &mut Noise) {
    let (drawn, size) = (noise.uniform(0.0, 1.0), noise.uniform(0.0, LARGEST));
    if drawn >= FREE {
        HoldForce::Contact.press(spec, size);
    }
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
