//! Laws' errors that are as large in every phase ([`errors_are_even`](crate::schema::CausesFile::errors_are_even)).
//!
//! A law that is off by a tenth moves a stroke by a tenth of the response too much, and a hold as well. In units of what load, oil and supply
//! ordinarily do, a hold that shows a change to a thousandth of it would let a law be off in a stroke, which varies more, by many times the
//! response: a shifted null passed for a leak, and friction for anything. In units of noise an error is what it is in each phase.

use super::fit::{AnyLeak, Fit, Moments, Whitened, dot};
use super::linear::{applied, square};
use super::{Causes, Cell};

impl<const N: usize> Whitened<N> {
    /// The same change where each coordinate of noise has a variance more, and the logarithm of what determinants are larger by.
    fn widened(&self, variance: f64) -> (Self, f64) {
        let (mut weights, mut change) = (self.weights, self.change);
        let mut log_determinant = 0.0;
        let of_noise = self.of_noise.chunks(4);
        for ((weights, change), of_noise) in weights.chunks_mut(4).zip(change.chunks_mut(4)).zip(of_noise) {
            let mut determinant = 1.0;
            for ((weight, change), of_noise) in weights.iter_mut().zip(change).zip(of_noise) {
                let ratio = 1.0 + variance * of_noise * *weight * *weight;
                let narrower = 1.0 / libm::sqrt(ratio);
                *weight *= narrower;
                *change *= narrower;
                determinant *= ratio;
            }
            log_determinant += libm::log(determinant);
        }
        let Whitened { count, in_noise, of_noise, .. } = *self;
        (Whitened { count, weights, change, in_noise, of_noise }, log_determinant)
    }

    fn unweighted(&self, values: &[f64; N]) -> [f64; N] {
        let mut unweighted = [0.0; N];
        let weighted = values.iter().zip(&self.weights).take(self.count);
        for (slot, (value, weight)) in unweighted.iter_mut().zip(weighted) {
            *slot = value / weight;
        }
        unweighted
    }

    /// The change along directions of length 1, at right angles, and beside them.
    fn along_and_beside(&self, directions: &[[f64; N]]) -> [[f64; N]; 2] {
        let mut along = [0.0; N];
        for direction in directions {
            let share = dot(&self.change, direction);
            along.iter_mut().zip(direction).for_each(|(slot, own)| *slot += share * own);
        }
        let mut beside = self.change;
        beside.iter_mut().zip(&along).for_each(|(slot, along)| *slot -= along);
        [along, beside]
    }
}

impl Causes {
    /// Squared length of the change along directions of length 1, at right angles, and beside them, in coordinates of noise.
    pub(super) fn parted_in_noise<const N: usize>(
        &self,
        whitened: &Whitened<N>,
        directions: &[[f64; N]],
    ) -> [f64; 2] {
        whitened.along_and_beside(directions).map(|part| {
            let part = whitened.unweighted(&part);
            match &self.in_noise {
                Some(noise) => applied(whitened.count, &noise.back, &part).map(|value| value * value).sum(),
                None => square(&part),
            }
        })
    }

    /// A cell's mean, or one of its directions, in coordinates of noise.
    fn numbers_in_noise(&self, at: usize) -> &[f64] {
        let numbers = self.in_noise.as_ref().map_or(&self.numbers, |noise| &noise.numbers);
        numbers.get(at..at + self.numbers()).unwrap_or_default()
    }

    /// Fits the sum of some cells, none, one or two.
    pub(super) fn fit_evenly<const N: usize>(&self, whitened: &Whitened<N>, cells: &[&Cell]) -> Fit {
        let variances = self.variances_of_laws(whitened, cells);
        let fit = |variance: f64| fit_widened(whitened, variance, |widened| self.lay(widened, cells).moments);
        under_either(fit(variances[0]), variances, fit)
    }

    /// The same, if the logarithm of the likelihood may reach `least`.
    pub(super) fn fit_evenly_from<const N: usize>(
        &self,
        whitened: &Whitened<N>,
        cells: &[&Cell],
        least: f64,
    ) -> Option<Fit> {
        let variances = self.variances_of_laws(whitened, cells);
        fit_from(whitened, variances, least, |widened| self.lay(widened, cells).moments)
    }

    /// Fits a cell beside a leak of whatever size.
    pub(super) fn fit_evenly_beside<const N: usize>(
        &self,
        whitened: &Whitened<N>,
        cell: &Cell,
        leak: &AnyLeak<'_, N>,
        least: f64,
    ) -> Option<Fit> {
        fit_from(whitened, leak.variances_beside(cell, whitened.count), least, |widened| {
            let directions = widened.span(leak.means);
            self.lay(widened, &[cell]).beside(&directions, [1.0; 2])
        })
    }

    /// Variance that the cells' laws give each coordinate of noise: any laws, and those that training has simulated. The last cell's response
    /// is what the cell before it leaves of the change, or most of it: its error goes by that.
    fn variances_of_laws<const N: usize>(&self, whitened: &Whitened<N>, cells: &[&Cell]) -> [f64; 2] {
        let mut rest = whitened.in_noise;
        let mut variances = [0.0; 2];
        for (place, cell) in cells.iter().enumerate() {
            let mean = self.numbers_in_noise(cell.at);
            let length = if place + 1 == cells.len() {
                square(&rest)
            } else {
                let vectors = (0..=cell.rank).map(|which| cell.at + which * self.numbers());
                vectors.map(|at| square(self.numbers_in_noise(at))).sum::<f64>()
            };
            rest.iter_mut().zip(mean).for_each(|(slot, mean)| *slot -= mean);
            let length = length / whitened.count as f64;
            variances[0] += cell.error * cell.error * length;
            variances[1] += cell.simulated_error_squared() * length;
        }
        variances
    }
}

/// Fits where each coordinate of noise has a variance more.
fn fit_widened<const N: usize>(
    whitened: &Whitened<N>,
    variance: f64,
    moments: impl Fn(&Whitened<N>) -> Moments,
) -> Fit {
    let (widened, log_determinant) = whitened.widened(variance);
    moments(&widened).fit_under_one(whitened.count, 1.0).in_units_of(log_determinant)
}

/// Fits under the variances of laws, if the logarithm of the likelihood may reach `least`: under the larger variance the change is nearest,
/// and determinants take nothing less than 0 off.
fn fit_from<const N: usize>(
    whitened: &Whitened<N>,
    variances: [f64; 2],
    least: f64,
    moments: impl Fn(&Whitened<N>) -> Moments,
) -> Option<Fit> {
    let fit = |variance: f64| fit_widened(whitened, variance, &moments);
    let under_any = fit(variances[0]);
    let may_reach = -0.5 * under_any.distance * whitened.count as f64 >= least;
    may_reach.then(|| under_either(under_any, variances, fit))
}

/// Of variances under any law and under one that training has simulated.
fn under_either(under_any: Fit, [any, simulated]: [f64; 2], fit: impl Fn(f64) -> Fit) -> Fit {
    if simulated < any { under_any.or(fit(simulated)) } else { under_any }
}

#[cfg(test)]
pub(super) mod tests {
    use alloc::{vec, vec::Vec};

    use super::super::{Cause, Change, ChangeVerdict, Kind, SizeUnit};
    use super::*;
    use crate::schema::{CausesFile, CellFile};

    const NOISE: f64 = 1e-4;
    /// Two holds that nothing moves by itself, and a stroke out and one back that oil and supply move against each other.
    const ORDINARY: [f64; 4] = [0.0, 0.0, 4e-6, 4e-6];

    pub(in super::super) fn cell(cause: Cause, unit: SizeUnit, error: f64, mean: [f64; 4]) -> CellFile {
        CellFile {
            kind: Kind { cause, side: None, unit },
            other_law: false,
            alike: false,
            size: 1.0,
            size_loadings: vec![0.4],
            size_rest: 0.01,
            error,
            mean: mean.iter().map(|value| *value as f32).collect(),
            directions: vec![mean.iter().map(|value| 0.4 * *value as f32).collect()],
        }
    }

    /// A leak, which moves a hold less than the other and strokes in another way, and a shifted null, which moves all alike.
    fn causes(errors_are_even: bool) -> Causes {
        let identity: Vec<f64> = (0..16).map(|at| if at % 5 == 0 { 1.0 } else { 0.0 }).collect();
        let file = CausesFile {
            basis: identity.clone(),
            inverse: identity,
            ordinary: ORDINARY.to_vec(),
            known_limit: 5.0,
            alike_from: 0.999,
            sizes_leaks: false,
            fitted: false,
            knows_dead_band: false,
            null_is_exact: true,
            errors_are_even,
            cells: vec![
                cell(Cause::PistonSeal, SizeUnit::Area, 0.3, [-0.008, -0.0072, -0.003, -0.013]),
                cell(Cause::ValveNull, SizeUnit::Share, 0.05, [-0.008; 4]),
            ],
            golden: Vec::new(),
        };
        Causes::from_file(file).unwrap()
    }

    pub(in super::super) fn variance_of_law(error: f64, change: [f64; 4]) -> f64 {
        error * error * change.iter().map(|value| value * value).sum::<f64>() / 4.0
    }

    /// Logarithm of the density of a change over that of the variances before alone, but for what both have in common; the direction's
    /// determinant and inverse by Sherman and Morrison.
    pub(in super::super) fn log_density(
        change: [f64; 4],
        cell: &CellFile,
        before: [f64; 4],
        variance: f64,
    ) -> f64 {
        let (mut distance, mut along, mut length, mut log_determinant) = (0.0, 0.0, 0.0, 0.0);
        for (at, (change, before)) in change.into_iter().zip(before).enumerate() {
            let now = before + variance;
            let (rest, direction) = (change - f64::from(cell.mean[at]), f64::from(cell.directions[0][at]));
            distance += rest * rest / now;
            along += rest * direction / now;
            length += direction * direction / now;
            log_determinant += libm::log(now / before);
        }
        -0.5 * (distance - along * along / (1.0 + length) + log_determinant + libm::log(1.0 + length))
    }

    #[test]
    fn analytic_an_even_error_is_a_variance_more_in_each_coordinate() {
        let causes = causes(true);
        let change = [-0.0081, -0.0074, -0.0021, -0.0127];
        let whitened = causes.whitened::<4>(&Change { numbers: &change, noise: NOISE });
        let leak = cell(Cause::PistonSeal, SizeUnit::Area, 0.3, [-0.008, -0.0072, -0.003, -0.013]);
        let before = ORDINARY.map(|ordinary| NOISE * NOISE + 1e-12 + ordinary);
        let [any, simulated] = [0.3, libm::sqrt(0.3 * 0.3 - 0.2 * 0.2 + 0.05 * 0.05)]
            .map(|error| log_density(change, &leak, before, variance_of_law(error, change)));
        let expected = libm::log(0.5 * (libm::exp(any) + libm::exp(simulated)));
        let given = causes.fit_evenly(&whitened, &[&causes.cells[0]]);
        assert!((given.log_likelihood - expected).abs() < 1e-6, "{} {expected}", given.log_likelihood);
        // A bound that it cannot reach is told before.
        assert!(causes.fit_evenly_from(&whitened, &[&causes.cells[0]], 0.0).is_none());
    }

    /// In units of ordinary variation the holds, which show 80 times the noise, would let a leak's law be off by anything in a stroke.
    #[test]
    fn what_moves_all_phases_alike_is_no_leak_whose_law_is_off() {
        let of = |errors_are_even, numbers: [f64; 4]| {
            causes(errors_are_even).explain(&Change { numbers: &numbers, noise: NOISE }).verdict
        };
        // A controller comes to rest by a little else after a stroke.
        let shifted = [-0.0089, -0.007, -0.0081, -0.0077];
        assert_eq!(of(false, shifted), ChangeVerdict::Named(Cause::PistonSeal, None));
        assert_eq!(of(true, shifted), ChangeVerdict::Named(Cause::ValveNull, None));
        for leaking in [[-0.0081, -0.0071, -0.0028, -0.0133], [-0.0073, -0.0064, -0.0027, -0.0118]] {
            assert_eq!(of(true, leaking), ChangeVerdict::Named(Cause::PistonSeal, None), "{leaking:?}");
        }
    }

    /// Variances 1/4 and 1/16 become 1 and 13/16.
    #[test]
    fn analytic_a_variance_more_widens_what_is_sure_the_most() {
        let whitened = Whitened {
            count: 2,
            weights: [2.0, 4.0, 0.0, 0.0],
            change: [6.0, 4.0, 0.0, 0.0],
            in_noise: [3.0, 1.0, 0.0, 0.0],
            of_noise: [1.0; 4],
        };
        let (widened, log_determinant) = whitened.widened(0.75);
        let weights = [1.0, libm::sqrt(16.0 / 13.0), 0.0, 0.0];
        assert!(widened.weights.iter().zip(&weights).all(|(a, b)| (a - b).abs() < 1e-12));
        // The change itself is 3 and 1.
        assert!(widened.change.iter().zip([3.0, weights[1], 0.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!((log_determinant - libm::log(4.0 * 13.0)).abs() < 1e-12);
        let parted =
            whitened.along_and_beside(&[[1.0, 0.0, 0.0, 0.0]]).map(|part| whitened.unweighted(&part));
        assert_eq!(parted, [[3.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]]);
    }
}
