//! Where in their ranges pitches and times are worth a simulation: read off the differences instead of tried on a grid.

use crate::fit::{Fit, Problem};
use crate::record::BINS;
use crate::simulated_axis::SimulatedAxis;

/// How many pitches are proposed.
const PITCHES: usize = 8;
/// Pitches of which those are chosen: near enough that over half a metre the nearest is a quarter of a wave off at most.
const WAVES: usize = 192;
/// How many events are proposed, and the shortest and longest of them, bins, each longer than the one before by a third.
const EVENTS: usize = 10;
const SHORTEST: usize = 10;
const LONGEST: usize = BINS / 3;

/// Pitches of the strongest waves over the position that are left of the recorded position, metres: an error of the position's sensor keeps
/// its pitch whatever the loop makes of its size.
pub(crate) fn pitches<A: SimulatedAxis>(
    problem: &Problem<'_>,
    fit: &Fit<A>,
    (low, high): (f64, f64),
) -> Vec<f64> {
    let waves_per_m: Vec<f64> = (0..WAVES)
        .map(|wave| 1.0 / high + (wave as f64 + 0.5) / WAVES as f64 * (1.0 / low - 1.0 / high))
        .collect();
    let powers = problem.waves_over_position(&fit.residual, &waves_per_m);
    let is_peak = |wave: usize| {
        let mut beside = wave.saturating_sub(1)..(wave + 2).min(WAVES);
        beside.all(|other| powers[other] <= powers[wave])
    };
    let mut peaks: Vec<usize> = (0..WAVES).filter(|wave| is_peak(*wave)).collect();
    peaks.sort_by(|a, b| powers[*b].total_cmp(&powers[*a]));
    peaks.into_iter().take(PITCHES).map(|wave| 1.0 / waves_per_m[wave]).collect()
}

/// Starts and durations, shares of the cycle, of the rectangles that explain most of the signals that show best when something happens, each
/// somewhere else than those before.
pub(crate) fn events<A>(problem: &Problem<'_>, fit: &Fit<A>) -> Vec<(f64, f64)> {
    let signals = problem.eventful(&fit.residual);
    let mut chosen: Vec<(usize, usize)> = Vec::new();
    for (index, differences) in signals.iter().enumerate() {
        let most = EVENTS * (index + 1) / signals.len();
        for (start, length) in rectangles(differences) {
            let like = |(other, of): &(usize, usize)| {
                let near = length.min(*of) / 3;
                start.abs_diff(*other) < near && (start + length).abs_diff(other + of) < near
            };
            if !chosen.iter().any(like) {
                chosen.push((start, length));
            }
            if chosen.len() == most {
                break;
            }
        }
    }
    let share = |bins: usize| bins as f64 / BINS as f64;
    chosen.into_iter().map(|(start, length)| (share(start), share(length))).collect()
}

/// Rectangles in a signal's differences, start and length in bins, the one that explains most first.
fn rectangles(differences: &[f64]) -> Vec<(usize, usize)> {
    let mut sums = vec![0.0];
    sums.extend(differences.iter().scan(0.0, |sum, difference| {
        *sum += difference;
        Some(*sum)
    }));
    let mean = sums[BINS] / BINS as f64;
    let mut found: Vec<(f64, usize, usize)> = Vec::new();
    let mut length = SHORTEST;
    while length <= LONGEST {
        for start in (0..BINS - length).step_by(length.div_ceil(8)) {
            let beyond = sums[start + length] - sums[start] - mean * length as f64;
            found.push((beyond * beyond / (length * (BINS - length)) as f64, start, length));
        }
        length += length.div_ceil(3);
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().map(|(_, start, length)| (start, length)).collect()
}
