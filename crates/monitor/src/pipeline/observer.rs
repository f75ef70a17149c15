//! What the command looks like by itself, whether a model knows its cycles or not: its range, and the period at which it repeats. So
//! that a user whose cycles have no estimate hears what was seen.
//!
//! Means over 20 ms, and over four, sixteen … times as long, stand in rings of a fixed size, which together reach from half a minute
//! back to more than an hour. The period is looked for only when somebody asks: as the lag at which a ring's values are most like
//! themselves (normalised autocorrelation).

use std::ops::Range;

use seepd_signals::{Sample, Signal};
use serde::Serialize;

/// Length of the shortest bin, ns.
const BIN_NS: i64 = 20_000_000;
/// Bins that a ring holds.
const BINS: usize = 1024;
/// Rings, each with bins four times as long as the one before: 20 ms to 5.1 s, over 20 s to 87 min.
const SCALES: usize = 5;
/// Shorter bins in one of the next ring.
const RATIO: u32 = 4;
/// A silence of so many bins is bridged by the last value; after a longer one the rings begin anew.
const BRIDGED_BINS: i64 = 50;
/// The shortest period that is looked for, bins.
const LEAST_LAG: usize = 16;
/// Periods that must be there for one to be told.
const TOLD_PERIODS: f64 = 2.5;
/// Periods that must be there for a mean cycle.
const PATTERN_PERIODS: f64 = 5.0;
/// Between the strokes of a cycle the command is unlike itself: the correlation must have fallen below this before it comes back.
const DIP: f64 = 0.5;
/// From this correlation on the command repeats.
const REPEATS: f64 = 0.7;
/// Rates this close to whole numbers are these.
const WHOLE_SHARE: f64 = 0.002;
/// Of two lags that are alike to within this, the shorter one is the period, and the longer one a multiple of it.
const ALIKE: f64 = 0.05;

/// What was seen of a command.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Observation {
    /// Smallest and largest command of the record, as it came from the mapping.
    pub command_range: Option<[f64; 2]>,
    /// Period at which it repeats, s; null where no pattern comes back two and a half times.
    pub period_s: Option<f64>,
    /// How alike the repetitions are, 1.
    pub likeness: Option<f64>,
    /// The time over which the pattern was looked for, s, up to the last sample.
    pub looked_s: f64,
    /// Rate of the samples, Hz, where it is not the model's.
    pub wrong_rate_hz: Option<f64>,
}

/// Looks at every sample's command, and remembers little.
#[derive(Debug, Clone)]
pub(crate) struct CommandObserver {
    range: Option<[f64; 2]>,
    /// Number of the bin that is being filled, counted in [`BIN_NS`].
    bin: Option<i64>,
    /// The time that it covers, ns.
    bin_ns: Range<i64>,
    sum: f64,
    count: u32,
    mean: f32,
    scales: [Scale; SCALES],
    /// First and last sample since the rings began, ns, and the samples between.
    stretch: Option<Stretch>,
}

/// Samples without a long silence between them.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    first_ns: i64,
    last_ns: i64,
    intervals: u64,
}

impl Stretch {
    fn rate_hz(&self) -> Option<f64> {
        let length_s = self.last_ns.saturating_sub(self.first_ns) as f64 / 1e9;
        let rate_hz = self.intervals as f64 / length_s;
        let whole_hz = rate_hz.round();
        let is_whole = (rate_hz - whole_hz).abs() < WHOLE_SHARE * rate_hz;
        (length_s > 0.0).then_some(if is_whole { whole_hz } else { rate_hz })
    }
}

/// A stretch of a command that repeats.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Pattern {
    /// Means over bins, at least five periods.
    pub(crate) values: Vec<f32>,
    /// Length of a bin, s.
    pub(crate) bin_s: f64,
    /// Period, bins.
    pub(crate) period_bins: f64,
    /// Rate of the samples, Hz.
    pub(crate) sample_rate_hz: f64,
}

/// At what lag, in bins, a ring's values are most like themselves, and how much.
#[derive(Debug, Clone, Copy)]
struct Repetition {
    lag: f64,
    likeness: f64,
}

/// A ring of means.
#[derive(Debug, Clone)]
struct Scale {
    bins: [f32; BINS],
    /// Bins so far.
    pushed: usize,
    /// Of the next longer bin.
    sum: f32,
    count: u32,
}

impl Default for Scale {
    fn default() -> Self {
        Scale { bins: [0.0; BINS], pushed: 0, sum: 0.0, count: 0 }
    }
}

impl Default for CommandObserver {
    fn default() -> Self {
        let scales = std::array::from_fn(|_| Scale::default());
        CommandObserver {
            range: None,
            bin: None,
            bin_ns: 0..0,
            sum: 0.0,
            count: 0,
            mean: 0.0,
            scales,
            stretch: None,
        }
    }
}

impl CommandObserver {
    /// Takes a sample.
    #[inline]
    pub(crate) fn take(&mut self, sample: &Sample) {
        let Some(command) = sample.get(Signal::Command).filter(|command| command.is_finite()) else { return };
        let [low, high] = self.range.unwrap_or([command; 2]);
        self.range = Some([low.min(command), high.max(command)]);
        if !self.bin_ns.contains(&sample.time_ns) {
            self.leave_bin(sample.time_ns.div_euclid(BIN_NS));
        }
        self.sum += command;
        self.count += 1;
        let time_ns = sample.time_ns;
        match &mut self.stretch {
            Some(stretch) => {
                (stretch.last_ns, stretch.intervals) = (time_ns.max(stretch.last_ns), stretch.intervals + 1);
            }
            None => self.stretch = Some(Stretch { first_ns: time_ns, last_ns: time_ns, intervals: 0 }),
        }
    }

    /// A sample of another bin has come; a late one is taken for one of this.
    fn leave_bin(&mut self, bin: i64) {
        let since = self.bin.map_or(0, |before| bin.saturating_sub(before));
        if (-BRIDGED_BINS..0).contains(&since) {
            return;
        }
        self.bin = Some(bin);
        let begin_ns = bin.saturating_mul(BIN_NS);
        self.bin_ns = begin_ns..begin_ns.saturating_add(BIN_NS);
        if self.count > 0 {
            self.mean = (self.sum / f64::from(self.count)) as f32;
        }
        (self.sum, self.count) = (0.0, 0);
        if !(0..=BRIDGED_BINS).contains(&since) {
            self.scales = std::array::from_fn(|_| Scale::default());
            self.stretch = None;
        } else {
            (0..since).for_each(|_| self.push(self.mean));
        }
    }

    fn push(&mut self, mean: f32) {
        let mut carried = Some(mean);
        for scale in &mut self.scales {
            let Some(mean) = carried else { return };
            carried = scale.push(mean);
        }
    }

    /// What was seen; the lag at which the command is most like itself is looked for now, which takes about a million multiplications.
    pub(crate) fn observation(&self) -> Observation {
        let best = self.repetition(TOLD_PERIODS);
        let looked = |(scale, bin_s): (&Scale, f64)| scale.filled() as f64 * bin_s;
        Observation {
            command_range: self.range,
            period_s: best.map(|(_, bin_s, found)| found.lag * bin_s),
            likeness: best.map(|(.., found)| found.likeness),
            looked_s: self.with_lengths().map(looked).fold(0.0, f64::max),
            wrong_rate_hz: None,
        }
    }

    /// The stretch over which the command repeats, where it does so often enough for a mean cycle.
    pub(crate) fn pattern(&self) -> Option<Pattern> {
        let (scale, bin_s, found) = self.repetition(PATTERN_PERIODS)?;
        let sample_rate_hz = self.stretch?.rate_hz()?;
        Some(Pattern { values: scale.values().to_vec(), bin_s, period_bins: found.lag, sample_rate_hz })
    }

    /// The ring in which the command repeats, the length of its bins, s, and the period.
    fn repetition(&self, periods: f64) -> Option<(&Scale, f64, Repetition)> {
        let mut best: Option<(&Scale, f64, Repetition)> = None;
        for (scale, bin_s) in self.with_lengths() {
            // A longer look counts where the command is more like itself than at a shorter one.
            if let Some(found) = scale.repetition(periods)
                && best.is_none_or(|(.., before)| found.likeness > before.likeness + ALIKE)
            {
                best = Some((scale, bin_s, found));
            }
        }
        best
    }

    /// The rings with the lengths of their bins, s.
    fn with_lengths(&self) -> impl Iterator<Item = (&Scale, f64)> {
        let lengths =
            std::iter::successors(Some(BIN_NS as f64 / 1e9), |bin_s| Some(bin_s * f64::from(RATIO)));
        self.scales.iter().zip(lengths)
    }
}

impl Scale {
    /// Takes a bin; the mean of the next longer one, when it is full.
    fn push(&mut self, mean: f32) -> Option<f32> {
        self.bins[self.pushed % BINS] = mean;
        self.pushed += 1;
        self.sum += mean;
        self.count += 1;
        (self.count == RATIO).then(|| {
            self.count = 0;
            std::mem::take(&mut self.sum) / RATIO as f32
        })
    }

    fn filled(&self) -> usize {
        self.pushed.min(BINS)
    }

    /// The values from the oldest on; behind them zeros.
    fn ordered(&self) -> [f32; BINS] {
        let mut values = self.bins;
        values.rotate_left(self.pushed.saturating_sub(self.filled()) % BINS);
        values
    }

    /// The values from the oldest on.
    fn values(&self) -> Vec<f32> {
        self.ordered().into_iter().take(self.filled()).collect()
    }

    /// The lag at which the ring's values are most like themselves, if so many periods are there.
    fn repetition(&self, periods: f64) -> Option<Repetition> {
        let count = self.filled();
        let mut values = self.ordered();
        let values = values.get_mut(..count)?;
        let mean = values.iter().sum::<f32>() / count.max(1) as f32;
        values.iter_mut().for_each(|value| *value -= mean);
        let longest = (count as f64 / periods) as usize;
        if longest <= LEAST_LAG {
            return None;
        }
        let mut energy = [0.0; BINS + 1];
        for (index, value) in values.iter().enumerate() {
            energy[index + 1] = energy[index] + f64::from(value * value);
        }
        let mut likeness = [0.0; BINS];
        for (lag, slot) in likeness.iter_mut().enumerate().take(longest + 1).skip(1) {
            let scale = energy[count - lag] * (energy[count] - energy[lag]);
            *slot = if scale > 0.0 { product(values, &values[lag..]) / scale.sqrt() } else { 0.0 };
        }
        let dip = (1..longest).find(|lag| likeness[*lag] < DIP)?.max(LEAST_LAG);
        let is_peak = |lag: &usize| {
            likeness[*lag] >= REPEATS
                && likeness[*lag] >= likeness[lag - 1]
                && likeness[*lag] > likeness[lag + 1]
        };
        let highest = (dip..longest).filter(is_peak).map(|lag| likeness[lag]).fold(0.0, f64::max);
        let lag = (dip..longest).filter(is_peak).find(|lag| likeness[*lag] >= highest - ALIKE)?;
        let curvature = likeness[lag - 1] - 2.0 * likeness[lag] + likeness[lag + 1];
        let shift =
            if curvature < 0.0 { 0.5 * (likeness[lag - 1] - likeness[lag + 1]) / curvature } else { 0.0 };
        Some(Repetition { lag: lag as f64 + shift, likeness: likeness[lag] })
    }
}

/// Sum of the products of two lists, as far as both go; in lanes, which a processor takes at once.
fn product(a: &[f32], b: &[f32]) -> f64 {
    const LANES: usize = 8;
    let mut sums = [0.0f32; LANES];
    for (a, b) in a.chunks_exact(LANES).zip(b.chunks_exact(LANES)) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let whole = a.len().min(b.len()) / LANES * LANES;
    let rest = a[whole..].iter().zip(&b[whole..]).map(|(a, b)| a * b);
    f64::from(sums.iter().sum::<f32>() + rest.sum::<f32>())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A command with two strokes a period, at a rate, with noise.
    fn observed(period_s: f64, rate_hz: f64, duration_s: f64, scale: f64) -> Observation {
        let mut observer = CommandObserver::default();
        let mut noise = seepd_sim::noise::Noise::new(1, 1);
        for tick in 0..(duration_s * rate_hz) as i64 {
            let at = (tick as f64 / rate_hz / period_s).fract();
            let command = match at {
                at if (0.1..0.3).contains(&at) => 0.6,
                at if (0.5..0.8).contains(&at) => -0.4,
                _ => 0.01,
            };
            let time_ns = (tick as f64 / rate_hz * 1e9) as i64;
            observer.take(&Sample::command(time_ns, scale * (command + noise.normal(0.003))));
        }
        observer.observation()
    }

    #[test]
    fn periods_from_two_seconds_to_fifteen_minutes_are_found_at_any_rate_and_scale() {
        for (period_s, rate_hz, duration_s, scale) in [
            (2.0, 1000.0, 20.0, 1.0),
            (7.02, 1000.0, 60.0, 10.0),
            (7.02, 50.0, 400.0, 1.0),
            (63.0, 200.0, 400.0, 100.0),
            (900.0, 50.0, 3000.0, 1.0),
        ] {
            let seen = observed(period_s, rate_hz, duration_s, scale);
            let found = seen.period_s.unwrap_or_else(|| panic!("{period_s}: {seen:?}"));
            assert!((found / period_s - 1.0).abs() < 0.005, "{period_s}: {found}");
            let [low, high] = seen.command_range.unwrap();
            assert!((low / scale + 0.41).abs() < 0.01 && (high / scale - 0.61).abs() < 0.01, "{low} {high}");
        }
    }

    #[test]
    fn late_and_repeated_samples_do_not_hide_a_period() {
        let mut observer = CommandObserver::default();
        for tick in 0..30_000_i64 {
            let command = if tick % 5000 < 1000 { 0.5 } else { -0.1 };
            observer.take(&Sample::command(tick * 1_000_000, command));
            if tick % 700 == 0 {
                observer.take(&Sample::command((tick - 300) * 1_000_000, command));
                observer.take(&Sample::command(tick * 1_000_000, command));
            }
        }
        let period_s = observer.observation().period_s;
        assert!(period_s.is_some_and(|period_s| (period_s - 5.0).abs() < 0.01), "{period_s:?}");
    }

    #[test]
    fn analytic_product_of_any_length() {
        let ones = [1.0f32; 21];
        let counted: Vec<f32> = (0u8..19).map(f32::from).collect();
        assert_eq!(product(&ones, &counted), 171.0);
        assert_eq!(product(&counted[..5], &counted), 30.0);
    }

    #[test]
    fn what_does_not_repeat_has_no_period() {
        assert_eq!(observed(30.0, 100.0, 60.0, 1.0).period_s, None);
        let mut noise = seepd_sim::noise::Noise::new(2, 2);
        let mut observer = CommandObserver::default();
        (0..60_000).for_each(|tick| observer.take(&Sample::command(tick * 1_000_000, noise.normal(0.1))));
        assert_eq!(observer.observation().period_s, None);
        assert_eq!(CommandObserver::default().observation().command_range, None);
    }
}
