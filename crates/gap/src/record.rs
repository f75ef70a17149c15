//! A log, aligned with the duty cycle and cut into cycles.

use seepd_signals::Signal;
use seepd_sim::SensorError;
use seepd_sim::cycle::DriveSample;

use crate::diagnosable::Diagnosable;
use crate::quantisation::position_step_m;
use crate::simulate::{Drive, bins_of, cycles_to_forget};
use crate::simulated_axis::SimulatedAxis;

/// RMS difference from the median cycle, over the signal's range, above which a cycle is of another kind.
pub(crate) const ANOTHER_KIND: f64 = 0.1;
/// Bins of a cycle in which signals are compared: 20 ms of the default duty cycle.
pub const BINS: usize = 500;
/// Fewest cycles with which a diagnosis is made at all, and with which it needs no warning.
pub const LEAST_CYCLES: usize = 3;
/// See [`LEAST_CYCLES`].
pub const ENOUGH_CYCLES: usize = 12;

/// A log as read: one value a controller tick, NaN where there is none.
#[derive(Debug, Clone, Default)]
pub struct Log {
    /// Values of each signal by [`Signal`]'s number; empty for a signal that the log lacks.
    pub values: [Vec<f64>; Signal::ALL.len()],
}

impl Log {
    /// A signal's values, if the log has it.
    pub fn get(&self, signal: Signal) -> Option<&[f64]> {
        Some(self.values[signal as usize].as_slice()).filter(|values| !values.is_empty())
    }

    /// The log as one who sees these signals alone has it.
    pub fn with_only(mut self, signals: &[Signal]) -> Self {
        for signal in Signal::ALL.into_iter().filter(|signal| !signals.contains(signal)) {
            self.values[signal as usize].clear();
        }
        self
    }

    /// Ticks.
    pub fn len(&self) -> usize {
        self.values.iter().map(Vec::len).max().unwrap_or(0)
    }

    /// Whether there is no tick.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The log with a value at every tick for signals that were recorded at a lower rate, and the largest usual distance of two values, in
    /// ticks. Values further apart than twice the usual, or than `most` ticks, keep their gap.
    pub(crate) fn at_every_tick(&self, most: usize) -> (Self, usize) {
        let mut filled = self.clone();
        let mut slowest = 1;
        for values in &mut filled.values {
            let usual = usual_distance(values);
            if usual > 1 && usual <= most {
                slowest = slowest.max(usual);
                fill(values, 2 * usual);
            }
        }
        (filled, slowest)
    }
}

/// Ticks from one finite value to the next, their median.
fn usual_distance(values: &[f64]) -> usize {
    let recorded: Vec<usize> = (0..values.len()).filter(|tick| values[*tick].is_finite()).collect();
    let mut distances: Vec<usize> = recorded.windows(2).map(|pair| pair[1] - pair[0]).collect();
    distances.sort_unstable();
    distances.get(distances.len() / 2).copied().unwrap_or(0)
}

/// Puts values between finite ones that are at most so far apart on straight lines.
fn fill(values: &mut [f64], furthest: usize) {
    let mut last: Option<usize> = None;
    for tick in 0..values.len() {
        if !values[tick].is_finite() {
            continue;
        }
        if let Some(last) = last.filter(|last| tick - last <= furthest) {
            let (from, to, distance) = (values[last], values[tick], (tick - last) as f64);
            for (index, value) in values[last..tick].iter_mut().enumerate().skip(1) {
                *value = from + (to - from) * index as f64 / distance;
            }
        }
        last = Some(tick);
    }
}

/// Why a log cannot be diagnosed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RecordError {
    /// A signal is missing.
    #[error("the log has no {0}; a diagnosis of this axis needs it")]
    Missing(&'static str),
    /// A signal never changes.
    #[error("the {0} never changes; this is not the log of a machine at work")]
    Constant(&'static str),
    /// A signal is in other units than SI.
    #[error("{signal} reaches {largest:.4e} {unit}: {advice}")]
    Units {
        /// Signal.
        signal: &'static str,
        /// Largest magnitude, in `unit`.
        largest: f64,
        /// SI unit.
        unit: &'static str,
        /// What it seems to be, and what to do.
        advice: &'static str,
    },
    /// The signals do not belong to this machine, or not to each other.
    #[error(transparent)]
    Mismatch(#[from] Mismatch),
    /// What is wrong with one of several runs.
    #[error("{run}: {error}")]
    InRun {
        /// Its name.
        run: String,
        /// What is wrong.
        error: Box<RecordError>,
    },
    /// The position goes where the plant's cannot.
    #[error(
        "the position reaches {reached_m:.4} m, and the stroke of the plant file is {stroke_m:.4} m; set plant.stroke_m, or offset in the mapping so that 0 is fully retracted"
    )]
    BeyondTheStroke {
        /// Furthest position, m.
        reached_m: f64,
        /// Stroke, m.
        stroke_m: f64,
    },
    /// A run in which nothing moves.
    #[error("the piston stands in all of it; a run must have a stroke")]
    StandsStill,
    /// A run that is over before it says anything.
    #[error("it has {found} values; a run needs {FEWEST_SAMPLES} or more")]
    ShortRun {
        /// Values.
        found: usize,
    },
    /// Too few cycles.
    #[error("the log has {found} usable cycles ({shortage}); at least {LEAST_CYCLES} are needed")]
    TooFew {
        /// Usable ones.
        found: usize,
        /// Why there are no more.
        shortage: Shortage,
    },
}

/// How signals do not belong together.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Mismatch {
    /// They do not follow the plant file's duty cycle.
    #[error(
        "{signals} and the plant file's duty cycle do not match (correlation {correlation:.2}); is it the right plant file?"
    )]
    DutyCycle {
        /// Signals by which the cycle was looked for.
        signals: &'static str,
        /// Best correlation with the plan, −1 … 1.
        correlation: f64,
    },
    /// Too few cycles are alike.
    #[error("the cycles differ in kind: too few of them are alike")]
    CyclesDiffer,
    /// The same command moves the pistons of two runs differently.
    #[error(
        "{run} and {other} move differently under the same command ({difference_m:.4} m apart, RMS); are they of the same machine?"
    )]
    OtherMachine {
        /// One run.
        run: String,
        /// A run with the same command.
        other: String,
        /// RMS difference of their positions, m.
        difference_m: f64,
    },
    /// Something that cannot be on such an axis, in a sentence of [`SimulatedAxis::contradiction`].
    #[error("{0}")]
    Contradiction(String),
    /// The position does not follow the demand.
    #[error(
        "the position does not follow the demand (correlation {correlation:.2}); are they of the same axis?"
    )]
    DoesNotFollow {
        /// Best correlation of both, −1 … 1.
        correlation: f64,
    },
    /// The position swings about the demand without end.
    #[error(
        "the position swings about the demand, by up to {:.0} mm to one side and {:.0} mm to the other where it stands still: find out why first \
         (gains that are too high, a valve that is slow or sticks), since a loop that swings cannot be compared; or are they of different axes?",
        1e3 * beyond_m,
        1e3 * short_m
    )]
    Swings {
        /// Farthest beyond the demand, m.
        beyond_m: f64,
        /// Farthest short of it, m.
        short_m: f64,
    },
    /// The position runs ahead of the demand.
    #[error(
        "the position runs ahead of the demand: the clocks of their topics differ; map the time in the messages instead"
    )]
    ClocksApart,
}

/// Why there are no more cycles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Shortage {
    /// The log ends before a cycle does.
    #[error("the log is shorter than a cycle")]
    ShorterThanACycle,
    /// The log has so few.
    #[error("the log is short")]
    Short,
    /// That many are not whole.
    #[error("{0} cut off or with gaps")]
    Incomplete(usize),
}

/// One cycle in bins.
#[derive(Debug, Clone)]
pub struct RecordedCycle {
    /// Mean of each compared signal in each bin, by place in [`Record::signals`]; NaN for a signal that this one's log lacks.
    pub bins: Vec<Vec<f64>>,
    /// Demand and load, or the command, at each tick.
    pub drive: Drive,
    /// Cycles of the same number are repetitions of each other.
    pub(crate) group: usize,
}

/// A log ready for diagnosis.
#[derive(Debug, Clone)]
pub struct Record {
    /// Signals that the log has, of those that are compared.
    pub signals: Vec<Signal>,
    /// Cycles.
    pub cycles: Vec<RecordedCycle>,
    /// Range of each signal over all cycles.
    pub range: Vec<f64>,
    /// RMS over range of each signal's cycle-to-cycle part.
    pub floor: Vec<f64>,
    /// What to know of the log, one line each.
    pub notes: Vec<String>,
    /// Whether these are runs without a controller, of a group's very drive each.
    pub(crate) is_open_loop: bool,
    /// A test beside the duty cycle: its mean cycle, and how many that is of.
    pub(crate) test: Option<(RecordedCycle, usize)>,
    /// The step in which the position is read, m, where the log shows one that could disturb a controller.
    pub(crate) position_step_m: Option<f64>,
}

/// Steps of a position that are looked for, m: finer ones disturb no controller.
const STEPS_M: (f64, f64) = (5e-5, 5e-4);
/// Fewest values of a signal in a cycle: fewer do not tell its strokes.
pub(crate) const FEWEST_SAMPLES: usize = 200;
/// Share of samples that may be missing in a cycle, bridged from their neighbours.
const MISSING_SHARE: f64 = 0.01;
/// Least correlation of demand (or position) with the plan.
const LEAST_CORRELATION: f64 = 0.9;

/// Where cycles begin, by the log's demand, or by what the controller must have been asked for.
fn starts_of_cycles<A: SimulatedAxis>(
    log: &Log,
    spec: &A,
    ticks: usize,
    notes: &mut Vec<String>,
) -> Result<Vec<usize>, RecordError> {
    let missing = || RecordError::Missing(Signal::Demand.name());
    let asked = match (log.get(Signal::Demand), log.get(Signal::Command), log.get(Signal::Position)) {
        (None, Some(command), Some(position)) => spec.asked_m(command, position).ok_or_else(missing)?,
        _ => Vec::new(),
    };
    let guide = log.get(Signal::Demand).unwrap_or(&asked);
    if guide.is_empty() {
        return Err(missing());
    }
    if log.get(Signal::Demand).is_none() {
        notes.push("the log has no demand; that of the plant file is used, aligned with what the controller must have been asked for".into());
    }
    if log.get(Signal::Load).is_none() {
        notes.push("the log has no load; that of the plant file is used".into());
    }
    if guide.len() < ticks {
        return Err(RecordError::TooFew { found: 0, shortage: Shortage::ShorterThanACycle });
    }
    let plan: Vec<f64> =
        (0..ticks).map(|tick| spec.duty_cycle().demand_m(tick as f64 * spec.tick_s())).collect();
    let (starts, best) = starts(guide, &plan);
    if best < LEAST_CORRELATION {
        let signals = match log.get(Signal::Demand) {
            Some(_) => "the log's demand",
            None => "the log's command and position",
        };
        return Err(Mismatch::DutyCycle { signals, correlation: best }.into());
    }
    Ok(starts)
}

/// Leaves out the cycles that are of another kind than most.
///
/// # Errors
/// [`RecordError`] where they are not few, or too few are left.
fn leave_out_others<A: SimulatedAxis>(
    cycles: &mut Vec<RecordedCycle>,
    signals: &[Signal],
    spec: &A,
    notes: &mut Vec<String>,
) -> Result<(), RecordError> {
    let range = ranges(cycles, signals.len());
    let others = of_another_kind(cycles, &range);
    if others.len() * 2 > cycles.len() || cycles.len() - others.len() < LEAST_CYCLES {
        // Signals that do not belong together differ from cycle to cycle as well: that is the better answer.
        plausible(signals, cycles, spec)?;
        return Err(Mismatch::CyclesDiffer.into());
    }
    if others.is_empty() {
        return Ok(());
    }
    notes
        .push(format!("{} cycles were left out, since they are of another kind than the rest", others.len()));
    let mut number = 0;
    cycles.retain(|_| {
        number += 1;
        !others.contains(&(number - 1))
    });
    Ok(())
}

impl Record {
    /// Aligns and cuts a log.
    ///
    /// # Errors
    /// [`RecordError`] for a log that cannot be of such a machine, or with too few cycles.
    pub fn new<A: Diagnosable>(log: &Log, spec: &A) -> Result<Self, RecordError> {
        spec.record(log)
    }

    #[doc(hidden)]
    pub fn of_log<A: SimulatedAxis>(log: &Log, spec: &A) -> Result<Self, RecordError> {
        check(log, spec)?;
        let mut notes = Vec::new();
        let ticks = (spec.duty_cycle().period_s / spec.tick_s()).round() as usize;
        let position_step_m = log.get(Signal::Position).and_then(|x| position_step_m(x, STEPS_M));
        let (log, slowest) = log.at_every_tick(ticks / FEWEST_SAMPLES);
        let log = &log;
        if slowest > 1 {
            notes.push(format!(
                "the log has a value every {slowest} ticks of the controller or so; those between are taken on straight lines"
            ));
        }
        let starts = starts_of_cycles(log, spec, ticks, &mut notes)?;
        let signals: Vec<Signal> =
            spec.signals().into_iter().filter(|signal| log.get(*signal).is_some()).collect();
        let (mut cycles, mut incomplete) = (Vec::new(), 0);
        for start in starts {
            match cut(log, spec, &signals, start, ticks) {
                Some(cycle) => cycles.push(cycle),
                None => incomplete += 1,
            }
        }
        if incomplete > 0 {
            notes.push(format!("{incomplete} cycles were left out, since they are cut off or have gaps"));
        }
        if cycles.len() < LEAST_CYCLES {
            let shortage = if incomplete > 0 { Shortage::Incomplete(incomplete) } else { Shortage::Short };
            return Err(RecordError::TooFew { found: cycles.len(), shortage });
        }
        if cycles.len() < ENOUGH_CYCLES {
            notes.push(format!("only {} cycles: probabilities and intervals are wide", cycles.len()));
        }
        leave_out_others(&mut cycles, &signals, spec, &mut notes)?;
        let range = ranges(&cycles, signals.len());
        let floor = floors(&cycles, &range);
        plausible(&signals, &cycles, spec)?;
        let cycles_before = cycles_to_forget(spec, &cycles[0].drive, &signals, &range);
        cycles.iter_mut().for_each(|cycle| cycle.drive.cycles_before = cycles_before);
        if let Some(step_m) = position_step_m {
            notes.push(format!("the position is read in steps of {:.4} mm", 1000.0 * step_m));
        }
        Ok(Record { signals, cycles, range, floor, notes, is_open_loop: false, test: None, position_step_m })
    }

    /// The record with a test of the same machine, which is fitted to as well: another duty cycle, cut from a log of its own.
    ///
    /// # Errors
    /// [`RecordError::Missing`] where the test's log lacks a signal that this one has.
    pub fn with_test(mut self, test: &Record) -> Result<Self, RecordError> {
        let all: Vec<usize> = (0..test.cycles.len()).collect();
        let mut shown = test.mean(&all);
        let bins = self
            .signals
            .iter()
            .map(|signal| {
                let place = test.signals.iter().position(|other| other == signal);
                Ok(std::mem::take(&mut shown[place.ok_or(RecordError::Missing(signal.name()))?]))
            })
            .collect::<Result<_, RecordError>>()?;
        let drive = mean_drive(test, &all);
        self.notes.push(format!("{} cycles of a test are fitted to as well", all.len()));
        self.test = Some((RecordedCycle { bins, drive, group: 0 }, all.len()));
        Ok(self)
    }

    /// Some of its cycles as a record of their own, with their own floor.
    pub(crate) fn part(&self, cycles: std::ops::Range<usize>) -> Self {
        let cycles = self.cycles[cycles].to_vec();
        let floor = floors(&cycles, &self.range);
        Record {
            signals: self.signals.clone(),
            cycles,
            range: self.range.clone(),
            floor,
            notes: self.notes.clone(),
            is_open_loop: self.is_open_loop,
            test: self.test.clone(),
            position_step_m: self.position_step_m,
        }
    }

    /// What was there, if its sensors are off by that much.
    pub(crate) fn without(&self, errors: &[Option<SensorError>]) -> Self {
        let mut record = self.clone();
        let test = record.test.iter_mut().map(|(test, _)| test);
        for cycle in record.cycles.iter_mut().chain(test) {
            for (values, error) in cycle.bins.iter_mut().zip(errors) {
                let Some(error) = error else { continue };
                values.iter_mut().for_each(|value| *value = error.there(*value));
            }
        }
        record
    }

    /// Mean of some cycles' bins, of those that have the signal.
    pub(crate) fn mean(&self, cycles: &[usize]) -> Vec<Vec<f64>> {
        (0..self.signals.len())
            .map(|signal| {
                let with: Vec<usize> = self.with_signal(cycles, signal).collect();
                let mean = |bin: usize| {
                    with.iter().map(|cycle| self.cycles[*cycle].bins[signal][bin]).sum::<f64>()
                        / with.len() as f64
                };
                (0..BINS).map(mean).collect()
            })
            .collect()
    }

    /// Those of some cycles whose log has a signal.
    pub(crate) fn with_signal(&self, cycles: &[usize], signal: usize) -> impl Iterator<Item = usize> {
        cycles.iter().copied().filter(move |cycle| self.cycles[*cycle].bins[signal][0].is_finite())
    }

    /// Some cycles by the drives that they repeat.
    pub(crate) fn by_group(&self, cycles: &[usize]) -> Vec<Vec<usize>> {
        let groups = cycles.iter().map(|cycle| self.cycles[*cycle].group).max().map_or(0, |last| last + 1);
        let of = |group: usize| cycles.iter().copied().filter(|c| self.cycles[*c].group == group).collect();
        (0..groups).map(of).filter(|group: &Vec<usize>| !group.is_empty()).collect()
    }

    /// Those of some cycles that may be shown together: all, or of runs the first drive's.
    pub(crate) fn alike(&self, cycles: &[usize]) -> Vec<usize> {
        self.by_group(cycles).into_iter().next().unwrap_or_default()
    }
}

fn span(values: &[f64]) -> (f64, f64) {
    let finite = || values.iter().copied().filter(|value| value.is_finite());
    (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max))
}

/// Cycles whose first two signals, command and position as a rule, are unlike the median cycle's by more than [`ANOTHER_KIND`].
fn of_another_kind(cycles: &[RecordedCycle], range: &[f64]) -> Vec<usize> {
    let median = |signal: usize| -> Vec<f64> {
        (0..BINS)
            .map(|bin| {
                let mut values: Vec<f64> = cycles.iter().map(|cycle| cycle.bins[signal][bin]).collect();
                values.sort_by(f64::total_cmp);
                values[values.len() / 2]
            })
            .collect()
    };
    let medians: Vec<Vec<f64>> = (0..range.len().min(2)).map(median).collect();
    let unlike = |cycle: &RecordedCycle| {
        medians.iter().enumerate().any(|(signal, median)| {
            let square: f64 = cycle.bins[signal].iter().zip(median).map(|(a, b)| (a - b).powi(2)).sum();
            (square / BINS as f64).sqrt() > ANOTHER_KIND * range[signal]
        })
    };
    (0..cycles.len()).filter(|index| unlike(&cycles[*index])).collect()
}

/// Whether signals go together as they do on any such axis.
fn plausible<A: SimulatedAxis>(
    signals: &[Signal],
    cycles: &[RecordedCycle],
    spec: &A,
) -> Result<(), RecordError> {
    let cycle = &cycles[0];
    let contradiction = spec.contradiction(signals, cycle).map(Mismatch::Contradiction);
    let Some(x) = bins_of(signals, Signal::Position, &cycle.bins) else {
        return contradiction.map_or(Ok(()), |mismatch| Err(mismatch.into()));
    };
    let ticks = cycle.drive.len();
    let demand: Vec<f64> = (0..BINS).map(|bin| cycle.drive[bin * ticks / BINS].demand_m).collect();
    // The position follows by up to a twentieth of the cycle.
    let lagged = |lag: usize| {
        let shifted: Vec<f64> = (0..BINS).map(|bin| x[(bin + lag) % BINS]).collect();
        correlation(&shifted, &demand, 0, 1)
    };
    let follows = (0..BINS / 20).map(lagged).fold(f64::NEG_INFINITY, f64::max);
    let stays_behind =
        (follows < LEAST_CORRELATION).then_some(Mismatch::DoesNotFollow { correlation: follows });
    if let Some(mismatch) = contradiction.or(stays_behind) {
        let swings = if follows > FOLLOWS_AT_ALL { swings(x, &demand) } else { None };
        return Err(swings.unwrap_or(mismatch).into());
    }
    let early = (1..BINS / 20).map(|lead| lagged(BINS - lead)).fold(f64::NEG_INFINITY, f64::max);
    if early > follows + 1e-3 {
        return Err(Mismatch::ClocksApart.into());
    }
    Ok(())
}

/// Correlation of position and demand from which they are of one axis, whatever else is wrong.
const FOLLOWS_AT_ALL: f64 = 0.3;
/// How far a position that swings is to either side of a demand that stands still, share of the demand's range.
const LEAST_SWING: f64 = 0.1;

/// How the position swings about a demand that stands still, if it does: to both sides within one hold, since a slow loop is short of the
/// demand at the end of one stroke and beyond it at the end of the next.
fn swings(position_m: &[f64], demand_m: &[f64]) -> Option<Mismatch> {
    let (low, high) = span(demand_m);
    let least_m = LEAST_SWING * (high - low);
    let stands_still = |from: &f64, to: &f64| (to - from).abs() < 1e-4 * (high - low);
    let mut first = 0;
    demand_m.chunk_by(stands_still).find_map(|hold| {
        let positions = &position_m[first..first + hold.len()];
        first += hold.len();
        let errors: Vec<f64> = positions.iter().zip(hold).map(|(x, demand)| x - demand).collect();
        let (lowest, beyond_m) = span(&errors);
        let short_m = -lowest;
        (short_m.min(beyond_m) > least_m).then_some(Mismatch::Swings { beyond_m, short_m })
    })
}

/// What can be wrong with a log before anything is compared.
pub(crate) fn check<A: SimulatedAxis>(log: &Log, spec: &A) -> Result<(), RecordError> {
    let named = spec.signals();
    let needed = [Signal::Command, Signal::Position].into_iter().filter(|signal| named.contains(signal));
    for signal in needed {
        let values = log.get(signal).ok_or(RecordError::Missing(signal.name()))?;
        let (low, high) = span(values);
        if high <= low || !(high - low).is_finite() {
            return Err(RecordError::Constant(signal.name()));
        }
    }
    let units = |signal: Signal, most: f64, advice| {
        let (low, high) = log.get(signal).map_or((0.0, 0.0), span);
        let largest = low.abs().max(high.abs());
        if largest > most {
            return Err(RecordError::Units { signal: signal.name(), largest, unit: signal.unit(), advice });
        }
        Ok(())
    };
    units(Signal::Command, 1.5, "that looks like percent; set scale = 0.01 in the mapping")?;
    for signal in [Signal::Position, Signal::Demand] {
        units(
            signal,
            3.0 * spec.stroke_m(),
            "that looks like millimetres; set scale = 0.001 in the mapping",
        )?;
    }
    for signal in [Signal::PSupply, Signal::PInlet, Signal::PCap, Signal::PRod] {
        let Some(values) = log.get(signal) else { continue };
        let (_, high) = span(values);
        if high < 1e4 {
            let advice = "that looks like bar; set scale = 1e5 in the mapping";
            return Err(RecordError::Units {
                signal: signal.name(),
                largest: high,
                unit: signal.unit(),
                advice,
            });
        }
    }
    Ok(())
}

/// Pearson's correlation of a stretch of the guide with the plan; by every `step`-th tick.
pub(crate) fn correlation(guide: &[f64], plan: &[f64], start: usize, step: usize) -> f64 {
    let Some(stretch) = guide.get(start..start + plan.len()) else { return f64::NEG_INFINITY };
    let pairs = || stretch.iter().zip(plan).step_by(step).filter(|(value, _)| value.is_finite());
    let n = pairs().count().max(1) as f64;
    let (mean_a, mean_b) = pairs().fold((0.0, 0.0), |sum, (a, b)| (sum.0 + a / n, sum.1 + b / n));
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in pairs() {
        let (a, b) = (a - mean_a, b - mean_b);
        ab += a * b;
        aa += a * a;
        bb += b * b;
    }
    ab / (aa * bb).sqrt().max(1e-30)
}

/// Ticks where cycles begin, and the first one's correlation.
fn starts(guide: &[f64], plan: &[f64]) -> (Vec<usize>, f64) {
    let ticks = plan.len();
    let coarse = (ticks / 500).max(1);
    let best_in = |from: usize, to: usize| -> (usize, f64) {
        let last = guide.len().saturating_sub(ticks);
        let of = |start: usize, step: usize| (start, correlation(guide, plan, start, step));
        let larger = |a: (usize, f64), b: (usize, f64)| if b.1 > a.1 { b } else { a };
        let rough = (from..=to.min(last))
            .step_by(coarse)
            .map(|s| of(s, coarse))
            .fold((from, f64::NEG_INFINITY), larger);
        let (low, high) = (rough.0.saturating_sub(coarse), (rough.0 + coarse).min(last));
        // The finest difference decides a tick: all samples count.
        (low..=high).map(|start| of(start, 1)).fold((rough.0, f64::NEG_INFINITY), larger)
    };
    let (first, best) = best_in(0, ticks);
    let mut starts = Vec::new();
    let mut at = first;
    while at + ticks <= guide.len() {
        starts.push(at);
        let next = at + ticks;
        if next + ticks > guide.len() {
            break;
        }
        let slack = ticks / 20;
        let near = best_in(next.saturating_sub(slack), next + slack);
        // A pause: look a whole period ahead.
        at = if near.1 >= LEAST_CORRELATION { near.0 } else { best_in(next, next + ticks).0.max(next) };
    }
    (starts, best)
}

fn cut<A: SimulatedAxis>(
    log: &Log,
    spec: &A,
    signals: &[Signal],
    start: usize,
    ticks: usize,
) -> Option<RecordedCycle> {
    let stretch = |signal: Signal| -> Option<Vec<f64>> {
        let values = log.get(signal)?.get(start..start + ticks)?;
        bridged(values)
    };
    let bins = signals.iter().map(|signal| Some(binned(&stretch(*signal)?))).collect::<Option<Vec<_>>>()?;
    let demand = log.get(Signal::Demand).is_some().then(|| stretch(Signal::Demand));
    let load = log.get(Signal::Load).is_some().then(|| stretch(Signal::Load));
    let (demand, load) =
        (demand.map_or(Some(None), |d| d.map(Some))?, load.map_or(Some(None), |l| l.map(Some))?);
    let period_s = spec.tick_s();
    let load_at = |tick: usize| match &load {
        Some(load) => load[tick % ticks],
        None => spec.duty_cycle().load_n((tick % ticks) as f64 * period_s),
    };
    let drive: Vec<DriveSample> = (0..ticks)
        .map(|tick| {
            let at_s = tick as f64 * period_s;
            let demand_m = demand.as_ref().map_or_else(|| spec.duty_cycle().demand_m(at_s), |d| d[tick]);
            DriveSample {
                load_end_n: load_at(tick + 1),
                open_loop: spec.duty_cycle().open_loop_at(at_s),
                ..DriveSample::new(at_s, demand_m, load_at(tick))
            }
        })
        .collect();
    Some(RecordedCycle { bins, drive: Drive::from(drive), group: 0 })
}

/// Mean of some cycles' drives.
pub(crate) fn mean_drive(record: &Record, cycles: &[usize]) -> Drive {
    let mut mean = record.cycles[cycles[0]].drive.clone();
    let n = cycles.len() as f64;
    for (tick, sample) in mean.samples.iter_mut().enumerate() {
        let of = |pick: &dyn Fn(&DriveSample) -> f64| {
            cycles.iter().map(|cycle| pick(&record.cycles[*cycle].drive[tick])).sum::<f64>() / n
        };
        sample.demand_m = of(&|sample| sample.demand_m);
        sample.load_n = of(&|sample| sample.load_n);
        sample.load_end_n = of(&|sample| sample.load_end_n);
    }
    mean
}

/// Fills short gaps along straight lines; `None` where too much is missing.
pub(crate) fn bridged(values: &[f64]) -> Option<Vec<f64>> {
    let missing = values.iter().filter(|value| !value.is_finite()).count();
    if missing as f64 > MISSING_SHARE * values.len() as f64 {
        return None;
    }
    let mut filled = values.to_vec();
    let mut last: Option<usize> = None;
    for index in 0..filled.len() {
        if !filled[index].is_finite() {
            continue;
        }
        let from = last.map_or(0, |last| last + 1);
        let before = last.map_or(filled[index], |last| filled[last]);
        for gap in from..index {
            let share = (gap + 1 - from) as f64 / (index + 1 - from) as f64;
            filled[gap] = before + (filled[index] - before) * share;
        }
        last = Some(index);
    }
    let end = last?;
    let value = filled[end];
    filled[end..].fill(value);
    Some(filled)
}

/// Means of ticks over [`BINS`] bins.
pub fn binned(values: &[f64]) -> Vec<f64> {
    let mut sums = vec![(0.0, 0u32); BINS];
    for (tick, value) in values.iter().enumerate() {
        let bin = &mut sums[bin_of(tick, values.len())];
        bin.0 += value;
        bin.1 += 1;
    }
    sums.into_iter().map(|(sum, count)| sum / f64::from(count.max(1))).collect()
}

/// The bin of a tick.
pub(crate) fn bin_of(tick: usize, ticks: usize) -> usize {
    (tick * BINS / ticks).min(BINS - 1)
}

pub(crate) fn ranges(cycles: &[RecordedCycle], signals: usize) -> Vec<f64> {
    (0..signals)
        .map(|signal| {
            let all: Vec<f64> = cycles.iter().flat_map(|cycle| cycle.bins[signal].iter().copied()).collect();
            let (low, high) = span(&all);
            (high - low).max(f64::MIN_POSITIVE)
        })
        .collect()
}

/// RMS of the bins' difference from their mean over cycles, over the signal's range; the mean square of those of groups.
pub(crate) fn floors(cycles: &[RecordedCycle], range: &[f64]) -> Vec<f64> {
    let groups = cycles.iter().map(|cycle| cycle.group).max().unwrap_or(0) + 1;
    let of_signal = |(signal, range): (usize, &f64)| {
        let squares = (0..groups).filter_map(|group| {
            let has = |cycle: &&RecordedCycle| cycle.group == group && cycle.bins[signal][0].is_finite();
            let repeated: Vec<&[f64]> =
                cycles.iter().filter(has).map(|cycle| cycle.bins[signal].as_slice()).collect();
            (repeated.len() > 1).then(|| variance(&repeated))
        });
        let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
        let square: f64 = if count > 0.0 { sum / count } else { 0.0 };
        (square.sqrt() / range).max(RESOLUTION)
    };
    range.iter().enumerate().map(of_signal).collect()
}

/// Variance over repetitions, the mean over bins.
fn variance(repeated: &[&[f64]]) -> f64 {
    let n = repeated.len() as f64;
    let square: f64 = (0..BINS)
        .map(|bin| {
            let mean = repeated.iter().map(|bins| bins[bin]).sum::<f64>() / n;
            repeated.iter().map(|bins| (bins[bin] - mean).powi(2)).sum::<f64>() / (n - 1.0)
        })
        .sum();
    square / BINS as f64
}

/// Least floor: what numbers in a log resolve, and simulations do, share of a range.
const RESOLUTION: f64 = 1e-4;
