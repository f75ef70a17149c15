//! Where a growing leak is going: slope after Theil and Sen with its confidence interval (Sen, "Estimates of the regression
//! coefficient based on Kendall's tau", JASA 63 (1968)), of the area or of its logarithm, whichever fits better.

use serde::Serialize;

/// Blocks of cycles whose means are the points; when there are as many, neighbours are put together.
const BLOCKS: usize = 48;
/// Least blocks for a projection.
const LEAST_BLOCKS: usize = 8;
/// Standard normal deviate of a two-sided interval of 90 %.
const Z_90: f64 = 1.645;
/// Offset of the logarithm, m²: a tenth of the smallest leaks that are found.
const OFFSET_M2: f64 = 1e-9;

/// When a threshold will be reached, s from now.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TimeTo {
    /// Best guess.
    pub expected_s: f64,
    /// With the steepest slope that the points admit at 90 %.
    pub earliest_s: f64,
    /// With the flattest one.
    pub latest_s: f64,
}

/// A line through the area or its logarithm.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Line {
    logarithmic: bool,
    /// Fitted value at the last point.
    level: f64,
    /// Slope, the flattest and the steepest that the points admit at 90 %, 1/s of the area (m²) or its logarithm.
    slope: [f64; 3],
    /// Mean magnitude of the residuals, m².
    residual_m2: f64,
}

/// A straight line through what was taken, with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slope {
    /// Value of the line at the last point.
    pub level: f64,
    /// Slope, and its interval of 90 %, 1/s.
    pub per_s: [f64; 3],
    /// Time of the first point, s.
    pub from_s: f64,
    /// Time of the last point, s.
    pub to_s: f64,
}

impl Slope {
    /// Time since the line was at 0, s: best guess, longest, shortest. For ever where it does not come from there.
    pub fn times_since_nothing(&self) -> [f64; 3] {
        let since = |per_s: f64| {
            let since_s = self.level / per_s;
            if since_s >= 0.0 { since_s } else { f64::INFINITY }
        };
        let [best, a, b] = self.per_s.map(since);
        [best, a.max(b), a.min(b)]
    }

    /// When it will have a value, from a time on, s, where the level is known to within `open`; `None` where it does not go there.
    pub fn time_to(&self, value: f64, open: f64, now_s: f64) -> Option<TimeTo> {
        let rest = value - self.level;
        if !self.per_s.iter().all(|per_s| rest / per_s > 0.0) {
            return None;
        }
        let [expected, a, b] = self.per_s.map(f64::abs);
        let after = |rest: f64, per_s: f64| (rest / per_s - (now_s - self.to_s)).max(0.0);
        Some(TimeTo {
            expected_s: after(rest.abs(), expected),
            earliest_s: after(rest.abs() - open, a.max(b)),
            latest_s: after(rest.abs() + open, a.min(b)),
        })
    }
}

/// How a leak grows: evenly or ever faster. The one that fits better gives the date, both together its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Growth {
    better: Line,
    other: Line,
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Block {
    count: u32,
    time_s: f64,
    area_m2: f64,
}

/// Leak over time in at most 48 points, however long.
#[derive(Debug, Clone, PartialEq)]
pub struct Trend {
    blocks: Vec<Block>,
    /// Cycles in a full block.
    size: u32,
}

impl Default for Trend {
    fn default() -> Self {
        Trend { blocks: Vec::with_capacity(BLOCKS), size: 1 }
    }
}

impl Trend {
    /// Forgets.
    pub fn clear(&mut self) {
        self.blocks.clear();
        self.size = 1;
    }

    /// Takes a cycle's estimate.
    pub fn take(&mut self, time_s: f64, area_m2: f64) {
        let room = self.blocks.last().is_some_and(|block| block.count < self.size);
        if !room {
            if self.blocks.len() >= BLOCKS {
                self.halve();
            }
            self.blocks.push(Block::default());
        }
        if let Some(block) = self.blocks.last_mut() {
            block.count += 1;
            let share = 1.0 / f64::from(block.count);
            block.time_s += share * (time_s - block.time_s);
            block.area_m2 += share * (area_m2 - block.area_m2);
        }
    }

    fn halve(&mut self) {
        let joined: Vec<Block> = self.blocks.chunks(2).map(join).collect();
        self.blocks.clear();
        self.blocks.extend(joined);
        self.size *= 2;
    }

    /// The straight line; `None` where too little is known.
    pub fn slope(&self) -> Option<Slope> {
        let line = self.fit(false)?;
        let (first, last) = (self.blocks.first()?, self.blocks.last()?);
        Some(Slope { level: line.level, per_s: line.slope, from_s: first.time_s, to_s: last.time_s })
    }

    /// How the leak grows; `None` where it does not for certain, or too little is known.
    pub fn growth(&self) -> Option<Growth> {
        let (even, faster) = (self.fit(false)?, self.fit(true)?);
        let (better, other) =
            if faster.residual_m2 < even.residual_m2 { (faster, even) } else { (even, faster) };
        (better.slope[1] > 0.0 && other.slope[1] > 0.0).then_some(Growth { better, other })
    }

    fn fit(&self, logarithmic: bool) -> Option<Line> {
        let points: Vec<(f64, f64)> = self
            .blocks
            .iter()
            .map(|block| {
                let area = block.area_m2;
                (block.time_s, if logarithmic { (area + OFFSET_M2).ln() } else { area })
            })
            .collect();
        let n = points.len();
        if n < LEAST_BLOCKS {
            return None;
        }
        let mut slopes: Vec<f64> = Vec::with_capacity(n * (n - 1) / 2);
        for (index, a) in points.iter().enumerate() {
            slopes
                .extend(points[index + 1..].iter().filter(|b| b.0 > a.0).map(|b| (b.1 - a.1) / (b.0 - a.0)));
        }
        slopes.sort_by(f64::total_cmp);
        let (count, n) = (slopes.len() as f64, n as f64);
        let half = Z_90 * (n * (n - 1.0) * (2.0 * n + 5.0) / 18.0).sqrt();
        let at =
            |rank: f64| slopes.get((rank.max(0.0) as usize).min(slopes.len().saturating_sub(1))).copied();
        let slope = [at(0.5 * count)?, at(0.5 * (count - half))?, at(0.5 * (count + half))?];
        let last_s = points.last()?.0;
        let mut levels: Vec<f64> = points.iter().map(|(t, y)| y - slope[0] * (t - last_s)).collect();
        levels.sort_by(f64::total_cmp);
        let level = *levels.get(levels.len() / 2)?;
        let back = |y: f64| if logarithmic { y.exp() - OFFSET_M2 } else { y };
        let residual: f64 =
            points.iter().map(|(t, y)| (back(*y) - back(level + slope[0] * (t - last_s))).abs()).sum();
        Some(Line { logarithmic, level, slope, residual_m2: residual / n })
    }
}

fn join(blocks: &[Block]) -> Block {
    let count = blocks.iter().map(|block| block.count).sum::<u32>();
    let mean = |of: fn(&Block) -> f64| {
        blocks.iter().map(|block| of(block) * f64::from(block.count)).sum::<f64>() / f64::from(count.max(1))
    };
    Block { count, time_s: mean(|block| block.time_s), area_m2: mean(|block| block.area_m2) }
}

impl Line {
    /// Times to an area, s: expected, longest, shortest; 0 where it has been reached.
    fn times_to(&self, area_m2: f64) -> [f64; 3] {
        let target = if self.logarithmic { (area_m2 + OFFSET_M2).ln() } else { area_m2 };
        let rest = (target - self.level).max(0.0);
        self.slope.map(|slope| rest / slope)
    }
}

impl Growth {
    /// When an area will be reached; all 0 where it has been.
    pub fn time_to(&self, area_m2: f64) -> TimeTo {
        let (better, other) = (self.better.times_to(area_m2), self.other.times_to(area_m2));
        TimeTo {
            expected_s: better[0],
            earliest_s: better[2].min(other[2]),
            latest_s: better[1].max(other[1]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seepd_sim::noise::Noise;

    fn trend(area: impl Fn(f64) -> f64, cycles: usize, noise: f64) -> Trend {
        let (mut trend, mut source) = (Trend::default(), Noise::new(3, 3));
        for cycle in 0..cycles {
            let time_s = 10.0 * cycle as f64;
            trend.take(time_s, area(time_s) + source.normal(noise));
        }
        trend
    }

    #[test]
    fn a_straight_line_is_continued_to_its_threshold() {
        let growth = trend(|t| 1e-8 + 1e-12 * t, 1000, 1e-9).growth().unwrap();
        // The last point is the mean of the last block, half a block before the last cycle at 9,990 s.
        let time = growth.time_to(1e-7);
        assert!(!growth.better.logarithmic);
        assert!((time.expected_s - 80_010.0).abs() < 8000.0, "{time:?}");
        // The steeper of two continuations, which fits hardly worse so far, is a possibility.
        assert!((20_000.0..80_010.0).contains(&time.earliest_s), "{time:?}");
        assert!((80_010.0..100_000.0).contains(&time.latest_s), "{time:?}");
    }

    #[test]
    fn exponential_growth_is_told_from_a_straight_line() {
        // Doubles each 2,000 s: from 3.2e-7 at 10,000 s to 1e-6 in 3,300 s.
        let growth = trend(|t| 1e-8 * (t / 2000.0).exp2(), 1000, 2e-9).growth().unwrap();
        assert!(growth.better.logarithmic);
        let time = growth.time_to(1e-6);
        assert!((2200.0..4500.0).contains(&time.expected_s), "{time:?}");
        assert_eq!(growth.time_to(1e-8).expected_s, 0.0);
    }

    #[test]
    fn analytic_a_line_tells_when_it_was_nothing_and_when_it_will_have_a_value() {
        // −2 a second, through 0 at 100 s; the last point is at 1,000 s.
        let mut falling = Trend::default();
        (10..=1000).step_by(30).for_each(|time_s| {
            falling.take(f64::from(time_s), -2.0 * (f64::from(time_s) - 100.0));
        });
        let slope = falling.slope().unwrap();
        assert_eq!((slope.per_s, slope.to_s, slope.level), ([-2.0; 3], 1000.0, -1800.0));
        assert_eq!(slope.times_since_nothing(), [900.0; 3]);
        // 200 to go, known to within 20, from 10 s after the last point on.
        let time = slope.time_to(-2000.0, 20.0, 1010.0).unwrap();
        assert_eq!(time, TimeTo { expected_s: 90.0, earliest_s: 80.0, latest_s: 100.0 });
        assert_eq!(slope.time_to(0.0, 0.0, 1000.0), None);
    }

    #[test]
    fn no_date_without_growth() {
        assert_eq!(trend(|_| 5e-8, 400, 3e-9).growth(), None);
        assert_eq!(trend(|t| 1e-8 + 1e-12 * t, 5, 0.0).growth(), None);
        assert_eq!(Trend::default().growth(), None);
    }

    #[test]
    fn points_stay_few_and_keep_their_mean() {
        let trend = trend(|t| t, 10_000, 0.0);
        assert!(trend.blocks.len() <= BLOCKS);
        let cycles: u32 = trend.blocks.iter().map(|block| block.count).sum();
        let sum: f64 = trend.blocks.iter().map(|block| block.area_m2 * f64::from(block.count)).sum();
        assert_eq!(cycles, 10_000);
        assert!((sum / 10_000.0 - 49_995.0).abs() < 1e-6);
    }
}
