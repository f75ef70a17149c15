//! Small linear algebra in plain loops: the same bits on every processor, which a library's products do not give. A matrix is its rows one after
//! the other.

use alloc::vec;
use alloc::vec::Vec;

/// Sweeps over all pairs of coordinates, more than ever were needed.
const MOST_SWEEPS: usize = 40;

/// Squared length.
pub(super) fn square(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum()
}

pub(super) fn row(matrix: &[f64], n: usize, i: usize) -> &[f64] {
    &matrix[i * n..(i + 1) * n]
}

/// A matrix times a vector.
pub(super) fn applied<'a>(
    n: usize,
    matrix: &'a [f64],
    values: &'a [f64],
) -> impl Iterator<Item = f64> + use<'a> {
    matrix.chunks_exact(n.max(1)).map(move |row| row.iter().zip(values).map(|(a, b)| a * b).sum())
}

pub(super) fn product(n: usize, a: &[f64], b: &[f64]) -> Vec<f64> {
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

pub(super) fn transposed(n: usize, matrix: &[f64]) -> Vec<f64> {
    (0..n * n).map(|at| matrix[at % n * n + at / n]).collect()
}

/// Lower Cholesky factor, with zeros above its diagonal; `None` of a matrix that is not positive definite.
pub(super) fn cholesky(n: usize, matrix: impl Fn(usize, usize) -> f64) -> Option<Vec<f64>> {
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
pub(super) fn solved_lower(n: usize, factor: &[f64], matrix: &[f64]) -> Vec<f64> {
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
pub(super) fn eigen(n: usize, mut matrix: Vec<f64>) -> (Vec<f64>, Vec<f64>) {
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
    use super::*;

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
}
