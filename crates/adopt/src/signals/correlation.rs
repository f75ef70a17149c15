//! What is left of how two quantities go together once others are accounted for.

use nalgebra::{DMatrix, DVector};

/// Correlation of `a` and `b` beyond what a straight line over `given` explains of each; `None` where too little is there.
pub(super) fn partial(a: &[f64], b: &[f64], given: &[Vec<f64>]) -> Option<f64> {
    let whole: Vec<usize> = (0..a.len())
        .filter(|at| {
            a[*at].is_finite() && b[*at].is_finite() && given.iter().all(|column| column[*at].is_finite())
        })
        .collect();
    if whole.len() < 100 {
        return None;
    }
    let regressors = DMatrix::from_fn(whole.len(), given.len() + 1, |row, column| {
        given.get(column).map_or(1.0, |values| values[whole[row]])
    });
    let normal = (regressors.transpose() * &regressors).try_inverse()?;
    let left = |values: &[f64]| {
        let values = DVector::from_iterator(whole.len(), whole.iter().map(|at| values[*at]));
        let coefficients = &normal * (regressors.transpose() * &values);
        values - &regressors * coefficients
    };
    let (a, b) = (left(a), left(b));
    let correlation = a.dot(&b) / (a.norm() * b.norm());
    correlation.is_finite().then_some(correlation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_what_others_explain_is_left_out() {
        let common: Vec<f64> = (0..1000).map(|n| (n as f64 / 40.0).sin()).collect();
        let own: Vec<f64> = (0..1000).map(|n| (n as f64 / 7.0).sin()).collect();
        // Together through `common` alone, against each other by their own share.
        let a: Vec<f64> = common.iter().zip(&own).map(|(c, o)| 3.0 * c + o).collect();
        let b: Vec<f64> = common.iter().zip(&own).map(|(c, o)| 3.0 * c - o).collect();
        assert!(partial(&a, &b, &[]).unwrap() > 0.7);
        assert!(partial(&a, &b, std::slice::from_ref(&common)).unwrap() < -0.999);
        assert_eq!(partial(&a[..50], &b[..50], &[]), None);
    }
}
