//! Sizes within what training has simulated. A fit's size is normal and knows no end: a cause that hardly answers as the change does would be
//! stretched to ten times what was ever simulated, or turned to its opposite, to explain it. So the normal is cut at the ends of the range, and
//! the hypothesis counts by the share that is left (Johnson, Kotz & Balakrishnan, Continuous Univariate Distributions 1, 1994, section 10.1).

use alloc::vec::Vec;
use core::f64::consts::{FRAC_1_SQRT_2, PI};

use super::Cell;

/// How far over the largest simulated size a size may lie: what the response of a machine may be off by, and some.
const BEYOND: f64 = 1.25;
/// Least share of a normal that has moments of its own.
const LEAST_SHARE: f64 = 1e-9;

/// Says for each cell which sizes its kind was simulated at, with its sign.
pub(super) fn mark_simulated(cells: &mut [Cell]) {
    let ends: Vec<f64> = cells.iter().map(|cell| farthest(cells, cell)).collect();
    for (cell, end) in cells.iter_mut().zip(ends) {
        cell.simulated = [end.min(0.0), end.max(0.0)];
    }
}

/// The farthest size from 0 among cells of a kind and a sign.
fn farthest(cells: &[Cell], of: &Cell) -> f64 {
    let is_sibling = |cell: &&Cell| cell.kind == of.kind && (cell.size > 0.0) == (of.size > 0.0);
    let magnitude = |cell: &Cell| {
        let spread: f64 =
            cell.loadings.iter().map(|loading| loading * loading).sum::<f64>() + cell.rest * cell.rest;
        // A uniform distribution ends at √3 standard deviations.
        libm::fabs(cell.size) + libm::sqrt(3.0 * spread)
    };
    let largest = cells.iter().filter(is_sibling).map(magnitude).fold(0.0, f64::max);
    libm::copysign(BEYOND * largest, of.size)
}

/// A normal distribution, cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cut {
    /// Logarithm of the share within the ends.
    pub(super) log_share: f64,
    pub(super) mean: f64,
    pub(super) variance: f64,
}

/// Cuts the normal of a mean and a variance at the ends of a range.
pub(super) fn cut((mean, variance): (f64, f64), [from, to]: [f64; 2]) -> Cut {
    let deviation = libm::sqrt(variance).max(f64::MIN_POSITIVE);
    let [low, high] = [from, to].map(|end| (end - mean) / deviation);
    let share = share_between(low, high);
    let log_share = libm::log(share.max(f64::MIN_POSITIVE));
    if share < LEAST_SHARE {
        return Cut { log_share, mean: mean.clamp(from, to), variance: 0.0 };
    }
    let [at_low, at_high] = [low, high].map(density);
    let shift = (at_low - at_high) / share;
    // Where an end lies far out its product is 0 · ∞.
    let product = |end: f64, density: f64| if density > 0.0 { end * density } else { 0.0 };
    let narrowed = 1.0 + (product(low, at_low) - product(high, at_high)) / share - shift * shift;
    Cut {
        log_share,
        mean: (mean + deviation * shift).clamp(from, to),
        variance: variance * narrowed.max(0.0),
    }
}

/// Share of the standard normal between two ends; by the tail where both lie on one side.
fn share_between(low: f64, high: f64) -> f64 {
    let tail = |from: f64| 0.5 * libm::erfc(from * FRAC_1_SQRT_2);
    if low > 0.0 { tail(low) - tail(high) } else { tail(-high) - tail(-low) }
}

fn density(at: f64) -> f64 {
    libm::exp(-0.5 * at * at) / libm::sqrt(2.0 * PI)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half a normal has mean σ √(2/π) and variance σ² (1 − 2/π).
    #[test]
    fn analytic_half_a_normal() {
        let half = cut((0.0, 4.0), [0.0, 1e9]);
        assert!((half.log_share - libm::log(0.5)).abs() < 1e-12, "{half:?}");
        assert!((half.mean - 2.0 * libm::sqrt(2.0 / PI)).abs() < 1e-12, "{half:?}");
        assert!((half.variance - 4.0 * (1.0 - 2.0 / PI)).abs() < 1e-12, "{half:?}");
    }

    #[test]
    fn neutral_a_normal_far_from_both_ends_stays_what_it_is() {
        assert_eq!(cut((5.0, 0.01), [0.0, 10.0]), Cut { log_share: 0.0, mean: 5.0, variance: 0.01 });
    }

    /// Beyond the end by σ the tail of 15.9 % is left, by 40 σ nothing that a number can say; and the mean is never outside.
    #[test]
    fn a_size_that_nobody_has_simulated_has_little_share_and_stays_within() {
        let [near, far] = [-1.0, -40.0].map(|mean| cut((mean, 1.0), [0.0, 10.0]));
        assert!((libm::exp(near.log_share) - 0.158_655).abs() < 1e-6, "{near:?}");
        assert!(far.log_share < -700.0 && far.mean == 0.0, "{far:?}");
        assert!((0.0..1.0).contains(&near.mean) && near.variance < 1.0, "{near:?}");
    }
}
