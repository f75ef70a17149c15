//! Machines simulated along a recorded drive, closed loop, and what they show in bins.

use seepd_signals::Signal;
use seepd_sim::cycle::DriveSample;

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

/// Simulates each machine over the drive, after a warm-up with the end of the same drive, and bins its signals. A simulation that goes
/// out of bounds shows NaN.
pub(crate) fn binned_signals<A: SimulatedAxis>(
    machines: &[A],
    drive: &[DriveSample],
    signals: &[Signal],
) -> Vec<BinnedSignals> {
    let warm_up = &drive[last_stroke(drive)..];
    let driven: Vec<DriveSample> = warm_up.iter().chain(drive).copied().collect();
    A::run(machines, &driven, warm_up.len(), signals)
}

/// Where a warm-up begins: before the last stroke, which wipes out how a machine was started. From there the command is within 5e-5 of
/// its range of what it is after a whole cycle, on the default duty cycle.
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

/// Share of the demand's range that makes a stroke.
const STROKE: f64 = 0.95;
/// A warm-up begins this part of a cycle before the stroke.
const REST_BEFORE: usize = 20;
