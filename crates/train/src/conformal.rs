//! Intervals that hold the truth as often as they say: normalised conformal prediction along the prediction (Johansson et al.,
//! "Regression conformal prediction with random forests", Machine Learning 97 (2014)), on machines that were not learned from.

use seepd_model::schema::Calibration;

use crate::train::round_to;

/// Level of the intervals.
pub(crate) const LEVEL: f64 = 0.9;
/// Floor of the trees' spread: below it, agreement of the trees is luck.
pub(crate) const SPREAD_FLOOR: f64 = 0.005;
/// Places along the prediction that are calibrated, each from that part of the predictions around it: places close enough for straight
/// lines between them, windows large enough for a quantile.
const PLACES: usize = 24;
const WINDOW_SHARE: usize = 12;
/// Room over the largest estimate that was seen of a machine without a leak.
const HEALTHY_ROOM: f64 = 1.1;

/// A prediction of a machine whose leak is known.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Prediction {
    /// Truth, transformed.
    pub(crate) truth: f64,
    /// Prediction, transformed.
    pub(crate) mean: f64,
    /// Standard deviation of the trees.
    pub(crate) spread: f64,
}

impl Prediction {
    fn score(&self) -> f64 {
        (self.truth - self.mean).abs() / (self.spread + SPREAD_FLOOR)
    }
}

/// Factors on the spread such that the interval holds the truth of `LEVEL` of the predictions, along the prediction.
pub(crate) fn factors(predictions: impl Iterator<Item = Prediction>) -> Vec<(f64, f64)> {
    let mut scores: Vec<(f64, f64)> = predictions.map(|one| (one.mean, one.score())).collect();
    scores.sort_by(|a, b| a.0.total_cmp(&b.0));
    let count = scores.len();
    let window = count.div_ceil(WINDOW_SHARE).max(1);
    let mut factors: Vec<(f64, f64)> = Vec::new();
    for place in 0..if count > 0 { PLACES } else { 0 } {
        let centre = (2 * place + 1) * count / (2 * PLACES);
        // At the ends the window moves inwards.
        let from = centre.saturating_sub(window / 2).min(count - window);
        let mut errors: Vec<f64> = scores[from..from + window].iter().map(|(_, score)| *score).collect();
        errors.sort_by(f64::total_cmp);
        let rank = ((errors.len() + 1) as f64 * LEVEL).ceil() as usize;
        let factor = errors[rank.clamp(1, errors.len()) - 1];
        let at = scores[centre].0;
        if factors.last().is_none_or(|last| at > last.0 + 1e-6) {
            factors.push((round_to(at, 5), round_to(factor, 5)));
        }
    }
    factors
}

/// The calibration for predictions at several levels of noise; `healthy` are estimates of machines without a leak, m².
pub(crate) fn calibration(
    by_noise: &[(f64, Vec<Prediction>)],
    healthy: impl Iterator<Item = f64>,
) -> Calibration {
    let all = by_noise.iter().flat_map(|(_, predictions)| predictions).copied();
    Calibration {
        level: LEVEL,
        spread_floor: SPREAD_FLOOR,
        factors: factors(all),
        by_noise: by_noise
            .iter()
            .map(|(noise, predictions)| (*noise, factors(predictions.iter().copied())))
            .collect(),
        healthy_limit: significant(HEALTHY_ROOM * healthy.fold(0.0, f64::max)),
    }
}

/// Three significant digits.
pub(crate) fn significant(value: f64) -> f64 {
    if value <= 0.0 || !value.is_finite() {
        return 0.0;
    }
    let scale = 10f64.powi(2 - value.log10().floor() as i32);
    (value * scale).round() / scale
}
