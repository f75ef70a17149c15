//! What to try next: the short test, or the further sensor, that tells the remaining explanations apart best.
//!
//! Each explanation is a fitted machine. Its answer to a test is simulated, with all of its parameters free as far as the log has left them
//! open, so that a difference that another calibration could make does not count. What a test is worth is the information that its answer
//! is expected to give about which explanation is right, by the pairwise bound of Kolchinsky and Tracey (Entropy 19 (2017), α = 1/2). Tests
//! stay within the places and speeds that the log shows, under the load with which its cycle begins.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use seepd_signals::Signal;
use seepd_sim::DutyCycle;
use seepd_sim::cycle::{DriveSample, LoadCorner, Move};
use serde::Serialize;

use crate::fit::{Fit, INDEPENDENT, MODEL_ERROR, normal_matrix};
use crate::rank::TEMPER;
use crate::record::{BINS, Record};
use crate::simulate::{BinnedSignals, Drive, binned_signals};
use crate::simulated_axis::SimulatedAxis;

/// Probability from which an explanation is worth telling from the others, and most of them.
const WORTH_TELLING: f64 = 0.03;
const MOST_CANDIDATES: usize = 6;
/// Expected probability of the right explanation after a test, below which no test is said to tell.
const TELLS: f64 = 0.75;
/// Noise of a sensor that the log does not have, share of its range.
const NEW_SENSOR: f64 = 0.005;
/// Longest test, s.
const LONGEST_S: f64 = 60.0;

/// The next test: what is to be told apart, and what would do so.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NextTest {
    /// Explanations, the most likely first, with their probabilities.
    pub explanations: Vec<(String, f64)>,
    /// Tests and sensors, the most informative first.
    pub proposals: Vec<Proposal>,
    /// Whether the first of them is expected to tell.
    pub tells: bool,
}

/// A test, or a sensor to add.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Proposal {
    /// What to do, in words.
    pub what: String,
    /// The signal to record beside the others, of a proposal that is a sensor.
    pub sensor: Option<&'static str>,
    /// Length of a repetition, s.
    pub seconds: f64,
    /// Information that is expected of it about which explanation is right, bit.
    pub information_bit: f64,
    /// Probability that the right one is expected to have afterwards.
    pub expected_probability: f64,
    /// What each explanation would show.
    pub outcomes: Vec<Outcome>,
    /// The test's demand, as a duty cycle; of a sensor the log's own.
    pub cycle: DutyCycle,
}

/// Where an explanation differs most from its most likely rival.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outcome {
    /// The explanation.
    pub explanation: String,
    /// The rival.
    pub instead_of: String,
    /// Signal that shows it most.
    pub signal: &'static str,
    /// When in the test, s.
    pub at_s: f64,
    /// By how much it differs there from what the rival can show, SI.
    pub difference: f64,
    /// The same in expected errors.
    pub in_errors: f64,
}

/// An explanation that may be right.
pub(crate) struct Candidate<'a, A> {
    pub(crate) name: String,
    pub(crate) probability: f64,
    pub(crate) spec: &'a A,
    /// The fit whose parameters are open: its own, or the calibration that it stands beside.
    pub(crate) fit: &'a Fit<A>,
}

/// Finds what would tell the candidates apart; `None` where there is nothing to tell.
pub(crate) fn next_test<A: SimulatedAxis>(
    record: &Record,
    spec: &A,
    mut candidates: Vec<Candidate<'_, A>>,
) -> Option<NextTest> {
    candidates.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    candidates.retain(|candidate| candidate.probability >= WORTH_TELLING);
    candidates.truncate(MOST_CANDIDATES);
    if candidates.len() < 2 {
        return None;
    }
    let sum: f64 = candidates.iter().map(|candidate| candidate.probability).sum();
    candidates.iter_mut().for_each(|candidate| candidate.probability /= sum);
    let mut proposals: Vec<Proposal> = moves(record, spec)
        .into_iter()
        .map(|(what, cycle)| {
            let drive = Drive::from(drive_of(&cycle, spec.tick_s()));
            Tried { signals: record.signals.clone(), drive, what, sensor: None, cycle }
        })
        .chain(sensors(record, spec))
        .filter_map(|tried| tried.judged(record, spec.tick_s(), &candidates))
        .collect();
    proposals.sort_by(|a, b| b.information_bit.total_cmp(&a.information_bit));
    let tells = proposals.first().is_some_and(|best| best.expected_probability >= TELLS);
    let explanations = candidates.iter().map(|one| (one.name.clone(), one.probability)).collect();
    Some(NextTest { explanations, proposals, tells })
}

/// A test on its way to a proposal.
struct Tried {
    what: String,
    sensor: Option<Signal>,
    signals: Vec<Signal>,
    drive: Drive,
    cycle: DutyCycle,
}

/// What a candidate shows in a test, in expected errors, and how that moves with its open parameters.
struct Answer {
    shown: DVector<f64>,
    response: DMatrix<f64>,
    /// What the log has left open of them, and the test says of them: factored once, as each pair of answers asks for it.
    precision: Option<Cholesky<f64, Dyn>>,
}

impl Tried {
    fn judged<A: SimulatedAxis>(
        self,
        record: &Record,
        tick_s: f64,
        candidates: &[Candidate<'_, A>],
    ) -> Option<Proposal> {
        let machines: Vec<A> = candidates.iter().map(|candidate| candidate.spec.clone()).collect();
        let views = binned_signals(&machines, &self.drive, &self.signals);
        let finite = |view: &BinnedSignals| view.iter().flatten().all(|value| value.is_finite());
        if !views.iter().all(finite) {
            return None;
        }
        let errors = self.expected_errors(record, &views);
        let answers: Vec<Answer> = candidates
            .iter()
            .zip(&views)
            .map(|(candidate, view)| self.answer(candidate, view, &errors))
            .collect();
        let apart =
            |i: usize, j: usize| answers[i].distance(&answers[j]).min(answers[j].distance(&answers[i]));
        let overlap = |i: usize| -> f64 {
            (0..candidates.len())
                .map(|j| {
                    let square = if i == j { 0.0 } else { TEMPER * apart(i, j) };
                    candidates[j].probability * (-square / 8.0).exp()
                })
                .sum()
        };
        let overlaps: Vec<f64> = (0..candidates.len()).map(overlap).collect();
        let each = || candidates.iter().map(|candidate| candidate.probability).zip(&overlaps);
        let information: f64 = each().map(|(p, overlap)| -p * overlap.ln()).sum();
        let expected: f64 = each().map(|(p, overlap)| p * p / overlap).sum();
        let seconds = self.drive.len() as f64 * tick_s;
        Some(Proposal {
            outcomes: self.outcomes(candidates, &answers, &errors, seconds),
            what: self.what,
            sensor: self.sensor.map(Signal::name),
            seconds,
            information_bit: information / std::f64::consts::LN_2,
            expected_probability: expected,
            cycle: self.cycle,
        })
    }

    /// Expected error of each signal: its noise, as the log has it, and what any model is off by.
    fn expected_errors(&self, record: &Record, views: &[BinnedSignals]) -> Vec<f64> {
        self.signals
            .iter()
            .enumerate()
            .map(|(place, signal)| {
                let all = || views.iter().flat_map(|view| view[place].iter().copied());
                let range = all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min);
                let recorded = record.signals.iter().position(|other| other == signal);
                let noise = recorded.map_or(NEW_SENSOR * range, |at| record.floor[at] * record.range[at]);
                noise.hypot(MODEL_ERROR * range).max(f64::MIN_POSITIVE)
            })
            .collect()
    }

    fn weighted(view: &BinnedSignals, errors: &[f64]) -> DVector<f64> {
        let share = (INDEPENDENT / BINS as f64).sqrt();
        let values =
            view.iter().zip(errors).flat_map(|(bins, error)| bins.iter().map(move |v| v * share / error));
        DVector::from_iterator(view.len() * BINS, values)
    }

    fn answer<A: SimulatedAxis>(
        &self,
        candidate: &Candidate<'_, A>,
        view: &BinnedSignals,
        errors: &[f64],
    ) -> Answer {
        let shown = Self::weighted(view, errors);
        let (free, at) = (&candidate.fit.free, &candidate.fit.at);
        let step = |index: usize| free[index].step(at[index], 1.0);
        let moved = |index: usize| {
            let mut machine = candidate.spec.clone();
            free[index].write(at[index] + step(index), &mut machine);
            machine
        };
        let machines: Vec<A> = (0..free.len()).map(moved).collect();
        let columns: Vec<DVector<f64>> = binned_signals(&machines, &self.drive, &self.signals)
            .iter()
            .enumerate()
            .map(|(index, view)| {
                let mut column = (Self::weighted(view, errors) - &shown) / step(index);
                if !column.iter().all(|value| value.is_finite()) {
                    column.fill(0.0);
                }
                column
            })
            .collect();
        let response =
            if columns.is_empty() { DMatrix::zeros(shown.len(), 0) } else { DMatrix::from_columns(&columns) };
        let precision = response.tr_mul(&response) + normal_matrix(free, &candidate.fit.jacobian, 1.0);
        Answer { shown, response, precision: precision.cholesky() }
    }

    /// Where each candidate differs most from the most likely of the others, beyond what that one could show with its open parameters.
    fn outcomes<A>(
        &self,
        candidates: &[Candidate<'_, A>],
        answers: &[Answer],
        errors: &[f64],
        seconds: f64,
    ) -> Vec<Outcome> {
        let of = |own: usize| {
            let rival = usize::from(own == 0);
            let rest = answers[rival].beyond(&answers[own]);
            let (most, value) = rest.iter().enumerate().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
            let (place, bin) = (most / BINS, most % BINS);
            let in_errors = value / (INDEPENDENT / BINS as f64).sqrt();
            Some(Outcome {
                explanation: candidates[own].name.clone(),
                instead_of: candidates[rival].name.clone(),
                signal: self.signals[place].name(),
                at_s: (bin as f64 + 0.5) * seconds / BINS as f64,
                difference: in_errors * errors[place],
                in_errors: in_errors.abs(),
            })
        };
        (0..candidates.len()).filter_map(of).collect()
    }
}

impl Answer {
    /// What another answer has beyond what this explanation can show with its open parameters, in expected errors.
    fn beyond(&self, other: &Answer) -> DVector<f64> {
        let difference = &other.shown - &self.shown;
        match &self.precision {
            Some(factor) => {
                let moved = factor.solve(&self.response.tr_mul(&difference));
                difference - &self.response * moved
            }
            None => difference,
        }
    }

    /// Squared distance of another answer from what this explanation can show, what it takes to move the parameters included.
    fn distance(&self, other: &Answer) -> f64 {
        let difference = &other.shown - &self.shown;
        difference.dot(&self.beyond(other)).max(0.0)
    }
}

/// The log's own cycle with a signal that the log does not have.
fn sensors<A: SimulatedAxis>(record: &Record, spec: &A) -> Vec<Tried> {
    let missing = spec.signals().into_iter().filter(|signal| !record.signals.contains(signal));
    missing
        .map(|signal| Tried {
            what: format!("record {} in the usual duty cycle", signal.name()),
            sensor: Some(signal),
            signals: record.signals.iter().copied().chain([signal]).collect(),
            drive: record.cycles[0].drive.clone(),
            cycle: spec.duty_cycle().clone(),
        })
        .collect()
}

/// A demand in the making.
struct Plan {
    at_s: f64,
    at_m: f64,
    start_m: f64,
    moves: Vec<Move>,
}

impl Plan {
    fn from(start_m: f64) -> Self {
        Plan { at_s: 0.5, at_m: start_m, start_m, moves: Vec::new() }
    }

    fn stand(mut self, seconds: f64) -> Self {
        self.at_s += seconds;
        self
    }

    /// A stroke that reaches that speed: smooth, or at that speed all the way.
    fn stroke(mut self, to_m: f64, speed_m_per_s: f64, smooth: bool) -> Self {
        let way = (to_m - self.at_m).abs();
        let seconds = (way / speed_m_per_s * if smooth { SMOOTH_PEAK } else { 1.0 }).max(0.02);
        let course = if smooth { Vec::new() } else { vec![0.0, 1.0] };
        let name = format!("move {}", self.moves.len() + 1);
        self.moves.push(Move {
            name,
            from_s: self.at_s,
            to_s: self.at_s + seconds,
            to_m,
            course,
            wait_s: 0.0,
            open_loop: None,
        });
        self.at_s += seconds;
        self.at_m = to_m;
        self
    }

    /// The duty cycle, back at its start.
    fn back(self, speed_m_per_s: f64, load_n: f64, tick_s: f64) -> DutyCycle {
        let start_m = self.start_m;
        let home = if (self.at_m - start_m).abs() > 1e-9 {
            self.stroke(start_m, 0.5 * speed_m_per_s, true)
        } else {
            self
        };
        let period_s = ((home.at_s + 0.5) / tick_s).ceil() * tick_s;
        DutyCycle { period_s, moves: home.moves, load: vec![LoadCorner { at_s: 0.0, force_n: load_n }] }
    }
}

/// Peak speed of a quintic move over its mean.
const SMOOTH_PEAK: f64 = 1.875;

/// Tests by moves within what the log shows.
fn moves<A: SimulatedAxis>(record: &Record, spec: &A) -> Vec<(String, DutyCycle)> {
    let demands = || record.cycles.iter().flat_map(|cycle| cycle.drive.iter().map(|sample| sample.demand_m));
    let (low, high) = demands().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
    let tick_s = spec.tick_s();
    let fastest = record.cycles[0]
        .drive
        .windows(11)
        .map(|window| (window[10].demand_m - window[0].demand_m).abs() / (10.0 * tick_s))
        .fold(0.0, f64::max);
    let width = high - low;
    if !(width > 0.0 && fastest > 0.0 && fastest.is_finite()) {
        return Vec::new();
    }
    let load_n = record.cycles[0].drive.first().map_or(0.0, |sample| sample.load_n);
    let end = |plan: Plan| plan.back(fastest, load_n, tick_s);
    let at = |share: f64| low + share * width;
    let slow = [0.3, 0.12, 0.05].map(|share| {
        let plan = Plan::from(at(0.0)).stroke(at(0.6), share * fastest, false).stand(1.5);
        end(plan.stroke(at(0.0), share * fastest, false).stand(1.0))
    });
    let speeds = [1.0, 0.5, 0.25, 0.12].iter().fold(Plan::from(at(0.1)), |plan, share| {
        let plan = plan.stroke(at(0.5), share * fastest, true).stand(0.5);
        plan.stroke(at(0.1), share * fastest, true).stand(0.5)
    });
    let reversals = [0.02, 0.05].map(|share| {
        let (a, b) = (at(0.5 - share), at(0.5 + share));
        end((0..4).fold(Plan::from(a), |plan, _| {
            plan.stroke(b, 0.04 * fastest, false).stand(0.6).stroke(a, 0.04 * fastest, false).stand(0.6)
        }))
    });
    let stairs = [0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0]
        .iter()
        .fold(Plan::from(at(0.0)), |plan, share| plan.stroke(at(*share), 0.6 * fastest, true).stand(1.5));
    let quick = (0..12).fold(Plan::from(at(0.5)), |plan, index| {
        let seconds = 0.8 * 0.8_f64.powi(index);
        let way = (0.02 * width).min(0.8 * fastest * seconds / SMOOTH_PEAK);
        let to = if index % 2 == 0 { at(0.5) + way } else { at(0.5) };
        let speed = SMOOTH_PEAK * (to - plan.at_m).abs().max(1e-6) / seconds;
        plan.stroke(to, speed, true)
    });
    let holds = Plan::from(at(0.05)).stand(6.0).stroke(at(0.95), fastest, true).stand(8.0);
    let mixed = Plan::from(at(0.1))
        .stroke(at(0.4), 0.12 * fastest, false)
        .stand(1.0)
        .stroke(at(0.37), 0.04 * fastest, false)
        .stroke(at(0.4), 0.04 * fastest, false)
        .stand(0.5)
        .stroke(at(0.9), fastest, true)
        .stand(3.0)
        .stroke(at(0.1), fastest, true);
    let [slow, slower, slowest] = slow;
    let [small, less_small] = reversals;
    let all = vec![
        ("move out and back at three tenths of the usual speed".to_owned(), slow),
        ("move out and back at an eighth of the usual speed".to_owned(), slower),
        ("creep out and back at a twentieth of the usual speed".to_owned(), slowest),
        ("strokes at four speeds, from the usual one to an eighth of it".to_owned(), end(speeds)),
        ("creep to and fro over a twenty-fifth of the stroke".to_owned(), small),
        ("creep to and fro over a tenth of the stroke".to_owned(), less_small),
        ("climb and descend in stairs of a quarter of the stroke".to_owned(), end(stairs)),
        ("small strokes to and fro, ever quicker".to_owned(), end(quick)),
        ("long holds near both ends of the stroke".to_owned(), end(holds)),
        ("a slow stroke, a slow reversal, and a fast stroke with a hold".to_owned(), end(mixed)),
    ];
    all.into_iter().filter(|(_, cycle)| cycle.period_s <= LONGEST_S).collect()
}

/// Demand and load of a duty cycle, tick by tick.
fn drive_of(cycle: &DutyCycle, tick_s: f64) -> Vec<DriveSample> {
    let ticks = (cycle.period_s / tick_s).round() as usize;
    (0..ticks)
        .map(|tick| {
            let at_s = tick as f64 * tick_s;
            DriveSample {
                load_end_n: cycle.load_n(at_s + tick_s),
                open_loop: cycle.open_loop_at(at_s),
                ..DriveSample::new(at_s, cycle.demand_m(at_s), cycle.load_n(at_s))
            }
        })
        .collect()
}
