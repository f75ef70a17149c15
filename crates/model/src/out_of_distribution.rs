//! The out-of-distribution score: how far a cycle lies from everything that training has seen (Mahalanobis distance, as in Lee et al.,
//! "A simple unified framework for detecting out-of-distribution samples and adversarial attacks", NeurIPS 2018, here on phase means).

use seepd_features::segment::MAX_PHASES;

use crate::schema::TrainingDistribution;

/// A cycle's distance from the training data.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutOfDistribution {
    /// Distance over its limit, 1: where it exceeds 1, the estimate is an extrapolation.
    pub score: f64,
    /// Index of the value with the largest share of the distance.
    pub most_unusual: usize,
}

impl OutOfDistribution {
    /// Scores values, one a phase, that belong to a transformed estimate `y`, against `ranges`, ascending in `from_y`; the score is 0
    /// where `ranges` is empty.
    pub fn of(ranges: &[TrainingDistribution], y: f64, values: &[f64]) -> Self {
        let after = ranges.partition_point(|range| range.from_y <= y);
        let Some(range) = ranges.get(after.saturating_sub(1)) else {
            return OutOfDistribution { score: 0.0, most_unusual: 0 };
        };
        let (distance, most_unusual) = size(whitened(range, values).get(..values.len()).unwrap_or_default());
        OutOfDistribution { score: distance / range.limit, most_unusual }
    }
}

/// Mahalanobis distance of values, one a phase, from a range's mean, over the square root of their number.
pub fn distance(range: &TrainingDistribution, values: &[f64]) -> f64 {
    size(whitened(range, values).get(..values.len()).unwrap_or_default()).0
}

fn whitened(range: &TrainingDistribution, values: &[f64]) -> [f64; MAX_PHASES] {
    let mut whitened = [0.0; MAX_PHASES];
    let mut row = 0;
    for (i, slot) in whitened.iter_mut().enumerate().take(values.len()) {
        let weights = range.whitening.get(row..=row + i).unwrap_or_default();
        let difference = values.iter().zip(&range.mean).map(|(value, mean)| value - mean);
        *slot = weights.iter().zip(difference).map(|(weight, value)| weight * value).sum();
        row += i + 1;
    }
    whitened
}

/// Root mean square, and the index of the largest.
fn size(values: &[f64]) -> (f64, usize) {
    let square = values.iter().map(|value| value * value).sum::<f64>() / values.len().max(1) as f64;
    let largest = values.iter().enumerate().max_by(|(_, a), (_, b)| a.abs().total_cmp(&b.abs()));
    (libm::sqrt(square), largest.map_or(0, |(index, _)| index))
}
