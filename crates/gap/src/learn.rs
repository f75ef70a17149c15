//! The law of the unknown: where no effect of the catalogue explains what is left, a function of one signal at one place is learned.
//!
//! The function is a curve over speed, position, pressure, command or time, in a local basis (hats), fitted in the closed loop beside the
//! calibration: what other parameters explain as well is theirs. Curves are smooth beforehand: their second differences are normal, and how
//! rough they may be is what makes the record most likely (MacKay, Neural Computation 4 (1992)). Places compete by the same score as
//! effects, each curve with as many parameters as the record determines of it. Kennedy and O'Hagan (Journal of the Royal Statistical
//! Society B 63 (2001)) learn such a discrepancy at the output; here it acts inside of the plant, so that the machine with it can be
//! simulated elsewhere.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;
use seepd_signals::Signal;
use seepd_sim::effects::Effect;
use seepd_sim::learned::{Argument, LearnedLaw};

use crate::fit::{Fit, INDEPENDENT, Problem, normal_matrix, placed, prior_cost};
use crate::rank::{TEMPER, evidence, unexplained};
use crate::record::{BINS, binned};
use crate::report::LearnedCurve;
use crate::resemblance::resemblance;
use crate::simulate::{BinnedSignals, binned_signals, bins_of};
use crate::simulated_axis::SimulatedAxis;

/// How rough a curve may be: standard deviations of its second differences that are tried, in units of its natural scale.
const ROUGHNESS: [f64; 6] = [0.01, 0.04, 0.15, 0.6, 2.4, 10.0];
/// Standard deviation of a curve's values beforehand, in the same units: wide, for what is smooth may be large.
const LARGEST: f64 = 30.0;
/// Step of the derivatives, in the same units.
const STEP: f64 = 0.2;
/// Places that are fitted in the closed loop, of those that are screened by their linear response.
const FITTED: usize = 4;
/// Iterations of such a fit.
const ITERATIONS: usize = 5;
/// Shares of a step that are tried side by side: one batch of lanes.
const SHARES: [f64; 8] = [1.0, 0.7, 0.5, 0.35, 0.2, 0.1, 0.05, 0.02];
/// Gain in the cost, as a share, below which a fit has converged.
const LEAST_GAIN: f64 = 2e-3;
/// Bins that have to lie within a knot's hat for it to count as visited, of a whole cycle.
const VISITED_BINS: f64 = 1.5;

/// A place with its curve, fitted.
pub(crate) struct LearnedMachine<A> {
    /// The law.
    pub(crate) law: &'static LearnedLaw,
    /// The machine with it, calibrated anew.
    pub(crate) spec: A,
    /// Ends of the argument.
    pub(crate) ends: (f64, f64),
    /// The curve's values at its knots, SI.
    pub(crate) values: Vec<f64>,
    /// Half of their 95 % intervals.
    pub(crate) spread: Vec<f64>,
    /// Whether the record says anything of each knot.
    pub(crate) visited: Vec<bool>,
    /// Probability, among all places and none of them.
    pub(crate) probability: f64,
    /// What the curve resembles, in words.
    pub(crate) resembles: String,
    score: f64,
    /// Size of what it leaves over that of what calibration leaves.
    left: f64,
}

impl<A> LearnedMachine<A> {
    /// What a report says of it.
    pub(crate) fn told(&self, shrink: f64, adopted: bool) -> LearnedCurve {
        let last = (self.values.len() - 1) as f64;
        let at = |knot: usize| self.ends.0 + (self.ends.1 - self.ends.0) * knot as f64 / last;
        let info = self.law.info();
        LearnedCurve {
            effect: info.key,
            place: self.law.site.name(),
            argument: self.law.argument.name(),
            units: [self.law.argument.unit(), info.parameters.last().map_or("1", |value| value.unit)],
            law: info.law,
            probability: self.probability,
            adopted,
            shrink,
            resembles: self.resembles.clone(),
            at: (0..self.values.len()).map(at).collect(),
            values: self.values.clone(),
            band95: self.values.iter().zip(&self.spread).map(|(v, s)| [v - s, v + s]).collect(),
            visited: self.visited.clone(),
        }
    }
}

/// Learns a law at each place that the axis offers; the most likely first. Probabilities of all sum to that of any of them.
pub(crate) fn learn<A: SimulatedAxis>(problem: &Problem<'_>, base: &Fit<A>) -> Vec<LearnedMachine<A>> {
    let laws = base.spec.learnable();
    if laws.is_empty() {
        return Vec::new();
    }
    let travelled = Travelled::of(problem, &base.spec);
    let mut begun: Vec<Curve<A>> = laws
        .par_iter()
        .filter(|law| !base.spec.effects().contains_key(law.key()))
        .filter_map(|law| Curve::new(problem, base, law, &travelled))
        .collect();
    begun.sort_by(|a, b| b.predicted_score(problem).total_cmp(&a.predicted_score(problem)));
    let without = score(problem, &base.residual, prior_cost(&base.free, &base.at), 0.0);
    let size = |residual: &DVector<f64>| problem.by_signal(residual).iter().sum::<f64>().sqrt();
    let size_without = size(&base.residual).max(f64::MIN_POSITIVE);
    let mut learned: Vec<LearnedMachine<A>> = begun
        .into_par_iter()
        .take(FITTED)
        .map(|curve| curve.fitted(problem))
        .map(|curve| {
            let left = size(&curve.plant.residual) / size_without;
            curve.finished(problem, left)
        })
        .collect();
    learned.sort_by(|a, b| b.score.total_cmp(&a.score));
    weigh(&mut learned, without);
    learned
}

/// Score of a machine as effects have it: see [`crate::rank`].
fn score(problem: &Problem<'_>, residual: &DVector<f64>, prior: f64, parameters: f64) -> f64 {
    -0.5 * INDEPENDENT * evidence(&problem.by_signal(residual))
        - 0.5 * prior
        - 0.5 * parameters * INDEPENDENT.ln()
}

/// Probabilities: against each other and none of them by their scores, and all together by what the best of them leaves.
fn weigh<A>(learned: &mut [LearnedMachine<A>], without: f64) {
    let Some(best) = learned.first() else { return };
    let (highest, explained) = (best.score.max(without), 1.0 - unexplained(best.left));
    let weight = |score: f64| (TEMPER * (score - highest)).exp();
    let sum: f64 = weight(without) + learned.iter().map(|one| weight(one.score)).sum::<f64>();
    learned.iter_mut().for_each(|one| one.probability = explained * weight(one.score) / sum);
}

/// What the arguments of laws are along the record's drives.
struct Travelled {
    signals: Vec<Signal>,
    /// What the machine shows along each, the demand, and the length of a bin, s.
    drives: Vec<(BinnedSignals, Vec<f64>, f64)>,
}

impl Travelled {
    fn of<A: SimulatedAxis>(problem: &Problem<'_>, machine: &A) -> Self {
        let signals = machine.signals();
        let drives = problem
            .drives()
            .iter()
            .map(|drive| {
                let shown = binned_signals(std::slice::from_ref(machine), drive, &signals).swap_remove(0);
                let demand: Vec<f64> = drive.iter().map(|sample| sample.demand_m).collect();
                (shown, binned(&demand), drive.len() as f64 * machine.tick_s() / BINS as f64)
            })
            .collect();
        Travelled { signals, drives }
    }

    /// An argument's values, bin by bin; empty where a machine does not show them.
    fn along(&self, argument: Argument) -> Vec<f64> {
        let mut all = Vec::new();
        for (shown, demand, bin_s) in &self.drives {
            let of = |signal: Signal| bins_of(&self.signals, signal, shown);
            let position = of(Signal::Position);
            let values: Option<Vec<f64>> = match argument {
                Argument::Position => position.cloned(),
                Argument::Speed => position.map(|x| slope(x, *bin_s)),
                Argument::Command => of(Signal::Command).cloned(),
                Argument::CapPressure => of(Signal::PCap).cloned(),
                Argument::RodPressure => of(Signal::PRod).cloned(),
                Argument::SupplyPressure => of(Signal::PSupply).cloned(),
                Argument::PressureDifference => of(Signal::PCap)
                    .zip(of(Signal::PRod))
                    .map(|(cap, rod)| cap.iter().zip(rod).map(|(a, b)| a - b).collect()),
                Argument::ControlError => {
                    position.map(|x| demand.iter().zip(x).map(|(demand, x)| demand - x).collect())
                }
                Argument::Time => Some((0..demand.len()).map(|bin| (bin as f64 + 0.5) * bin_s).collect()),
            };
            all.extend(values.unwrap_or_default());
        }
        all
    }

    /// Where a curve begins and ends, and which of its knots the record says something of; `None` for an argument that hardly changes.
    fn span(&self, argument: Argument, knots: usize) -> Option<((f64, f64), Vec<bool>)> {
        let values = self.along(argument);
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let width = high - low;
        if !(width.is_finite() && width > 1e-9 * low.abs().max(high.abs()).max(1e-9)) {
            return None;
        }
        let mut within = vec![0.0; knots];
        for value in &values {
            let place = (value - low) / width * (knots - 1) as f64;
            let knot = (place as usize).min(knots - 2);
            within[knot] += 1.0 - (place - knot as f64);
            within[knot + 1] += place - knot as f64;
        }
        let visited = within.iter().map(|bins| *bins >= VISITED_BINS * self.drives.len() as f64).collect();
        Some(((low, high), visited))
    }
}

/// Rates of change from bin to bin of a cycle.
fn slope(values: &[f64], bin_s: f64) -> Vec<f64> {
    let n = values.len();
    (0..n).map(|bin| (values[(bin + 1) % n] - values[(bin + n - 1) % n]) / (2.0 * bin_s)).collect()
}

/// A curve on its way: the plant beside it, what it shows, and how both respond.
struct Curve<A> {
    law: &'static LearnedLaw,
    ends: (f64, f64),
    visited: Vec<bool>,
    /// Size of the curve's units.
    unit: f64,
    /// The machine with the curve, its plant's parameters free.
    plant: Fit<A>,
    /// The curve's values in their units.
    at: DVector<f64>,
    /// Derivatives of the differences by them.
    response: DMatrix<f64>,
    step: Step,
}

/// Where the present derivatives lead.
struct Step {
    plant: DVector<f64>,
    curve: DVector<f64>,
    /// Precision of the curve's values beforehand.
    prior: DMatrix<f64>,
    /// The same with what the record says of them beside the calibration.
    precision: Option<Cholesky<f64, Dyn>>,
    /// How many parameters the record determines.
    parameters: f64,
}

impl<A: SimulatedAxis> Curve<A> {
    fn new(
        problem: &Problem<'_>,
        base: &Fit<A>,
        law: &&'static LearnedLaw,
        travelled: &Travelled,
    ) -> Option<Self> {
        let (ends, visited) = travelled.span(law.argument, law.knots())?;
        let at = DVector::zeros(law.knots());
        let unit = base.spec.learned_unit(law.site);
        let mut curve = Curve {
            law,
            ends,
            visited,
            unit,
            plant: base.clone(),
            at,
            response: DMatrix::zeros(0, 0),
            step: Step::nowhere(),
        };
        curve.respond(problem);
        Some(curve)
    }

    /// The machine with other values of the curve.
    fn with_values(&self, spec: &A, values: &DVector<f64>) -> A {
        let mut spec = spec.clone();
        let table = spec.effects_mut().entry(self.law.key().into()).or_default();
        let all = [self.ends.0, self.ends.1].into_iter().chain(values.iter().map(|value| value * self.unit));
        for (parameter, value) in self.law.parameters().iter().zip(all) {
            table.insert(parameter.name.into(), value);
        }
        spec
    }

    /// Simulates the derivatives by the curve's values, and solves for the next step.
    fn respond(&mut self, problem: &Problem<'_>) {
        let moved = |knot: usize| {
            let mut values = self.at.clone();
            values[knot] += STEP;
            self.with_values(&self.plant.spec, &values)
        };
        let machines: Vec<A> = (0..self.at.len()).map(moved).collect();
        let columns: Vec<DVector<f64>> = problem
            .residuals(&machines)
            .into_iter()
            .map(|shown| (shown - &self.plant.residual) / STEP)
            .collect();
        self.response = DMatrix::from_columns(&columns);
        self.step = self.likeliest_step();
    }

    /// The step under the roughness that makes the record most likely.
    fn likeliest_step(&self) -> Step {
        let (plant, at) = (&self.plant, &self.at);
        let own = normal_matrix(&plant.free, &plant.jacobian, 1.0);
        let own_gradient = plant.gradient(1.0);
        let Some(own) = own.cholesky() else { return Step::nowhere() };
        let cross = plant.jacobian.tr_mul(&self.response);
        let solved_cross = own.solve(&cross);
        // What the record says of the curve once calibration has taken what it can.
        let information = self.response.tr_mul(&self.response) - cross.tr_mul(&solved_cross);
        let gradient = self.response.tr_mul(&plant.residual) - solved_cross.tr_mul(&own_gradient);
        let tried = ROUGHNESS.iter().filter_map(|roughness| {
            let prior = smoothness(at.len(), *roughness);
            let gradient = &gradient + &prior * at;
            let precision = (&information + &prior).cholesky()?;
            let curve = -precision.solve(&gradient);
            let log_determinant =
                |factor: &Cholesky<f64, Dyn>| factor.l().diagonal().iter().map(|x| x.ln()).sum::<f64>();
            let likelihood = 0.5 * gradient.dot(&-&curve) + log_determinant(&prior.clone().cholesky()?)
                - log_determinant(&precision)
                - 0.5 * at.dot(&(&prior * at));
            Some((likelihood, prior, precision, curve))
        });
        let Some((_, prior, precision, curve)) = tried.max_by(|a, b| a.0.total_cmp(&b.0)) else {
            return Step::nowhere();
        };
        let parameters = precision.solve(&information).trace().max(0.0);
        let plant = -own.solve(&(own_gradient + cross * &curve));
        Step { plant, curve, prior, precision: Some(precision), parameters }
    }

    /// The score that the present derivatives promise.
    fn predicted_score(&self, problem: &Problem<'_>) -> f64 {
        if self.step.precision.is_none() {
            return f64::NEG_INFINITY;
        }
        let residual = &self.plant.residual
            + &self.plant.jacobian * &self.step.plant
            + &self.response * &self.step.curve;
        let prior = prior_cost(&self.plant.free, &(&self.plant.at + &self.step.plant))
            + self.cost_of_curve(&(&self.at + &self.step.curve));
        score(problem, &residual, prior, self.step.parameters)
    }

    fn cost_of_curve(&self, values: &DVector<f64>) -> f64 {
        values.dot(&(&self.step.prior * values))
    }

    /// Goes down the cost in the closed loop.
    fn fitted(mut self, problem: &Problem<'_>) -> Self {
        for _ in 0..ITERATIONS {
            if self.step.precision.is_none() || self.plant.spec.is_spent() {
                break;
            }
            let places: Vec<(DVector<f64>, DVector<f64>)> = SHARES
                .iter()
                .map(|share| {
                    let plant = self.plant.within_bounds(&(&self.plant.at + &self.step.plant * *share));
                    (plant, &self.at + &self.step.curve * *share)
                })
                .collect();
            let machines: Vec<A> = places
                .iter()
                .map(|(plant, curve)| {
                    self.with_values(&placed(&self.plant.spec, &self.plant.free, plant), curve)
                })
                .collect();
            let cost = |residual: &DVector<f64>, plant: &DVector<f64>, curve: &DVector<f64>| {
                residual.norm_squared() + prior_cost(&self.plant.free, plant) + self.cost_of_curve(curve)
            };
            let before = cost(&self.plant.residual, &self.plant.at, &self.at);
            let best = problem
                .residuals(&machines)
                .iter()
                .zip(places)
                .zip(machines)
                .map(|((residual, (plant, curve)), machine)| (cost(residual, &plant, &curve), curve, machine))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((after, curve, machine)) = best.filter(|best| best.0 < before) else { break };
            self.at = curve;
            self.plant = Fit::at(problem, &machine, self.plant.free);
            self.respond(problem);
            if before - after < LEAST_GAIN * before {
                break;
            }
        }
        self
    }

    fn finished(self, problem: &Problem<'_>, left: f64) -> LearnedMachine<A> {
        let prior = prior_cost(&self.plant.free, &self.plant.at) + self.cost_of_curve(&self.at);
        let misfit = problem.misfit(&self.plant.residual).sqrt();
        let covariance = self.step.precision.as_ref().map(Cholesky::inverse);
        let spread = |knot: usize| {
            let variance = covariance.as_ref().map_or(f64::INFINITY, |c| c[(knot, knot)].max(0.0));
            1.96 * misfit * variance.sqrt() * self.unit
        };
        let values: Vec<f64> = self.at.iter().map(|value| value * self.unit).collect();
        let spread: Vec<f64> = (0..values.len()).map(spread).collect();
        LearnedMachine {
            score: score(problem, &self.plant.residual, prior, self.step.parameters),
            resembles: resemblance(self.law, self.ends, &values, &self.visited),
            law: self.law,
            spec: self.plant.spec,
            ends: self.ends,
            values,
            spread,
            visited: self.visited,
            probability: 0.0,
            left,
        }
    }
}

impl Step {
    fn nowhere() -> Self {
        Step {
            plant: DVector::zeros(0),
            curve: DVector::zeros(0),
            prior: DMatrix::zeros(0, 0),
            precision: None,
            parameters: 0.0,
        }
    }
}

/// Precision of a curve's values: second differences of that standard deviation, and a wide one of the values themselves.
fn smoothness(knots: usize, roughness: f64) -> DMatrix<f64> {
    let mut precision = DMatrix::identity(knots, knots) / (LARGEST * LARGEST);
    let weight = (roughness * roughness).recip();
    for knot in 1..knots.saturating_sub(1) {
        let second = [(knot - 1, 1.0), (knot, -2.0), (knot + 1, 1.0)];
        for (row, a) in second {
            for (column, b) in second {
                precision[(row, column)] += weight * a * b;
            }
        }
    }
    precision
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_lines_cost_no_more_than_their_values() {
        let precision = smoothness(13, 0.1);
        let line = DVector::from_fn(13, |knot, _| 2.0 + 0.5 * knot as f64);
        let cost = line.dot(&(&precision * &line));
        assert!((cost - line.norm_squared() / (LARGEST * LARGEST)).abs() < 1e-9);
        let bent = DVector::from_fn(13, |knot, _| if knot == 6 { 1.0 } else { 0.0 });
        assert!(bent.dot(&(&precision * &bent)) > 500.0);
    }
}
