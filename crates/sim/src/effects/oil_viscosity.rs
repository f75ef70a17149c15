//! Oil viscosity: oil that is colder or warmer than planned.

use super::{Constants, Effect, EffectInfo, Equation, Law, Parameter, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct OilViscosity;

/// Viscosity over plan.
struct Viscosity<T> {
    factor: T,
}

impl<T: Real> Viscosity<T> {
    fn new(values: &[T]) -> Self {
        Viscosity { factor: values[0] }
    }
}

impl<T: Real> Law<T> for Viscosity<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    fn adjust(&self, constants: &mut Constants<'_, T>) {
        let (plant, factor) = (&mut *constants.plant, self.factor);
        plant.b_v = plant.b_v * factor;
        plant.g_cyl = plant.g_cyl / factor;
        plant.g_vlv = plant.g_vlv / factor;
        plant.g_vlv2 = plant.g_vlv2 / factor;
        // The transition to turbulent flow is at a Reynolds number, whose pressure difference goes with ν².
        plant.dp_t_squared = plant.dp_t_squared * factor * factor * factor * factor;
    }
}

impl Effect for OilViscosity {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "oil_viscosity",
            parameters: &[Parameter {
                name: "factor",
                unit: "1",
                neutral: 1.0,
                range: (0.3, 3.0),
                source: "ISO VG 46 between 20 and 80 °C against 45 °C (ASTM D341)",
            }],
            law: "b_v · factor, laminar resistances · factor, dp_t · factor² (transition at a Reynolds number)",
            signature: "strokes need more pressure difference in proportion to their speed; leaks past seal and valve change the other way",
            equation: Equation::Force,
        }
    }
    built_by!(Viscosity::new);
}
