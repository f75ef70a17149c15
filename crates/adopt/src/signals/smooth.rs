//! How a column goes with another's slope, and how it follows another.

use std::ops::RangeInclusive;

/// Sums of a trace from its start, by which a mean over any stretch is had at once.
pub(super) struct Sums {
    sums: Vec<f64>,
    counts: Vec<u32>,
}

impl Sums {
    pub(super) fn of(values: &[f64]) -> Self {
        let (mut sums, mut counts) =
            (Vec::with_capacity(values.len() + 1), Vec::with_capacity(values.len() + 1));
        let (mut sum, mut count) = (0.0, 0);
        sums.push(sum);
        counts.push(count);
        for value in values {
            if value.is_finite() {
                sum += value;
                count += 1;
            }
            sums.push(sum);
            counts.push(count);
        }
        Sums { sums, counts }
    }

    /// Mean of a stretch; `None` where it is not there or less than half of it is.
    pub(super) fn mean(&self, from: isize, length: usize) -> Option<f64> {
        let begin = usize::try_from(from).ok()?;
        let end = begin + length;
        let count = self.counts.get(end)? - self.counts[begin];
        (2 * count as usize > length).then(|| (self.sums[end] - self.sums[begin]) / f64::from(count))
    }
}

/// A trace averaged over stretches of one length, and that averaged again: a difference of the first is what a mean of the second is the
/// slope's integral of, so that both have seen the same smoothing.
pub(super) struct Smoothed {
    once: Vec<f64>,
    twice: Vec<f64>,
}

impl Smoothed {
    pub(super) fn of(values: &[f64], length: usize) -> Self {
        let once = means(values, length);
        let twice = means(&once, length);
        Smoothed { once, twice }
    }

    /// Slopes over stretches of that length, per sample.
    pub(super) fn slopes(&self, length: usize) -> Vec<f64> {
        self.once.windows(length + 1).map(|window| (window[length] - window[0]) / length as f64).collect()
    }

    /// Means over the stretches of the slopes.
    pub(super) fn means(&self, length: usize) -> Vec<f64> {
        self.twice[..self.twice.len().saturating_sub(length)].to_vec()
    }
}

fn means(values: &[f64], length: usize) -> Vec<f64> {
    let sums = Sums::of(values);
    (0..values.len()).map(|at| sums.mean(at as isize, length).unwrap_or(f64::NAN)).collect()
}

/// How the slope of one column goes with another column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Drives {
    /// Share of the slope's variance that a monotone curve over the other explains, 0–1.
    pub(super) explained: f64,
    /// Whether the slope falls as the other rises.
    pub(super) falling: bool,
    /// Share of the slope's variance that a straight line explains.
    pub(super) straight: f64,
    /// Slope of that line, per sample.
    pub(super) gain: f64,
    /// The other's value at which the slope is zero.
    pub(super) null: f64,
    /// By how much the other is ahead, samples.
    pub(super) lead: isize,
}

/// Pairs that are looked at.
const PAIRS: usize = 4000;
/// Pieces of a monotone curve.
const BINS: usize = 40;

/// How `driven`'s slope goes with `driver`, which is `lead` samples ahead, both smoothed over `length`, while `driven` is `within` bounds.
pub(super) fn drives(
    driver: &Smoothed,
    driven: &Smoothed,
    length: usize,
    lead: isize,
    within: &RangeInclusive<f64>,
) -> Option<Drives> {
    let samples = driven.once.len();
    let step = (samples / PAIRS).max(1);
    let mut pairs: Vec<(f64, f64)> = (0..samples.saturating_sub(length))
        .step_by(step)
        .filter_map(|at| {
            let slope = (driven.once[at + length] - driven.once[at]) / length as f64;
            let before = usize::try_from(at as isize - lead).ok()?;
            let value = *driver.twice.get(before)?;
            let inside = within.contains(&driven.once[at]) && within.contains(&driven.once[at + length]);
            (inside && slope.is_finite() && value.is_finite()).then_some((value, slope))
        })
        .collect();
    if pairs.len() < 2 * BINS {
        return None;
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let moments = Moments::of(&pairs);
    if moments.var_x <= 0.0 || moments.var_y <= 0.0 {
        return None;
    }
    let (falling, gain) = (moments.cov < 0.0, moments.cov / moments.var_x);
    if falling {
        pairs.iter_mut().for_each(|(_, slope)| *slope = -*slope);
    }
    let blocks = monotone(&pairs);
    let left: f64 = blocks.iter().map(|block| block.scatter()).sum();
    let explained = 1.0 - left / (moments.var_y * pairs.len() as f64);
    let straight = moments.cov * moments.cov / (moments.var_x * moments.var_y);
    let null = null_of(&blocks);
    Some(Drives { explained, falling, straight, gain, null, lead })
}

/// Means and variances of pairs.
struct Moments {
    var_x: f64,
    var_y: f64,
    cov: f64,
}

impl Moments {
    fn of(pairs: &[(f64, f64)]) -> Self {
        let count = pairs.len() as f64;
        let mean_x = pairs.iter().map(|(x, _)| x).sum::<f64>() / count;
        let mean_y = pairs.iter().map(|(_, y)| y).sum::<f64>() / count;
        let (mut var_x, mut var_y, mut cov) = (0.0, 0.0, 0.0);
        for (x, y) in pairs {
            let (dx, dy) = (x - mean_x, y - mean_y);
            var_x += dx * dx;
            var_y += dy * dy;
            cov += dx * dy;
        }
        Moments { var_x: var_x / count, var_y: var_y / count, cov: cov / count }
    }
}

/// A stretch over which a monotone curve is level.
struct Level {
    count: f64,
    sum_x: f64,
    sum_y: f64,
    sum_yy: f64,
}

impl Level {
    fn mean(&self) -> f64 {
        self.sum_y / self.count
    }

    fn scatter(&self) -> f64 {
        self.sum_yy - self.sum_y * self.sum_y / self.count
    }
}

/// The rising curve that is nearest to sorted pairs, in pieces (pool adjacent violators).
fn monotone(sorted: &[(f64, f64)]) -> Vec<Level> {
    let mut levels: Vec<Level> = Vec::new();
    let (least, largest) = (sorted[0].0, sorted[sorted.len() - 1].0);
    let width = (largest - least) / BINS as f64;
    let bin = |x: f64| ((x - least) / width) as usize;
    for piece in sorted.chunk_by(|a, b| bin(a.0) == bin(b.0)) {
        let mut level = Level { count: 0.0, sum_x: 0.0, sum_y: 0.0, sum_yy: 0.0 };
        for (x, y) in piece {
            level.count += 1.0;
            level.sum_x += x;
            level.sum_y += y;
            level.sum_yy += y * y;
        }
        while let Some(last) = levels.pop_if(|last| last.mean() >= level.mean()) {
            level.count += last.count;
            level.sum_x += last.sum_x;
            level.sum_y += last.sum_y;
            level.sum_yy += last.sum_yy;
        }
        levels.push(level);
    }
    levels
}

/// Where a rising curve crosses zero.
fn null_of(levels: &[Level]) -> f64 {
    let x = |level: &Level| level.sum_x / level.count;
    let crossing = levels.windows(2).find(|pair| pair[0].mean() <= 0.0 && pair[1].mean() > 0.0);
    match crossing {
        Some([below, above]) => {
            let share = -below.mean() / (above.mean() - below.mean());
            x(below) + share * (x(above) - x(below))
        }
        _ => f64::NAN,
    }
}

/// How one column is like another that comes before or after it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Follows {
    /// Share of its variance that a straight line over the other explains.
    pub(super) explained: f64,
    /// Its change for each of the other's.
    pub(super) gain: f64,
    /// By how much it is behind, samples; negative: ahead.
    pub(super) behind: isize,
}

/// How `follower` is like `leader`, at the delay of those given at which it is most.
pub(super) fn follows(leader: &[f64], follower: &[f64], delays: &[isize]) -> Option<Follows> {
    let step = (leader.len() / PAIRS).max(1);
    let at_delay = |delay: isize| {
        let pairs: Vec<(f64, f64)> = (0..leader.len())
            .step_by(step)
            .filter_map(|at| {
                let after = usize::try_from(at as isize + delay).ok()?;
                let pair = (leader[at], *follower.get(after)?);
                (pair.0.is_finite() && pair.1.is_finite()).then_some(pair)
            })
            .collect();
        let Moments { var_x, var_y, cov } = Moments::of(&pairs);
        (pairs.len() >= 2 * BINS && var_x > 0.0 && var_y > 0.0).then(|| Follows {
            explained: cov * cov / (var_x * var_y),
            gain: cov / var_x,
            behind: delay,
        })
    };
    delays.iter().filter_map(|delay| at_delay(*delay)).max_by(|a, b| a.explained.total_cmp(&b.explained))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A command with pauses, and the position that it drives over a curve with a dead band, `delay` samples later.
    fn driven(delay: usize) -> (Vec<f64>, Vec<f64>) {
        let command: Vec<f64> =
            (0..6000).map(|n| if n / 500 % 2 == 0 { (n as f64 / 80.0).sin() } else { 0.0 }).collect();
        let speed = |u: f64| {
            if u > 0.1 {
                u - 0.1
            } else if u < -0.1 {
                2.0 * (u + 0.1)
            } else {
                0.0
            }
        };
        let mut position = vec![0.0; delay];
        for u in &command {
            position.push(position.last().copied().unwrap_or(0.0) + speed(*u));
        }
        position.truncate(command.len());
        (command, position)
    }

    #[test]
    fn a_slope_follows_what_drives_it_and_nothing_else() {
        let (command, position) = driven(8);
        let anywhere = f64::NEG_INFINITY..=f64::INFINITY;
        let (u, x) = (Smoothed::of(&command, 5), Smoothed::of(&position, 5));
        let found = drives(&u, &x, 5, 8, &anywhere).unwrap();
        assert!(found.explained > 0.99 && !found.falling, "{found:?}");
        assert!(found.null.abs() < 0.12, "{found:?}");
        let reversed: Vec<f64> = command.iter().map(|u| 12.0 - 8.0 * u).collect();
        let found = drives(&Smoothed::of(&reversed, 5), &x, 5, 8, &anywhere).unwrap();
        assert!(found.explained > 0.99 && found.falling && (found.null - 12.0).abs() < 1.0, "{found:?}");
        let other: Vec<f64> = (0..6000).map(|n| (n as f64 / 37.0).cos()).collect();
        assert!(drives(&Smoothed::of(&other, 5), &x, 5, 0, &anywhere).unwrap().explained < 0.2);
    }

    #[test]
    fn a_follower_is_behind_by_so_many_samples() {
        let leader: Vec<f64> = (0..3000).map(|n| (n as f64 / 90.0).sin()).collect();
        let follower: Vec<f64> = (0..3000).map(|n| 1000.0 * ((n as f64 - 20.0) / 90.0).sin()).collect();
        let delays: Vec<isize> = (-40..=40).collect();
        let found = follows(&leader, &follower, &delays).unwrap();
        assert_eq!(found.behind, 20);
        assert!(found.explained > 0.999 && (found.gain - 1000.0).abs() < 5.0, "{found:?}");
    }

    #[test]
    fn a_mean_needs_half_of_its_samples() {
        let sums = Sums::of(&[1.0, f64::NAN, 3.0, f64::NAN, f64::NAN]);
        assert_eq!(sums.mean(0, 3), Some(2.0));
        assert_eq!(sums.mean(2, 3), None);
        assert_eq!((sums.mean(-1, 2), sums.mean(4, 2)), (None, None));
    }
}
