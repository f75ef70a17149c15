//! The mark of a cycle's start: a switch of that name, which rises once a cycle.

use seepd_signals::Signal;

use super::circuit::Drive;
use super::names::Role;
use super::trace::{Character, Trace};
use super::{Assigned, Outcome, SignalProposal, mapping_to};

/// Rises that a mark has at least.
const LEAST_RISES: usize = 2;
/// How far apart the positions at the rises may be, share of the position's range.
const SAME_PLACE: f64 = 0.05;
/// How far the times between rises may differ from their median, share of it: dwell times vary.
const SAME_PERIOD: f64 = 0.7;

/// Settles the mark.
pub(super) fn propose(traces: &[Trace<'_>], drive: &Drive<'_>, proposal: &mut SignalProposal) {
    if proposal.assigned.contains_key(&Signal::CycleStart) {
        return;
    }
    let named = traces.iter().filter(|trace| {
        trace.character == Character::Switch && trace.unit.is_none() && trace.name.role() == Role::CycleStart
    });
    let marks: Vec<(&Trace<'_>, usize)> =
        named.filter_map(|trace| Some((trace, marks(trace, drive)?))).collect();
    // Of several, the log does not say which: the cycle is found without any.
    let [(trace, rises)] = marks.as_slice() else { return };
    // A mark is a rise above 0.5.
    let scale = if trace.largest > 0.5 && trace.least < 0.5 { 1.0 } else { 1.0 / trace.range() };
    let offset = if scale == 1.0 { 0.0 } else { -trace.least * scale };
    proposal.settle(
        Signal::CycleStart,
        Outcome::Assigned(Assigned {
            column: trace.index,
            mapping: mapping_to(trace, scale, offset),
            confidence: 0.85,
            evidence: vec![format!(
                "It rises {rises} times, at regular intervals and always at the same position."
            )],
            rivals: Vec::new(),
        }),
    );
}

/// How many times a trace rises, if it does so once a cycle.
fn marks(trace: &Trace<'_>, drive: &Drive<'_>) -> Option<usize> {
    let middle = 0.5 * (trace.least + trace.largest);
    let rises: Vec<usize> = trace
        .values
        .windows(2)
        .enumerate()
        .filter(|(_, pair)| pair[0] < middle && pair[1] >= middle)
        .map(|(at, _)| at + 1)
        .collect();
    let regular = rises.len() >= LEAST_RISES && is_regular(&rises);
    let in_place = drive.position.as_ref().is_none_or(|position| in_one_place(position, &rises));
    (regular && in_place).then_some(rises.len())
}

fn is_regular(rises: &[usize]) -> bool {
    let mut periods: Vec<usize> = rises.windows(2).map(|pair| pair[1] - pair[0]).collect();
    periods.sort_unstable();
    let median = periods[periods.len() / 2] as f64;
    periods.iter().all(|period| (*period as f64 - median).abs() <= SAME_PERIOD * median)
}

fn in_one_place(position: &[f64], rises: &[usize]) -> bool {
    let span = |values: &mut dyn Iterator<Item = f64>| {
        let (least, largest) = values
            .filter(|value| value.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, largest), value| {
                (least.min(value), largest.max(value))
            });
        largest - least
    };
    let range = span(&mut position.iter().copied());
    span(&mut rises.iter().map(|at| position[*at])) <= SAME_PLACE * range
}
