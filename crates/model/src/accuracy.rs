//! What estimates are worth beside the truth.

use alloc::vec::Vec;

use serde::Serialize;

use crate::ensemble::Estimate;

/// Ranges of leak areas by which errors are reported, m²; the last range includes its upper end.
pub const DECADES_M2: [(f64, f64); 3] = [(5e-8, 1e-7), (1e-7, 1e-6), (1e-6, 1e-5)];

/// A range of areas.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Decade {
    /// Lower end, m².
    pub from_m2: f64,
    /// Upper end, m².
    pub to_m2: f64,
    /// Estimates of which the truth lies in the range.
    pub count: usize,
    /// Median of |estimate − truth| / truth; not a number for none.
    pub median_relative_error: f64,
    /// Share of estimates of which the interval holds the truth; not a number for none.
    pub coverage: f64,
}

/// An estimate beside the truth, m².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Judged {
    /// The truth.
    pub truth_m2: f64,
    /// The estimate.
    pub estimate_m2: f64,
    /// Its interval.
    pub interval_m2: [f64; 2],
}

impl Judged {
    /// A model's estimate beside the truth.
    pub fn new(truth_m2: f64, estimate: &Estimate) -> Self {
        Judged { truth_m2, estimate_m2: estimate.value, interval_m2: estimate.interval }
    }

    /// |estimate − truth| / truth.
    pub fn relative_error(&self) -> f64 {
        (self.estimate_m2 - self.truth_m2).abs() / self.truth_m2
    }

    /// Whether the interval holds the truth.
    pub fn is_covered(&self) -> bool {
        (self.interval_m2[0]..=self.interval_m2[1]).contains(&self.truth_m2)
    }
}

/// Whether an area lies in one of [`DECADES_M2`].
pub fn in_main_range(area_m2: f64) -> bool {
    (DECADES_M2[0].0..=DECADES_M2[DECADES_M2.len() - 1].1).contains(&area_m2)
}

/// Error and coverage by decade of the truth.
pub fn decades(cases: &[Judged]) -> Vec<Decade> {
    let last = DECADES_M2[DECADES_M2.len() - 1].1;
    DECADES_M2
        .iter()
        .map(|&(from_m2, to_m2)| {
            let within = |truth: f64| (from_m2..to_m2).contains(&truth) || (truth == last && truth == to_m2);
            let cases = cases.iter().filter(|case| within(case.truth_m2));
            Decade {
                from_m2,
                to_m2,
                count: cases.clone().count(),
                median_relative_error: median_relative_error(cases.clone()),
                coverage: coverage(cases),
            }
        })
        .collect()
}

/// Share of cases of which the interval holds the truth; not a number for none.
pub fn coverage<'c>(cases: impl Iterator<Item = &'c Judged> + Clone) -> f64 {
    cases.clone().filter(|case| case.is_covered()).count() as f64 / cases.count() as f64
}

/// Median of |estimate − truth| / truth; not a number for none.
pub fn median_relative_error<'c>(cases: impl Iterator<Item = &'c Judged>) -> f64 {
    median(cases.map(Judged::relative_error).collect())
}

/// Coefficient of determination of (truth, estimate) pairs; not a number where the truth does not vary.
pub fn r_squared(pairs: &[(f64, f64)]) -> f64 {
    let mean = pairs.iter().map(|pair| pair.0).sum::<f64>() / pairs.len() as f64;
    let residual: f64 = pairs.iter().map(|(truth, estimate)| square(truth - estimate)).sum();
    let total: f64 = pairs.iter().map(|(truth, _)| square(truth - mean)).sum();
    if total > 0.0 { 1.0 - residual / total } else { f64::NAN }
}

fn square(value: f64) -> f64 {
    value * value
}

/// Mean of |truth − estimate|; not a number for none.
pub fn mean_absolute_error(pairs: &[(f64, f64)]) -> f64 {
    pairs.iter().map(|(truth, estimate)| (truth - estimate).abs()).sum::<f64>() / pairs.len() as f64
}

/// The middle value; not a number for none.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(truth_m2: f64, estimate_m2: f64, half_width_m2: f64) -> Judged {
        let interval_m2 = [(estimate_m2 - half_width_m2).max(0.0), estimate_m2 + half_width_m2];
        Judged { truth_m2, estimate_m2, interval_m2 }
    }

    #[test]
    fn errors_and_coverage_by_decade() {
        let cases = [
            case(6e-8, 6.6e-8, 1e-8),
            case(2e-7, 2.4e-7, 1e-8),
            case(4e-7, 4e-7, 1e-8),
            case(1e-5, 1.1e-5, 2e-6),
            case(0.0, 1e-9, 2e-9),
        ];
        let found = decades(&cases);
        assert_eq!(found.iter().map(|decade| decade.count).collect::<Vec<_>>(), [1, 2, 1]);
        assert_eq!(found.iter().map(|decade| decade.coverage).collect::<Vec<_>>(), [1.0, 0.5, 1.0]);
        for (decade, error) in found.iter().zip([0.1, 0.2, 0.1]) {
            assert!((decade.median_relative_error - error).abs() < 1e-9, "{decade:?}");
        }
        assert_eq!(coverage(cases.iter()), 0.8);
        assert!(coverage([].iter()).is_nan() && median(Vec::new()).is_nan());
    }

    #[test]
    fn the_coefficient_of_determination_of_a_perfect_and_of_a_constant_estimate() {
        assert_eq!(r_squared(&[(1.0, 1.0), (2.0, 2.0), (3.0, 3.0)]), 1.0);
        assert_eq!(r_squared(&[(1.0, 2.0), (2.0, 2.0), (3.0, 2.0)]), 0.0);
        assert!(r_squared(&[(1.0, 1.0), (1.0, 1.0)]).is_nan());
    }
}
