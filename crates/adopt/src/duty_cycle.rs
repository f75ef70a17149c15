//! The duty cycle of a recording: which strokes follow each other again and again, and how long the machine stands between them.
//!
//! A machine that waits for its operator or its part has no period. So cycles are looked for in the order of the strokes, not in time: the
//! shortest row of strokes that repeats. The wait that varies most, or the longest, ends the cycle; what varies there costs nothing.

use std::ops::Range;

use seepd_signals::Signal;

use crate::open_loop::{OpenLoopPart, with_open_loop};
use crate::recording::Recording;
use crate::strokes::{Guide, Stroke, Strokes, find, mean, quantile};

/// Most strokes of a cycle.
pub const MOST_STROKES: usize = 24;
/// Fewest cycles that are one.
pub const LEAST_CYCLES: usize = 3;
/// Strokes are alike where their ways and levels differ by less than this share of the range.
const ALIKE: f64 = 0.05;
/// The same where the command guides: its integral varies with load and oil.
const ALIKE_COMMAND: f64 = 0.12;
/// Durations of strokes that are alike differ by less than this factor.
const ALIKE_DURATION: f64 = 1.6;
/// Share of the strokes that have to repeat.
const REPEATED: f64 = 0.7;
/// A row is preferred to a shorter one where it repeats so much better.
const BETTER: f64 = 0.15;
/// A hold whose duration varies by more than this share of the period is driven by events.
const VARYING: f64 = 0.01;
/// The cycle begins this share of its last hold before its first stroke.
const REST_BEFORE: f64 = 0.3;
/// At most this share of the period.
const MOST_REST_BEFORE: f64 = 0.1;

/// Why no duty cycle was found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DutyCycleError {
    /// The recording has no command.
    #[error("the log has no command that moves")]
    NoCommand,
    /// Hardly any stroke.
    #[error("the {guide} shows {strokes} strokes, too few for cycles that repeat")]
    TooFewStrokes {
        /// Signal that was looked at.
        guide: &'static str,
        /// Strokes.
        strokes: usize,
    },
    /// Strokes, but no order in them.
    #[error(
        "no row of up to {MOST_STROKES} strokes repeats in the {strokes} strokes of the {guide} (the best repeats in {share:.0} % of them): \
         the log has no duty cycle, or several that alternate without order",
        share = 100.0 * .share
    )]
    NoRepetition {
        /// Signal that was looked at.
        guide: &'static str,
        /// Strokes.
        strokes: usize,
        /// Best share of strokes that repeat.
        share: f64,
    },
    /// Too few cycles of one kind.
    #[error(
        "the row of {strokes} strokes repeats only {cycles} times; at least {LEAST_CYCLES} cycles are needed, and 50 or more are good"
    )]
    TooFewCycles {
        /// Strokes of the row.
        strokes: usize,
        /// Times.
        cycles: usize,
    },
    /// All strokes go one way.
    #[error("the strokes of the {guide} all go the same way; a cylinder's position comes back")]
    OneWay {
        /// Signal that was looked at.
        guide: &'static str,
    },
}

/// How long something takes, s: the middle, and what nine of ten cycles lie between.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Duration {
    /// Median, s.
    pub median_s: f64,
    /// Quantile of 5 %, s.
    pub least_s: f64,
    /// Quantile of 95 %, s.
    pub most_s: f64,
}

impl Duration {
    fn of(seconds: &[f64]) -> Self {
        let at = |share| quantile(seconds.iter().copied(), share);
        Duration { median_s: at(0.5), least_s: at(0.05), most_s: at(0.95) }
    }

    /// How much it varies, s.
    pub fn spread_s(&self) -> f64 {
        self.most_s - self.least_s
    }
}

/// A stroke of the cycle and the hold after it.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleStroke {
    /// Name: `extend` and `retract`, numbered where there are several.
    pub name: String,
    /// Start as planned, s from the cycle's start.
    pub from_s: f64,
    /// End as planned, s from the cycle's start.
    pub to_s: f64,
    /// Median way, m, or integral of the command, s.
    pub way: f64,
    /// Time of the hold after it, to the next stroke of the same cycle or of the next one.
    pub hold_after: Duration,
    /// Its beginning without position control, where the log tells one.
    pub open_loop: Option<OpenLoopPart>,
}

/// The duty cycle of a recording.
#[derive(Debug, Clone)]
pub struct FoundCycle {
    /// Signal by which it was found.
    pub guide: Guide,
    /// Planned period, s: each hold at its shortest where events end it, at its median where not.
    pub period_s: f64,
    /// From one cycle's first stroke to the next one's.
    pub period: Duration,
    /// Strokes in time order.
    pub strokes: Vec<CycleStroke>,
    /// Sample at which each stroke of each cycle begins.
    pub cycles: Vec<Vec<usize>>,
    /// Strokes that belong to no cycle: moves by hand, set-up, a cycle that was broken off.
    pub left_out: usize,
    /// The command's value at rest, where it guides.
    pub rest: f64,
}

impl FoundCycle {
    /// Holds within the cycle that events end, by the index of the stroke before; the one that ends the cycle does no harm.
    pub fn varying_holds(&self) -> Vec<usize> {
        let inner = self.strokes.len().saturating_sub(1);
        (0..inner).filter(|i| self.strokes[*i].hold_after.spread_s() > VARYING * self.period_s).collect()
    }

    /// The ticks of its open-loop parts.
    pub fn open_ticks(&self, tick_s: f64) -> Vec<Range<usize>> {
        let tick = |at_s: f64| (at_s / tick_s).round().max(0.0) as usize;
        self.strokes
            .iter()
            .filter_map(|stroke| Some(tick(stroke.from_s)..tick(stroke.open_loop?.to_s)))
            .collect()
    }

    /// How far the time between first and last stroke may exceed the plan, share of the period.
    pub fn stretch(&self) -> f64 {
        let inner = self.strokes.len().saturating_sub(1);
        self.strokes[..inner].iter().map(|stroke| stroke.hold_after.spread_s()).sum::<f64>() / self.period_s
    }

    /// How much longer than planned the machine stands after a stroke, s; 0 where no event ends the hold, and after the last one, whose
    /// wait is nobody's.
    pub fn wait_s(&self, stroke: usize) -> f64 {
        if self.varying_holds().contains(&stroke) { self.strokes[stroke].hold_after.spread_s() } else { 0.0 }
    }

    /// Makes one stroke of two that follow each other.
    pub(crate) fn join(&mut self, index: usize) {
        if index + 1 >= self.strokes.len() {
            return;
        }
        let second = self.strokes.remove(index + 1);
        for starts in &mut self.cycles {
            starts.remove(index + 1);
        }
        let first = &mut self.strokes[index];
        first.to_s = second.to_s;
        first.way += second.way;
        first.hold_after = second.hold_after;
        let outwards: Vec<bool> = self.strokes.iter().map(|stroke| stroke.way > 0.0).collect();
        for (stroke, name) in self.strokes.iter_mut().zip(names(&outwards)) {
            stroke.name = name;
        }
    }

    /// Mean of a signal over the cycles at steps of a tick, each stroke aligned by itself; `None` where the recording lacks it.
    pub fn mean_of(&self, recording: &Recording, signal: Signal, tick_s: f64) -> Option<Vec<f64>> {
        let values = recording.log.get(signal)?;
        let ticks = (self.period_s / tick_s).round() as usize;
        let mut means: Vec<f64> = (0..ticks)
            .map(|tick| {
                let at_s = tick as f64 * tick_s;
                let stroke = self.nearest_stroke(at_s);
                let offset = (at_s - self.strokes[stroke].from_s) * recording.rate_hz;
                mean(
                    &self
                        .cycles
                        .iter()
                        .filter_map(|starts| at(values, starts[stroke] as f64 + offset))
                        .collect::<Vec<f64>>(),
                )
            })
            .collect();
        let last = means.iter().copied().rfind(|value| value.is_finite())?;
        let mut before = last;
        for value in &mut means {
            if value.is_finite() {
                before = *value;
            } else {
                *value = before;
            }
        }
        Some(means)
    }

    /// One cycle of a signal, aligned like the mean.
    pub fn cycle_of(
        &self,
        recording: &Recording,
        signal: Signal,
        cycle: usize,
        tick_s: f64,
    ) -> Option<Vec<f64>> {
        let values = recording.log.get(signal)?;
        let starts = self.cycles.get(cycle)?;
        let ticks = (self.period_s / tick_s).round() as usize;
        let of = |tick: usize| {
            let at_s = tick as f64 * tick_s;
            let stroke = self.nearest_stroke(at_s);
            at(values, starts[stroke] as f64 + (at_s - self.strokes[stroke].from_s) * recording.rate_hz)
                .unwrap_or(f64::NAN)
        };
        Some((0..ticks).map(of).collect())
    }

    /// The stroke by which a time in the cycle is aligned: a hold's first half belongs to the stroke before it.
    fn nearest_stroke(&self, at_s: f64) -> usize {
        let after = self.strokes.partition_point(|stroke| stroke.from_s <= at_s);
        let Some(before) = after.checked_sub(1) else { return 0 };
        let Some(next) = self.strokes.get(after) else { return before };
        let middle_s = 0.5 * (self.strokes[before].to_s + next.from_s);
        if at_s < middle_s { before } else { after }
    }
}

/// The value at a place between samples.
fn at(values: &[f64], place: f64) -> Option<f64> {
    if place < 0.0 {
        return None;
    }
    let (index, share) = (place as usize, place.fract());
    let (from, to) = (*values.get(index)?, *values.get(index + 1)?);
    Some(from + (to - from) * share).filter(|value| value.is_finite())
}

/// Finds the duty cycle of a recording. `overlap` is half the width of the valve's dead band as far as it is known, share of full command; it
/// counts where the command alone has to tell the strokes.
///
/// # Errors
/// [`DutyCycleError`] where nothing repeats.
pub fn find_duty_cycle(recording: &Recording, overlap: f64) -> Result<FoundCycle, DutyCycleError> {
    let guide = Guide::of(recording).ok_or(DutyCycleError::NoCommand)?;
    let found = find(recording, guide, overlap);
    let of = |found: &Strokes| {
        Row::of(found, guide)?.rotated(found, recording.rate_hz).cycle(recording, found, guide)
    };
    let cycle = of(&found).or_else(|error| {
        // A short stop in a stroke, as where position control takes over, may be seen in one cycle and not in the next.
        let joined = found.joined();
        if joined.strokes.len() < found.strokes.len() { of(&joined).map_err(|_| error) } else { Err(error) }
    })?;
    Ok(with_open_loop(recording, cycle))
}

/// A row of strokes that repeats.
struct Row {
    length: usize,
    /// Index of the first stroke of each repetition.
    starts: Vec<usize>,
}

impl Row {
    fn of(found: &Strokes, guide: Guide) -> Result<Self, DutyCycleError> {
        let name = guide.signal().name();
        let strokes = &found.strokes;
        if strokes.len() < 2 * LEAST_CYCLES {
            return Err(DutyCycleError::TooFewStrokes { guide: name, strokes: strokes.len() });
        }
        if strokes.iter().all(|stroke| stroke.way > 0.0) || strokes.iter().all(|stroke| stroke.way < 0.0) {
            return Err(DutyCycleError::OneWay { guide: name });
        }
        let alike = |a: &Stroke, b: &Stroke| are_alike(a, b, found.range, guide);
        let share = |length: usize| {
            let pairs = strokes.len() - length;
            (0..pairs).filter(|i| alike(&strokes[*i], &strokes[i + length])).count() as f64 / pairs as f64
        };
        let mut best = (0, 0.0);
        for length in 2..=MOST_STROKES.min(strokes.len() / LEAST_CYCLES) {
            // A part of a longer row may repeat as well; the row is the shortest that repeats about as often as any.
            let now = share(length);
            if now > best.1 + BETTER {
                best = (length, now);
            }
        }
        let (length, share) = best;
        if share < REPEATED {
            return Err(DutyCycleError::NoRepetition { guide: name, strokes: strokes.len(), share });
        }
        // The repetition that most others are like.
        let windows = strokes.len() + 1 - length;
        let is_like = |a: usize, b: usize| (0..length).all(|i| alike(&strokes[a + i], &strokes[b + i]));
        let reference = (0..windows.min(4 * length))
            .chain((0..windows).step_by((windows / 50).max(1)))
            .max_by_key(|a| (0..windows).filter(|b| is_like(*a, *b)).count())
            .unwrap_or(0);
        let row = Row { length, starts: repetitions(windows, length, |start| is_like(reference, start)) };
        if row.starts.len() < LEAST_CYCLES {
            return Err(DutyCycleError::TooFewCycles { strokes: length, cycles: row.starts.len() });
        }
        Ok(row)
    }

    /// The same row, begun after the hold that varies most, or else the longest.
    fn rotated(self, found: &Strokes, rate_hz: f64) -> Self {
        let strokes = &found.strokes;
        let gap_s = |i: usize| Some((strokes.get(i + 1)?.start as f64 - strokes[i].end as f64) / rate_hz);
        let holds: Vec<Duration> = (0..self.length)
            .map(|i| {
                Duration::of(&self.starts.iter().filter_map(|start| gap_s(start + i)).collect::<Vec<f64>>())
            })
            .collect();
        let period_s: f64 = holds.iter().map(|hold| hold.median_s).sum();
        let most_varying = (0..self.length)
            .filter(|i| holds[*i].spread_s() > VARYING * period_s)
            .max_by(|a, b| holds[*a].spread_s().total_cmp(&holds[*b].spread_s()));
        let longest = || (0..self.length).max_by(|a, b| holds[*a].median_s.total_cmp(&holds[*b].median_s));
        let Some(last) = most_varying.or_else(longest) else { return self };
        let shift = (last + 1) % self.length;
        if shift == 0 {
            return self;
        }
        // Repetitions that follow each other without a break, and what is whole of them from the shift on.
        let follows: Vec<bool> = self
            .starts
            .iter()
            .map(|start| self.starts.binary_search(&(start + self.length)).is_ok())
            .collect();
        let starts = self
            .starts
            .iter()
            .zip(follows)
            .filter(|(_, follows)| *follows)
            .map(|(start, _)| start + shift)
            .collect();
        Row { length: self.length, starts }
    }

    fn cycle(
        self,
        recording: &Recording,
        found: &Strokes,
        guide: Guide,
    ) -> Result<FoundCycle, DutyCycleError> {
        if self.starts.len() < LEAST_CYCLES {
            return Err(DutyCycleError::TooFewCycles { strokes: self.length, cycles: self.starts.len() });
        }
        let rate = recording.rate_hz;
        let strokes = &found.strokes;
        let of = |pick: &dyn Fn(usize) -> Option<f64>| -> Vec<f64> {
            self.starts.iter().filter_map(|start| pick(*start)).collect()
        };
        let seconds = |samples: usize| samples as f64 / rate;
        let durations: Vec<f64> = (0..self.length)
            .map(|i| {
                Duration::of(&of(&|start| Some(seconds(strokes[start + i].end - strokes[start + i].start))))
                    .median_s
            })
            .collect();
        let holds: Vec<Duration> = (0..self.length)
            .map(|i| {
                let hold = |start: usize| {
                    let next = strokes.get(start + i + 1)?;
                    Some(seconds(next.start.saturating_sub(strokes[start + i].end)))
                };
                Duration::of(&of(&hold))
            })
            .collect();
        let period = Duration::of(
            &self
                .starts
                .windows(2)
                .filter(|pair| pair[1] - pair[0] == self.length)
                .map(|pair| seconds(strokes[pair[1]].start - strokes[pair[0]].start))
                .collect::<Vec<f64>>(),
        );
        let whole_s: f64 =
            durations.iter().sum::<f64>() + holds.iter().map(|hold| hold.median_s).sum::<f64>();
        let planned_s =
            |hold: &Duration| if hold.spread_s() > VARYING * whole_s { hold.least_s } else { hold.median_s };
        let last_s = holds.last().map_or(0.0, planned_s);
        let period_s = durations.iter().sum::<f64>() + holds.iter().map(planned_s).sum::<f64>();
        // A constant period is known better from cycle to cycle than from its parts.
        let period_s = if period.spread_s() < VARYING * period_s && period.median_s.is_finite() {
            period.median_s
        } else {
            period_s
        };
        let mut time_s = (REST_BEFORE * last_s).min(MOST_REST_BEFORE * period_s);
        let names =
            names(&(0..self.length).map(|i| strokes[self.starts[0] + i].way > 0.0).collect::<Vec<bool>>());
        let mut planned = Vec::with_capacity(self.length);
        for (i, name) in names.into_iter().enumerate() {
            let (from_s, to_s) = (time_s, time_s + durations[i]);
            time_s = to_s + planned_s(&holds[i]);
            let way = Duration::of(&of(&|start| Some(strokes[start + i].way))).median_s;
            planned.push(CycleStroke { name, from_s, to_s, way, hold_after: holds[i], open_loop: None });
        }
        let cycles = self
            .starts
            .iter()
            .map(|start| (0..self.length).map(|i| strokes[start + i].start).collect())
            .collect();
        let left_out = strokes.len() - self.length * self.starts.len();
        Ok(FoundCycle { guide, period_s, period, strokes: planned, cycles, left_out, rest: found.rest })
    }
}

fn are_alike(a: &Stroke, b: &Stroke, range: f64, guide: Guide) -> bool {
    let limit = range * if guide == Guide::Command { ALIKE_COMMAND } else { ALIKE };
    let (a_length, b_length) = ((a.end - a.start) as f64, (b.end - b.start) as f64);
    (a.way - b.way).abs() < limit
        && (a.from - b.from).abs() < limit
        && a_length.max(b_length) < ALIKE_DURATION * a_length.min(b_length) + 2.0
}

/// Starts at which the row is there, each after the end of the one before.
fn repetitions(windows: usize, length: usize, is_there: impl Fn(usize) -> bool) -> Vec<usize> {
    let mut starts = Vec::new();
    let mut start = 0;
    while start < windows {
        if is_there(start) {
            starts.push(start);
            start += length;
        } else {
            start += 1;
        }
    }
    starts
}

/// `extend` and `retract`, numbered where there are several.
fn names(extends: &[bool]) -> Vec<String> {
    let count = |way: bool| extends.iter().filter(|extend| **extend == way).count();
    let mut numbers = [0usize; 2];
    extends
        .iter()
        .map(|extend| {
            let name = if *extend { "extend" } else { "retract" };
            let number = &mut numbers[usize::from(*extend)];
            *number += 1;
            if count(*extend) == 1 { name.to_owned() } else { format!("{name}_{number}") }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_recordings::{press, recorded};

    /// With an overlap the command of a hold is anywhere within the dead band, on the side from which the piston came: no level is a rest,
    /// and a stroke is what the command opens beyond the overlap.
    #[test]
    fn a_command_alone_over_a_dead_band_tells_the_strokes() {
        for jump in [0.0, 0.09] {
            let mut spec = press();
            spec.set_effect("valve_deadband.half_width=0.1").unwrap();
            (spec.controller.ki, spec.controller.dead_band_compensation) = (0.0, jump);
            let mut recording = recorded(&spec);
            for signal in [Signal::Demand, Signal::Position] {
                recording.log.values[signal as usize].clear();
            }
            let mut found = find_duty_cycle(&recording, 0.1).unwrap();
            let planned: Vec<(bool, f64)> = spec
                .cycle
                .moves_from()
                .map(|(from_m, stroke)| (stroke.to_m > from_m, stroke.to_s - stroke.from_s))
                .collect();
            assert_eq!(found.strokes.len(), planned.len(), "{:?}", found.strokes);
            // The found cycle begins after its longest hold, the planned one after its only stroke back.
            let back = found.strokes.iter().position(|stroke| stroke.way < 0.0).unwrap();
            found.strokes.rotate_left(back + 1);
            for (stroke, (extends, lasts_s)) in found.strokes.iter().zip(planned) {
                let found_s = stroke.to_s - stroke.from_s;
                assert!((stroke.way > 0.0) == extends, "{:?}", found.strokes);
                // The ends of a slow stroke open less than an eighth of what the fastest does.
                assert!(found_s < 1.15 * lasts_s && found_s > 0.45 * lasts_s, "{found_s} {lasts_s}");
            }
        }
    }
}
