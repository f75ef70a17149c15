//! What a monitor said of changes against the truth.

use serde::{Deserialize, Serialize};

use super::Change;

/// What a monitor said of a machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Cycles after the baseline.
    pub cycles: usize,
    /// Those without an estimate.
    pub silent: usize,
    /// Whether the flag was ever above healthy.
    pub flagged: bool,
    /// Whether it was at the end.
    pub flagged_at_end: bool,
    /// The cause at the end, and the second of a pair.
    pub cause: String,
    /// The second of a pair.
    pub also: Option<String>,
    /// Probability of the cause.
    pub probability: f64,
    /// Every cause with its probability, the likeliest first.
    pub candidates: Vec<(String, f64)>,
    /// Leak at the end, L/min, and its interval; absent without an estimate.
    pub leak_lpm: Option<(f64, [f64; 2])>,
}

/// A machine with what was said of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answered {
    /// The truth.
    pub change: Change,
    /// The answer.
    pub answer: Answer,
}

/// Causes that the command alone cannot tell apart for certain.
const CLASSES: [&[&str]; 2] = [&["valve_null", "external_leak"], &["friction", "load", "spring"]];
/// Causes that cannot be told apart are told as a class where they have this probability together.
const TOLD_FROM: f64 = 0.65;
/// Leaks from here on must not be missed, L/min.
const LEAST_LPM: f64 = 0.3;

/// Scores of all machines.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scores {
    /// Machines.
    pub machines: usize,
    /// Share of the machines without a leak on which a flag rose.
    pub false_flags: Share,
    /// Share of the leaks of 0.3 L/min and more that had no flag at the end: alone, and beside another cause.
    pub missed: [Share; 2],
    /// Share whose cause is right within classes: of all, of those with the catalogue's laws, of those with others.
    pub right: [Share; 3],
    /// Share of which a cause, or none, was said for certain, and share that is right of these.
    pub decided: [Share; 2],
    /// Share of the causes without a name that were called unknown, or left open.
    pub outside: Share,
    /// Mean probability said of the cause that is named, or of its class, less the share of machines that have it, of those decided.
    pub overconfidence: f64,
    /// Share of cycles without an estimate after a change with a name.
    pub silent: Share,
    /// Leaks of 0.3 L/min and more, alone and beside another cause: median and 90th percentile of the relative error.
    pub leak_error: [[f64; 2]; 2],
    /// Share of these whose interval holds the truth.
    pub held: [Share; 2],
    /// What was wrong, a line each.
    pub wrong: Vec<String>,
}

/// A share with what it is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Share {
    /// How many.
    pub count: usize,
    /// Of how many.
    pub of: usize,
}

impl Share {
    fn of(answers: &[&Answered], is: impl Fn(&Answered) -> bool) -> Self {
        Share { count: answers.iter().filter(|one| is(one)).count(), of: answers.len() }
    }

    /// The share; 0 of none.
    pub fn value(self) -> f64 {
        self.count as f64 / self.of.max(1) as f64
    }
}

impl Answer {
    /// What is told, with its probability: a cause, or of a class whose members cannot be told apart the likeliest.
    fn told(&self) -> Option<(&str, f64)> {
        match self.cause.as_str() {
            "unknown" => None,
            "cannot_tell" => {
                let (likeliest, _) = self.candidates.first()?;
                let class = class_of(likeliest);
                let members = self.candidates.iter().filter(|(cause, _)| class.contains(&cause.as_str()));
                let probability = members.map(|(_, probability)| probability).sum();
                (probability >= TOLD_FROM).then_some((likeliest, probability))
            }
            cause => Some((cause, self.probability)),
        }
    }
}

/// The class of a cause; empty for one that stands alone.
fn class_of(cause: &str) -> &'static [&'static str] {
    CLASSES.into_iter().find(|class| class.contains(&cause)).unwrap_or_default()
}

impl Answered {
    fn leaks(&self) -> bool {
        self.change.leak_lpm > 0.0
    }

    fn is_outside(&self) -> bool {
        self.change.cause.as_deref() == Some("outside")
    }

    /// Whether a cause that was named is the planted one, or of its class.
    fn is(&self, named: &str) -> bool {
        let Some(cause) = self.change.cause.as_deref() else { return false };
        cause == named || class_of(cause).contains(&named)
    }

    fn is_decided(&self) -> bool {
        self.answer.told().is_some()
    }

    /// Whether the machine has what is named first, whatever else it has.
    fn has_what_is_named(&self) -> bool {
        match self.answer.told() {
            None => false,
            Some(("none", _)) => !self.leaks() && self.change.cause.is_none(),
            Some(("piston_seal", _)) => self.leaks(),
            Some((cause, _)) => self.is(cause),
        }
    }

    /// Whether the cause is right: nothing, the seal, another cause, or both.
    fn is_right(&self) -> bool {
        let also = &self.answer.also;
        let Some((cause, _)) = self.answer.told() else { return false };
        match (self.leaks(), self.change.cause.is_some()) {
            (false, false) => cause == "none",
            (true, false) => cause == "piston_seal" && also.is_none(),
            (false, true) => self.is(cause),
            (true, true) => cause == "piston_seal" && also.as_deref().is_some_and(|also| self.is(also)),
        }
    }

    fn error(&self) -> Option<f64> {
        let (given, _) = self.answer.leak_lpm?;
        Some((given / self.change.leak_lpm - 1.0).abs())
    }

    fn is_held(&self) -> bool {
        self.answer.leak_lpm.is_some_and(|(_, [low, high])| (low..=high).contains(&self.change.leak_lpm))
    }

    fn told(&self) -> String {
        let Change { cause, effects, factors, leak_lpm, leak_exponent, other_law, drifts } = &self.change;
        format!(
            "{} {effects:?} {factors:?}, leak {leak_lpm:.2} L/min (exponent {leak_exponent:.2}){}{}: {} {:.2}, also {}, leak {:?}{}",
            cause.as_deref().unwrap_or("nothing else"),
            if *other_law { ", other law" } else { "" },
            if *drifts { ", drift" } else { "" },
            self.answer.cause,
            self.answer.probability,
            self.answer.also.as_deref().unwrap_or("nothing"),
            self.answer.leak_lpm,
            if self.answer.flagged { ", flagged" } else { "" },
        )
    }
}

/// Scores answers.
pub fn score(answers: &[Answered]) -> Scores {
    let of = |is: &dyn Fn(&Answered) -> bool| answers.iter().filter(|one| is(one)).collect::<Vec<_>>();
    let named = of(&|one| !one.is_outside());
    let large = |beside: bool| {
        of(&move |one: &Answered| {
            one.change.leak_lpm >= LEAST_LPM && !one.is_outside() && one.change.cause.is_some() == beside
        })
    };
    let decided: Vec<&Answered> = named.iter().copied().filter(|one| one.is_decided()).collect();
    let by_law =
        |other: bool| named.iter().copied().filter(|one| one.change.other_law == other).collect::<Vec<_>>();
    let said: f64 = decided.iter().filter_map(|one| one.answer.told()).map(|(_, said)| said).sum::<f64>()
        / decided.len().max(1) as f64;
    let changed = of(&|one| one.change.cause.is_some() && !one.is_outside());
    let leaks = [large(false), large(true)];
    Scores {
        machines: answers.len(),
        false_flags: Share::of(&of(&|one| !one.leaks() && !one.is_outside()), |one| one.answer.flagged),
        missed: [0, 1].map(|beside| Share::of(&leaks[beside], |one| !one.answer.flagged_at_end)),
        right: [
            Share::of(&named, Answered::is_right),
            Share::of(&by_law(false), Answered::is_right),
            Share::of(&by_law(true), Answered::is_right),
        ],
        decided: [Share::of(&named, Answered::is_decided), Share::of(&decided, Answered::is_right)],
        outside: Share::of(&of(&Answered::is_outside), |one| !one.is_decided()),
        overconfidence: said - Share::of(&decided, Answered::has_what_is_named).value(),
        silent: Share {
            count: changed.iter().map(|one| one.answer.silent).sum(),
            of: changed.iter().map(|one| one.answer.cycles).sum(),
        },
        leak_error: [0, 1]
            .map(|beside| quantiles(leaks[beside].iter().filter_map(|one| one.error()).collect())),
        held: [0, 1].map(|beside| Share::of(&leaks[beside], Answered::is_held)),
        wrong: named
            .iter()
            .filter(|one| !one.is_right() || (one.answer.flagged && !one.leaks()))
            .map(|one| one.told())
            .collect(),
    }
}

/// Median and 90th percentile.
fn quantiles(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get((share * values.len() as f64) as usize).or(values.last()).copied();
    [0.5, 0.9].map(|share| at(share).unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    fn answered(cause: Option<&str>, leak_lpm: f64, said: &str, also: Option<&str>, given: f64) -> Answered {
        Answered {
            change: Change {
                cause: cause.map(str::to_owned),
                effects: BTreeMap::new(),
                factors: [1.0; 2],
                leak_lpm,
                leak_exponent: 0.5,
                other_law: false,
                drifts: false,
            },
            answer: Answer {
                cycles: 10,
                silent: 1,
                flagged: given > 0.3,
                flagged_at_end: given > 0.3,
                cause: said.into(),
                also: also.map(str::to_owned),
                probability: 0.9,
                candidates: Vec::new(),
                leak_lpm: Some((given, [0.9 * given, 1.1 * given])),
            },
        }
    }

    /// Friction or a load, 0.9 together, is told as their class; a null shift or a gain, of which neither is like the other, is not told.
    #[test]
    fn causes_that_look_alike_are_told_as_a_class() {
        let of = |candidates: [(&str, f64); 2]| {
            let mut one = answered(Some("load"), 0.0, "cannot_tell", None, 0.0);
            one.answer.candidates =
                candidates.map(|(cause, probability)| (cause.into(), probability)).to_vec();
            one
        };
        let [class, none] =
            [[("friction", 0.5), ("load", 0.4)], [("valve_null", 0.5), ("controller", 0.4)]].map(of);
        assert!(class.is_decided() && class.is_right() && !none.is_decided() && !none.is_right());
        let scores = score(&[class, none]);
        assert_eq!(
            (scores.right[0], scores.decided[0]),
            (Share { count: 1, of: 2 }, Share { count: 1, of: 2 })
        );
        assert!((scores.overconfidence + 0.1).abs() < 1e-12, "{}", scores.overconfidence);
    }

    #[test]
    fn answers_are_scored_by_what_was_planted() {
        let scores = score(&[
            answered(None, 0.0, "none", None, 0.0),
            answered(None, 1.0, "piston_seal", None, 1.05),
            // Of one class; a flag without a leak.
            answered(Some("valve_null"), 0.0, "external_leak", None, 0.4),
            // The leak beside it is missed.
            answered(Some("friction"), 0.5, "load", None, 0.0),
            answered(Some("outside"), 0.0, "unknown", None, 0.0),
        ]);
        assert_eq!(
            (scores.false_flags, scores.outside),
            (Share { count: 1, of: 2 }, Share { count: 1, of: 1 })
        );
        assert_eq!(scores.missed, [Share { count: 0, of: 1 }, Share { count: 1, of: 1 }]);
        assert_eq!(scores.right[0], Share { count: 3, of: 4 });
        assert_eq!(scores.silent, Share { count: 2, of: 20 });
        assert!((scores.leak_error[0][0] - 0.05).abs() < 1e-12 && scores.held[0].count == 1);
        assert_eq!(scores.wrong.len(), 2);
    }
}
