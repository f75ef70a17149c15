//! How likely each explanation is: retuning alone, each effect, none of these.
//!
//! Scores are log-likelihoods of the differences' mean squares by signal, with heavy tails, since the right cause under a slightly different
//! law leaves a small rest; each free parameter of an effect costs half the logarithm of the number of independent values
//! (Schwarz, Annals of Statistics 6 (1978)). "None of these" is scored as an explanation that leaves a third of the retuned gap: an effect
//! that leaves less beats it, and one that leaves more does not.

use crate::axis::Axis;
use crate::fit::{Fit, INDEPENDENT, Problem, prior_cost};
use crate::search::Explanation;

/// Rest of the retuned gap that the right cause under another law leaves, share of its RMS.
const REST_OF_A_NAMED_CAUSE: f64 = 0.35;
/// Parameters that an unknown cause is charged with.
const UNKNOWN_PARAMETERS: f64 = 6.0;
/// Prior probabilities: of no effect, and of one that nobody has named.
const PRIOR_NONE: f64 = 0.4;
const PRIOR_UNKNOWN: f64 = 0.1;
/// Prior probability that there is another effect beside one.
const PRIOR_ANOTHER: f64 = 0.3;
/// Share of the score that is believed: the scores' own errors are of the order of the scores.
const TEMPER: f64 = 0.25;

/// Probabilities that sum to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Ranking {
    /// Of retuning alone.
    pub none: f64,
    /// Of a cause that the catalogue lacks.
    pub unknown: f64,
    /// Of each machine with effects, in the order given.
    pub explanations: Vec<f64>,
}

/// Log-likelihood of a fit's mean squares by signal.
fn likelihood(by_signal: &[f64]) -> f64 {
    -0.5 * INDEPENDENT * by_signal.iter().map(|square| square.ln_1p()).sum::<f64>()
}

/// Score of a machine whose effects have that many parameters.
pub(crate) fn score<A>(problem: &Problem<'_>, fit: &Fit<A>, parameters: f64) -> f64 {
    likelihood(&problem.by_signal(&fit.residual))
        - 0.5 * prior_cost(&fit.free, &fit.at)
        - 0.5 * parameters * INDEPENDENT.ln()
}

/// Weighs the explanations.
pub fn rank<A: Axis>(problem: &Problem<'_>, retuned: &Fit<A>, explanations: &[Explanation<A>]) -> Ranking {
    let none = score(problem, retuned, 0.0);
    let rest: Vec<f64> = problem
        .by_signal(&retuned.residual)
        .iter()
        .map(|square| (square * REST_OF_A_NAMED_CAUSE * REST_OF_A_NAMED_CAUSE).max(square.min(1.0)))
        .collect();
    let unknown = likelihood(&rest) - 0.5 * UNKNOWN_PARAMETERS * INDEPENDENT.ln();
    let each = (1.0 - PRIOR_NONE - PRIOR_UNKNOWN) / A::catalogue().len() as f64;
    let mut logs = vec![TEMPER * none + PRIOR_NONE.ln(), TEMPER * unknown + PRIOR_UNKNOWN.ln()];
    logs.extend(explanations.iter().map(|explanation| {
        let further = (explanation.effects.len() - 1) as f64;
        let prior = each.ln() + further * (PRIOR_ANOTHER * each).ln();
        TEMPER * score(problem, &explanation.fit, explanation.parameters() as f64) + prior
    }));
    let highest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = logs.iter().map(|log| (log - highest).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let share = |index: usize| weights[index] / sum;
    Ranking { none: share(0), unknown: share(1), explanations: (2..weights.len()).map(share).collect() }
}
