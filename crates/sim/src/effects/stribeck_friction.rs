//! Stribeck friction: seals and guides that stick more at rest than in motion.

use super::{
    Effect, EffectInfo, Equation, Law, Moment, Parameter, TRANSITION_SPEED_M_PER_S, Terms, built_by,
};
use crate::real::Real;

/// See the [module](self).
pub(super) struct StribeckFriction;

/// The parameter that says how firmly it sticks.
pub(super) const CREEP: &str = "creep_speed_m_per_s";

/// Forces at speed and at rest, N, the speed between them, m/s, and one over the speed below which the piston creeps, s/m.
struct Stribeck<T> {
    force: T,
    static_force: T,
    speed: T,
    firmness: T,
}

impl<T: Real> Stribeck<T> {
    fn new(values: &[T]) -> Self {
        // Neutral lanes have no speed.
        Stribeck {
            force: values[0],
            static_force: values[1],
            speed: values[2].max(T::splat(1e-4)),
            firmness: T::splat(1.0) / values[3].max(T::splat(1e-6)),
        }
    }
}

impl<T: Real> Law<T> for Stribeck<T> {
    #[inline(always)]
    fn act(&self, _memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        let v = moment.state.v;
        let share = v / self.speed;
        let added = (self.static_force - self.force).max(T::splat(0.0)) * (-(share * share)).exp();
        let sign = (v * self.firmness).tanh();
        terms.force -= (self.force + added) * sign;
    }
}

impl Effect for StribeckFriction {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "stribeck_friction",
            parameters: &[
                Parameter {
                    name: "force_n",
                    unit: "N",
                    neutral: 0.0,
                    range: (0.0, 5e3),
                    source: "Jelali & Kroll, Hydraulic Servo-systems (2003), ch. 4: as Coulomb friction",
                },
                Parameter {
                    name: "static_force_n",
                    unit: "N",
                    neutral: 0.0,
                    range: (0.0, 8e3),
                    source: "Jelali & Kroll, Hydraulic Servo-systems (2003), ch. 4: to 1.6 times the force in motion",
                },
                Parameter {
                    name: "stribeck_speed_m_per_s",
                    unit: "m/s",
                    neutral: 0.0,
                    range: (5e-3, 0.1),
                    source: "Armstrong-Hélouvry, Control of Machines with Friction (1991): 5 to 100 mm/s for lubricated seals",
                },
                Parameter {
                    name: CREEP,
                    unit: "m/s",
                    neutral: TRANSITION_SPEED_M_PER_S,
                    range: (1e-4, 1e-2),
                    source: "Canudas de Wit et al., IEEE Trans. Autom. Control 40 (1995): seals stick, and bend by hundredths of a millimetre only",
                },
            ],
            law: "force −= (F_c + max(F_s − F_c, 0) e^(−(v / v_s)²)) tanh(v / creep_speed)",
            signature: "pressure difference peaks as each stroke begins and ends, more than it steps at reversal",
            equation: Equation::Force,
        }
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[0] == 0.0 && values[1] == 0.0
    }
    built_by!(Stribeck::new);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cycle::CycleRun;
    use crate::{Input, Machine, MachineSpec, Schedule};

    /// Share of a cycle's time in which the nominal press with a static friction of 3 kN is slower than 0.2 mm/s.
    fn standing(creep_speed_m_per_s: f64) -> f64 {
        let mut spec = MachineSpec::default();
        let creeps = format!("{CREEP}={creep_speed_m_per_s}");
        for set in ["force_n=2000", "static_force_n=3000", "stribeck_speed_m_per_s=0.03", &creeps] {
            spec.set_effect(&format!("stribeck_friction.{set}")).unwrap();
        }
        let spec = spec.with_stable_steps();
        let machine = Machine::<f64>::new(&[&spec]);
        let mut state = machine.start();
        let ticks = (spec.cycle.period_s / spec.controller.period_s) as usize;
        let positions: Vec<f64> =
            Schedule::new(&spec.cycle, spec.controller.period_s, vec![CycleRun::with_leak(0.0)])
                .take(2 * ticks)
                .map(|sample| machine.tick(&mut state, &Input::gather(&[sample])).position)
                .skip(ticks)
                .collect();
        let way_m = 2e-4 * spec.controller.period_s;
        let slow = positions.windows(2).filter(|pair| (pair[1] - pair[0]).abs() < way_m).count();
        slow as f64 / ticks as f64
    }

    /// Between what its controller asks for, a piston that sticks stands; one that creeps at some millimetres a second under the same
    /// force never does for long.
    #[test]
    fn a_piston_that_sticks_stands_in_its_holds() {
        let (firm, soft) = (standing(1e-4), standing(5e-3));
        assert!(firm > 0.02 && soft < 0.2 * firm, "{firm} {soft}");
    }
}
