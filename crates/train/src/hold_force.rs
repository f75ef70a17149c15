//! A force that presses in the holds, of which a log without a load says nothing.
//!
//! A piston that stands still takes no flow, whatever presses against it: the command of a healthy hold is the same. What a leak does to it
//! is not, since the pressure difference over the piston is another one, or has another sign. Each way in which a machine may be pressed is
//! learned as leaks of its own.

use seepd_sim::MachineSpec;
use seepd_sim::cycle::{Move, sum_of_loads};
use seepd_sim::noise::Noise;

/// What presses in the holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HoldForce {
    /// What the plan has, with what the series draws of contacts.
    AsDrawn,
    /// What the plan has.
    AsPlanned,
    /// A contact where the piston is out furthest.
    Contact,
    /// A process against every move out, until the next move back.
    Process,
}

/// Smallest and largest force, shares of the piston's largest.
const SMALLEST: f64 = 0.05;
const LARGEST: f64 = 0.5;
/// Moves that end this near to the furthest place, share of the cycle's way, touch.
const TOUCHING: f64 = 0.02;
/// Share of a move's time after which it presses, and by which the next one has let go.
const PRESSES_FROM: f64 = 0.85;
const GONE_BY: f64 = 0.3;

impl HoldForce {
    /// The ways in which a machine with this plan may be pressed that its holds tell apart.
    pub(crate) fn all(spec: &MachineSpec) -> Vec<Self> {
        let presses = |force: Self| -> Vec<bool> {
            spec.cycle.moves_from().map(|(from_m, stroke)| force.presses(spec, from_m, stroke)).collect()
        };
        let mut all = vec![HoldForce::AsPlanned, HoldForce::Contact];
        if presses(HoldForce::Process) != presses(HoldForce::Contact) {
            all.push(HoldForce::Process);
        }
        all
    }

    /// Puts a force of some size on a machine.
    pub(crate) fn put_on(self, spec: &mut MachineSpec, noise: &mut Noise) {
        let share = noise.uniform(SMALLEST, LARGEST);
        self.press(spec, share);
    }

    /// Puts a force of a share of the piston's largest on a machine.
    pub(crate) fn press(self, spec: &mut MachineSpec, share: f64) {
        let force_n = -share * spec.plant.cap_area_m2 * spec.plant.relief_pressure_pa;
        let level = |(from_m, stroke): (f64, &Move)| {
            if self.presses(spec, from_m, stroke) { force_n } else { 0.0 }
        };
        let levels: Vec<f64> = spec.cycle.moves_from().map(level).collect();
        if levels.iter().all(|level| *level == 0.0) {
            return;
        }
        let comes = |level: f64| if level == 0.0 { (0.0, GONE_BY) } else { (PRESSES_FROM, 1.0) };
        let pressed = spec.cycle.load_by_moves(&levels, comes);
        spec.cycle.load = sum_of_loads(&[(1.0, &spec.cycle.load), (1.0, &pressed)]);
    }

    /// Whether it presses in the hold after a move.
    fn presses(self, spec: &MachineSpec, from_m: f64, stroke: &Move) -> bool {
        match self {
            HoldForce::AsDrawn | HoldForce::AsPlanned => false,
            HoldForce::Contact => {
                let (low_m, high_m) = spec.cycle.reach_m();
                high_m - stroke.to_m <= TOUCHING * (high_m - low_m)
            }
            HoldForce::Process => stroke.to_m > from_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The nominal press moves out twice, to 280 and to 310 mm, and back once: a contact presses after the second, a process after both.
    #[test]
    fn a_force_presses_in_the_holds_that_it_belongs_to() {
        let plan = MachineSpec::default();
        assert_eq!(HoldForce::all(&plan), [HoldForce::AsPlanned, HoldForce::Contact, HoldForce::Process]);
        let largest_n = LARGEST * plan.plant.cap_area_m2 * plan.plant.relief_pressure_pa;
        let mut noise = Noise::new(7, 1);
        for (force, presses_at) in [
            (HoldForce::AsPlanned, [false; 4]),
            (HoldForce::Contact, [false, false, true, false]),
            (HoldForce::Process, [false, true, true, false]),
        ] {
            let mut spec = plan.clone();
            force.put_on(&mut spec, &mut noise);
            for (at_s, presses) in [0.2, 2.9, 5.0, 7.9].into_iter().zip(presses_at) {
                let beside_n = spec.cycle.load_n(at_s) - plan.cycle.load_n(at_s);
                assert_eq!(beside_n < -0.09 * largest_n, presses, "{force:?} at {at_s} s: {beside_n}");
                assert!((-largest_n..1e-9).contains(&beside_n), "{force:?} at {at_s} s: {beside_n}");
            }
        }
    }

    /// A press that moves out once is pressed alike by a contact and by a process.
    #[test]
    fn one_move_out_has_one_way_to_be_pressed() {
        let mut plan = MachineSpec::default();
        plan.cycle.moves.remove(0);
        assert_eq!(HoldForce::all(&plan), [HoldForce::AsPlanned, HoldForce::Contact]);
    }
}
