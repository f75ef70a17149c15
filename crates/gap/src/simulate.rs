//! Machines simulated along a recorded drive, and what they show in bins.

use std::ops::Deref;

use seepd_signals::Signal;
use seepd_sim::cycle::{DriveSample, RunStart};

use crate::simulated_axis::SimulatedAxis;

/// What a machine shows: mean of each signal in each bin.
pub type BinnedSignals = Vec<Vec<f64>>;

/// A signal's bins, if it is among the signals of the view.
pub(crate) fn bins_of<'v>(
    signals: &[Signal],
    signal: Signal,
    view: &'v BinnedSignals,
) -> Option<&'v Vec<f64>> {
    signals.iter().position(|other| *other == signal).map(|index| &view[index])
}

/// What drives a machine, tick by tick: demand and load of a cycle, or the command of a run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Drive {
    /// Ticks.
    pub samples: Vec<DriveSample>,
    /// Where a run begins; a cycle begins where the one before, which is alike, has ended.
    pub start: Option<RunStart>,
    /// Whole cycles that are simulated before a cycle, beside the last stroke, until it is forgotten how the machine was started.
    pub cycles_before: usize,
}

impl From<Vec<DriveSample>> for Drive {
    fn from(samples: Vec<DriveSample>) -> Self {
        Drive { samples, start: None, cycles_before: 0 }
    }
}

impl Deref for Drive {
    type Target = [DriveSample];

    fn deref(&self) -> &[DriveSample] {
        &self.samples
    }
}

/// Simulates each machine over the drive and bins its signals; over a cycle after a warm-up with the end of the same drive, and with as
/// many whole cycles as it says. A simulation that goes out of bounds shows NaN.
pub(crate) fn binned_signals<A: SimulatedAxis>(
    machines: &[A],
    drive: &Drive,
    signals: &[Signal],
) -> Vec<BinnedSignals> {
    if let Some(start) = &drive.start {
        return A::run_from(machines, start, drive, signals);
    }
    let warm_up = &drive[last_stroke(drive)..];
    let cycles = std::iter::repeat_n(&drive.samples, drive.cycles_before + 1).flatten();
    let driven: Vec<DriveSample> = warm_up.iter().chain(cycles).copied().collect();
    A::run(machines, &driven, driven.len() - drive.len(), signals)
}

/// How many whole cycles a machine needs along a drive before it shows what it shows for good: none where it comes to rest within a cycle.
/// None as well where it never does, as a loop that hunts.
pub(crate) fn cycles_to_forget<A: SimulatedAxis>(
    spec: &A,
    drive: &Drive,
    signals: &[Signal],
    range: &[f64],
) -> usize {
    let shown_after = |cycles_before: usize| {
        let drive = Drive { cycles_before, ..drive.clone() };
        binned_signals(std::slice::from_ref(spec), &drive, signals).swap_remove(0)
    };
    let is_alike = |one: &BinnedSignals, other: &BinnedSignals| {
        one.iter().zip(other).zip(range).all(|((one, other), range)| {
            let square: f64 = one.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum();
            (square / one.len() as f64).sqrt() <= FORGOTTEN * range
        })
    };
    let (mut cycles, mut shown) = (0, shown_after(0));
    for more in CYCLES_BEFORE {
        let next = shown_after(more);
        if is_alike(&shown, &next) {
            return cycles;
        }
        (cycles, shown) = (more, next);
    }
    0
}

/// Where a warm-up begins: before the last stroke, which wipes out how a machine was started. From there the command is within 5e-5 of
/// its range of what it is after a whole cycle, on the default duty cycle; where that is not enough, [`cycles_to_forget`] says so.
fn last_stroke(drive: &[DriveSample]) -> usize {
    let demands = || drive.iter().map(|sample| sample.demand_m);
    let (low, high) =
        demands().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
    let end = demands().next_back().unwrap_or(0.0);
    let (mut least, mut most) = (end, end);
    for (tick, demand) in demands().enumerate().rev() {
        (least, most) = (least.min(demand), most.max(demand));
        if most - least > STROKE * (high - low) {
            return tick.saturating_sub(drive.len() / REST_BEFORE);
        }
    }
    0
}

/// Whole cycles that are tried before a cycle, each for what a machine may still have to forget after those before it.
const CYCLES_BEFORE: [usize; 3] = [1, 2, 4];
/// Difference up to which a signal is what it is for good, RMS over range: a quarter of the error that any model is allowed.
const FORGOTTEN: f64 = 5e-4;
/// Share of the demand's range that makes a stroke.
const STROKE: f64 = 0.95;
/// A warm-up begins this part of a cycle before the stroke.
const REST_BEFORE: usize = 20;
