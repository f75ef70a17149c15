//! Where a recording moves and where it stands.

use seepd_signals::Signal;

use crate::recording::Recording;

/// The signal by which strokes are found, the best one that a recording has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Guide {
    /// The demand: it stands exactly.
    Demand,
    /// The measured position.
    Position,
    /// The command alone: it is near its rest while the machine stands.
    Command,
}

impl Guide {
    /// The best guide of a recording; `None` without a command.
    pub fn of(recording: &Recording) -> Option<Self> {
        let moves = |signal: Signal| recording.log.get(signal).is_some_and(|values| range(values) > 0.0);
        [
            (Guide::Demand, Signal::Demand),
            (Guide::Position, Signal::Position),
            (Guide::Command, Signal::Command),
        ]
        .into_iter()
        .find(|(_, signal)| moves(*signal))
        .map(|(guide, _)| guide)
    }

    /// Its signal.
    pub fn signal(self) -> Signal {
        match self {
            Guide::Demand => Signal::Demand,
            Guide::Position => Signal::Position,
            Guide::Command => Signal::Command,
        }
    }

    /// Speed, share of the usual fastest one, above which the machine moves.
    fn threshold(self) -> f64 {
        match self {
            Guide::Demand => 0.01,
            Guide::Position => 0.04,
            Guide::Command => 0.12,
        }
    }
}

/// A part of the recording in which the machine moves one way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stroke {
    /// First sample.
    pub start: usize,
    /// Sample after the last.
    pub end: usize,
    /// Level of the guide before: a position, m, or 0 where the command guides.
    pub from: f64,
    /// Way, m, or the command's integral over time, s.
    pub way: f64,
}

/// What was found in a guide.
#[derive(Debug, Clone)]
pub struct Strokes {
    /// In time order.
    pub strokes: Vec<Stroke>,
    /// Range of the guide: of positions, or of the command's integrals.
    pub range: f64,
    /// The command's value at rest, where it guides.
    pub rest: f64,
}

impl Strokes {
    /// With strokes the same way made one where the stop between them is short beside either.
    pub(crate) fn joined(&self) -> Self {
        let length = |stroke: &Stroke| stroke.end - stroke.start;
        let mut strokes: Vec<Stroke> = Vec::with_capacity(self.strokes.len());
        for stroke in &self.strokes {
            match strokes.last_mut() {
                Some(last)
                    if last.way * stroke.way > 0.0
                        && (stroke.start.saturating_sub(last.end) as f64)
                            < SHORT_STOP * length(last).min(length(stroke)) as f64 =>
                {
                    (last.end, last.way) = (stroke.end, last.way + stroke.way);
                }
                _ => strokes.push(*stroke),
            }
        }
        Strokes { strokes, ..*self }
    }
}

/// A stop is short that takes less than this share of the shorter stroke beside it.
const SHORT_STOP: f64 = 0.25;
/// Shortest stroke and shortest hold, s, and samples.
const SHORTEST_S: f64 = 0.03;
const SHORTEST_SAMPLES: usize = 3;
/// Way, share of the largest, below which a stroke is none.
const LEAST_WAY: f64 = 0.02;
/// Smoothing is widened until the noise of the speed is below this share of the threshold.
const QUIET: f64 = 0.25;
/// Longest window of the smoothing, s.
const LONGEST_WINDOW_S: f64 = 1.0;

/// Finds the strokes of a recording. `overlap` is half the width of the valve's dead band as far as it is known, share of full command: a
/// command within it moves nothing.
pub fn find(recording: &Recording, guide: Guide, overlap: f64) -> Strokes {
    let values = recording.log.get(guide.signal()).unwrap_or_default();
    if guide == Guide::Command {
        if overlap > 0.0 {
            of_opening(recording, &opened(values, overlap), 0.0)
        } else {
            of_opening(recording, values, rest_of(values))
        }
    } else {
        of_position(recording, values, guide)
    }
}

fn of_position(recording: &Recording, values: &[f64], guide: Guide) -> Strokes {
    let noise = noise_of(values);
    let mut window = ((0.01 * recording.rate_hz) as usize).max(1);
    let (mut speed, mut fastest) = speed_of(values, window);
    // The difference of two means of `window` samples each.
    let noisy = |window: usize| noise * (2.0 / window as f64).sqrt() / window as f64;
    while noisy(window) > QUIET * guide.threshold() * fastest
        && (window as f64) < LONGEST_WINDOW_S * recording.rate_hz
    {
        window = window * 3 / 2 + 1;
        (speed, fastest) = speed_of(values, window);
    }
    let threshold = (guide.threshold() * fastest).max(1.0 / QUIET * noisy(window));
    let level = |at: usize, back: bool| -> f64 {
        let span = window.max(SHORTEST_SAMPLES);
        let (from, to) = if back { (at.saturating_sub(span), at) } else { (at, at + span) };
        mean(values.get(from..to.min(values.len())).unwrap_or_default())
    };
    let pieces = moving(&speed, threshold, shortest(recording));
    let strokes: Vec<Stroke> = pieces
        .into_iter()
        .map(|(start, end)| {
            let from = level(start.max(1), true);
            Stroke { start, end, from, way: level(end, false) - from }
        })
        .filter(|stroke| stroke.way.is_finite())
        .collect();
    kept(strokes, range(values), 0.0)
}

/// What the command opens beyond the overlap of the valve's lands. Holds stand on either side of it, so that no level is the rest.
fn opened(values: &[f64], overlap: f64) -> Vec<f64> {
    values
        .iter()
        .map(|u| if u.is_finite() { (u.abs() - overlap).max(0.0).copysign(*u) } else { *u })
        .collect()
}

fn of_opening(recording: &Recording, values: &[f64], rest: f64) -> Strokes {
    let noise = noise_of(values);
    let mut window = ((0.01 * recording.rate_hz) as usize).max(1);
    let fastest = quantile(values.iter().map(|value| (value - rest).abs()), 0.98);
    let threshold = Guide::Command.threshold() * fastest;
    while noise / (window as f64).sqrt() > QUIET * threshold
        && (window as f64) < LONGEST_WINDOW_S * recording.rate_hz
    {
        window = window * 3 / 2 + 1;
    }
    let smooth: Vec<f64> = smoothed(values, window).into_iter().map(|value| value - rest).collect();
    let strokes: Vec<Stroke> = moving(&smooth, threshold, shortest(recording))
        .into_iter()
        .map(|(start, end)| {
            let way = values[start..end]
                .iter()
                .filter(|value| value.is_finite())
                .map(|value| value - rest)
                .sum::<f64>()
                / recording.rate_hz;
            Stroke { start, end, from: 0.0, way }
        })
        .collect();
    let largest = strokes.iter().map(|stroke| stroke.way.abs()).fold(0.0, f64::max);
    kept(strokes, largest, rest)
}

fn kept(strokes: Vec<Stroke>, range: f64, rest: f64) -> Strokes {
    let largest = strokes.iter().map(|stroke| stroke.way.abs()).fold(0.0, f64::max);
    let strokes = strokes.into_iter().filter(|stroke| stroke.way.abs() >= LEAST_WAY * largest).collect();
    Strokes { strokes, range, rest }
}

fn shortest(recording: &Recording) -> usize {
    ((SHORTEST_S * recording.rate_hz) as usize).max(SHORTEST_SAMPLES)
}

/// Spans in which a speed keeps one sign above a threshold; holds and strokes that are too short are none.
fn moving(speed: &[f64], threshold: f64, shortest: usize) -> Vec<(usize, usize)> {
    let sign = |value: f64| {
        if value > threshold {
            1
        } else if value < -threshold {
            -1
        } else {
            0
        }
    };
    let mut spans: Vec<(usize, usize, i32)> = Vec::new();
    for (index, value) in speed.iter().enumerate() {
        let now = if value.is_finite() { sign(*value) } else { 0 };
        if now == 0 {
            continue;
        }
        match spans.last_mut() {
            Some(last) if last.2 == now && index <= last.1 + shortest => last.1 = index + 1,
            _ => spans.push((index, index + 1, now)),
        }
    }
    spans.into_iter().filter(|span| span.1 - span.0 >= shortest).map(|span| (span.0, span.1)).collect()
}

/// Difference of the means of the windows after and before each sample, a sample, and its usual largest magnitude.
fn speed_of(values: &[f64], window: usize) -> (Vec<f64>, f64) {
    let sums = running_sums(values);
    let mean = |from: usize, to: usize| (sums[to] - sums[from]) / (to - from) as f64;
    let speed: Vec<f64> = (0..values.len())
        .map(|at| {
            if at < window || at + window > values.len() || !values[at].is_finite() {
                return 0.0;
            }
            (mean(at, at + window) - mean(at - window, at)) / window as f64
        })
        .collect();
    let fastest = quantile(speed.iter().map(|value| value.abs()), 0.98);
    (speed, fastest)
}

/// Mean over a window around each sample.
pub(crate) fn smoothed(values: &[f64], window: usize) -> Vec<f64> {
    let sums = running_sums(values);
    (0..values.len())
        .map(|at| {
            let (from, to) = (at.saturating_sub(window / 2), (at + window / 2 + 1).min(values.len()));
            (sums[to] - sums[from]) / (to - from) as f64
        })
        .collect()
}

/// Sums up to each sample; a gap repeats what was before it.
fn running_sums(values: &[f64]) -> Vec<f64> {
    let mut last = values.iter().copied().find(|value| value.is_finite()).unwrap_or(0.0);
    let mut sums = Vec::with_capacity(values.len() + 1);
    let mut sum = 0.0;
    sums.push(sum);
    for value in values {
        if value.is_finite() {
            last = *value;
        }
        sum += last;
        sums.push(sum);
    }
    sums
}

/// Standard deviation of white noise, by the median of third differences, which smooth signals do not reach.
pub(crate) fn noise_of(values: &[f64]) -> f64 {
    let differences = values.windows(4).map(|w| (w[3] - 3.0 * w[2] + 3.0 * w[1] - w[0]).abs());
    // Of a normal value the median magnitude is 0.6745; the third difference of white noise has a variance of 20.
    quantile(differences.filter(|value| value.is_finite()), 0.5) / (0.6745 * 20f64.sqrt())
}

/// The command's usual value: the densest place of its distribution near the middle of its range.
fn rest_of(values: &[f64]) -> f64 {
    const CELLS: usize = 100;
    let (low, high) = (quantile(values.iter().copied(), 0.005), quantile(values.iter().copied(), 0.995));
    if high <= low {
        return low;
    }
    let mut counts = [0usize; CELLS];
    for value in values.iter().filter(|value| value.is_finite()) {
        let cell = (value - low) / (high - low) * CELLS as f64;
        if (0.0..CELLS as f64).contains(&cell) {
            counts[cell as usize] += 1;
        }
    }
    // A command that stands at an end saturates there; it does not rest.
    let inner = CELLS / 20..CELLS - CELLS / 20;
    let densest = inner.max_by_key(|cell| counts[*cell]).unwrap_or(CELLS / 2);
    let (from, to) = (densest as f64 - 1.0, densest as f64 + 2.0);
    let near = |value: &f64| {
        let cell = (value - low) / (high - low) * CELLS as f64;
        (from..to).contains(&cell)
    };
    mean(&values.iter().copied().filter(near).collect::<Vec<f64>>())
}

pub(crate) fn mean(values: &[f64]) -> f64 {
    let (count, sum) = values
        .iter()
        .filter(|value| value.is_finite())
        .fold((0usize, 0.0), |(count, sum), value| (count + 1, sum + value));
    sum / count as f64
}

/// Change of a cycle's values from tick to tick around one of them: the cycle begins again after its end.
pub(crate) fn slope(cycle: &[f64], tick: usize) -> f64 {
    let ticks = cycle.len();
    0.5 * (cycle[(tick + 1) % ticks] - cycle[(tick + ticks - 1) % ticks])
}

pub(crate) fn range(values: &[f64]) -> f64 {
    let finite = || values.iter().copied().filter(|value| value.is_finite());
    finite().fold(f64::NEG_INFINITY, f64::max) - finite().fold(f64::INFINITY, f64::min)
}

/// The value below which that share of the finite values lies; NaN where there is none.
pub(crate) fn quantile(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    const MOST: usize = 200_000;
    let all: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    let mut some: Vec<f64> = all.iter().copied().step_by((all.len() / MOST).max(1)).collect();
    if some.is_empty() {
        return f64::NAN;
    }
    some.sort_by(f64::total_cmp);
    let place = share * (some.len() - 1) as f64;
    some[place.round() as usize]
}
