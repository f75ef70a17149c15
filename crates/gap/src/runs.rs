//! Runs of a machine without a controller: recorded commands with what they made the machine do, in one log or several.
//!
//! A run is cut where the piston stands, and each piece begins anew, at rest where the run was. Pieces with the same command are
//! repetitions of each other, also where they come from different logs, and where one has a pressure that the other lacks.

use std::ops::Range;

use seepd_signals::Signal;
use seepd_sim::cycle::{DriveSample, OpenLoopTick, RunStart};

use crate::diagnosable::Diagnosable;
use crate::record::{
    ANOTHER_KIND, FEWEST_SAMPLES, Log, Mismatch, Record, RecordError, RecordedCycle, binned, bridged, check,
    floors, ranges,
};
use crate::simulate::Drive;
use crate::simulated_axis::SimulatedAxis;

/// A log of a run.
#[derive(Debug, Clone)]
pub struct Run {
    /// What it is called in messages.
    pub name: String,
    /// Its signals.
    pub log: Log,
}

/// Time over which a speed is taken, to either side, s: noise of a third of a millimetre is one of half a millimetre a second then.
const SPEED_OVER_S: f64 = 0.1;
/// Share of the fastest speed below which the piston stands.
const STANDING: f64 = 0.04;
/// Change of the command, share of full, from which it changes.
const CHANGED: f64 = 0.01;
/// A rest of that length cuts a run, s; what is kept of it before what comes next, and after what was.
const REST_S: f64 = 0.5;
const BEFORE_S: f64 = 0.05;
const AFTER_S: f64 = 0.25;
/// Share of the stroke that a piece must go.
const LEAST_WAY: f64 = 0.02;
/// Share of the stroke by which a position may be beyond its end.
const BEYOND: f64 = 0.02;
/// Share of ticks in which commands of repetitions may differ, and the share by which their lengths may.
const DIFFERENT_TICKS: f64 = 0.02;
const DIFFERENT_LENGTH: f64 = 0.1;
/// Time over which the start of a piece is averaged, s.
const START_S: f64 = 0.02;
/// Largest distance of recorded values, s.
const FURTHEST_S: f64 = 0.05;

impl Run {
    /// Mean of a signal over the beginning.
    pub(crate) fn begins(&self, signal: Signal, tick_s: f64) -> Option<f64> {
        mean(self.log.get(signal)?.get(..(START_S / tick_s).ceil() as usize)?)
    }
}

/// A stretch of a run in which the piston moves.
struct Piece<'r> {
    run: &'r Run,
    ticks: Range<usize>,
}

impl Piece<'_> {
    fn of(&self, signal: Signal) -> Option<&[f64]> {
        self.run.log.get(signal)?.get(self.ticks.clone())
    }

    fn len(&self) -> usize {
        self.ticks.len()
    }

    /// Mean over the beginning.
    fn start_of(&self, signal: Signal, ticks: usize) -> Option<f64> {
        mean(self.of(signal)?.get(..ticks)?)
    }
}

impl Record {
    /// Puts runs of one machine together.
    ///
    /// # Errors
    /// [`RecordError`] for what is wrong with a run, or between two.
    pub fn of_runs<A: Diagnosable>(runs: &[Run], spec: &A) -> Result<Self, RecordError> {
        spec.record_of_runs(runs)
    }

    #[doc(hidden)]
    pub fn of_runs_on<A: SimulatedAxis>(runs: &[Run], spec: &A) -> Result<Self, RecordError> {
        let mut notes = Vec::new();
        let mut filled = Vec::with_capacity(runs.len());
        for run in runs {
            let (run, note) = checked(run, spec)?;
            notes.extend(note);
            filled.push(run);
        }
        let mut pieces: Vec<Piece<'_>> = Vec::new();
        for run in &filled {
            let cut = moving(run, spec);
            if cut.is_empty() {
                let error = Box::new(RecordError::StandsStill);
                return Err(RecordError::InRun { run: run.name.clone(), error });
            }
            pieces.extend(cut.into_iter().map(|ticks| Piece { run, ticks }));
        }
        let groups = repetitions(pieces, spec);
        let signals: Vec<Signal> = spec
            .signals()
            .into_iter()
            .filter(|signal| filled.iter().any(|run| run.log.get(*signal).is_some()))
            .collect();
        let mut cycles = Vec::new();
        for (number, group) in groups.iter().enumerate() {
            same_machine(group)?;
            cycles.extend(recorded(group, number, &signals, spec));
        }
        follows(&groups)?;
        if groups.iter().all(|group| group.len() < 3) {
            notes.push("no command is there three times: the gaps are those of runs that were fitted to, and what differs from run to run is hardly known".into());
        }
        let names: std::collections::BTreeSet<&str> = runs.iter().map(|run| run.name.as_str()).collect();
        notes.push(format!(
            "{} runs, {} strokes under {} commands; the machine is driven by the recorded command, from where each stroke begins",
            names.len(),
            cycles.len(),
            groups.len()
        ));
        if filled.iter().all(|run| run.log.get(Signal::Load).is_none()) {
            notes.push("the runs have no load; none is assumed".into());
        }
        let range = ranges(&cycles, signals.len());
        let floor = floors(&cycles, &range);
        Ok(Record {
            signals,
            cycles,
            range,
            floor,
            notes,
            is_open_loop: true,
            test: None,
            position_step_m: None,
        })
    }
}

/// A run with a value at every tick, and what there is to know of it.
///
/// # Errors
/// [`RecordError::InRun`] for what is wrong with it.
pub(crate) fn checked<A: SimulatedAxis>(run: &Run, spec: &A) -> Result<(Run, Option<String>), RecordError> {
    let name = run.name.clone();
    let (log, slowest) = run.log.at_every_tick((FURTHEST_S / spec.tick_s()) as usize);
    let note = (slowest > 1).then(|| {
        format!("{name} has a value every {slowest} ticks or so; those between are taken on straight lines")
    });
    match check_run(&log, spec) {
        Ok(()) => Ok((Run { name, log }, note)),
        Err(error) => Err(RecordError::InRun { run: name, error: Box::new(error) }),
    }
}

/// What can be wrong with one run.
fn check_run<A: SimulatedAxis>(log: &Log, spec: &A) -> Result<(), RecordError> {
    check(log, spec)?;
    let position = log.get(Signal::Position).unwrap_or_default();
    let found = position.iter().filter(|x| x.is_finite()).count();
    if found < FEWEST_SAMPLES {
        return Err(RecordError::ShortRun { found });
    }
    let stroke_m = spec.stroke_m();
    let beyond = |x: &&f64| **x > (1.0 + BEYOND) * stroke_m || **x < -BEYOND * stroke_m;
    // A single value may be a disturbance.
    let mut outside: Vec<f64> = position.iter().filter(beyond).copied().collect();
    if outside.len() > position.len() / 100 {
        outside.sort_by(f64::total_cmp);
        return Err(RecordError::BeyondTheStroke { reached_m: outside[outside.len() / 2], stroke_m });
    }
    Ok(())
}

fn mean(values: &[f64]) -> Option<f64> {
    let finite = || values.iter().filter(|value| value.is_finite());
    let count = finite().count();
    (count > 0).then(|| finite().sum::<f64>() / count as f64)
}

/// Speed at each tick, m/s, over a time to either side, s.
pub(crate) fn speeds(position_m: &[f64], over_s: f64, tick_s: f64) -> Vec<f64> {
    let width = (over_s / tick_s).round().max(1.0) as usize;
    let speed = |tick: usize| -> f64 {
        let (from, to) = (tick.saturating_sub(width), (tick + width).min(position_m.len()));
        match (mean(&position_m[from..tick]), mean(&position_m[tick..to])) {
            // The means' own times are half of what they are taken over apart.
            (Some(before), Some(after)) => (after - before) / (0.5 * (to - from) as f64 * tick_s),
            _ => 0.0,
        }
    };
    (0..position_m.len()).map(speed).collect()
}

/// Stretches of a run between rests.
pub(crate) fn moving<A: SimulatedAxis>(run: &Run, spec: &A) -> Vec<Range<usize>> {
    let (Some(x), Some(u)) = (run.log.get(Signal::Position), run.log.get(Signal::Command)) else {
        return Vec::new();
    };
    let ticks = |seconds: f64| (seconds / spec.tick_s()).round().max(1.0) as usize;
    let (width, length) = (ticks(SPEED_OVER_S), x.len().min(u.len()));
    let around = |tick: usize| (tick.saturating_sub(width), (tick + width).min(length));
    let speeds = speeds(&x[..length], SPEED_OVER_S, spec.tick_s());
    let fastest = speeds.iter().map(|speed| speed.abs()).fold(0.0, f64::max);
    let rests = |tick: usize| {
        let (from, to) = around(tick);
        let (low, high) = (from..to)
            .map(|tick| u[tick])
            .filter(|u| u.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), u| (low.min(u), high.max(u)));
        speeds[tick].abs() <= STANDING * fastest && high - low <= CHANGED
    };
    let mut pieces = Vec::new();
    let (mut begin, mut rest) = (0, 0);
    for tick in 0..=length {
        if tick < length && rests(tick) {
            rest += 1;
            continue;
        }
        if rest >= ticks(REST_S) || tick == length {
            let stood = tick - rest;
            pieces.push(begin..(stood + ticks(AFTER_S)).min(tick));
            begin = tick.saturating_sub(ticks(BEFORE_S)).max(stood);
        }
        rest = 0;
    }
    let way = |piece: &Range<usize>| {
        let finite = || x[piece.clone()].iter().copied().filter(|x| x.is_finite());
        finite().fold(f64::NEG_INFINITY, f64::max) - finite().fold(f64::INFINITY, f64::min)
    };
    pieces.retain(|piece| piece.len() >= FEWEST_SAMPLES && way(piece) > LEAST_WAY * spec.stroke_m());
    pieces
}

/// Pieces by what they repeat: the same command from the same place.
fn repetitions<'r, A: SimulatedAxis>(pieces: Vec<Piece<'r>>, spec: &A) -> Vec<Vec<Piece<'r>>> {
    let start = (START_S / spec.tick_s()).ceil() as usize;
    let mut groups: Vec<Vec<Piece<'r>>> = Vec::new();
    for piece in pieces {
        let repeats = |group: &&mut Vec<Piece<'r>>| {
            let (Some(a), Some(b)) = (group[0].of(Signal::Command), piece.of(Signal::Command)) else {
                return false;
            };
            let [from_a, from_b] = [&group[0], &piece].map(|one| one.start_of(Signal::Position, start));
            let apart = from_a.zip(from_b).map_or(f64::INFINITY, |(a, b)| (a - b).abs());
            let common = a.len().min(b.len());
            let longer = a.len().max(b.len()) - common;
            let other = a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() > CHANGED).count();
            longer as f64 <= DIFFERENT_LENGTH * common as f64
                && other as f64 <= DIFFERENT_TICKS * common as f64
                && apart <= LEAST_WAY * spec.stroke_m()
        };
        match groups.iter_mut().find(repeats) {
            Some(group) => group.push(piece),
            None => groups.push(vec![piece]),
        }
    }
    groups
}

/// Ticks that all repetitions have.
fn common_ticks(group: &[Piece<'_>]) -> usize {
    group.iter().map(Piece::len).min().unwrap_or(0)
}

/// A group's pieces in bins, each along the group's drive.
fn recorded<A: SimulatedAxis>(
    group: &[Piece<'_>],
    number: usize,
    signals: &[Signal],
    spec: &A,
) -> Vec<RecordedCycle> {
    let ticks = common_ticks(group);
    let drive = drive_of(group, ticks, spec);
    let in_bins = |piece: &Piece<'_>, signal: Signal| {
        let values = piece.of(signal).and_then(|values| bridged(&values[..ticks]));
        values.map_or_else(|| vec![f64::NAN; crate::record::BINS], |values| binned(&values))
    };
    group
        .iter()
        .map(|piece| RecordedCycle {
            bins: signals.iter().map(|signal| in_bins(piece, *signal)).collect(),
            drive: drive.clone(),
            group: number,
        })
        .collect()
}

/// Command and load of a group, and where it begins: the mean over its pieces, of each signal over those that have it.
fn drive_of<A: SimulatedAxis>(group: &[Piece<'_>], ticks: usize, spec: &A) -> Drive {
    let bridged_of = |signal: Signal| -> Vec<Vec<f64>> {
        group.iter().filter_map(|piece| bridged(&piece.of(signal)?[..ticks])).collect()
    };
    let (commands, loads) = (bridged_of(Signal::Command), bridged_of(Signal::Load));
    let at = |all: &[Vec<f64>], tick: usize| {
        let tick = tick.min(ticks - 1);
        all.iter().map(|values| values[tick]).sum::<f64>() / all.len().max(1) as f64
    };
    let samples = (0..ticks)
        .map(|tick| DriveSample {
            run: 0,
            at_s: tick as f64 * spec.tick_s(),
            demand_m: f64::NAN,
            command: at(&commands, tick),
            load_n: at(&loads, tick),
            load_end_n: at(&loads, tick + 1),
            leak_area_m2: 0.0,
            open_loop: OpenLoopTick::default(),
        })
        .collect();
    let over = (START_S / spec.tick_s()).ceil() as usize;
    let begins = |signal: Signal| -> Option<f64> {
        mean(&group.iter().filter_map(|piece| piece.start_of(signal, over)).collect::<Vec<f64>>())
    };
    let start = RunStart {
        position_m: begins(Signal::Position).unwrap_or(0.0),
        p_cap_pa: begins(Signal::PCap),
        p_rod_pa: begins(Signal::PRod),
    };
    Drive { samples, start: Some(start), cycles_before: 0 }
}

/// That the same command moves all pistons of a group alike.
fn same_machine(group: &[Piece<'_>]) -> Result<(), RecordError> {
    let ticks = common_ticks(group);
    let positions: Vec<Vec<f64>> = group
        .iter()
        .map(|piece| piece.of(Signal::Position).and_then(|x| bridged(&x[..ticks])).unwrap_or_default())
        .collect();
    let range = |x: &[f64]| {
        x.iter().copied().fold(f64::NEG_INFINITY, f64::max) - x.iter().copied().fold(f64::INFINITY, f64::min)
    };
    let apart = |a: &[f64], b: &[f64]| -> f64 {
        let square: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
        (square / ticks.max(1) as f64).sqrt()
    };
    let Some(first) = positions.first() else { return Ok(()) };
    for (piece, position) in group.iter().zip(&positions).skip(1) {
        let difference_m = apart(first, position);
        if difference_m > ANOTHER_KIND * range(first) {
            let (run, other) = (piece.run.name.clone(), group[0].run.name.clone());
            return Err(Mismatch::OtherMachine { run, other, difference_m }.into());
        }
    }
    Ok(())
}

/// That a positive command extends.
fn follows(groups: &[Vec<Piece<'_>>]) -> Result<(), RecordError> {
    let way = |piece: &Piece<'_>| -> Option<f64> {
        let (u, x) = (piece.of(Signal::Command)?, piece.of(Signal::Position)?);
        let (first, last) = (x.iter().find(|x| x.is_finite())?, x.iter().rev().find(|x| x.is_finite())?);
        Some((last - first) * mean(u)?.signum())
    };
    let with: f64 = groups.iter().filter_map(|group| way(group.first()?)).sum();
    if with < 0.0 {
        let what =
            "the command's sign is inverted: a positive command retracts; set scale = -1 in the mapping";
        return Err(Mismatch::Contradiction(what.to_owned()).into());
    }
    Ok(())
}
