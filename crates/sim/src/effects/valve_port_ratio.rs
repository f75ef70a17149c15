//! Spool for a cylinder of unequal areas: the edges of the rod side are narrower than those of the cap side.

use super::{Effect, EffectInfo, Equation, Law, Moment, Openings, Parameter, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct ValvePortRatio;

/// Both edges of the rod side over those of the cap side.
struct RodSide<T>(T);

impl<T: Real> RodSide<T> {
    fn new(values: &[T]) -> Self {
        RodSide(values[0])
    }
}

impl<T: Real> Law<T> for RodSide<T> {
    #[inline(always)]
    fn open(&self, _moment: &Moment<'_, T>, openings: &mut Openings<T>) {
        openings.rod = openings.rod * self.0;
    }
}

impl Effect for ValvePortRatio {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_port_ratio",
            parameters: &[Parameter {
                name: "rod_side",
                unit: "1",
                neutral: 1.0,
                range: (0.1, 2.0),
                source: "spools for 2 : 1 cylinders have 0.5",
            }],
            law: "k_v of P→A and A→T: 1, of P→B and B→T: rod_side",
            signature: "both chambers keep their pressure through strokes either way, where areas are as unequal",
            equation: Equation::Rod,
        }
    }
    built_by!(RodSide::new);
}

#[cfg(test)]
mod tests {
    use crate::MachineSpec;
    use crate::Steps;
    use crate::batch::{self, Job};
    use crate::cycle::CycleRun;

    /// Within what an asymmetry may be, both are the same law.
    #[test]
    fn narrower_edges_of_the_rod_side_are_an_asymmetry_of_the_same_size() {
        let commands = |effect: &str| {
            let mut spec = MachineSpec::default();
            spec.set_effect(effect).unwrap();
            let job = Job {
                spec,
                runs: vec![CycleRun::with_leak(1e-6)],
                start_tick: 0,
                skip_ticks: 0,
                record_ticks: 10_000,
            };
            batch::commands(&[job], Steps::Own, |_, commands| commands.to_vec()).remove(0)
        };
        let narrow = commands("valve_port_ratio.rod_side=0.8");
        assert_eq!(narrow, commands("valve_asymmetry.b_side_ratio=0.8"));
        assert_ne!(narrow, commands("valve_port_ratio.rod_side=1"));
    }
}
