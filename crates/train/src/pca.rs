//! Principal components of the cycles' bins.

use nalgebra::{DMatrix, SymmetricEigen};
use seepd_model::schema::ProjectionFile;

/// The first `count` principal components of the rows (all of one length), largest variance first, each with
/// its largest loading positive.
pub(crate) fn components(rows: &[Vec<f32>], count: usize) -> Vec<ProjectionFile> {
    let Some(width) = rows.first().map(Vec::len) else { return Vec::new() };
    let n = rows.len() as f64;
    let mean: Vec<f64> =
        (0..width).map(|j| rows.iter().map(|row| f64::from(row[j])).sum::<f64>() / n).collect();
    let eigen = SymmetricEigen::new(covariance(rows, &mean) / n);
    let mut order: Vec<usize> = (0..width).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    order
        .into_iter()
        .take(count)
        .enumerate()
        .map(|(rank, column)| {
            let loading = eigen.eigenvectors.column(column);
            let largest = loading.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(1.0);
            ProjectionFile {
                name: format!("pca_{}", rank + 1),
                mean: mean.iter().map(|value| *value as f32).collect(),
                loading: loading.iter().map(|value| (value * largest.signum()) as f32).collect(),
            }
        })
        .collect()
}

/// Sum of the rows' outer products around the mean. Plain loops: a library's product takes other instructions on other
/// processors, and a model's bytes shall not depend on them.
fn covariance(rows: &[Vec<f32>], mean: &[f64]) -> DMatrix<f64> {
    let width = mean.len();
    let mut sum = vec![0.0; width * width];
    let mut centred = vec![0.0; width];
    for row in rows {
        for ((value, bin), mean) in centred.iter_mut().zip(row).zip(mean) {
            *value = f64::from(*bin) - mean;
        }
        for (line, a) in sum.chunks_exact_mut(width).zip(&centred) {
            for (cell, b) in line.iter_mut().zip(&centred) {
                *cell += a * b;
            }
        }
    }
    DMatrix::from_vec(width, width, sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a line through (1, 2, 3) along (2, −1, 2)/3: the component is the line, the mean its middle.
    #[test]
    fn analytic_line_in_space() {
        let direction = [2.0f32 / 3.0, -1.0 / 3.0, 2.0 / 3.0];
        let rows: Vec<Vec<f32>> = (-50..=50)
            .map(|t| (0..3).map(|j| (j + 1) as f32 + t as f32 * 0.1 * direction[j as usize]).collect())
            .collect();
        let found = &components(&rows, 1)[0];
        for (j, direction) in direction.iter().enumerate() {
            assert!((found.loading[j].abs() - direction.abs()).abs() < 1e-6);
            assert!((found.mean[j] - (j + 1) as f32).abs() < 1e-6);
        }
        assert!(found.loading[0] * found.loading[1] < 0.0);
    }
}
