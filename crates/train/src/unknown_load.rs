//! Forces on the piston that nobody knows of: where a log has no load, training machines differ in them.

use seepd_sim::MachineSpec;
use seepd_sim::cycle::LoadCorner;
use seepd_sim::noise::Noise;
use serde::{Deserialize, Serialize};

/// What may press against the piston beside the load of the plant file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum UnknownLoad {
    /// A contact where the piston is out furthest: strokes say little of it, the hold that follows feels it.
    Contact,
    /// That, or a process that presses against every move out, of which a command alone says nothing.
    ContactOrProcess,
}

/// Share of the machines that nothing presses against.
const FREE: f64 = 0.5;
/// Largest force, share of the piston's largest.
const LARGEST: f64 = 0.45;
/// Moves that end this near to the furthest place, share of the cycle's way, touch.
const TOUCHING: f64 = 0.02;
/// Shares of a move's time after which a contact presses, and by which a process presses in full.
const CONTACT_FROM: f64 = 0.85;
const PROCESS_WITHIN: f64 = 0.3;

impl UnknownLoad {
    /// Gives a machine its force, or none.
    pub(crate) fn put_on(self, spec: &mut MachineSpec, noise: &mut Noise) {
        let (drawn, size) = (noise.uniform(0.0, 1.0), noise.uniform(0.0, LARGEST));
        if drawn < FREE {
            return;
        }
        let force_n = -size * spec.plant.cap_area_m2 * spec.plant.relief_pressure_pa;
        let is_process = self == UnknownLoad::ContactOrProcess && drawn > FREE + 0.5 * (1.0 - FREE);
        let ends = spec.cycle.moves.iter().map(|stroke| stroke.to_m);
        let (low, high) = ends.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
        let touches = |to_m: f64| high - to_m <= TOUCHING * (high - low);
        let mut before_m = spec.cycle.start_position_m();
        let levels: Vec<f64> = spec
            .cycle
            .moves
            .iter()
            .map(|stroke| {
                let presses = if is_process { stroke.to_m > before_m } else { touches(stroke.to_m) };
                before_m = stroke.to_m;
                if presses { force_n } else { 0.0 }
            })
            .collect();
        add(spec, &levels, is_process);
    }
}

/// Adds forces that last from each move to the next to the plan's load.
fn add(spec: &mut MachineSpec, levels: &[f64], is_process: bool) {
    let mut before = levels.last().copied().unwrap_or(0.0);
    let mut extra = vec![LoadCorner { at_s: 0.0, force_n: before }];
    for (stroke, level) in spec.cycle.moves.iter().zip(levels) {
        let at = |share: f64| stroke.from_s + share * (stroke.to_s - stroke.from_s);
        // A contact comes at a move's end and goes at the next one's beginning.
        let comes_late = !is_process && *level != 0.0;
        let (from, to) = if comes_late { (CONTACT_FROM, 1.0) } else { (0.0, PROCESS_WITHIN) };
        extra.push(LoadCorner { at_s: at(from), force_n: before });
        extra.push(LoadCorner { at_s: at(to), force_n: *level });
        before = *level;
    }
    extra.dedup_by(|later, earlier| later.at_s <= earlier.at_s);
    let planned = spec.cycle.clone();
    let of_extra = seepd_sim::DutyCycle { load: extra, ..planned.clone() };
    let mut times: Vec<f64> = planned.load.iter().chain(&of_extra.load).map(|corner| corner.at_s).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let sum = |at_s: f64| planned.load_n(at_s) + of_extra.load_n(at_s);
    spec.cycle.load = times.into_iter().map(|at_s| LoadCorner { at_s, force_n: sum(at_s) }).collect();
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half of the machines are free; the others are pressed against where they are out furthest, or wherever they move out.
    #[test]
    fn what_presses_presses_where_it_may() {
        let plan = MachineSpec::default();
        let largest_n = plan.plant.cap_area_m2 * plan.plant.relief_pressure_pa;
        let drawn = |kind: UnknownLoad| -> Vec<MachineSpec> {
            let mut noise = Noise::new(7, 1);
            let one = |_| {
                let mut spec = plan.clone();
                kind.put_on(&mut spec, &mut noise);
                spec
            };
            (0..400).map(one).collect()
        };
        let beside = |spec: &MachineSpec, at_s: f64| spec.cycle.load_n(at_s) - plan.cycle.load_n(at_s);
        for kind in [UnknownLoad::Contact, UnknownLoad::ContactOrProcess] {
            let machines = drawn(kind);
            let pressed: Vec<&MachineSpec> = machines.iter().filter(|spec| **spec != plan).collect();
            assert!((170..230).contains(&pressed.len()), "{}", pressed.len());
            // `extend` ends at 2.5 s, 30 mm before `press` does at 4 s; `retract` begins at 6 s.
            let early = pressed.iter().filter(|spec| beside(spec, 2.9) < 0.0).count();
            assert_eq!(early > 0, kind == UnknownLoad::ContactOrProcess);
            for spec in pressed {
                assert!((-LARGEST * largest_n..0.0).contains(&beside(spec, 5.0)));
                assert!(beside(spec, 7.5).abs() < 1e-9 && beside(spec, 0.2).abs() < 1e-9);
            }
        }
    }
}
