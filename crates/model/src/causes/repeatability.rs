//! A machine repeats some phases less well than others: a hold before which a move ends now here and now there, a move whose start follows
//! an event. What such a phase shows says little, and what the others show no less for it.
//!
//! With N the covariance that noise of variance 1 gives the numbers of a change, C that of what load, oil and supply ordinarily do, and D what
//! a machine's cycles scatter more than its noise makes them, the causes are told apart in coordinates in which N + D is the identity and C
//! diagonal: with `N + D = L Lᵀ` and the eigenvectors Q of `L⁻¹ C L⁻ᵀ`, `B = Qᵀ L⁻¹`. What laws are off by is as large as it was, and
//! has in each coordinate of these its own share of N.

use alloc::vec;
use alloc::vec::Vec;

use super::Causes;
use crate::schema::CausesFile;

/// Least standard deviation of noise, share of full command: a command without any scatters infinitely more.
const LEAST_NOISE: f64 = 1e-6;
/// Sweeps over all pairs of coordinates, more than ever were needed.
const MOST_SWEEPS: usize = 40;

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

fn square(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum()
}

fn row(matrix: &[f64], n: usize, i: usize) -> &[f64] {
    &matrix[i * n..(i + 1) * n]
}

pub(super) fn applied<'a>(
    n: usize,
    matrix: &'a [f64],
    values: &'a [f64],
) -> impl Iterator<Item = f64> + use<'a> {
    matrix.chunks_exact(n.max(1)).map(move |row| row.iter().zip(values).map(|(a, b)| a * b).sum())
}

fn product(n: usize, a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; n * n];
    for i in 0..n {
        for (k, factor) in row(a, n, i).iter().enumerate() {
            for (slot, value) in product[i * n..(i + 1) * n].iter_mut().zip(row(b, n, k)) {
                *slot += factor * value;
            }
        }
    }
    product
}

fn transposed(n: usize, matrix: &[f64]) -> Vec<f64> {
    (0..n * n).map(|at| matrix[at % n * n + at / n]).collect()
}

/// Lower Cholesky factor, with zeros above its diagonal; `None` of a matrix that is not positive definite.
fn cholesky(n: usize, matrix: impl Fn(usize, usize) -> f64) -> Option<Vec<f64>> {
    let mut factor = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..=i {
            let inner: f64 = (0..j).map(|k| factor[i * n + k] * factor[j * n + k]).sum();
            let rest = matrix(i, j) - inner;
            if i == j && !(rest > 0.0 && rest.is_finite()) {
                return None;
            }
            factor[i * n + j] = if i == j { libm::sqrt(rest) } else { rest / factor[j * n + j] };
        }
    }
    Some(factor)
}

/// `L⁻¹ M` of a lower factor.
fn solved_lower(n: usize, factor: &[f64], matrix: &[f64]) -> Vec<f64> {
    let mut solved = matrix.to_vec();
    for i in 0..n {
        for column in 0..n {
            let inner: f64 = (0..i).map(|k| factor[i * n + k] * solved[k * n + column]).sum();
            solved[i * n + column] = (solved[i * n + column] - inner) / factor[i * n + i];
        }
    }
    solved
}

/// Eigenvalues of a symmetric matrix, and its eigenvectors in the columns of the other: Jacobi's rotations (Golub & Van Loan, Matrix
/// Computations, 2013, section 8.5), which give the same bits on every processor.
fn eigen(n: usize, mut matrix: Vec<f64>) -> (Vec<f64>, Vec<f64>) {
    let mut vectors = vec![0.0; n * n];
    (0..n).for_each(|i| vectors[i * n + i] = 1.0);
    let least = f64::EPSILON * libm::sqrt(square(&matrix));
    for _ in 0..MOST_SWEEPS {
        let mut is_diagonal = true;
        for p in 0..n {
            for q in p + 1..n {
                let beside = matrix[p * n + q];
                if libm::fabs(beside) <= least {
                    continue;
                }
                is_diagonal = false;
                let half = 0.5 * (matrix[q * n + q] - matrix[p * n + p]) / beside;
                let tangent = libm::copysign(1.0, half) / (libm::fabs(half) + libm::sqrt(half * half + 1.0));
                let cosine = 1.0 / libm::sqrt(tangent * tangent + 1.0);
                turn(&mut matrix, (n, 1), (p, q), (cosine, tangent * cosine));
                turn(&mut matrix, (1, n), (p, q), (cosine, tangent * cosine));
                turn(&mut vectors, (1, n), (p, q), (cosine, tangent * cosine));
            }
        }
        if is_diagonal {
            break;
        }
    }
    ((0..n).map(|i| matrix[i * n + i]).collect(), vectors)
}

/// Turns two rows of a matrix, or two columns, as the strides from one to the next and along one say.
fn turn(
    matrix: &mut [f64],
    (next, along): (usize, usize),
    (p, q): (usize, usize),
    (cosine, sine): (f64, f64),
) {
    for at in 0..next.max(along) {
        let (first, second) = (p * next + at * along, q * next + at * along);
        let (a, b) = (matrix[first], matrix[second]);
        matrix[first] = cosine * a - sine * b;
        matrix[second] = sine * a + cosine * b;
    }
}

#[cfg(test)]
mod tests {
    use super::super::fit::Whitened;
    use super::super::{Cause, Change, ChangeVerdict, Kind, SizeUnit};
    use super::*;
    use crate::schema::CellFile;

    /// A hold and a stroke, whose means are the first two numbers and whose rises the last two.
    const INVERSE: [f64; 16] =
        [1.0, 0.0, 0.0, 0.0, 0.5, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.25, 0.5];
    const BASIS: [f64; 16] =
        [1.0, 0.0, 0.0, 0.0, -0.25, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -0.5, 2.0];
    const ORDINARY: [f64; 4] = [1e-8, 4e-6, 0.0, 1e-6];
    const NOISE: f64 = 1e-4;

    fn causes(basis: [f64; 16], inverse: [f64; 16], error: f64) -> Causes {
        let cell = |cause, unit, mean: [f32; 4]| CellFile {
            kind: Kind { cause, side: None, unit },
            other_law: false,
            alike: false,
            size: 1.0,
            size_loadings: vec![0.4],
            size_rest: 0.01,
            error,
            mean: mean.to_vec(),
            directions: vec![mean.iter().map(|value| 0.4 * value).collect()],
        };
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
                cell(Cause::PistonSeal, SizeUnit::Area, [-0.008, -0.003, 0.0, 0.001]),
                cell(Cause::Friction, SizeUnit::Force, [-0.004, 0.004, 0.0, 0.0]),
            ],
            golden: Vec::new(),
        };
        Causes::from_file(file).unwrap()
    }

    fn identity() -> [f64; 16] {
        core::array::from_fn(|at| if at % 5 == 0 { 1.0 } else { 0.0 })
    }

    #[test]
    fn analytic_eigenvalues_and_vectors_of_a_symmetric_matrix() {
        let (values, vectors) = eigen(2, vec![2.0, 1.0, 1.0, 2.0]);
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        assert!((sorted[0] - 1.0).abs() < 1e-14 && (sorted[1] - 3.0).abs() < 1e-14, "{values:?}");
        assert!((square(&vectors) - 2.0).abs() < 1e-14);
        // A V = V diag(λ) of one of five with eigenvalues over six decades.
        let n = 5;
        let matrix: Vec<f64> = (0..n * n)
            .map(|at| {
                let (i, j) = (at / n, at % n);
                libm::pow(0.1, (i + j) as f64 / 2.0) * if i == j { 3.0 } else { libm::cos((i + j) as f64) }
            })
            .collect();
        let (values, vectors) = eigen(n, matrix.clone());
        let images = product(n, &matrix, &vectors);
        for (at, image) in images.iter().enumerate() {
            assert!((image - values[at % n] * vectors[at]).abs() < 1e-14, "{at}");
        }
    }

    /// A hold that scatters three times as noise makes it, its rise too: in the machine's coordinates B (N + D) Bᵀ is the identity, and
    /// B C Bᵀ has the ordinary variances on its diagonal.
    #[test]
    fn analytic_noise_with_scatter_is_even_and_ordinary_variation_apart() {
        let causes = causes(BASIS, INVERSE, 0.3);
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
        let causes = causes(identity(), identity(), 0.3);
        let machine =
            causes.of_machine(NOISE, &[10.0, 0.5, 10.0, 1.0].map(|deviation| deviation * NOISE)).unwrap();
        let change = [-0.0085, -0.0027, 2e-4, 9e-4];
        let whitened = machine.whitened::<4>(&Change { numbers: &change, noise: NOISE });
        let given = machine.fit_evenly(&whitened, &[&machine.cells[0]]).log_likelihood;
        let mean = [-0.008, -0.003, 0.0, 0.001].map(f64::from).map(|value| f64::from(value as f32));
        let density = |error: f64| {
            let variance = error * error * change.iter().map(|value| value * value).sum::<f64>() / 4.0;
            let (mut distance, mut along, mut length, mut log_determinant) = (0.0, 0.0, 0.0, 0.0);
            for at in 0..4 {
                let scatter = if at % 2 == 0 { 100.0 } else { 1.0 };
                let before = scatter * (NOISE * NOISE + 1e-12) + ORDINARY[at];
                let now = before + variance;
                let (rest, direction) = (change[at] - mean[at], 0.4 * mean[at]);
                distance += rest * rest / now;
                along += rest * direction / now;
                length += direction * direction / now;
                log_determinant += libm::log(now / before);
            }
            libm::exp(
                -0.5 * (distance - along * along / (1.0 + length)
                    + log_determinant
                    + libm::log(1.0 + length)),
            )
        };
        let simulated = libm::sqrt(0.3 * 0.3 - 0.2 * 0.2 + 0.05 * 0.05);
        let expected = libm::log(0.5 * (density(0.3) + density(simulated)));
        assert!((given - expected).abs() < 1e-6, "{given} {expected}");
    }

    /// A hold that ends now here and now there, by one of its own standard deviations: a cause for whom only noise moves it.
    #[test]
    fn what_a_machine_does_not_repeat_is_no_cause() {
        let causes = causes(identity(), identity(), 0.3);
        let machine = causes.of_machine(NOISE, &[2e-3, NOISE, 2e-3, NOISE]).unwrap();
        let told =
            |causes: &Causes, numbers: [f64; 4]| causes.explain(&Change { numbers: &numbers, noise: NOISE });
        let scattered = [-0.002, 0.0, 0.0, 0.0];
        let [plain, own] = [&causes, &machine].map(|causes| told(causes, scattered).none);
        assert!(plain < 1e-6 && own > 0.5, "{plain} {own}");
        // What the stroke shows counts as it did.
        let leaking = [-0.008, -0.003, 0.0, 0.001];
        assert_eq!(told(&machine, leaking).verdict, ChangeVerdict::Named(Cause::PistonSeal, None));
    }

    #[test]
    fn neutral_a_machine_that_only_noise_moves_has_no_causes_of_its_own() {
        let causes = causes(BASIS, INVERSE, 0.3);
        for deviations in [&[0.9 * NOISE, NOISE, NOISE, 0.0][..], &[0.0; 4], &[1.0; 2], &[]] {
            assert!(causes.of_machine(NOISE, deviations).is_none(), "{deviations:?}");
        }
    }
}
