//! What a valve opens at a command that stands still.

use crate::effects::{Effect, Law, Substep, ValveCurve, ValveDeadband, ValveFlowShape, ValveOverlap};
use crate::spec::MachineSpec;

/// The steady way from a machine's command, less its null, to the opening that passes oil: dead band and flow curve.
pub struct SteadyOpening {
    laws: Vec<Box<dyn Law<f64>>>,
}

impl SteadyOpening {
    /// Of a machine.
    pub fn of(spec: &MachineSpec) -> Self {
        let laws: [&dyn Effect; 4] = [&ValveDeadband, &ValveFlowShape, &ValveOverlap, &ValveCurve];
        let laws = laws.into_iter().filter(|law| spec.effects.contains_key(law.key()));
        SteadyOpening { laws: laws.map(|law| law.scalar(&spec.effect_values(law))).collect() }
    }

    /// Opening, share of full, of a command, share of full.
    pub fn at(&self, command: f64) -> f64 {
        let standing = Substep { tick: 0, index: 0, steps: 1, dt: 1.0, period: 1.0 };
        self.laws.iter().fold(command, |spool, law| law.spool(&mut [], spool, &standing))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_valve_opens_beyond_its_overlap_and_along_its_curve() {
        let mut spec = MachineSpec::default();
        assert_eq!(SteadyOpening::of(&spec).at(-0.3), -0.3);
        spec.set_effect("valve_deadband.half_width=0.1").unwrap();
        spec.set_effect("valve_curve.null_slope=0.5").unwrap();
        spec.set_effect("valve_curve.knee=0.4").unwrap();
        let opening = SteadyOpening::of(&spec);
        assert_eq!(opening.at(0.08), 0.0);
        assert!((opening.at(0.3) - 0.1).abs() < 1e-12 && (opening.at(-0.3) + 0.1).abs() < 1e-12);
        assert!((opening.at(1.0) - (0.45 + 0.5 * 0.5 / 0.6)).abs() < 1e-12);
    }
}
