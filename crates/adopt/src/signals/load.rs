//! The load force: its unit, and its sign, which no name tells.

use seepd_signals::Signal;

use super::circuit::Drive;
use super::correlation::partial;
use super::full_scale::number;
use super::names::Role;
use super::smooth::Smoothed;
use super::trace::{Character, Trace};
use super::units::Quantity;
use super::{Assigned, Candidate, Outcome, Question, SignalProposal, mapping_to, shown};

/// Units of force without a name, with what they are in N.
const UNITS: &[(f64, &str)] = &[(1.0, "N"), (1e3, "kN"), (9_806.65, "t")];
/// Values without a unit that reach this are N: kilonewtons are not written in hundreds for cylinders that are common.
const NEWTONS: f64 = 1000.0;
/// Correlation from which a sign is believed: with the balance of the chambers, and with the command given the speed.
const BALANCED: f64 = 0.5;
const HELPED: f64 = 0.2;
/// Area of the rod's side over the cap's, of usual cylinders; the balance's sign hardly depends on it.
const AREA_RATIO: f64 = 0.7;
/// Stretch over which speeds are taken, s.
const STRETCH_S: f64 = 0.06;

/// Settles the load.
pub(super) fn propose(traces: &[Trace<'_>], drive: &Drive<'_>, proposal: &mut SignalProposal) {
    if proposal.assigned.contains_key(&Signal::Load) {
        return;
    }
    let loads: Vec<&Trace<'_>> = traces.iter().filter(|trace| is_load(trace)).collect();
    match loads.as_slice() {
        [] => {}
        [one] => {
            let outcome = settled(one, traces, drive, proposal);
            proposal.settle(Signal::Load, outcome);
        }
        several => {
            let candidate = |trace: &&Trace<'_>| {
                let scale = ways(trace).first().map_or(1.0, |way| way.0);
                Candidate {
                    column: trace.index,
                    mapping: mapping_to(trace, scale, 0.0),
                    what: "the load".into(),
                }
            };
            let candidates = several.iter().map(candidate).collect();
            let why = "The log has several forces.".into();
            proposal.questions.push(Question { signal: Signal::Load, candidates, why });
        }
    }
}

fn is_load(trace: &Trace<'_>) -> bool {
    let role = trace.name.role();
    trace.character == Character::Moving
        && match trace.unit.map(|unit| unit.quantity) {
            Some(Quantity::Force) => role != Role::Other && role != Role::Error,
            None => role == Role::Load,
            Some(_) => false,
        }
}

/// What a trace may be multiplied by, the likeliest first; one where that is known.
fn ways<'t>(trace: &'t Trace<'_>) -> Vec<(f64, &'t str)> {
    match trace.unit {
        Some(unit) => vec![(unit.factor, trace.column.unit.as_deref().unwrap_or_default())],
        None if trace.largest_magnitude() >= NEWTONS => vec![UNITS[0]],
        None => vec![UNITS[1], UNITS[2], UNITS[0]],
    }
}

fn settled(trace: &Trace<'_>, traces: &[Trace<'_>], drive: &Drive<'_>, proposal: &SignalProposal) -> Outcome {
    let ways = ways(trace);
    let sign = sign(trace, traces, drive, proposal);
    if let ([(scale, unit)], Some((sign, why))) = (ways.as_slice(), &sign) {
        let unit = match trace.unit {
            Some(_) => format!("It is in {unit}."),
            None => {
                format!("It has no unit, and reaches {}: taken as {unit}.", number(trace.largest_magnitude()))
            }
        };
        return Outcome::Assigned(Assigned {
            column: trace.index,
            mapping: mapping_to(trace, sign * scale, 0.0),
            confidence: if trace.unit.is_some() { 0.85 } else { 0.75 },
            evidence: vec![why.clone(), unit],
            rivals: Vec::new(),
        });
    }
    let signs: &[f64] = match &sign {
        Some((sign, _)) if *sign > 0.0 => &[1.0],
        Some(_) => &[-1.0],
        None => &[1.0, -1.0],
    };
    let candidate = |(scale, unit): &(f64, &str), sign: &f64| Candidate {
        column: trace.index,
        mapping: mapping_to(trace, sign * scale, 0.0),
        what: format!(
            "in {unit}, positive where it {}",
            if *sign > 0.0 { "helps to extend" } else { "resists extension" }
        ),
    };
    let candidates = ways.iter().flat_map(|way| signs.iter().map(move |sign| candidate(way, sign))).collect();
    let why = match (ways.len(), sign.is_some()) {
        (1, _) => "neither pressures nor command tell its sign",
        (_, true) => "it has no unit",
        (_, false) => "it has no unit, and neither pressures nor command tell its sign",
    };
    Outcome::Asked(Question {
        signal: Signal::Load,
        candidates,
        why: format!("{} is the load, but {why}.", shown(trace)),
    })
}

/// The sign with which a trace is positive in the extending direction, and why.
fn sign(
    trace: &Trace<'_>,
    traces: &[Trace<'_>],
    drive: &Drive<'_>,
    proposal: &SignalProposal,
) -> Option<(f64, String)> {
    by_chambers(trace, traces, proposal).or_else(|| by_command(trace, drive))
}

/// By the chambers, which hold what the load does not: a load that helps to extend leaves less to the cap's.
fn by_chambers(trace: &Trace<'_>, traces: &[Trace<'_>], proposal: &SignalProposal) -> Option<(f64, String)> {
    let chamber = |signal: Signal| {
        let assigned = proposal.assigned.get(&signal)?;
        Some(traces.get(assigned.column)?.values.iter().map(|value| value * assigned.mapping.scale))
    };
    let held: Vec<f64> =
        chamber(Signal::PCap)?.zip(chamber(Signal::PRod)?).map(|(cap, rod)| AREA_RATIO * rod - cap).collect();
    let correlation = partial(&trace.values, &held, &[])?;
    let sentence =
        |what: &str| format!("It goes {what} the balance of the chambers (correlation {correlation:.2}).");
    if correlation.abs() < BALANCED {
        return None;
    }
    Some(if correlation > 0.0 {
        (1.0, sentence("with"))
    } else {
        (-1.0, sentence("against") + " Its sign is reversed: positive is to extend.")
    })
}

/// By the command, which a load that helps to extend spares at the same speed.
fn by_command(trace: &Trace<'_>, drive: &Drive<'_>) -> Option<(f64, String)> {
    let (command, position) = (&drive.command, drive.position.as_ref()?);
    let length = ((STRETCH_S * drive.rate_hz).round() as usize).max(1);
    let [force, command, position] =
        [&trace.values, command, position].map(|values| Smoothed::of(values, length));
    let speed = position.slopes(length);
    let up = speed.iter().map(|speed| speed.max(0.0)).collect();
    let down = speed.iter().map(|speed| speed.min(0.0)).collect();
    let correlation = partial(&force.means(length), &command.means(length), &[up, down])?;
    let why = |what: &str| {
        format!("At the same speed the command is {what} where it is high (correlation {correlation:.2}).")
    };
    if correlation.abs() < HELPED {
        return None;
    }
    Some(if correlation < 0.0 {
        (1.0, why("less"))
    } else {
        (-1.0, why("more") + " Its sign is reversed: positive is to extend.")
    })
}
