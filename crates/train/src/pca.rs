//! Principal components of the cycles' bins.

use nalgebra::{DMatrix, SymmetricEigen};
use seepd_model::schema::ProjectionFile;

/// The first `count` principal components of the rows (all of one length), largest variance first, each with
/// its largest loading positive.
pub fn components(rows: &[Vec<f32>], count: usize) -> Vec<ProjectionFile> {
    let Some(width) = rows.first().map(Vec::len) else { return Vec::new() };
    let n = rows.len() as f64;
    let mean: Vec<f64> = (0..width).map(|j| rows.iter().map(|row| f64::from(row[j])).sum::<f64>() / n).collect();
    let centred = DMatrix::from_fn(rows.len(), width, |i, j| f64::from(rows[i][j]) - mean[j]);
    let eigen = SymmetricEigen::new(centred.tr_mul(&centred) / n);
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a line through (1, 2, 3) along (2, −1, 2)/3: the component is the line, the mean its middle.
    #[test]
    fn analytic_line_in_space() {
        let direction = [2.0f32 / 3.0, -1.0 / 3.0, 2.0 / 3.0];
        let rows: Vec<Vec<f32>> =
            (-50..=50).map(|t| (0..3).map(|j| (j + 1) as f32 + t as f32 * 0.1 * direction[j as usize]).collect()).collect();
        let found = &components(&rows, 1)[0];
        for j in 0..3 {
            assert!((found.loading[j].abs() - direction[j].abs()).abs() < 1e-6);
            assert!((found.mean[j] - (j + 1) as f32).abs() < 1e-6);
        }
        assert!(found.loading[0] * found.loading[1] < 0.0);
    }
}
