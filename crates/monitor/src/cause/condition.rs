//! A verdict in words: what has changed, by how much, and what tells causes apart that the command cannot.

use seepd_model::causes::{Candidate, Cause, ChangeVerdict, Explanation, Side, SizeUnit};

use super::course::Condition;
use crate::baseline::trend::TimeTo;
use crate::repair::RepairKind;

/// L/min in a m³/s.
const LPM: f64 = 60_000.0;

/// A cause in words, without its size.
pub const fn words_of(cause: Cause, side: Option<Side>) -> &'static str {
    match (cause, side) {
        (Cause::PistonSeal, _) => "piston seal",
        (Cause::ValveNull, _) => "valve: null shifted",
        (Cause::ValveLands, _) => "valve: lands worn",
        (Cause::ExternalLeak, Some(Side::Cap)) => "hose, fitting or rod seal: oil lost outside, cap side",
        (Cause::ExternalLeak, Some(Side::Rod)) => "hose, fitting or rod seal: oil lost outside, rod side",
        (Cause::ExternalLeak, None) => "hose, fitting or rod seal: oil lost outside",
        (Cause::Friction, _) => "more friction: guide, packing or alignment",
        (Cause::Load, _) => "load or weight changed",
        (Cause::Spring, _) => "a force that grows with the stroke: spring or counterweight",
        (Cause::OilViscosity, _) => "oil thicker or thinner: temperature or sort",
        (Cause::Supply, _) => "supply pressure changed: relief valve or pump",
        (Cause::Controller, _) => "controller retuned, no wear",
        (Cause::PositionScale, _) => "position sensor: scale off",
        (Cause::ValveHysteresis, _) => "valve: hysteresis, spool sticks",
        (Cause::ValveDeadBand, _) => "valve: dead band",
    }
}

/// What helps, as a sentence.
const fn advice_on(cause: Cause) -> &'static str {
    match cause {
        Cause::PistonSeal => "Plan to replace the seal.",
        Cause::ValveNull => "Adjust the null, or check the spool's feedback.",
        Cause::ValveLands => "Plan to replace the valve.",
        Cause::ExternalLeak => "Look for oil outside the cylinder.",
        Cause::Friction => "Check guides, packing and alignment.",
        Cause::Load => "If the tool was changed on purpose, learn a new baseline.",
        Cause::Spring => "Check springs, counterweights and tooling.",
        Cause::OilViscosity => "Check the oil's temperature and grade.",
        Cause::Supply => "Check the relief valve and the pump.",
        Cause::Controller => "If the gains were changed on purpose, learn a new baseline.",
        Cause::PositionScale => "Check the position sensor.",
        Cause::ValveHysteresis | Cause::ValveDeadBand => "Check the valve and its oil for dirt and wear.",
    }
}

/// A size with its unit as people write it.
pub fn size_of(candidate: &Candidate) -> String {
    let size = candidate.size;
    match (candidate.kind.cause, candidate.kind.unit) {
        (Cause::ValveNull, _) => format!("{:+.2} % of full command", 100.0 * size),
        (Cause::ValveHysteresis | Cause::ValveDeadBand, _) => {
            format!("{:.2} % of full command", 100.0 * size)
        }
        (_, SizeUnit::Share) => format!("{:+.1} %", 100.0 * size),
        (_, SizeUnit::Area) => format!("{:.3} mm²", 1e6 * size),
        (_, SizeUnit::Flow) => format!("{:.2} L/min a land at 7 MPa", LPM * size),
        (_, SizeUnit::Conductance) => format!("{:.2} L/min at 8 MPa", LPM * 8e6 * size),
        (_, SizeUnit::Force) => format!("{:+.2} kN", 1e-3 * size),
        (_, SizeUnit::Stiffness) => format!("{:.1} kN/m", 1e-3 * size),
    }
}

/// What has changed, in a sentence or two; `None` where nothing has, or only the seal, of which flags tell.
pub fn sentence(explanation: &Explanation) -> Option<String> {
    let named = |cause: Cause| explanation.candidate(cause);
    let told = |cause: Cause| {
        let candidate = named(cause)?;
        Some(format!("{} ({})", words_of(cause, candidate.kind.side), size_of(candidate)))
    };
    match explanation.verdict {
        ChangeVerdict::Nothing | ChangeVerdict::Named(Cause::PistonSeal, None) => None,
        ChangeVerdict::Named(Cause::PistonSeal, Some(also)) => {
            Some(format!("{}, beside a leak of the piston seal. {}", told(also)?, advice_on(also)))
        }
        ChangeVerdict::Named(cause, _) => {
            let seal = if explanation.seal < 0.1 { ", seal unchanged" } else { "" };
            Some(format!("{}{seal}. {}", told(cause)?, advice_on(cause)))
        }
        ChangeVerdict::CannotTell => {
            let [first, second] = [0, 1].map(|rank| explanation.candidates().get(rank));
            let words = |candidate: &Candidate| words_of(candidate.kind.cause, candidate.kind.side);
            let first = words(first?);
            let second = second.map(words).filter(|second| *second != first);
            let tells = distinguish(explanation).first().map_or(String::new(), |tells| format!("; {tells}"));
            Some(match second {
                Some(second) => format!("{first}, or {second}? The command alone cannot tell yet{tells}."),
                None => format!("{first}, perhaps: too little has changed to be sure{tells}."),
            })
        }
        ChangeVerdict::Unknown => Some("something has changed that is none of the known causes.".to_owned()),
    }
}

/// How a cause grows and when it will matter, in a sentence; `None` of one that came at once.
pub fn growth_sentence(condition: &Condition) -> Option<String> {
    let rate = condition.told(condition.rate_per_day?);
    Some(match condition.time_to_matter {
        Some(TimeTo { expected_s, earliest_s, latest_s }) => format!(
            "It changes by {rate} a day, and matters, at {}, in about {} ({} … {}).",
            condition.told(condition.matters_from.copysign(condition.size)),
            span(expected_s),
            span(earliest_s),
            span(latest_s)
        ),
        None => format!("It changes by {rate} a day."),
    })
}

/// A time as people say it.
fn span(time_s: f64) -> String {
    let (unit, length_s) = match time_s {
        s if s >= 2.0 * 86_400.0 => ("days", 86_400.0),
        s if s >= 2.0 * 3600.0 => ("hours", 3600.0),
        s if s >= 120.0 => ("minutes", 60.0),
        _ => ("seconds", 1.0),
    };
    format!("{:.0} {unit}", time_s / length_s)
}

/// A cause that a repair has brought, in a sentence: as was to be expected, so that there is nothing to do about it.
pub fn sentence_after(explanation: &Explanation, what: RepairKind) -> Option<String> {
    let ChangeVerdict::Named(first, second) = explanation.verdict else { return None };
    let cause = second.unwrap_or(first);
    let candidate = explanation.candidate(cause)?;
    let seal = match (first, explanation.seal < 0.1) {
        (Cause::PistonSeal, _) => ", beside a leak of the piston seal",
        (_, true) => ", seal unchanged",
        (_, false) => "",
    };
    let words = words_of(cause, candidate.kind.side);
    Some(format!("{words} ({}) since {}, as was to be expected{seal}.", size_of(candidate), what.words()))
}

/// What would tell the candidates apart; empty where one is named.
pub fn distinguish(explanation: &Explanation) -> Vec<&'static str> {
    if explanation.verdict != ChangeVerdict::CannotTell {
        return Vec::new();
    }
    let is_possible = |cause: Cause| {
        explanation.candidates().iter().any(|one| one.kind.cause == cause && one.probability >= 0.1)
    };
    TELLS
        .iter()
        .filter(|(causes, _)| causes.iter().filter(|cause| is_possible(**cause)).count() >= 2)
        .map(|(_, tells)| *tells)
        .collect()
}

/// Causes that look alike in the command, with what tells them apart.
const TELLS: [(&[Cause], &str); 5] = [
    (
        &[Cause::ValveNull, Cause::ExternalLeak],
        "cap and rod pressures tell a null shift from oil lost outside",
    ),
    (
        &[Cause::PistonSeal, Cause::ValveNull],
        "cap and rod pressures tell a leak of the seal from a null shift",
    ),
    (
        &[Cause::Friction, Cause::Load, Cause::Spring],
        "cap and rod pressures, or the load, tell friction from another force",
    ),
    (
        &[Cause::Controller, Cause::Spring, Cause::ValveHysteresis],
        "the demand and the position tell whether the controller was retuned",
    ),
    (
        &[Cause::PositionScale, Cause::Supply, Cause::OilViscosity, Cause::Load],
        "the oil's temperature and the supply pressure, where they are measured, tell conditions from a sensor",
    ),
];
