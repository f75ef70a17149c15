//! What has changed since the baseline, beside the leak: causes over cycles, and the leak sized beside them.
//!
//! A step changes a cycle at once: the mean of the cycles since then says more than any of them. Without one the mean forgets, so that it
//! follows a drift.

pub mod condition;
pub mod course;
mod tracker;

use seepd_model::causes::{Candidate, Cause, ChangeVerdict, Explanation, Kind, OtherLaw, SizeUnit};
use seepd_model::{Estimate, RelativeEstimate};

pub use tracker::{Explained, Tracker};

/// Causes that have less probability are not listed.
pub const LISTED_FROM: f64 = 0.01;
/// Cycles in a row with one verdict before it is told.
pub const TOLD_AFTER: u64 = 3;
/// Probability of an explanation that the leak's interval leaves open.
const LEFT_OPEN: f64 = 0.05;
/// Probability from which a leak is sized by another law than the estimate has learned.
const CERTAIN: f64 = 1.0 - LEFT_OPEN;
/// Standard deviations on either side of an interval of 90 %.
const Z_90: f64 = 1.645;
/// Most, and least over 1, that another law makes of a leak: at the pressure differences of strokes and holds, a gap against an orifice.
const LARGEST_RATIO: f64 = 2.0;
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

/// How much of a leak residual counts as one: all of it where a leak explains the cycles as well as other causes do, the less the more
/// these do better. A change that is too small to be named yet is no leak only because it moves the command as one would.
pub(crate) fn share_of_seal(explanation: &Explanation) -> f64 {
    against(explanation.seal, explanation.without_seal() - explanation.none)
}

fn against(seal: f64, others: f64) -> f64 {
    (seal / others.max(f64::MIN_POSITIVE)).min(1.0)
}

/// The leak that is named for some cycles, alone or beside another cause.
pub(crate) fn named_leak(explained: &Explained) -> Option<&Candidate> {
    let explanation = &explained.explanation;
    let names_the_seal = matches!(explanation.verdict, ChangeVerdict::Named(Cause::PistonSeal, _));
    let seal = explanation.candidate(Cause::PistonSeal).filter(|seal| seal.size > 0.0);
    seal.filter(|_| names_the_seal && explained.agreeing >= TOLD_AFTER)
}

/// Whether the seal leaks and nothing that load, oil and supply do explains it: with an interval that begins above 0.
pub(crate) fn is_surely_a_leak(explained: &Explained) -> bool {
    named_leak(explained).is_some_and(|seal| seal.probability >= CERTAIN && seal.interval90[0] > 0.0)
}

/// A leak that may be one: more than one cause would do, or the cycles that name it are few.
pub(crate) fn doubtful_leak(explained: &Explained) -> Option<&Candidate> {
    let explanation = &explained.explanation;
    let is_open =
        matches!(explanation.verdict, ChangeVerdict::CannotTell | ChangeVerdict::Named(Cause::PistonSeal, _));
    let seal = explanation.candidate(Cause::PistonSeal).filter(|seal| seal.probability >= LEFT_OPEN);
    seal.filter(|_| is_open && named_leak(explained).is_none())
}

/// The estimate of a doubtful leak, no larger than its explanation leaves open: the regression takes for a leak whatever moves the command as
/// one would, as far as it goes. The interval keeps its end.
pub(crate) fn no_larger_than(seal: &Candidate, given: RelativeEstimate) -> RelativeEstimate {
    let largest = seal.interval90[1].max(0.0);
    let Estimate { value, interval: [low, high], .. } = given.estimate;
    if value <= largest {
        return given;
    }
    let ratio = largest / value;
    let estimate = Estimate { value: largest, interval: [ratio * low, high], ..given.estimate };
    let contributions_m2 = given.contributions_m2.map(|part| ratio * part);
    let leak_residual_m2 = ratio * given.leak_residual_m2;
    RelativeEstimate { estimate, leak_residual_m2, contributions_m2, ..given }
}

/// Whether a cause's response is taken off the phases' means before the leak is sized. The comparison knows load, oil and supply as
/// conditions by itself, as far as training has seen them.
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

/// A leak that is named, with the middle size of three that err for reasons of their own: its explanation's, the regression's, and that
/// without a baseline, where the cycle is like those of training; without the third the explanation's. The interval has what explanation and
/// regression leave open. Whether it is a leak the regression's residual goes on to say, until it is certain.
pub(crate) fn middle_sized(
    seal: &Candidate,
    law: &OtherLaw,
    absolute_m2: Option<f64>,
    given: RelativeEstimate,
) -> RelativeEstimate {
    let explained = size_by_law(seal, law);
    let regressed = given.estimate.value;
    let middle = |absolute: f64| absolute.clamp(explained.min(regressed), explained.max(regressed));
    let size = absolute_m2.map_or(explained, middle);
    let ([low, high], [own_low, own_high]) = (seal.interval90, given.estimate.interval);
    let interval = [low.min(own_low).max(0.0), high.max(own_high)];
    let estimate = Estimate { value: size, interval, ..given.estimate };
    let sure_m2 = if seal.probability >= CERTAIN { size } else { 0.0 };
    let leak_residual_m2 = given.leak_residual_m2.max(sure_m2);
    let ratio = leak_residual_m2 / given.leak_residual_m2;
    let contributions_m2 = given.contributions_m2.map(|part| if ratio > 0.0 { ratio * part } else { part });
    RelativeEstimate { estimate, leak_residual_m2, contributions_m2, ..given }
}

/// The size of an explained leak under the law that was learned, or under another one that is certain. The explanation's own size is the
/// mean of both, by their probabilities; where the law that was learned would have a seal that leaks less, it stands.
fn size_by_law(seal: &Candidate, law: &OtherLaw) -> f64 {
    let size = if law.probability >= CERTAIN {
        law.size
    } else {
        (seal.size - law.probability * law.size) / (1.0 - law.probability)
    };
    if size <= 0.0 {
        return seal.size;
    }
    let [low, high] = seal.interval90;
    size.clamp(low.max(0.0).min(seal.size), high.max(seal.size))
}

/// A leak whose law may be another than the estimate has learned. `of_mean` is the estimate of the mean of cycles that has been explained:
/// what other laws make of that in the mean holds for the cycle `now`. The size follows another law once that is certain; until then the
/// interval has what is open, or had it from training on where `is_calibrated` on every law.
pub(crate) fn under_any_law(
    law: &OtherLaw,
    is_calibrated: bool,
    now: RelativeEstimate,
    of_mean: &RelativeEstimate,
) -> RelativeEstimate {
    let OtherLaw { probability, size, deviation } = *law;
    let known = of_mean.estimate;
    let is_like_training = now.out_of_distribution.score <= 1.0 && of_mean.out_of_distribution.score <= 1.0;
    let counts_from = if is_calibrated { CERTAIN } else { LEFT_OPEN };
    if probability < counts_from || !is_like_training || !(known.value > 0.0 && size > 0.0) {
        return now;
    }
    let square = |value: f64| value * value;
    let known_deviation = 0.5 * (known.interval[1] - known.interval[0]) / Z_90;
    let value = if probability < CERTAIN { known.value } else { size };
    let variance = (1.0 - probability) * (square(known_deviation) + square(known.value - value))
        + probability * (square(deviation) + square(size - value));
    let ratio = (value / known.value).clamp(1.0 / LARGEST_RATIO, LARGEST_RATIO);
    let half = Z_90 * variance.sqrt() / known.value;
    let interval = [ratio - half, ratio + half].map(|share| (share * now.estimate.value).max(0.0));
    let estimate = Estimate { value: ratio * now.estimate.value, interval, ..now.estimate };
    let contributions_m2 = now.contributions_m2.map(|part| ratio * part);
    RelativeEstimate { estimate, leak_residual_m2: ratio * now.leak_residual_m2, contributions_m2, ..now }
}

/// The leak beside a cause whose response was taken off: none in an explanation without the seal; the interval has what other explanations
/// leave open.
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

#[cfg(test)]
mod tests {
    use seepd_model::OutOfDistribution;
    use seepd_model::causes::{Causes, Change};
    use seepd_model::relative::MAX_CHANGES;
    use seepd_model::schema::{CausesFile, CellFile};

    use super::*;

    fn estimate(value: f64, interval: [f64; 2]) -> RelativeEstimate {
        RelativeEstimate {
            estimate: Estimate { value, spread: 0.0, interval, transformed: 0.0 },
            leak_residual_m2: value,
            contributions_m2: [0.0; MAX_CHANGES],
            out_of_distribution: OutOfDistribution { score: 0.0, most_unusual: 0 },
        }
    }

    /// An orifice's 1 mm² ± 0.1 or a gap's 1.4 ± 0.2. In doubt it is the orifice's, with the variance of both and of their distance from
    /// it; a certain gap's is 1.4. It holds for the mean, and by the share for a cycle that has grown since.
    #[test]
    fn analytic_a_leak_follows_another_law_once_that_is_certain() {
        let of_mean = estimate(1e-6, [1e-6 - Z_90 * 0.1e-6, 1e-6 + Z_90 * 0.1e-6]);
        for (probability, size, variance) in
            [(0.5, 1.0, 0.5 * 0.01 + 0.5 * (0.04 + 0.16)), (1.0, 1.4, 0.04_f64)]
        {
            let law = OtherLaw { probability, size: 1.4e-6, deviation: 0.2e-6 };
            let now = estimate(2e-6, [1.8e-6, 2.2e-6]);
            let given = under_any_law(&law, false, now, &of_mean);
            assert!((given.estimate.value / (2e-6 * size) - 1.0).abs() < 1e-9, "{}", given.estimate.value);
            let half = Z_90 * variance.sqrt();
            let [low, high] = given.estimate.interval.map(|end| end / 2e-6);
            assert!(
                (low - (size - half)).abs() < 1e-9 && (high - (size + half)).abs() < 1e-9,
                "{low} {high}"
            );
            assert!((given.leak_residual_m2 / (2e-6 * size) - 1.0).abs() < 1e-9);
            // An interval that every law has calibrated stays until the other one is certain.
            let calibrated = under_any_law(&law, true, now, &of_mean).estimate.interval;
            let expected = if probability < 1.0 { now.estimate.interval } else { given.estimate.interval };
            assert_eq!(calibrated, expected);
        }
    }

    /// The regression says 1 mm² ± 0.2 of a leak that is explained by 1.5 ± 0.4.
    #[test]
    fn a_leak_of_the_middle_size_keeps_what_the_regression_leaves_open() {
        let kind = Kind { cause: Cause::PistonSeal, side: None, unit: SizeUnit::Area };
        let seal = Candidate { kind, probability: 0.99, size: 1.5e-6, interval90: [1.1e-6, 1.9e-6] };
        let mut given = estimate(1e-6, [0.8e-6, 1.2e-6]);
        given.contributions_m2[0] = 1e-6;
        let sized = middle_sized(&seal, &OtherLaw::default(), None, given);
        assert_eq!((sized.estimate.value, sized.estimate.interval), (1.5e-6, [0.8e-6, 1.9e-6]));
        // What each phase contributes still adds up to the residual.
        assert_eq!((sized.leak_residual_m2, sized.contributions_m2[0]), (1.5e-6, 1.5e-6));
        // An orifice's 1.2 or a gap's 1.8, with even odds: an orifice's until the other is certain.
        let of_law = |probability| {
            let law = OtherLaw { probability, size: 1.8e-6, deviation: 0.1e-6 };
            middle_sized(&seal, &law, None, given).estimate.value
        };
        for (absolute, middle) in [(0.2e-6, 1e-6), (1.3e-6, 1.3e-6), (4e-6, 1.5e-6)] {
            let sized = middle_sized(&seal, &OtherLaw::default(), Some(absolute), given);
            assert_eq!(sized.estimate.value, middle);
        }
        assert!((of_law(0.5) / 1.2e-6 - 1.0).abs() < 1e-9 && of_law(0.97) == 1.8e-6);
        // With nine in ten for the gap an orifice would leak less than at the baseline.
        assert_eq!(of_law(0.9), 1.5e-6);
    }

    /// Two causes that answer alike, at two sizes of a leak: 2 mm² ± 1 would explain the change as well as a null would.
    #[test]
    fn a_leak_in_doubt_is_no_larger_than_its_explanation_leaves_open() {
        let identity: Vec<f64> = (0..16).map(|at| if at % 5 == 0 { 1.0 } else { 0.0 }).collect();
        let cell = |cause, unit, size: f64| CellFile {
            kind: Kind { cause, side: None, unit },
            other_law: false,
            alike: false,
            size,
            size_loadings: vec![0.5 * size],
            size_rest: 0.1 * size,
            error: 0.0,
            mean: vec![-0.01, -0.01, 0.0, 0.0],
            directions: vec![vec![-0.005, -0.005, 0.0, 0.0]],
        };
        let causes = Causes::from_file(CausesFile {
            basis: identity.clone(),
            inverse: identity,
            ordinary: vec![0.0; 4],
            known_limit: 5.0,
            alike_from: 1.0,
            sizes_leaks: true,
            fitted: true,
            knows_dead_band: true,
            null_is_exact: true,
            errors_are_even: true,
            cells: vec![
                cell(Cause::PistonSeal, SizeUnit::Area, 2e-6),
                cell(Cause::ValveNull, SizeUnit::Share, 0.01),
            ],
            golden: Vec::new(),
        })
        .unwrap();
        let explained = |numbers: [f64; 4], agreeing| Explained {
            explanation: causes.explain(&Change { numbers: &numbers, noise: 1e-4 }),
            agreeing,
            changed: agreeing,
            mean_of: agreeing,
        };
        let in_doubt = explained([-0.01, -0.01, 0.0, 0.0], 10);
        assert_eq!(in_doubt.explanation.verdict, ChangeVerdict::CannotTell);
        let seal = *doubtful_leak(&in_doubt).unwrap();
        let [_, largest] = seal.interval90;
        assert!((2e-6..3e-6).contains(&largest), "{largest}");
        let mut given = estimate(2.0 * largest, [largest, 4.0 * largest]);
        given.contributions_m2[0] = 2.0 * largest;
        let bounded = no_larger_than(&seal, given);
        assert_eq!((bounded.estimate.value, bounded.leak_residual_m2), (largest, largest));
        assert_eq!(bounded.estimate.interval, [0.5 * largest, 4.0 * largest]);
        assert_eq!(bounded.contributions_m2[0], largest);
        // One within it stays, and so does what is no leak.
        let within = estimate(largest, [0.0, largest]);
        assert_eq!(no_larger_than(&seal, within), within);
        let nothing = explained([0.0; 4], 10);
        assert!(doubtful_leak(&nothing).is_none(), "{:?}", nothing.explanation.verdict);
    }

    #[test]
    fn neutral_a_leak_of_the_law_that_was_learned_stays_as_it_was() {
        let now = estimate(2e-6, [1.8e-6, 2.2e-6]);
        for probability in [0.0, 0.04] {
            let law = OtherLaw { probability, size: 3e-6, deviation: 1e-7 };
            assert_eq!(under_any_law(&law, false, now, &now), now);
        }
    }

    #[test]
    fn what_other_causes_explain_better_counts_less_as_a_leak() {
        assert_eq!(against(0.3, 0.2), 1.0);
        assert_eq!(against(0.0, 0.0), 0.0);
        assert!((against(0.05, 0.2) - 0.25).abs() < 1e-12);
    }
}
