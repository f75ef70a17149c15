//! Structure compliance: a rod, mount or tool that gives: two masses with a spring between them.

use super::{Effect, EffectInfo, Equation, Law, Moment, Parameter, Terms, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct StructureCompliance;

/// Spring, damper, and the share of the mass behind them.
struct TwoMasses<T> {
    stiffness: T,
    fraction: T,
}

/// Damping ratio of the load's mass on the spring: of bolted steel structures.
const DAMPING_RATIO: f64 = 0.05;

impl<T: Real> TwoMasses<T> {
    fn new(values: &[T]) -> Self {
        TwoMasses { stiffness: values[0], fraction: values[1] }
    }

    /// Force of spring and damper on the piston's mass, N; deflection and its rate are the load's less the piston's.
    #[inline(always)]
    fn spring(&self, memory: &[T], mass_inverse: T) -> T {
        let load_mass = self.fraction / mass_inverse;
        let damping = T::splat(2.0 * DAMPING_RATIO) * (self.stiffness * load_mass).sqrt();
        self.stiffness * memory[0] + damping * memory[1]
    }
}

impl<T: Real> Law<T> for TwoMasses<T> {
    /// Deflection, m, and its rate, m/s.
    fn memory(&self) -> usize {
        2
    }

    fn has_states(&self) -> bool {
        true
    }

    #[inline(always)]
    fn act(&self, memory: &[T], moment: &Moment<'_, T>, terms: &mut Terms<T>) {
        let plant = moment.plant;
        let on_piston =
            terms.force - moment.load * plant.load_scale + self.spring(memory, plant.mass_inverse);
        // The balance divides by the whole mass; the piston has the rest of it.
        let scaled = on_piston / (T::splat(1.0) - self.fraction);
        terms.force = self.fraction.where_positive(scaled, terms.force);
    }

    #[inline(always)]
    fn advance(&self, memory: &mut [T], moment: &Moment<'_, T>, terms: &Terms<T>, dt: T) {
        let plant = moment.plant;
        let zero = T::splat(0.0);
        let on_load = moment.load * plant.load_scale - self.spring(memory, plant.mass_inverse);
        let piston = terms.force * plant.mass_inverse;
        let rate = memory[1] + (on_load * plant.mass_inverse / self.fraction - piston) * dt;
        memory[1] = self.fraction.where_positive(rate, zero);
        memory[0] += memory[1] * dt;
    }
}

impl Effect for StructureCompliance {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "structure_compliance",
            parameters: &[
                Parameter {
                    name: "stiffness_n_per_m",
                    unit: "N/m",
                    neutral: 1e8,
                    range: (1e6, 1e8),
                    source: "rods, trunnions and frames of presses: 1 to 100 kN a 1 mm",
                },
                Parameter {
                    name: "mass_fraction",
                    unit: "1",
                    neutral: 0.0,
                    range: (0.05, 0.9),
                    source: "tool and slide behind the rod: most of the moved mass",
                },
            ],
            law: "two masses (1 − mass_fraction) M and mass_fraction M with a spring between them, damping ratio 0.05; the load acts on the second",
            signature: "fast load steps ring; nothing in slow phases, as position is measured at the piston",
            equation: Equation::Force,
        }
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[1] == 0.0
    }
    built_by!(TwoMasses::new);
}
