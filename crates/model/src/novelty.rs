//! How far a cycle lies from everything that training has seen.

use seepd_features::segment::MAX_PHASES;

use crate::schema::NoveltyFile;

/// A cycle's distance from training.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Novelty {
    /// Distance over its limit: above 1 an estimate is a guess.
    pub ratio: f64,
    /// Index of the value with the largest share of it.
    pub newest: usize,
}

impl Novelty {
    /// Of values that belong to a transformed estimate `y`; 0 where nothing is known of training.
    pub fn of(ranges: &[NoveltyFile], y: f64, values: &[f64]) -> Self {
        let after = ranges.partition_point(|range| range.from_y <= y);
        let Some(range) = ranges.get(after.saturating_sub(1)) else {
            return Novelty { ratio: 0.0, newest: 0 };
        };
        let (distance, newest) = size(whitened(range, values).get(..values.len()).unwrap_or_default());
        Novelty { ratio: distance / range.limit, newest }
    }
}

/// Distance of values from a range's mean: root mean square of the whitened difference.
pub fn distance(range: &NoveltyFile, values: &[f64]) -> f64 {
    size(whitened(range, values).get(..values.len()).unwrap_or_default()).0
}

fn whitened(range: &NoveltyFile, values: &[f64]) -> [f64; MAX_PHASES] {
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
