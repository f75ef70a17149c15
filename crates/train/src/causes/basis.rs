//! The coordinates in which noise is even and ordinary variation is apart.

use nalgebra::{DMatrix, SymmetricEigen};

use super::{CauseSimulator, ordinary_days, unit_noise};
use crate::hold_force::HoldForce;
use crate::linear;

/// Ordinary variation of load and of supply pressure, to either side; the oil's is the training's.
pub(super) const ORDINARY_LOAD: f64 = 0.02;
pub(super) const ORDINARY_SUPPLY: f64 = 0.02;
/// Machines and days of each that say what is ordinary.
const MACHINES: usize = 40;
const DAYS: usize = 6;
/// Readings of one cycle that say what noise does.
const READINGS: usize = 400;
/// Noise of these, share of full command.
const READING_NOISE: f64 = 0.003;
/// Smallest variance of noise in a number over the largest: numbers that noise hardly moves.
const LEAST_SHARE: f64 = 1e-4;

/// See [`CausesFile`](seepd_model::schema::CausesFile).
pub(super) struct Basis {
    pub(super) rows: Vec<f64>,
    pub(super) inverse: Vec<f64>,
    pub(super) ordinary: Vec<f64>,
}

impl Basis {
    /// Learns both covariances; `None` where cycles were not found.
    pub(super) fn learn(simulator: &CauseSimulator<'_>) -> Option<Self> {
        let noise = noise_covariance(simulator)?;
        let ordinary = ordinary_covariance(simulator)?;
        Self::of(noise.0, &noise.1, &ordinary)
    }

    /// With the noise's covariance `N = L Lᵀ` and the eigenvectors Q of `L⁻¹ C L⁻ᵀ`, C the ordinary covariance: `B = Qᵀ L⁻¹`.
    fn of(n: usize, noise: &[f64], ordinary: &[f64]) -> Option<Self> {
        let largest = (0..n).map(|i| noise[i * n + i]).fold(0.0, f64::max);
        let factor =
            linear::cholesky(n, |i, j| noise[i * n + j] + if i == j { LEAST_SHARE * largest } else { 0.0 })?;
        let inverse = linear::inverse(n, &factor);
        let lower =
            |packed: &[f64], i: usize, j: usize| if j <= i { packed[i * (i + 1) / 2 + j] } else { 0.0 };
        let whitened = |i: usize, j: usize| -> f64 {
            (0..n)
                .map(|k| {
                    lower(&inverse, i, k)
                        * (0..n).map(|l| ordinary[k * n + l] * lower(&inverse, j, l)).sum::<f64>()
                })
                .sum()
        };
        let eigen = SymmetricEigen::new(DMatrix::from_fn(n, n, whitened));
        let (mut rows, mut back) = (vec![0.0; n * n], vec![0.0; n * n]);
        for i in 0..n {
            for j in 0..n {
                rows[i * n + j] = (0..n).map(|k| eigen.eigenvectors[(k, i)] * lower(&inverse, k, j)).sum();
                back[i * n + j] = (0..n).map(|k| lower(&factor, i, k) * eigen.eigenvectors[(k, j)]).sum();
            }
        }
        let ordinary = (0..n).map(|i| eigen.eigenvalues[i].max(0.0)).collect();
        Some(Basis { rows, inverse: back, ordinary })
    }

    pub(super) fn coordinates(&self, numbers: &[f64]) -> Vec<f64> {
        let n = self.ordinary.len();
        self.rows.chunks_exact(n).map(|row| row.iter().zip(numbers).map(|(a, b)| a * b).sum()).collect()
    }

    pub(super) fn weights(&self, noise: f64) -> Vec<f64> {
        self.ordinary.iter().map(|ordinary| 1.0 / (noise * noise + ordinary).sqrt()).collect()
    }
}

/// Number of numbers, and the covariance that noise of standard deviation 1 gives them, rows one after the other.
fn noise_covariance(simulator: &CauseSimulator<'_>) -> Option<(usize, Vec<f64>)> {
    let one = simulator.machine(super::purpose::ORDINARY, MACHINES, HoldForce::AsDrawn);
    let seed = simulator.settings.seed;
    let rows = super::simulate_stably(std::slice::from_ref(&one), |_, _, commands| {
        let still = simulator.numbers(commands, 0.0, &vec![0.0; commands.len()])?;
        let rows: Vec<Vec<f64>> = (0..READINGS as u64)
            .filter_map(|reading| {
                let noise = unit_noise(seed, reading, commands.len());
                let numbers = simulator.numbers(commands, READING_NOISE, &noise)?;
                Some(
                    numbers
                        .iter()
                        .zip(&still)
                        .map(|(noisy, still)| (noisy - still) / READING_NOISE)
                        .collect(),
                )
            })
            .collect();
        Some(rows)
    })
    .into_iter()
    .next()??;
    let n = rows.first()?.len();
    Some((n, covariance(n, &rows)))
}

/// Covariance of a machine's days about its own mean.
fn ordinary_covariance(simulator: &CauseSimulator<'_>) -> Option<Vec<f64>> {
    let observations: Vec<_> =
        (0..MACHINES).flat_map(|machine| ordinary_days(simulator, machine, DAYS)).collect();
    let read = simulator.read(&observations);
    let mut rows = Vec::new();
    for days in read.chunks(DAYS) {
        // The change of a day against another: twice the variance about the mean, that of the baseline's day included.
        for pair in days.chunks_exact(2) {
            if let [Some(a), Some(b)] = pair {
                rows.push(a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<f64>>());
            }
        }
    }
    let n = rows.first()?.len();
    Some(covariance(n, &rows))
}

/// Mean outer product.
fn covariance(n: usize, rows: &[Vec<f64>]) -> Vec<f64> {
    let mut sum = vec![0.0; n * n];
    for row in rows {
        for (line, a) in sum.chunks_exact_mut(n).zip(row) {
            for (cell, b) in line.iter_mut().zip(row) {
                *cell += a * b / rows.len() as f64;
            }
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// N = diag(4, 1), C = N-whitened [[2, 1], [1, 2]]: variances 1 and 3 in coordinates where the noise is even.
    #[test]
    fn analytic_both_covariances_are_diagonal_in_the_basis() {
        let noise = [4.0, 0.0, 0.0, 1.0];
        let ordinary = [8.0, 2.0, 2.0, 2.0];
        let basis = Basis::of(2, &noise, &ordinary).unwrap();
        let mut variances = basis.ordinary.clone();
        variances.sort_by(f64::total_cmp);
        assert!((variances[0] - 1.0).abs() < 1e-3 && (variances[1] - 3.0).abs() < 1e-3, "{variances:?}");
        // B⁻¹ B = 1.
        let there = basis.coordinates(&[0.3, -0.7]);
        let back: Vec<f64> =
            basis.inverse.chunks_exact(2).map(|row| row[0] * there[0] + row[1] * there[1]).collect();
        assert!((back[0] - 0.3).abs() < 1e-12 && (back[1] + 0.7).abs() < 1e-12, "{back:?}");
    }
}
