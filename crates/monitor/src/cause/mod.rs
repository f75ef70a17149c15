//! What has changed since the baseline, beside the leak: causes over cycles, and the leak sized beside them.
//!
//! A step changes a cycle at once: the mean of the cycles since then says more than any of them. Without one the mean forgets, so that it follows
//! a drift.

pub mod condition;
pub mod course;
mod tracker;

use seepd_model::causes::{Cause, ChangeVerdict, Explanation, Kind, SizeUnit};
use seepd_model::{Estimate, RelativeEstimate};

pub use tracker::{Explained, Tracker};

/// Causes that have less probability are not listed.
pub const LISTED_FROM: f64 = 0.01;
/// Cycles in a row with one verdict before it is told.
pub const TOLD_AFTER: u64 = 3;
/// Probability of an explanation that the leak's interval leaves open.
const LEFT_OPEN: f64 = 0.05;
/// Probability of the seal from which on another cause alone takes nothing off its leak: it could hide one.
pub(crate) const IN_DOUBT: f64 = 0.2;

/// The name of a verdict's cause in messages.
pub const fn name_of(verdict: ChangeVerdict) -> &'static str {
    match verdict {
        ChangeVerdict::Nothing => "none",
        ChangeVerdict::Named(cause, _) => cause.name(),
        ChangeVerdict::CannotTell => "cannot_tell",
        ChangeVerdict::Unknown => "unknown",
    }
}

/// Whether a cause's response is taken off the phases' means before the leak is sized. The comparison knows load, oil and supply as conditions by itself, as far
/// as training has seen them.
pub(crate) fn is_taken_off(kind: Kind, knows_load: bool, is_beyond_training: bool) -> bool {
    match (kind.cause, kind.unit) {
        (Cause::Load, SizeUnit::Share) => is_beyond_training && !knows_load,
        (Cause::OilViscosity | Cause::Supply, _) => is_beyond_training,
        _ => true,
    }
}

/// A leak that is surely one, though no cycle of training's comparison was like it: its size is that of the explanation.
pub(crate) fn leak_beyond_training(
    explanation: &Explanation,
    plain: RelativeEstimate,
) -> Option<RelativeEstimate> {
    let seal = explanation.candidate(Cause::PistonSeal).filter(|seal| seal.size > 0.0)?;
    let interval = seal.interval90.map(|end| end.max(0.0));
    let estimate = Estimate { value: seal.size, interval, ..plain.estimate };
    Some(RelativeEstimate { estimate, leak_residual_m2: seal.size, ..plain })
}

/// The leak beside a cause whose response was taken off: none in an explanation without the seal; the interval has what other explanations leave open.
pub(crate) fn beside(
    explanation: &Explanation,
    has_leak: bool,
    given: RelativeEstimate,
    healthy_limit_m2: f64,
) -> RelativeEstimate {
    let seal = explanation.candidate(Cause::PistonSeal).filter(|seal| seal.probability >= LEFT_OPEN);
    let [low, high] = seal.map_or([0.0; 2], |seal| seal.interval90);
    if !has_leak {
        let interval = [0.0, high.max(healthy_limit_m2)];
        let estimate = Estimate { value: 0.0, interval, ..given.estimate };
        return RelativeEstimate { estimate, leak_residual_m2: 0.0, ..given };
    }
    let is_like_training = given.out_of_distribution.score <= 1.0;
    let value =
        if is_like_training { given.estimate.value } else { seal.map_or(0.0, |seal| seal.size.max(0.0)) };
    let [own_low, own_high] = if is_like_training { given.estimate.interval } else { [value; 2] };
    let is_certain = explanation.without_seal() < LEFT_OPEN;
    let lowest = if is_certain { own_low.min(low).max(0.0) } else { 0.0 };
    let estimate = Estimate { value, interval: [lowest, own_high.max(high)], ..given.estimate };
    let leak_residual_m2 = if is_like_training { given.leak_residual_m2 } else { value };
    RelativeEstimate { estimate, leak_residual_m2, ..given }
}
