//! The step in which a position is read, read off the log itself: a quantised sensor's values stand on a comb, whatever the loop makes of it.
//!
//! A comb of step `s` gives the mean of `exp(2πi x / s)` over the positions `x` a length near 1, less by the noise that was added after the
//! step: the characteristic function of the positions, which for spread ones is about 0 (Widrow and Kollár, *Quantization Noise*, 2008).
//! A stroke at a constant speed puts regular distances between its samples as well. Those are others at another speed, in the other direction
//! and at rest, so that each of these must show the comb, at the same place.

use std::f64::consts::TAU;

use nalgebra::Complex;
use seepd_sim::effects::EffectInfo;

/// Moving samples that are looked at: in the search, and for the frequency in the end.
const SEARCHED: usize = 800;
const REFINED: usize = 8000;
/// A comb is seen from this length of the mean on, in all and in each group.
const SEEN_FROM: f64 = 0.5;
/// Groups of samples; the first are those at rest.
const GROUPS: usize = 5;
const AT_REST: usize = 0;
/// Fewest samples of a group that says anything.
const FEWEST: usize = 100;
/// Frequencies between 1 and the reciprocal of the stroke.
const PER_STROKE: f64 = 3.0;
/// A frequency whose length is this share of the largest is the comb's own; the largest may be a multiple of it.
const FUNDAMENTAL: f64 = 0.75;
/// Samples on either side over which a speed is taken.
const SPEED_OVER: usize = 10;
/// Share of the largest speed from which a sample is a moving one.
const MOVING: f64 = 0.1;

/// Whether an effect is that of a position which is read in steps.
pub(crate) fn is_of_steps(effect: &EffectInfo) -> bool {
    effect.parameters.iter().any(|parameter| parameter.name == "step_m")
}

/// The step of a quantised position, of those within a range, m; `None` where there is no comb, or it drowns in noise.
pub(crate) fn position_step_m(position_m: &[f64], (least_m, most_m): (f64, f64)) -> Option<f64> {
    let groups = groups(position_m);
    let all: Vec<f64> = groups[AT_REST + 1..].iter().flatten().copied().collect();
    let stroke_m = all.iter().copied().fold(f64::NEG_INFINITY, f64::max)
        - all.iter().copied().fold(f64::INFINITY, f64::min);
    if all.len() < SEARCHED || stroke_m <= most_m || groups.iter().any(|group| group.len() < FEWEST) {
        return None;
    }
    let spacing = 1.0 / (PER_STROKE * stroke_m);
    let count = ((1.0 / least_m - 1.0 / most_m) / spacing) as usize;
    let lengths = lengths(&evenly(&all, SEARCHED), 1.0 / most_m, spacing, count);
    let largest = lengths.iter().copied().fold(0.0, f64::max);
    let is_comb = |length: &f64| *length >= SEEN_FROM && *length >= FUNDAMENTAL * largest;
    let first = lengths.iter().position(is_comb)?;
    // The top of the peak whose flank this is.
    let top = (first..(first + 3).min(count)).max_by(|a, b| lengths[*a].total_cmp(&lengths[*b]))?;
    let waves_per_m = refined(&evenly(&all, REFINED), 1.0 / most_m + top as f64 * spacing, spacing);
    let whole = mean_phasor(&all, waves_per_m);
    let agrees = |group: &Vec<f64>| (mean_phasor(group, waves_per_m) / whole * whole.norm()).re >= SEEN_FROM;
    (whole.norm() >= SEEN_FROM && groups.iter().all(agrees)).then_some(1.0 / waves_per_m)
}

/// Samples in groups that cannot have a regular distance in common: at rest, and out and back, slower and faster than the middle speed
/// of that direction each.
fn groups(position_m: &[f64]) -> [Vec<f64>; GROUPS] {
    let speeds: Vec<f64> =
        position_m.windows(2 * SPEED_OVER + 1).map(|around| around[2 * SPEED_OVER] - around[0]).collect();
    let finite = speeds.iter().filter(|speed| speed.is_finite());
    let fastest = finite.fold(0.0, |most: f64, speed| most.max(speed.abs()));
    let least = MOVING * fastest;
    let middle = |sign: f64| {
        let mut moving: Vec<f64> =
            speeds.iter().map(|speed| sign * speed).filter(|speed| *speed > least).collect();
        moving.sort_by(f64::total_cmp);
        moving.get(moving.len() / 2).copied().unwrap_or(0.0)
    };
    let (middle_out, middle_back) = (middle(1.0), middle(-1.0));
    let mut groups = [const { Vec::new() }; GROUPS];
    for (speed, position) in speeds.iter().zip(&position_m[SPEED_OVER.min(position_m.len())..]) {
        let group = match *speed {
            speed if speed > middle_out.max(least) => 1,
            speed if speed > least => 2,
            speed if speed < -middle_back.max(least) => 3,
            speed if speed < -least => 4,
            _ => AT_REST,
        };
        if position.is_finite() && speed.is_finite() {
            groups[group].push(*position);
        }
    }
    groups
}

fn evenly(values: &[f64], count: usize) -> Vec<f64> {
    let count = count.min(values.len());
    (0..count).map(|index| values[index * values.len() / count]).collect()
}

/// Length of the mean phasor at frequencies from one on.
fn lengths(values: &[f64], from: f64, spacing: f64, count: usize) -> Vec<f64> {
    let mut sums = vec![Complex::new(0.0, 0.0); count];
    for value in values {
        let turn = Complex::cis(TAU * value * spacing);
        let mut phasor = Complex::cis(TAU * value * from);
        for sum in &mut sums {
            *sum += phasor;
            phasor *= turn;
        }
    }
    sums.into_iter().map(|sum| sum.norm() / values.len() as f64).collect()
}

fn mean_phasor(values: &[f64], waves_per_m: f64) -> Complex<f64> {
    values.iter().map(|value| Complex::cis(TAU * value * waves_per_m)).sum::<Complex<f64>>()
        / values.len() as f64
}

/// The frequency of the peak's top, by thirds of what is left on either side of it.
fn refined(values: &[f64], near: f64, spacing: f64) -> f64 {
    let (mut low, mut high) = (near - spacing, near + spacing);
    while high - low > 1e-4 * spacing {
        let [lower, upper] = [1.0, 2.0].map(|thirds| low + thirds / 3.0 * (high - low));
        if mean_phasor(values, lower).norm() > mean_phasor(values, upper).norm() {
            high = upper;
        } else {
            low = lower;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use seepd_sim::noise::Noise;

    use super::*;

    const RANGE_M: (f64, f64) = (5e-5, 5e-4);

    /// Strokes out and back between holds at 1 kHz, each cycle a little elsewhere, read in steps, with noise added after.
    fn strokes(step_m: f64, noise_m: f64) -> Vec<f64> {
        let mut noise = Noise::new(3, 7);
        let mut positions = Vec::new();
        for cycle in 0..8 {
            let shift_m = 1.3e-4 * f64::from(cycle);
            for tick in 0..4000 {
                let t_s = f64::from(tick) / 1000.0;
                let there = |from_s: f64, takes_s: f64| {
                    let share = ((t_s - from_s) / takes_s).clamp(0.0, 1.0);
                    share * share * (3.0 - 2.0 * share)
                };
                let position_m = 0.05 + shift_m + 0.3 * (there(0.5, 0.9) - there(2.2, 1.4));
                let read_m = if step_m > 0.0 { (position_m / step_m).round() * step_m } else { position_m };
                positions.push(read_m + noise.normal(noise_m));
            }
        }
        positions
    }

    #[test]
    fn a_step_is_read_off_to_a_thousandth() {
        for step_m in [7e-5, 2.13e-4, 4.1e-4] {
            let read = position_step_m(&strokes(step_m, 1e-5), RANGE_M).unwrap();
            assert!((read / step_m - 1.0).abs() < 1e-3, "{read} of {step_m}");
        }
    }

    #[test]
    fn without_a_step_there_is_none() {
        assert_eq!(position_step_m(&strokes(0.0, 1e-5), RANGE_M), None);
        // Nor where noise hides it, nor in a log that stands still or is short.
        assert_eq!(position_step_m(&strokes(1e-4, 1e-4), RANGE_M), None);
        assert_eq!(position_step_m(&[0.1; 5000], RANGE_M), None);
        assert_eq!(position_step_m(&[], RANGE_M), None);
    }

    /// Constant speeds put 0.25 mm between samples out and twice that back, on the same comb; where the piston rests it is beside it.
    #[test]
    fn strokes_at_a_constant_speed_are_no_comb() {
        let mut noise = Noise::new(3, 7);
        let out = (0..1000).map(|n| 0.25e-3 * f64::from(n));
        let back = (0..500).map(|n| 0.25 - 0.5e-3 * f64::from(n));
        let rest = |position_m: f64| std::iter::repeat_n(position_m, 500);
        let cycle: Vec<f64> = out.chain(rest(0.250_08)).chain(back).chain(rest(-0.000_08)).collect();
        let mut log = |read: fn(f64) -> f64| -> Vec<f64> {
            cycle.iter().cycle().take(12_500).map(|x| read(*x) + noise.normal(1e-5)).collect()
        };
        assert_eq!(position_step_m(&log(|x| x), RANGE_M), None);
        let read_in_steps = position_step_m(&log(|x| (x / 0.25e-3).round() * 0.25e-3), RANGE_M);
        assert!(
            read_in_steps.is_some_and(|step_m| (step_m / 0.25e-3 - 1.0).abs() < 1e-3),
            "{read_in_steps:?}"
        );
    }
}
