//! How likely each explanation is: calibration alone, each effect, none of these.
//!
//! Three questions in turn. *Is there a gap that calibration leaves?* Scores decide between the calibrated machine and those with effects,
//! and the calibrated gap itself, over what differs from cycle to cycle, says whether anything is left at all. *Does the catalogue explain
//! it?* The share that the best machine leaves of what calibration leaves: the right cause leaves noise, or, under a somewhat different
//! law, less than half; a cause that the catalogue lacks is imitated in parts. And what its pressure transducers would have to be off by:
//! one may have failed, several have not. *Which effect is it?* Scores again.
//!
//! Scores are log-likelihoods of the differences' mean squares by signal, with heavy tails, since the right cause under a slightly
//! different law leaves a small rest. How well the simulator describes the machine otherwise is not known beforehand: a machine that leaves
//! less than a model's usual error shows that this one is better, and counts for it. Each free parameter of an effect costs half the
//! logarithm of the number of independent values (Schwarz, Annals of Statistics 6 (1978)).

use seepd_sim::SensorError;

use crate::fit::{Fit, INDEPENDENT, Problem, prior_cost};
use crate::search::Explanation;
use crate::simulated_axis::SimulatedAxis;
use crate::transducers::odds_of_imitation;

/// Prior probability of no effect.
pub(crate) const PRIOR_NONE: f64 = 0.45;
/// Prior probability that there is another effect beside one.
const PRIOR_ANOTHER: f64 = 0.3;
/// Share of the score that is believed: the scores' own errors are of the order of the scores.
pub(crate) const TEMPER: f64 = 0.25;
/// Mean square over expected error below which a machine is not the better for leaving less.
const OWN_ERROR: f64 = 0.3;
/// Evidence of a gap beyond noise at which "no effect" is as likely as not, whatever the scores say: a signal or two off by somewhat more
/// than their expected error.
const EVIDENT: f64 = 1.2;
/// Share that the best machine leaves at which "none of these" is as likely as not, and the width of the change.
const HALF_EXPLAINED: (f64, f64) = (0.47, 0.06);
/// What a further effect of a machine adds to that share: two effects imitate more than one.
const SHARE_OF_ANOTHER: f64 = 0.03;
/// What a sensor's error takes, as a share of what calibration leaves of its signal, from which on it tells of an imitation, and from which
/// on it does so in full.
const BENT_SHARE: (f64, f64) = (0.3, 0.6);

/// Probabilities that sum to 1.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Ranking {
    /// Of calibration alone.
    pub(crate) none: f64,
    /// Of a cause that the catalogue lacks.
    pub(crate) unknown: f64,
    /// Of each machine with effects, in the order given.
    pub(crate) explanations: Vec<f64>,
}

/// How likely it is that a machine which leaves that share of what calibration leaves only imitates the cause.
pub(crate) fn unexplained(left: f64) -> f64 {
    1.0 / (1.0 + ((HALF_EXPLAINED.0 - left) / HALF_EXPLAINED.1).exp())
}

/// Whether a machine leaves so much of what calibration leaves that its effects rather imitate the cause.
pub(crate) fn rather_imitates<A>(
    problem: &Problem<'_>,
    calibrated: &Fit<A>,
    explanation: &Explanation<A>,
) -> bool {
    unexplained(left(problem, calibrated, explanation)) > 0.5
}

/// Share that a machine leaves of what calibration leaves: of the evidence, in which small signals count as much as large ones, and of the
/// size, in which a real machine's many small rests do not outweigh what was explained. Shares of next to nothing say nothing.
fn left<A>(problem: &Problem<'_>, calibrated: &Fit<A>, explanation: &Explanation<A>) -> f64 {
    let size = |fit: &Fit<A>| problem.beyond_noise(&fit.residual).iter().sum::<f64>().sqrt();
    let gap = evidence_of_gap(problem, calibrated);
    let of_evidence = evidence_of_gap(problem, &explanation.fit) / gap.max(0.1 * EVIDENT);
    let of_size = if of_evidence > 0.0 { size(&explanation.fit) / size(calibrated) } else { 0.0 };
    0.5 * (of_evidence + of_size) + SHARE_OF_ANOTHER * (explanation.effects.len() - 1) as f64
}

/// Evidence of a gap beyond what differs from cycle to cycle.
fn evidence_of_gap<A>(problem: &Problem<'_>, fit: &Fit<A>) -> f64 {
    (evidence(&problem.by_signal(&fit.residual)) - evidence(&problem.noise)).max(0.0)
}

/// Minus the log-likelihood of mean squares by signal, over half the independent values.
pub(crate) fn evidence(by_signal: &[f64]) -> f64 {
    by_signal.iter().map(|square| square.ln_1p()).sum()
}

/// Score of a machine whose effects have that many parameters.
pub(crate) fn score<A>(problem: &Problem<'_>, fit: &Fit<A>, parameters: f64) -> f64 {
    let left: f64 = problem.by_signal(&fit.residual).iter().map(|square| (OWN_ERROR + square).ln()).sum();
    -0.5 * INDEPENDENT * left - 0.5 * prior_cost(&fit.free, &fit.at) - 0.5 * parameters * INDEPENDENT.ln()
}

/// How many times likelier it is by the sensors' errors that a machine only imitates the cause. An error tells where it takes a good part of
/// what calibration leaves of its signal: beside a large gap, the small rest of a cause under another law bends sensors as well.
fn odds_by_sensors<A>(problem: &Problem<'_>, calibrated: &Fit<A>, errors: &[Option<SensorError>]) -> f64 {
    let gaps = problem.by_signal(&calibrated.residual);
    let bent = problem.of_sensors(errors);
    let (from, to) = BENT_SHARE;
    let told = bent.iter().zip(&gaps).map(|(bent, gap)| {
        let share = (bent / gap.max(f64::MIN_POSITIVE)).sqrt();
        ((share - from) / (to - from)).clamp(0.0, 1.0)
    });
    odds_of_imitation(&problem.record.signals, errors, &told.collect::<Vec<f64>>())
}

/// Weighs the explanations; `sensors` tells what each signal's sensor is off by, if the machine is that one.
pub(crate) fn rank<A: SimulatedAxis>(
    problem: &Problem<'_>,
    calibrated: &Fit<A>,
    explanations: &[Explanation<A>],
    sensors: impl Fn(&A) -> Vec<Option<SensorError>>,
) -> Ranking {
    let each = (1.0 - PRIOR_NONE) / calibrated.spec.catalogue().len() as f64;
    let mut logs = vec![TEMPER * score(problem, calibrated, 0.0) + PRIOR_NONE.ln()];
    logs.extend(explanations.iter().map(|explanation| {
        let further = (explanation.effects.len() - 1) as f64;
        let prior = each.ln() + further * (PRIOR_ANOTHER * each).ln();
        TEMPER * score(problem, &explanation.fit, explanation.parameters() as f64) + prior
    }));
    let highest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = logs.iter().map(|log| (log - highest).exp()).collect();
    let sum: f64 = weights.iter().sum();

    let none = weights[0] / sum / (1.0 + (evidence_of_gap(problem, calibrated) / EVIDENT).powi(4));
    let best = explanations.iter().zip(&weights[1..]).max_by(|a, b| a.1.total_cmp(b.1));
    let unexplained = best.map_or(1.0, |(best, _)| {
        let by_share = unexplained(left(problem, calibrated, best));
        let odds = odds_by_sensors(problem, calibrated, &sensors(&best.fit.spec));
        odds * by_share / (odds * by_share + 1.0 - by_share)
    });
    let with_effects = (sum - weights[0]).max(f64::MIN_POSITIVE);
    let named = (1.0 - none) * (1.0 - unexplained);
    let unknown = if explanations.is_empty() { 1.0 - none } else { (1.0 - none) * unexplained };
    let explanations = weights[1..].iter().map(|weight| named * weight / with_effects).collect();
    Ranking { none, unknown, explanations }
}
