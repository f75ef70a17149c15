//! A contact that nobody knows of: where a log has no load, training machines differ in it.
//!
//! What a piston runs into at the end of its way is felt in the hold that follows, of which its strokes say little.

use seepd_sim::cycle::LoadCorner;
use seepd_sim::noise::Noise;
use seepd_sim::{DutyCycle, MachineSpec};

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
    let ends = spec.cycle.moves.iter().map(|stroke| stroke.to_m);
    let (low, high) = ends.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
    let touches = |to_m: f64| if high - to_m <= TOUCHING * (high - low) { force_n } else { 0.0 };
    let levels: Vec<f64> = spec.cycle.moves.iter().map(|stroke| touches(stroke.to_m)).collect();
    let contact = DutyCycle { load: lasting(&spec.cycle, &levels), ..DutyCycle::default() };
    let planned = spec.cycle.clone();
    let mut times: Vec<f64> = planned.load.iter().chain(&contact.load).map(|corner| corner.at_s).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let sum = |at_s: f64| planned.load_n(at_s) + contact.load_n(at_s);
    spec.cycle.load = times.into_iter().map(|at_s| LoadCorner { at_s, force_n: sum(at_s) }).collect();
}

/// Forces that come at the end of a move and go as the next one begins.
fn lasting(cycle: &DutyCycle, levels: &[f64]) -> Vec<LoadCorner> {
    let mut before = levels.last().copied().unwrap_or(0.0);
    let mut corners = vec![LoadCorner { at_s: 0.0, force_n: before }];
    for (stroke, level) in cycle.moves.iter().zip(levels) {
        let at = |share: f64| stroke.from_s + share * (stroke.to_s - stroke.from_s);
        let (from, to) = if *level == 0.0 { (0.0, GONE_BY) } else { (PRESSES_FROM, 1.0) };
        corners.push(LoadCorner { at_s: at(from), force_n: before });
        corners.push(LoadCorner { at_s: at(to), force_n: *level });
        before = *level;
    }
    corners.dedup_by(|later, earlier| later.at_s <= earlier.at_s);
    corners
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
