//! What is computed once for a cycle, from which each feature is then read off.

use crate::load::LoadSummary;
use crate::moments::{MomentSummary, Moments};
use crate::segment::{CycleDefinition, MAX_CYCLE_BINS, MAX_PHASES, PhaseKind, Span};

/// Lag of the second difference that measures oscillation, s: half a period of 25 Hz, where a loop with a spent
/// phase margin swings, and long against the noise that the filter leaves.
const OSCILLATION_LAG_S: f64 = 0.02;

/// The samples of a ring buffer by their running numbers.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RingView<'a> {
    ring: &'a [f32],
    /// Number of the sample after the newest.
    next: i64,
    /// How many samples there are.
    filled: i64,
    /// Index in `ring` of sample number `next`.
    cursor: usize,
}

impl<'a> RingView<'a> {
    pub(crate) fn new(ring: &'a [f32], next: i64, filled: i64, cursor: usize) -> Self {
        RingView { ring, next, filled, cursor }
    }

    /// Number of the oldest sample.
    pub(crate) fn oldest(&self) -> i64 {
        self.next - self.filled
    }

    /// The samples `from … to`, cut to what there is, as two slices in order.
    fn slices(&self, from: i64, to: i64) -> (&'a [f32], &'a [f32]) {
        let from = from.clamp(self.oldest(), self.next);
        let to = to.clamp(from, self.next);
        let n = self.ring.len();
        let back = |number: i64| (self.next - number) as usize;
        let length = (to - from) as usize;
        if length == 0 || back(from) > n {
            return (&[], &[]);
        }
        let start = (self.cursor + n - back(from)) % n;
        let head = length.min(n - start);
        (
            self.ring.get(start..start + head).unwrap_or_default(),
            self.ring.get(..length - head).unwrap_or_default(),
        )
    }

    /// Calls `take` with each sample `from … to`, cut to what there is.
    #[inline]
    fn each(&self, from: i64, to: i64, mut take: impl FnMut(f64)) {
        let (head, tail) = self.slices(from, to);
        head.iter().for_each(|value| take(f64::from(*value)));
        tail.iter().for_each(|value| take(f64::from(*value)));
    }

    fn at(&self, number: i64) -> f64 {
        self.slices(number, number + 1).0.first().map_or(0.0, |value| f64::from(*value))
    }

    /// First sample number in `from … to` whose value satisfies the condition.
    fn first(&self, from: i64, to: i64, condition: impl Fn(f64) -> bool) -> Option<i64> {
        let (head, tail) = self.slices(from, to);
        let found = head.iter().chain(tail).position(|value| condition(f64::from(*value)))?;
        Some(from.max(self.oldest()) + found as i64)
    }
}

/// A phase's summary.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PhaseStatistics {
    /// Samples.
    pub count: f64,
    /// Mean command.
    pub mean: f64,
    /// Mean magnitude.
    pub mean_absolute: f64,
    /// Mean square.
    pub energy: f64,
    /// Slope of the straight line through the samples, 1/s.
    pub slope_per_s: f64,
    /// What that line rises by over the phase.
    pub rise: f64,
    /// Smallest and largest command.
    pub extremes: (f64, f64),
}

impl PhaseStatistics {
    const EMPTY: Self = PhaseStatistics {
        count: 0.0,
        mean: 0.0,
        mean_absolute: 0.0,
        energy: 0.0,
        slope_per_s: 0.0,
        rise: 0.0,
        extremes: (0.0, 0.0),
    };
}

/// A cycle's summary.
#[derive(Debug, Clone, Copy)]
pub struct CycleStatistics {
    /// Over the whole cycle.
    pub moments: MomentSummary,
    /// Smallest and largest command of the cycle.
    pub extremes: (f64, f64),
    /// By phase, in the definition's order.
    pub phases: [PhaseStatistics; MAX_PHASES],
    /// Mean square in strokes and in holds.
    pub energy: (f64, f64),
    /// RMS of the second difference in holds.
    pub oscillation: f64,
    /// Slope in the longest hold, 1/s.
    pub trend_per_s: f64,
    /// 10 % to 90 % of the first and the last stroke's excursion, s.
    pub edge_times_s: (f64, f64),
    /// Mean command of the first stroke less that of the last one: scales with speed over valve size.
    pub stroke_scale: f64,
    /// Coefficient of variation of the magnitude within strokes.
    pub amplitude_variation: f64,
    /// Standard deviation of the measurement noise on the command before the filter, share of full command.
    pub noise: f64,
    /// The load over the cycle, where the samples tell it.
    pub load: Option<LoadSummary>,
    pub(crate) bins: [f32; MAX_CYCLE_BINS],
    pub(crate) bin_count: usize,
}

impl CycleStatistics {
    /// Of no cycle.
    pub(crate) const EMPTY: Self = CycleStatistics {
        moments: MomentSummary { mean: 0.0, standard_deviation: 0.0, skewness: 0.0, kurtosis: 0.0 },
        extremes: (0.0, 0.0),
        phases: [PhaseStatistics::EMPTY; MAX_PHASES],
        energy: (0.0, 0.0),
        oscillation: 0.0,
        trend_per_s: 0.0,
        edge_times_s: (0.0, 0.0),
        stroke_scale: 0.0,
        amplitude_variation: 0.0,
        noise: 0.0,
        load: None,
        bins: [0.0; MAX_CYCLE_BINS],
        bin_count: 0,
    };

    /// Summarises the cycle that lies in the ring at `span`.
    pub(crate) fn of(definition: &CycleDefinition<'_>, ring: &RingView<'_>, span: &Span) -> Self {
        let timeline = Timeline { definition, span };
        let mut moments = Moments::default();
        let mut extremes = (f64::INFINITY, f64::NEG_INFINITY);
        timeline.each_part(|from, to| {
            ring.each(from, to, |u| {
                moments.push(u);
                widen(&mut extremes, u);
            });
        });
        let bin_count = definition.cycle_bins().min(MAX_CYCLE_BINS);
        let mut statistics =
            CycleStatistics { moments: moments.summary(), extremes, bin_count, ..CycleStatistics::EMPTY };
        statistics.fill_phases(&timeline, ring);
        statistics.fill_strokes(&timeline, ring);
        statistics.fill_bins(&timeline, ring);
        statistics
    }

    fn fill_phases(&mut self, timeline: &Timeline<'_, '_>, ring: &RingView<'_>) {
        let definition = timeline.definition;
        let rate = definition.sample_rate_hz;
        let lag = libm::round(OSCILLATION_LAG_S * rate).max(1.0) as i64;
        let (mut stroke, mut hold, mut magnitude) = (Mean::default(), Mean::default(), Mean::default());
        let mut oscillation = Mean::default();
        let mut longest_hold = 0.0;
        for (phase, statistics) in definition.phases.iter().zip(&mut self.phases) {
            let (from, to) = timeline.range(phase.from_s, phase.to_s);
            *statistics = phase_statistics(ring, from, to, rate);
            let count = statistics.count;
            match phase.kind {
                PhaseKind::Stroke => {
                    stroke.add(statistics.energy, count);
                    magnitude.add(statistics.mean_absolute, count);
                }
                PhaseKind::Hold => {
                    hold.add(statistics.energy, count);
                    oscillation.add(second_difference(ring, from, to, lag), count);
                    if count > longest_hold {
                        longest_hold = count;
                        self.trend_per_s = statistics.slope_per_s;
                    }
                }
            }
        }
        self.energy = (stroke.value(), hold.value());
        self.oscillation = libm::sqrt(oscillation.value());
        let mean = magnitude.value();
        if mean > 0.0 {
            self.amplitude_variation = libm::sqrt((stroke.value() - mean * mean).max(0.0)) / mean;
        }
    }

    fn fill_strokes(&mut self, timeline: &Timeline<'_, '_>, ring: &RingView<'_>) {
        let definition = timeline.definition;
        let strokes = definition.anchors.largest().map(|anchor| {
            let end_s = anchor.end_s;
            let before =
                |phase: &&crate::segment::Phase| phase.kind == PhaseKind::Stroke && phase.from_s < end_s;
            definition
                .phases
                .iter()
                .take(MAX_PHASES)
                .enumerate()
                .rev()
                .find(|(_, phase)| before(phase))
                .map(|(i, _)| i)
        });
        let [Some(first), Some(last)] = strokes else { return };
        self.stroke_scale = self.phases[first].mean - self.phases[last].mean;
        self.edge_times_s = (self.edge_time_s(timeline, ring, first), self.edge_time_s(timeline, ring, last));
    }

    /// Time from 10 % to 90 % of a stroke's excursion, measured from the stroke's first sample to its peak, s.
    fn edge_time_s(&self, timeline: &Timeline<'_, '_>, ring: &RingView<'_>, index: usize) -> f64 {
        let phase = &timeline.definition.phases[index];
        let (from, to) = timeline.range(phase.from_s, phase.to_s);
        let base = ring.at(from.max(ring.oldest()));
        let (low, high) = self.phases[index].extremes;
        let peak = if high - base > base - low { high } else { low };
        let reached = |share: f64| {
            let level = base + share * (peak - base);
            ring.first(from, to, |u| if peak > base { u >= level } else { u <= level })
        };
        match (reached(0.1), reached(0.9)) {
            (Some(start), Some(end)) => (end - start) as f64 / timeline.definition.sample_rate_hz,
            _ => 0.0,
        }
    }

    fn fill_bins(&mut self, timeline: &Timeline<'_, '_>, ring: &RingView<'_>) {
        if timeline.definition.projections.is_empty() {
            return;
        }
        let bin_s = timeline.definition.bin_samples as f64 / timeline.definition.sample_rate_hz;
        for (index, bin) in self.bins.iter_mut().enumerate().take(self.bin_count) {
            let from_s = index as f64 * bin_s;
            let (from, to) = timeline.range(from_s, from_s + bin_s);
            let mut sum = 0.0;
            ring.each(from, to, |u| sum += u);
            *bin = (sum / (to - from).max(1) as f64) as f32;
        }
    }

    /// Mean command of each phase, in the definition's order; 0 where the definition has no more.
    pub fn phase_means(&self) -> [f64; MAX_PHASES] {
        self.phases.map(|phase| phase.mean)
    }

    /// What the command rises by over each phase, in the definition's order; 0 where the definition has no more.
    pub fn phase_rises(&self) -> [f64; MAX_PHASES] {
        self.phases.map(|phase| phase.rise)
    }

    /// The cycle's command in bins, aligned to its anchors; empty where the definition has no projection.
    pub fn bins(&self) -> &[f32] {
        self.bins.get(..self.bin_count).unwrap_or_default()
    }
}

/// Where a cycle's planned times lie among the samples. Each time is counted from the nearest anchor, so that
/// a dwell that varies shifts nothing.
pub(crate) struct Timeline<'d, 'm> {
    pub(crate) definition: &'d CycleDefinition<'m>,
    pub(crate) span: &'d Span,
}

impl Timeline<'_, '_> {
    /// Sample numbers of a part of the cycle.
    pub(crate) fn range(&self, from_s: f64, to_s: f64) -> (i64, i64) {
        let middle = 0.5 * (from_s + to_s);
        let mut nearest = (f64::INFINITY, 0.0, 0.0);
        for (anchor, place) in self.definition.anchors.as_slice().iter().zip(self.span.anchors) {
            let far = (middle - anchor.end_s).abs();
            if far < nearest.0 {
                nearest = (far, place, anchor.end_s);
            }
        }
        let (_, place, end_s) = nearest;
        let number = |at_s: f64| libm::round(place + (at_s - end_s) * self.definition.sample_rate_hz) as i64;
        (number(from_s), number(to_s))
    }

    /// The sample numbers over which a cycle is described as a whole: all of it; where it may wait for events between its strokes, the
    /// phases that every cycle has.
    fn each_part(&self, mut take: impl FnMut(i64, i64)) {
        if self.definition.anchors.is_row() {
            self.definition.phases.iter().for_each(|phase| {
                let (from, to) = self.range(phase.from_s, phase.to_s);
                take(from, to);
            });
        } else {
            take(self.span.start, self.span.end);
        }
    }
}

/// A weighted mean.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    sum: f64,
    weight: f64,
}

impl Mean {
    #[inline]
    fn add(&mut self, value: f64, weight: f64) {
        self.sum += value * weight;
        self.weight += weight;
    }

    fn value(&self) -> f64 {
        if self.weight > 0.0 { self.sum / self.weight } else { 0.0 }
    }
}

/// Plain comparisons: samples are finite here, and `f64::min` would pay for NaN at each of them.
#[inline]
fn widen(extremes: &mut (f64, f64), value: f64) {
    extremes.0 = if value < extremes.0 { value } else { extremes.0 };
    extremes.1 = if value > extremes.1 { value } else { extremes.1 };
}

fn phase_statistics(ring: &RingView<'_>, from: i64, to: i64, rate: f64) -> PhaseStatistics {
    let (mut count, mut sum, mut magnitude, mut squares, mut moment) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let mut extremes = (f64::INFINITY, f64::NEG_INFINITY);
    ring.each(from, to, |u| {
        sum += u;
        magnitude += u.abs();
        squares += u * u;
        moment += count * u;
        count += 1.0;
        widen(&mut extremes, u);
    });
    if count < 1.0 {
        return PhaseStatistics::default();
    }
    let mean = sum / count;
    // Least squares over 0 … n−1: Σ(i − ī) u = moment − ī Σu, Σ(i − ī)² = n (n² − 1)/12.
    let spread = count * (count * count - 1.0) / 12.0;
    let slope = if spread > 0.0 { (moment - 0.5 * (count - 1.0) * sum) / spread } else { 0.0 };
    PhaseStatistics {
        count,
        mean,
        mean_absolute: magnitude / count,
        energy: squares / count,
        slope_per_s: slope * rate,
        rise: slope * count,
        extremes,
    }
}

/// Mean square of `(u_i − 2 u_{i−lag} + u_{i−2 lag})`, in steps of the lag.
fn second_difference(ring: &RingView<'_>, from: i64, to: i64, lag: i64) -> f64 {
    let mut mean = Mean::default();
    let mut number = from + 2 * lag;
    while number < to {
        let difference = ring.at(number) - 2.0 * ring.at(number - lag) + ring.at(number - 2 * lag);
        mean.add(difference * difference, 1.0);
        number += lag;
    }
    mean.value()
}
