//! Which effects are worth a fit: what each explains of the gap beyond what calibration explains.

use nalgebra::{DMatrix, DVector};
use seepd_sim::effects::{EffectInfo, Parameter};

use crate::fit::{Fit, Problem, normal_matrix};
use crate::proposals::{events, pitches};
use crate::simulated_axis::SimulatedAxis;

/// An effect at the strength at which it explains most.
#[derive(Clone)]
pub(crate) struct Candidate {
    /// The effect.
    pub(crate) effect: &'static EffectInfo,
    /// Its values.
    pub(crate) values: Vec<f64>,
    /// How much of the calibrated cost it takes away, to first order.
    pub(crate) gain: f64,
    /// Norm of its signature beyond calibration, in expected errors: how much it would show at all.
    pub(crate) visible: f64,
}

/// Levels of a parameter that are tried, shares of its range: for one with its neutral value at the low end, and for one with it inside.
const ONE_SIDED: [f64; 3] = [0.06, 0.25, 0.7];
const TWO_SIDED: [f64; 4] = [0.12, 0.38, 0.62, 0.88];
/// Levels of a parameter whose range spans decades, shares of its logarithm: it acts most, and perhaps only, near the low end.
const DECADES: [f64; 5] = [0.02, 0.05, 0.1, 0.3, 0.7];
/// Levels of a parameter beside the first.
const BESIDE: [f64; 2] = [0.15, 0.6];
/// Levels of a size beside places, times or waves, which are tried at many: how much of it follows from the projection.
const ONE_SIZE: [f64; 1] = [0.2];
/// How many starts beside those that the differences propose, and how long an event is there.
const STARTS: usize = 12;
const USUAL_DURATION: f64 = 0.09;

/// Screens the catalogue, but for some effects, on the calibrated machine; the most promising first.
pub(crate) fn screen<A: SimulatedAxis>(
    problem: &Problem<'_>,
    calibrated: &Fit<A>,
    without: &[String],
) -> Vec<Candidate> {
    let mut tried: Vec<(&'static EffectInfo, Vec<f64>)> = Vec::new();
    for effect in calibrated.spec.catalogue() {
        // What the plant file has already is part of the plant.
        if !calibrated.spec.effects().contains_key(effect.key) && !without.iter().any(|key| key == effect.key)
        {
            let levels = levels(effect, problem, calibrated);
            tried.extend(levels.into_iter().map(|values| (effect, values)));
        }
    }
    let machines: Vec<A> =
        tried.iter().map(|(effect, values)| with(&calibrated.spec, effect, values)).collect();
    let projector = CalibrationProjector::new(calibrated);
    let base = projector.project(&calibrated.residual);
    let mut best: Vec<Candidate> = Vec::new();
    for ((effect, values), residual) in tried.into_iter().zip(problem.residuals(&machines)) {
        let signature = projector.project(&(residual - &calibrated.residual));
        let square = signature.norm_squared().max(1e-12);
        // How much of it, within what is still somewhat linear.
        let amount = (-signature.dot(&base) / square).clamp(0.2, 2.5);
        let gain = base.norm_squared() - (&base + &signature * amount).norm_squared();
        let candidate = Candidate { effect, values, gain, visible: square.sqrt() };
        match best.iter_mut().find(|other| other.effect.key == effect.key) {
            Some(other) if candidate.gain > other.gain => *other = candidate,
            Some(_) => {}
            None => best.push(candidate),
        }
    }
    best.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    best
}

/// The machine with an effect at these values.
pub(crate) fn with<A: SimulatedAxis>(spec: &A, effect: &EffectInfo, values: &[f64]) -> A {
    let mut spec = spec.clone();
    let table = spec.effects_mut().entry(effect.key.into()).or_default();
    for (parameter, value) in effect.parameters.iter().zip(values) {
        table.insert(parameter.name.into(), *value);
    }
    spec
}

/// Combinations of the parameters' levels; those of pitches and of events' times are what the differences propose.
fn levels<A: SimulatedAxis>(
    effect: &EffectInfo,
    problem: &Problem<'_>,
    calibrated: &Fit<A>,
) -> Vec<Vec<f64>> {
    let spec = calibrated.as_described();
    let is_event = (0..effect.parameters.len()).any(|index| effect.is_time(index));
    let is_wave = effect.parameters.iter().any(|parameter| parameter.name == "pitch_m");
    let mut combinations: Vec<Vec<f64>> = vec![Vec::new()];
    for (index, parameter) in effect.parameters.iter().enumerate() {
        let (low, high) = spec.range(effect, parameter);
        let inside = low < parameter.neutral && parameter.neutral < high;
        let of_share = |share: &f64| low + share * (high - low);
        let values: Vec<f64> = match parameter.name {
            // Put in below, where they go together.
            "start_s" | "duration_s" => vec![parameter.neutral],
            "pitch_m" => pitches(problem, calibrated, (low, high)),
            "step_m" if problem.record.position_step_m.is_some() => {
                problem.record.position_step_m.into_iter().collect()
            }
            _ if is_event || is_wave => ONE_SIZE.iter().map(of_share).collect(),
            _ if spans_decades(low, high) => {
                DECADES.iter().map(|share| low * (high / low).powf(*share)).collect()
            }
            _ if inside => TWO_SIDED.iter().map(of_share).collect(),
            _ if index == 0 => ONE_SIDED.iter().map(of_share).collect(),
            _ => BESIDE.iter().map(of_share).collect(),
        };
        let extended = |before: &Vec<f64>| {
            let with = |value: &f64| before.iter().copied().chain([*value]).collect::<Vec<f64>>();
            values.iter().map(with).collect::<Vec<_>>()
        };
        combinations = combinations.iter().flat_map(extended).collect();
    }
    if is_event { at_times(effect, &combinations, problem, calibrated) } else { combinations }
}

/// The combinations at every time that an event is tried at.
fn at_times<A: SimulatedAxis>(
    effect: &EffectInfo,
    combinations: &[Vec<f64>],
    problem: &Problem<'_>,
    calibrated: &Fit<A>,
) -> Vec<Vec<f64>> {
    let period_s = calibrated.spec.duty_cycle().period_s;
    let usual = (0..STARTS).map(|start| ((start as f64 + 0.3) / STARTS as f64, USUAL_DURATION));
    let times: Vec<(f64, f64)> = events(problem, calibrated).into_iter().chain(usual).collect();
    let at = |values: &Vec<f64>| {
        let put = |(start, duration): &(f64, f64)| {
            let of = |(parameter, value): (&Parameter, &f64)| match parameter.name {
                "start_s" => start * period_s,
                "duration_s" => duration * period_s,
                _ => *value,
            };
            effect.parameters.iter().zip(values).map(of).collect::<Vec<f64>>()
        };
        times.iter().map(put).collect::<Vec<_>>()
    };
    combinations.iter().flat_map(at).collect()
}

/// Whether a range is one of orders of magnitude.
pub(crate) fn spans_decades(low: f64, high: f64) -> bool {
    low > 0.0 && high >= 100.0 * low
}

/// What is left of a difference once calibration has taken its part.
pub(crate) struct CalibrationProjector {
    jacobian: DMatrix<f64>,
    inverse: DMatrix<f64>,
}

impl CalibrationProjector {
    pub(crate) fn new<A>(fit: &Fit<A>) -> Self {
        let matrix = normal_matrix(&fit.free, &fit.jacobian, 1.0);
        let size = matrix.nrows();
        let inverse = matrix.try_inverse().unwrap_or_else(|| DMatrix::zeros(size, size));
        CalibrationProjector { jacobian: fit.jacobian.clone(), inverse }
    }

    pub(crate) fn project(&self, difference: &DVector<f64>) -> DVector<f64> {
        difference - &self.jacobian * (&self.inverse * self.jacobian.tr_mul(difference))
    }
}
