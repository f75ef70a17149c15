//! Where the gap is: which equation does not balance, in which phase of the duty cycle, and which signal shows it.
//!
//! Each balance is evaluated on the recorded signals and on the simulated ones with the same coefficients and the same differences over
//! bins; what differs is imbalance that the machine has and the simulation has not.

use seepd_signals::Signal;

use crate::record::{BINS, Record};
use crate::report::Place;
use crate::simulate::BinnedSignals;
use crate::simulated_axis::{Imbalances, SimulatedAxis};

/// Phases in reports.
const PHASES: [&str; 7] = ["extend", "press", "hold", "retract", "reversal", "near_zero", "near_end"];
/// Speed below which a hold is a hold, share of the largest.
const STANDING: f64 = 0.01;
/// Share of the stroke within which an end stop is near.
const NEAR_END: f64 = 0.06;
/// Most places in a report.
const TOLD: usize = 12;

/// The phase of each bin.
fn phases<A: SimulatedAxis>(spec: &A) -> Vec<usize> {
    let cycle = spec.duty_cycle();
    let at = |bin: f64| (bin + 0.5) / BINS as f64 * cycle.period_s;
    let speed = |bin: usize| {
        let (before, after) = (at(bin as f64 - 0.5).max(0.0), at(bin as f64 + 0.5));
        (cycle.demand_m(after) - cycle.demand_m(before)) / (after - before)
    };
    let fastest = (0..BINS).map(|bin| speed(bin).abs()).fold(1e-9, f64::max);
    let mean_load = (0..BINS).map(|bin| cycle.load_n(at(bin as f64)).abs()).sum::<f64>() / BINS as f64;
    // A move is a press stroke as a whole, though the load may come in the middle of it.
    let presses = |at_s: f64| {
        cycle.moves.iter().any(|stroke| {
            (stroke.from_s..stroke.to_s).contains(&at_s) && cycle.load_n(stroke.to_s).abs() > 1.2 * mean_load
        })
    };
    (0..BINS)
        .map(|bin| {
            let position = cycle.demand_m(at(bin as f64));
            let (before, after) = (speed(bin.saturating_sub(8)), speed((bin + 8).min(BINS - 1)));
            if position < NEAR_END * spec.stroke_m() || position > (1.0 - NEAR_END) * spec.stroke_m() {
                6
            } else if before * after < -(STANDING * fastest).powi(2) {
                4
            } else if speed(bin).abs() < STANDING * fastest {
                2
            } else if speed(bin) < 0.0 {
                3
            } else if presses(at(bin as f64)) {
                1
            } else {
                0
            }
        })
        .collect()
}

/// The phases of the cycle in time order: name, start and end, s.
pub(crate) fn phase_spans<A: SimulatedAxis>(spec: &A) -> Vec<(&'static str, f64, f64)> {
    let at = |bin: usize| bin as f64 / BINS as f64 * spec.duty_cycle().period_s;
    let mut spans: Vec<(&'static str, f64, f64)> = Vec::new();
    for (bin, phase) in phases(spec).into_iter().enumerate() {
        match spans.last_mut() {
            Some((name, _, end)) if *name == PHASES[phase] => *end = at(bin + 1),
            _ => spans.push((PHASES[phase], at(bin), at(bin + 1))),
        }
    }
    spans
}

/// In the place of balances that nobody knows: the signals, over their range.
fn signals_themselves(record: &Record, view: &BinnedSignals) -> Imbalances {
    let of = |((signal, range), values): ((&Signal, &f64), &Vec<f64>)| {
        (signal.name(), values.iter().map(|value| value / range).collect())
    };
    record.signals.iter().zip(&record.range).zip(view).map(of).collect()
}

/// Where the recorded machine's balances differ from the simulated one's; where there are no equations, its signals.
pub(crate) fn places<A: SimulatedAxis>(
    record: &Record,
    calibrated: &A,
    recorded: &BinnedSignals,
    simulated: &BinnedSignals,
) -> Vec<Place> {
    let phase = phases(calibrated);
    let difference =
        |signal: usize, bin: usize| (recorded[signal][bin] - simulated[signal][bin]) / record.range[signal];
    let mut found: Vec<Place> = Vec::new();
    let of = |view: &BinnedSignals| {
        let balances = calibrated.imbalances(&record.signals, view);
        if balances.is_empty() { signals_themselves(record, view) } else { balances }
    };
    let pairs = of(recorded).into_iter().zip(of(simulated));
    for ((equation, a), (_, b)) in pairs {
        for (number, name) in PHASES.iter().enumerate() {
            let bins = || (0..BINS).filter(|bin| phase[*bin] == number);
            let share: f64 = bins().map(|bin| (a[bin] - b[bin]).powi(2)).sum();
            let shown = |signal: usize| bins().map(|bin| difference(signal, bin).powi(2)).sum::<f64>();
            let most = (0..record.signals.len()).max_by(|a, b| shown(*a).total_cmp(&shown(*b)));
            let signal = most.map_or("command", |index| record.signals[index].name());
            if share > 0.0 {
                found.push(Place { equation, phase: name, signal, share });
            }
        }
    }
    let sum: f64 = found.iter().map(|place| place.share).sum();
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    found.truncate(TOLD);
    let told: f64 = found.iter().map(|place| place.share).sum();
    let scale = if sum > 0.0 { 1.0 / told } else { 0.0 };
    for place in &mut found {
        place.share *= scale;
    }
    found
}
