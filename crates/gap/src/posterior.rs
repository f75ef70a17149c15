//! What a fit leaves open: how far its parameters may lie off, together.
//!
//! One force, one valve, one supply pressure may be wrong while their product is right. Taken one by one, their intervals say nothing of
//! that; the covariance of all does (Bates, Watts, Nonlinear Regression Analysis, 1988, chapter 2).

use nalgebra::{Cholesky, DMatrix};
use seepd_sim::series::Direction;

use crate::fit::{Fit, Free, Target};
use crate::simulated_axis::{Scale, SimulatedAxis};

/// The distribution of fitted parameters near where they were fitted.
#[derive(Debug, Clone)]
pub struct Posterior {
    free: Vec<Free>,
    /// Value of each.
    values: Vec<f64>,
    /// What the differences say, in the fit's coordinates.
    information: DMatrix<f64>,
}

impl Posterior {
    pub(crate) fn of<A: SimulatedAxis>(fit: &Fit<A>) -> Self {
        Posterior {
            values: fit.free.iter().zip(fit.at.iter()).map(|(free, at)| free.value(*at)).collect(),
            information: fit.jacobian.tr_mul(&fit.jacobian),
            free: fit.free.clone(),
        }
    }

    /// As many independent directions as there are parameters, each drawn with a standard deviation of 1. The differences are taken to be
    /// `times` as large as the fit expected, and no parameter that counts by its logarithm is less known beforehand than `least_known`, a
    /// standard deviation. None where the record and what is known beforehand leave a parameter without any bound.
    pub fn directions(&self, times: f64, least_known: f64) -> Vec<Direction> {
        let mut precision = self.information.scale(times.powi(2).recip());
        for (index, parameter) in self.free.iter().enumerate() {
            let sigma = match (parameter.prior, parameter.scale) {
                (Some((_, sigma)), Scale::Logarithmic) => Some(sigma.min(least_known)),
                (Some((_, sigma)), Scale::Linear(_)) => Some(sigma),
                (None, Scale::Logarithmic) => Some(least_known),
                (None, Scale::Linear(_)) => None,
            };
            precision[(index, index)] += sigma.map_or(0.0, |sigma| (sigma * sigma).recip());
        }
        let Some(root) = precision.try_inverse().and_then(Cholesky::new) else { return Vec::new() };
        root.l().column_iter().map(|column| self.direction(column.as_slice())).collect()
    }

    fn direction(&self, changes: &[f64]) -> Direction {
        let mut direction = Direction::default();
        for ((parameter, value), change) in self.free.iter().zip(&self.values).zip(changes) {
            match (&parameter.target, parameter.scale) {
                (Target::Plant(plant), Scale::Logarithmic) => {
                    direction.plant.insert(plant.key.to_string(), *change);
                }
                (Target::Plant(plant), Scale::Linear(unit)) => {
                    direction.plant_by_addition.insert(plant.key.to_string(), change * unit);
                }
                (Target::Effect(effect, index), scale) => {
                    let change = match scale {
                        Scale::Linear(unit) => change * unit,
                        Scale::Logarithmic => change * value,
                    };
                    let of_effect = direction.effects.entry(effect.key.to_owned()).or_default();
                    of_effect.insert(effect.parameters[*index].name.to_owned(), change);
                }
            }
        }
        direction
    }
}

#[cfg(test)]
mod tests {
    use seepd_sim::MachineSpec;
    use seepd_sim::noise::Noise;
    use seepd_sim::series::{self, Tolerances};

    use super::*;
    use crate::fit::free_parameters;

    /// Of a return pressure of 0.2 bar that is known to 2 bar, shares would make machines of a millibar and of hundreds of bar.
    #[test]
    fn a_return_pressure_near_zero_moves_by_addition() {
        let mut spec = MachineSpec::default();
        spec.plant.return_pressure_pa = 2e4;
        let mut free = free_parameters(&spec);
        free.retain(|free| free.key() == "return_pressure_pa");
        let nothing_told = Posterior { free, values: vec![2e4], information: DMatrix::zeros(1, 1) };
        let together = nothing_told.directions(1.0, 1.0);
        let tolerances = Tolerances { together, ..Tolerances::even(0.0) };
        let mut noise = Noise::new(1, 1);
        let drawn: Vec<f64> =
            (0..500).map(|_| series::vary(&spec, &tolerances, &mut noise).plant.return_pressure_pa).collect();
        let largest = 2e4 + 3f64.sqrt() * 2e5;
        assert!(drawn.iter().all(|pressure_pa| (0.0..=largest).contains(pressure_pa)), "{drawn:?}");
        assert!(drawn.iter().any(|pressure_pa| *pressure_pa > 0.9 * largest), "{drawn:?}");
    }
}
