//! The next test of `seepd gap`: told in words, and written as a demand and a plant file.

use std::fmt::Write;

use seepd_gap::next_test::{NextTest, Outcome, Proposal};
use seepd_signals::Signal;

use super::gap::{PlantFile, emitted};
use crate::failure::{Code, Failure};
use crate::quantity::BAR_PER_PA;

/// How often a test is to be repeated: a record needs three cycles.
const REPETITIONS: usize = 3;
/// Proposals that are told.
const TOLD: usize = 3;

/// The terminal's report.
pub(super) fn report(next: Option<&NextTest>) -> String {
    let Some(next) = next else { return String::new() };
    let mut text = String::from("\nwhat to try next:\n");
    let Some(best) = next.proposals.first() else {
        return text + "  no test within this log's places and speeds could be simulated\n";
    };
    if !next.tells {
        let _ = writeln!(
            text,
            "  no allowed test tells these apart: after the best one the right explanation would have {:.0} %",
            100.0 * best.expected_probability
        );
    }
    for proposal in next.proposals.iter().take(TOLD) {
        let _ = writeln!(
            text,
            "  {:>4.2} bit  {}{}; the right explanation would then have {:.0} %",
            proposal.information_bit,
            proposal.what,
            length(proposal),
            100.0 * proposal.expected_probability
        );
    }
    for outcome in &best.outcomes {
        let _ = writeln!(text, "            {}", told(outcome));
    }
    text
}

fn length(proposal: &Proposal) -> String {
    match proposal.sensor {
        Some(_) => String::new(),
        None => format!(" ({:.0} s, {REPETITIONS} times)", proposal.seconds),
    }
}

/// What an explanation would show, in a sentence.
pub(crate) fn told(outcome: &Outcome) -> String {
    let (value, unit) = match Signal::from_name(outcome.signal) {
        Some(Signal::PSupply | Signal::PInlet | Signal::PCap | Signal::PRod) => {
            (outcome.difference * BAR_PER_PA, "bar")
        }
        Some(Signal::Position | Signal::Demand) => (outcome.difference * 1e3, "mm"),
        Some(Signal::Load) => (outcome.difference * 1e-3, "kN"),
        _ => (outcome.difference * 100.0, "% of full"),
    };
    format!(
        "if it is {}: {} is {value:+.2} {unit} off at {:.1} s of what {} can explain",
        outcome.explanation, outcome.signal, outcome.at_s, outcome.instead_of
    )
}

/// A test as files.
pub(crate) struct TestFiles {
    /// Its demand, repeated, as CSV.
    pub(super) demand: String,
    /// A plant file with it as duty cycle.
    pub(super) plant: String,
}

/// The best test that is a move.
///
/// # Errors
/// [`Failure`] where there is no such test, or it cannot be written.
pub(super) fn files<A: PlantFile>(machine: &A, next: Option<&NextTest>) -> Result<TestFiles, Failure> {
    let none = || Failure::data("there is no test to write: one explanation is as good as certain");
    let next = next.ok_or_else(none)?;
    let best = next.proposals.iter().find(|proposal| proposal.sensor.is_none()).ok_or_else(none)?;
    let period_s = machine.tick_s();
    let ticks = (best.seconds / period_s).round() as usize;
    let mut demand = String::from("t_s;demand_m\n");
    for tick in 0..REPETITIONS * ticks {
        let at_s = (tick % ticks) as f64 * period_s;
        let _ = writeln!(demand, "{:.6};{:.7}", tick as f64 * period_s, best.cycle.demand_m(at_s));
    }
    let with_test = machine.with_cycle(&best.cycle).ok_or_else(|| {
        Failure::new(
            Code::Usage,
            "--emit-test: the duty cycle of a simulator of yours cannot be changed here",
        )
    })?;
    Ok(TestFiles { demand, plant: emitted(with_test)? })
}
