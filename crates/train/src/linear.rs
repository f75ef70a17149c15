//! Small linear algebra in plain loops: the same bits on every processor, which a library's products do not give.

/// Lower Cholesky factor of a symmetric positive definite matrix, rows one after the other, each up to its diagonal; `None` for
/// another matrix. `matrix(i, j)` is asked for `j ≤ i`.
pub(crate) fn cholesky(n: usize, matrix: impl Fn(usize, usize) -> f64) -> Option<Vec<f64>> {
    let mut factor = vec![0.0; n * (n + 1) / 2];
    for i in 0..n {
        for j in 0..=i {
            let (row_i, row_j) = (i * (i + 1) / 2, j * (j + 1) / 2);
            let dot: f64 = (0..j).map(|k| factor[row_i + k] * factor[row_j + k]).sum();
            let rest = matrix(i, j) - dot;
            factor[row_i + j] = if i > j {
                rest / factor[row_j + j]
            } else if rest > 0.0 {
                rest.sqrt()
            } else {
                return None;
            };
        }
    }
    Some(factor)
}

/// Solves `L Lᵀ x = b`.
pub(crate) fn solve(factor: &[f64], mut x: Vec<f64>) -> Vec<f64> {
    let n = x.len();
    for i in 0..n {
        let row = i * (i + 1) / 2;
        let dot: f64 = (0..i).map(|k| factor[row + k] * x[k]).sum();
        x[i] = (x[i] - dot) / factor[row + i];
    }
    for i in (0..n).rev() {
        let dot: f64 = (i + 1..n).map(|k| factor[k * (k + 1) / 2 + i] * x[k]).sum();
        x[i] = (x[i] - dot) / factor[i * (i + 1) / 2 + i];
    }
    x
}

/// Inverse of a lower triangular factor, in the same form.
pub(crate) fn inverse(n: usize, factor: &[f64]) -> Vec<f64> {
    let mut inverse = vec![0.0; factor.len()];
    for column in 0..n {
        for i in column..n {
            let row = i * (i + 1) / 2;
            let dot: f64 = (column..i).map(|k| factor[row + k] * inverse[k * (k + 1) / 2 + column]).sum();
            let unit = if i == column { 1.0 } else { 0.0 };
            inverse[row + column] = (unit - dot) / factor[row + i];
        }
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;

    const MATRIX: [[f64; 3]; 3] = [[4.0, 2.0, 0.6], [2.0, 5.0, 1.0], [0.6, 1.0, 3.0]];

    #[test]
    fn solution_meets_its_equations_and_the_inverse_its_factor() {
        let factor = cholesky(3, |i, j| MATRIX[i][j]).unwrap();
        let x = solve(&factor, vec![1.0, -2.0, 0.5]);
        for (row, expected) in MATRIX.iter().zip([1.0, -2.0, 0.5]) {
            let given: f64 = row.iter().zip(&x).map(|(a, b)| a * b).sum();
            assert!((given - expected).abs() < 1e-12);
        }
        let inverse = inverse(3, &factor);
        // L⁻¹ M L⁻ᵀ = 1.
        let at = |i: usize, j: usize| if j <= i { inverse[i * (i + 1) / 2 + j] } else { 0.0 };
        for i in 0..3 {
            for j in 0..3 {
                let sum: f64 = (0..9).map(|k| at(i, k / 3) * MATRIX[k / 3][k % 3] * at(j, k % 3)).sum();
                assert!((sum - f64::from(u8::from(i == j))).abs() < 1e-12);
            }
        }
        assert_eq!(cholesky(2, |i, j| if i == j { 1.0 } else { 2.0 }), None);
    }
}
