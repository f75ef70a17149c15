//! Hose volume: hoses and pipes between valve and cylinder that the plan leaves out.

use super::{Constants, Effect, EffectInfo, Equation, Law, Parameter, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct HoseVolume;

/// Volumes at the cap and the rod port, m³.
struct Hoses<T> {
    a: T,
    b: T,
}

impl<T: Real> Hoses<T> {
    fn new(values: &[T]) -> Self {
        Hoses { a: values[0], b: values[1] }
    }
}

impl<T: Real> Law<T> for Hoses<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    fn adjust(&self, constants: &mut Constants<'_, T>) {
        constants.plant.v_01 += self.a;
        constants.plant.v_02 += self.b;
    }
}

impl Effect for HoseVolume {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "hose_volume",
            parameters: &[
                Parameter {
                    name: "a_m3",
                    unit: "m3",
                    neutral: 0.0,
                    range: (0.0, 1e-3),
                    source: "2 m of 25 mm hose hold 1 L",
                },
                Parameter {
                    name: "b_m3",
                    unit: "m3",
                    neutral: 0.0,
                    range: (0.0, 1e-3),
                    source: "2 m of 25 mm hose hold 1 L",
                },
            ],
            law: "V_01 + a_m3, V_02 + b_m3",
            signature: "pressures follow load steps and reversals more softly",
            equation: Equation::Cap,
        }
    }
    built_by!(Hoses::new);
}
