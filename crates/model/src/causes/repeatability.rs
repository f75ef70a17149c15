//! A machine repeats some phases less well than others: a hold before which a move ends now here and now there, a move whose start follows
//! an event. What such a phase shows says little, and what the others show no less for it.
//!
//! With N the covariance that noise of variance 1 gives the numbers of a change, C that of what load, oil and supply ordinarily do, and D what
//! a machine's cycles scatter more than its noise makes them, the causes are told apart in coordinates in which N + D is the identity and C
//! diagonal: with `N + D = L Lᵀ` and the eigenvectors Q of `L⁻¹ C L⁻ᵀ`, `B = Qᵀ L⁻¹`. What laws are off by is as large as it was, and
//! has in each coordinate of these its own share of N.

use alloc::vec::Vec;

use super::Causes;
use super::linear::{applied, cholesky, eigen, product, row, solved_lower, square, transposed};
use crate::schema::CausesFile;

/// Least standard deviation of noise, share of full command: a command without any scatters infinitely more.
const LEAST_NOISE: f64 = 1e-6;

/// Where laws' errors are measured: the coordinates of noise alone.
#[derive(Debug, Clone)]
pub(super) struct NoiseCoordinates {
    /// From numbers to these, rows one after the other.
    pub(super) basis: Vec<f64>,
    /// Means and directions of the cells.
    pub(super) numbers: Vec<f64>,
    /// From the coordinates of noise and scatter to these, rows one after the other.
    pub(super) back: Vec<f64>,
    /// Variance of each coordinate of noise and scatter where those of noise have 1.
    pub(super) variances: Vec<f64>,
}

impl Causes {
    /// The same causes as a machine shows them whose command has noise of a standard deviation, and whose phases' means, then rises, deviate
    /// so much from cycle to cycle. `None` where none of them scatters more than noise makes it, or not each has a deviation.
    pub fn of_machine(&self, noise: f64, deviations: &[f64]) -> Option<Causes> {
        let n = self.numbers();
        let CausesFile { basis, inverse, ordinary, .. } = &self.file;
        if deviations.len() != n {
            return None;
        }
        let excess = excess_variances(inverse, noise.max(LEAST_NOISE), deviations);
        if !excess.iter().any(|excess| *excess > 0.0) {
            return None;
        }
        let covariance = |i: usize, j: usize| {
            let of_noise: f64 = row(inverse, n, i).iter().zip(row(inverse, n, j)).map(|(a, b)| a * b).sum();
            of_noise + if i == j { excess[i] } else { 0.0 }
        };
        let factor = cholesky(n, covariance)?;
        let narrowed = solved_lower(n, &factor, inverse);
        let scaled: Vec<f64> =
            narrowed.iter().enumerate().map(|(at, value)| value * libm::sqrt(ordinary[at % n])).collect();
        let of_ordinary = product(n, &scaled, &transposed(n, &scaled));
        let (variances, vectors) = eigen(n, of_ordinary);
        let turned = transposed(n, &vectors);
        let across = product(n, &turned, &narrowed);
        let own_inverse = product(n, &factor, &vectors);
        let numbers = self.numbers.chunks_exact(n).flat_map(|values| applied(n, &across, values)).collect();
        let in_noise = NoiseCoordinates {
            basis: basis.clone(),
            numbers: self.numbers.clone(),
            back: product(n, basis, &own_inverse),
            variances: (0..n).map(|i| square(row(&across, n, i))).collect(),
        };
        let file = CausesFile {
            basis: product(n, &across, basis),
            inverse: own_inverse,
            ordinary: variances.iter().map(|variance| variance.max(0.0)).collect(),
            golden: Vec::new(),
            ..self.file.clone()
        };
        Some(Causes { file, numbers, in_noise: Some(in_noise), ..self.clone() })
    }
}

/// Variance of each number beyond what noise makes it, in units of the noise's.
fn excess_variances(inverse: &[f64], noise: f64, deviations: &[f64]) -> Vec<f64> {
    inverse
        .chunks_exact(deviations.len().max(1))
        .zip(deviations)
        .map(|(row, deviation)| {
            let ratio = deviation / noise;
            (ratio * ratio - square(row)).max(0.0)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use alloc::vec;

    use super::super::even::tests::{cell, log_density, variance_of_law};
    use super::super::fit::Whitened;
    use super::super::{Cause, Change, ChangeVerdict, SizeUnit};
    use super::*;

    /// A hold and a stroke, whose means are the first two numbers and whose rises the last two.
    const INVERSE: [f64; 16] =
        [1.0, 0.0, 0.0, 0.0, 0.5, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.25, 0.5];
    const BASIS: [f64; 16] =
        [1.0, 0.0, 0.0, 0.0, -0.25, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -0.5, 2.0];
    const ORDINARY: [f64; 4] = [1e-8, 4e-6, 0.0, 1e-6];
    const NOISE: f64 = 1e-4;

    const LEAK: [f64; 4] = [-0.008, -0.003, 0.0, 0.001];
    const ERROR: f64 = 0.3;

    fn causes(basis: [f64; 16], inverse: [f64; 16]) -> Causes {
        let file = CausesFile {
            basis: basis.to_vec(),
            inverse: inverse.to_vec(),
            ordinary: ORDINARY.to_vec(),
            known_limit: 20.0,
            alike_from: 0.999,
            sizes_leaks: false,
            fitted: false,
            knows_dead_band: false,
            null_is_exact: false,
            errors_are_even: true,
            cells: vec![
                cell(Cause::PistonSeal, SizeUnit::Area, ERROR, LEAK),
                cell(Cause::Friction, SizeUnit::Force, ERROR, [-0.004, 0.004, 0.0, 0.0]),
            ],
            golden: Vec::new(),
        };
        Causes::from_file(file).unwrap()
    }

    fn identity() -> [f64; 16] {
        core::array::from_fn(|at| if at % 5 == 0 { 1.0 } else { 0.0 })
    }

    /// A hold that scatters three times as noise makes it, its rise too: in the machine's coordinates B (N + D) Bᵀ is the identity, and
    /// B C Bᵀ has the ordinary variances on its diagonal.
    #[test]
    fn analytic_noise_with_scatter_is_even_and_ordinary_variation_apart() {
        let causes = causes(BASIS, INVERSE);
        // The stroke's mean has 0.5² + 2² of the noise's variance.
        let deviations = [3.0, libm::sqrt(4.25), 3.0, 0.1].map(|deviation| deviation * NOISE);
        let machine = causes.of_machine(NOISE, &deviations).unwrap();
        let (basis, inverse) = (&machine.file.basis, &machine.file.inverse);
        let back = product(4, basis, inverse);
        assert!(back.iter().zip(identity()).all(|(a, b)| (a - b).abs() < 1e-12), "{back:?}");
        let mut scatter = product(4, &INVERSE, &transposed(4, &INVERSE));
        scatter[0] += 8.0;
        scatter[10] += 8.0;
        let turned = |covariance: &[f64]| product(4, &product(4, basis, covariance), &transposed(4, basis));
        let even = turned(&scatter);
        assert!(even.iter().zip(identity()).all(|(a, b)| (a - b).abs() < 1e-12), "{even:?}");
        let scaled: Vec<f64> = (0..16).map(|at| INVERSE[at] * libm::sqrt(ORDINARY[at % 4])).collect();
        let ordinary = turned(&product(4, &scaled, &transposed(4, &scaled)));
        for (at, value) in ordinary.iter().enumerate() {
            let expected = if at % 5 == 0 { machine.file.ordinary[at / 4] } else { 0.0 };
            assert!((value - expected).abs() < 1e-18, "{at}: {value} {expected}");
        }
        // Its repeatability is the noise's, as it is told.
        let noise = machine.noise_of(&deviations[..2]);
        assert!((noise / NOISE - 1.0).abs() < 1e-12, "{noise}");
        // Lengths in coordinates of noise are what they were.
        let numbers = [1e-3, -2e-3, 5e-4, 7e-4];
        let change = Change { numbers: &numbers, noise: NOISE };
        let [plain, own] = [&causes, &machine].map(|causes| causes.whitened::<4>(&change));
        assert!(plain.in_noise.iter().zip(&own.in_noise).all(|(a, b)| (a - b).abs() < 1e-18));
        let whole = |causes: &Causes, whitened: &Whitened<4>| causes.parted_in_noise(whitened, &[])[1];
        assert!((whole(&causes, &plain) / whole(&machine, &own) - 1.0).abs() < 1e-12);
    }

    /// Where numbers are each other's affair alone, a law's error is a variance more beside those of noise, scatter and ordinary variation.
    #[test]
    fn analytic_a_law_s_error_is_as_large_beside_scatter() {
        let causes = causes(identity(), identity());
        let machine =
            causes.of_machine(NOISE, &[10.0, 0.5, 10.0, 1.0].map(|deviation| deviation * NOISE)).unwrap();
        let change = [-0.0085, -0.0027, 2e-4, 9e-4];
        let whitened = machine.whitened::<4>(&Change { numbers: &change, noise: NOISE });
        let given = machine.fit_evenly(&whitened, &[&machine.cells[0]]).log_likelihood;
        let before = [100.0, 1.0, 100.0, 1.0].map(|scatter: f64| scatter * (NOISE * NOISE + 1e-12));
        let before = core::array::from_fn(|at| before[at] + ORDINARY[at]);
        let leak = cell(Cause::PistonSeal, SizeUnit::Area, ERROR, LEAK);
        let density =
            |error: f64| libm::exp(log_density(change, &leak, before, variance_of_law(error, change)));
        let simulated = libm::sqrt(ERROR * ERROR - 0.2 * 0.2 + 0.05 * 0.05);
        let expected = libm::log(0.5 * (density(ERROR) + density(simulated)));
        assert!((given - expected).abs() < 1e-6, "{given} {expected}");
    }

    /// A hold that ends now here and now there, by one of its own standard deviations: a cause for whom only noise moves it.
    #[test]
    fn what_a_machine_does_not_repeat_is_no_cause() {
        let causes = causes(identity(), identity());
        let machine = causes.of_machine(NOISE, &[2e-3, NOISE, 2e-3, NOISE]).unwrap();
        let told =
            |causes: &Causes, numbers: [f64; 4]| causes.explain(&Change { numbers: &numbers, noise: NOISE });
        let scattered = [-0.002, 0.0, 0.0, 0.0];
        let [plain, own] = [&causes, &machine].map(|causes| told(causes, scattered).none);
        assert!(plain < 1e-6 && own > 0.5, "{plain} {own}");
        // What the stroke shows counts as it did.
        assert_eq!(told(&machine, LEAK).verdict, ChangeVerdict::Named(Cause::PistonSeal, None));
    }

    #[test]
    fn neutral_a_machine_that_only_noise_moves_has_no_causes_of_its_own() {
        let causes = causes(BASIS, INVERSE);
        for deviations in [&[0.9 * NOISE, NOISE, NOISE, 0.0][..], &[0.0; 4], &[1.0; 2], &[]] {
            assert!(causes.of_machine(NOISE, deviations).is_none(), "{deviations:?}");
        }
    }
}
