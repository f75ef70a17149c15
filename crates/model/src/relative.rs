//! The leak relative to a healthy machine's own baseline: what valve null, gain, friction and temperature have in common with the
//! baseline cancels; see [`RelativeFile`] for the formulas.

use alloc::format;
use alloc::vec::Vec;

use seepd_features::segment::MAX_PHASES;

use crate::check::{check_length, check_relative};
use crate::ensemble::{Ensemble, Estimate};
use crate::error::ModelError;
use crate::model::agree;
use crate::out_of_distribution::OutOfDistribution;
use crate::schema::{DeadbandFile, KindFile, RelativeFile, RelativeGolden, Transform, ViewFile};

/// Most changes that a leak residual depends on: the phases and the load.
pub const MAX_CHANGES: usize = MAX_PHASES + 1;
/// Most inputs of the trees: baseline and changes by phase, and the leak residual.
const MAX_INPUTS: usize = 2 * MAX_PHASES + 1;
/// What each cycle takes from the sums over cycles, in standard deviations of the leak residual; the stated rate of false alarms
/// depends on it.
pub const DRIFT_ALLOWANCE: f64 = 0.5;
/// A baseline further from training's than this many standard deviations counts as that far: products would run away.
const FARTHEST_BASELINE: f64 = 4.0;
/// A leak residual as negative as this share of the offset counts as that: it has a logarithm.
const LEAST_RESIDUAL: f64 = 0.75;

/// A cycle to be compared with its baseline.
#[derive(Debug, Clone, Copy)]
pub struct Comparison<'a> {
    /// The baseline's mean command by phase.
    pub baseline: &'a [f64],
    /// The cycle's mean command by phase.
    pub present: &'a [f64],
    /// The load over the baseline's, less 1, where it is known.
    pub load_change: Option<f64>,
    /// Standard deviation of the command's noise.
    pub noise: f64,
}

/// What a comparison gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelativeEstimate {
    /// Leak area, m², and its interval.
    pub estimate: Estimate,
    /// Leak residual, m², the change against the baseline as a leak area: around 0 for a healthy machine, and negative as often as not.
    pub leak_residual_m2: f64,
    /// What each change contributes to the leak residual, m²: phases in their order, then the load.
    pub contributions_m2: [f64; MAX_CHANGES],
    /// Distance of the changes, phases in their order and then the load, from what training has seen.
    pub out_of_distribution: OutOfDistribution,
}

/// The relative estimate of a model, checked.
#[derive(Debug, Clone)]
pub struct Relative {
    file: RelativeFile,
    ensemble: Ensemble,
}

impl Relative {
    /// Checks and takes a file.
    ///
    /// # Errors
    /// [`ModelError`] as of a whole model.
    pub fn from_file(file: RelativeFile) -> Result<Self, ModelError> {
        check_relative(&file, file.baseline_mean.len().min(MAX_PHASES))?;
        Self::from_checked(file)
    }

    /// From a file whose structure has been checked.
    pub(crate) fn from_checked(mut file: RelativeFile) -> Result<Self, ModelError> {
        let ensemble = Ensemble::from_checked(&file.trees);
        file.trees = Vec::new();
        let relative = Relative { file, ensemble };
        for (index, golden) in relative.file.golden.iter().enumerate() {
            relative.check_golden(golden, &format!("relative.golden[{index}]"))?;
        }
        Ok(relative)
    }

    fn check_golden(&self, golden: &RelativeGolden, path: &str) -> Result<(), ModelError> {
        for (key, values) in [("baseline", &golden.baseline), ("present", &golden.present)] {
            check_length(&format!("{path}.{key}"), values.len(), self.phases())?;
        }
        let given = self.estimate(&Comparison {
            baseline: &golden.baseline,
            present: &golden.present,
            load_change: golden.load_change,
            noise: golden.noise,
        });
        agree(path, [(golden.estimate, given.estimate.value)])?;
        agree(path, golden.interval.into_iter().zip(given.estimate.interval))?;
        agree(path, [(golden.leak_residual, given.leak_residual_m2)])
    }

    /// The file without its trees.
    pub fn file(&self) -> &RelativeFile {
        &self.file
    }

    /// Phases that are compared.
    pub fn phases(&self) -> usize {
        self.file.baseline_mean.len()
    }

    /// The view of what is known.
    pub fn view(&self, knows_load: bool) -> &ViewFile {
        if knows_load { &self.file.load } else { &self.file.command }
    }

    /// Compares a cycle with its baseline. Missing values count as the mean of training.
    pub fn estimate(&self, comparison: &Comparison<'_>) -> RelativeEstimate {
        let view = self.view(comparison.load_change.is_some());
        let inputs = Inputs::of(&self.file, comparison);
        let mut contributions_m2 = [0.0; MAX_CHANGES];
        let leak_residual_m2 = inputs.leak_residual(&view.leak_residual, &mut contributions_m2);
        let offset = self.file.offset_m2;
        let logarithm = log_leak_residual(leak_residual_m2, offset);
        let (correction, spread) = self.ensemble.vote(&inputs.of_trees(logarithm));
        let estimate = Estimate::around(
            logarithm + correction,
            spread,
            Some(comparison.noise),
            Transform::LnOffset(offset),
            &self.kind(comparison.load_change.is_some(), comparison.baseline).calibration,
        );
        let out_of_distribution = self.out_of_distribution(estimate.transformed, &inputs);
        RelativeEstimate { estimate, leak_residual_m2, contributions_m2, out_of_distribution }
    }

    /// How far the baseline lies from training's, in standard deviations: the farthest phase.
    pub fn baseline_distance(&self, baseline: &[f64]) -> f64 {
        let standardised = standardised(baseline, &self.file.baseline_mean, &self.file.baseline_scale);
        standardised.iter().map(|value| libm::fabs(*value)).fold(0.0, f64::max)
    }

    /// Half width of the valve's dead band beyond the plant file's, share of full command, as the baseline shows it; `None` for one that
    /// shows none. See [`DeadbandFile`].
    pub fn deadband(&self, baseline: &[f64]) -> Option<f64> {
        let file = &self.file.deadband;
        let standardised = standardised(baseline, &self.file.baseline_mean, &self.file.baseline_scale);
        Some(half_width(file, &standardised)).filter(|half_width| *half_width > file.limit)
    }

    /// How far estimates go wrong for a machine with this baseline.
    pub fn kind(&self, knows_load: bool, baseline: &[f64]) -> &KindFile {
        let view = self.view(knows_load);
        if self.deadband(baseline).is_some() { &view.deadband } else { &view.plain }
    }

    fn out_of_distribution(&self, y: f64, inputs: &Inputs) -> OutOfDistribution {
        let OutOfDistribution { score, most_unusual } =
            OutOfDistribution::of(&self.file.training_distributions, y, inputs.phase_changes());
        let load_change =
            inputs.load_change().map_or(0.0, |change| libm::fabs(change) / self.file.largest_load_change);
        if load_change > score {
            OutOfDistribution { score: load_change, most_unusual: inputs.phases }
        } else {
            OutOfDistribution { score, most_unusual }
        }
    }
}

/// A baseline less its mean over the phases: a valve that is off its null shifts all phases alike, and says nothing of how the machine
/// answers to a leak.
pub fn centred(baseline: &[f64]) -> [f64; MAX_PHASES] {
    let mean = baseline.iter().sum::<f64>() / baseline.len().max(1) as f64;
    let mut centred = [0.0; MAX_PHASES];
    for (slot, value) in centred.iter_mut().zip(baseline) {
        *slot = value - mean;
    }
    centred
}

/// A baseline as [`centred`], over mean and standard deviation of training's.
pub fn standardised(baseline: &[f64], mean: &[f64], scale: &[f64]) -> [f64; MAX_PHASES] {
    let mut standardised = centred(baseline);
    for (value, (mean, scale)) in standardised.iter_mut().zip(mean.iter().zip(scale)) {
        *value = (*value - mean) / scale;
    }
    for value in standardised.iter_mut().skip(mean.len()) {
        *value = 0.0;
    }
    standardised
}

/// Half width of the dead band that a standardised baseline shows, whether it exceeds the limit or not.
pub fn half_width(file: &DeadbandFile, standardised: &[f64]) -> f64 {
    file.intercept + file.slopes.iter().zip(standardised).map(|(slope, value)| slope * value).sum::<f64>()
}

/// What leak residual and trees depend on.
#[derive(Debug, Clone, Copy)]
pub struct Inputs {
    /// Phases in their order, then the load where it is known.
    changes: [f64; MAX_CHANGES],
    count: usize,
    baseline: [f64; MAX_PHASES],
    phases: usize,
}

impl Inputs {
    /// Changes and standardised baseline of a comparison.
    pub fn of(file: &RelativeFile, comparison: &Comparison<'_>) -> Self {
        Self::standardised(&file.baseline_mean, &file.baseline_scale, comparison)
    }

    /// The same, where mean and standard deviation of baselines are not in a file yet.
    pub fn standardised(mean: &[f64], scale: &[f64], comparison: &Comparison<'_>) -> Self {
        let phases = mean.len().min(MAX_PHASES);
        let mut inputs =
            Inputs { changes: [0.0; MAX_CHANGES], count: phases, baseline: [0.0; MAX_PHASES], phases };
        let standardised = standardised(comparison.baseline, mean, scale);
        for (index, standardised) in standardised.iter().enumerate().take(phases) {
            let (Some(before), Some(now)) = (comparison.baseline.get(index), comparison.present.get(index))
            else {
                continue;
            };
            inputs.changes[index] = now - before;
            inputs.baseline[index] = standardised.clamp(-FARTHEST_BASELINE, FARTHEST_BASELINE);
        }
        if let Some(change) = comparison.load_change {
            inputs.changes[phases] = change;
            inputs.count = phases + 1;
        }
        inputs
    }

    /// Changes by phase.
    pub fn phase_changes(&self) -> &[f64] {
        self.changes.get(..self.phases).unwrap_or_default()
    }

    /// The load's relative change, where it is known.
    fn load_change(&self) -> Option<f64> {
        self.changes.get(self.phases..self.count).and_then(|load| load.first()).copied()
    }

    /// Calls `take` with each term of the leak residual, in the order of its coefficients, and the changes that it is a product of.
    #[inline]
    pub fn each_term(&self, mut take: impl FnMut(f64, [usize; 2])) {
        let changes = self.changes.get(..self.count).unwrap_or_default();
        for (i, change) in changes.iter().enumerate() {
            take(*change, [i, i]);
        }
        for (i, a) in changes.iter().enumerate() {
            for (j, b) in changes.iter().enumerate().skip(i) {
                take(a * b, [i, j]);
            }
        }
        for (i, change) in changes.iter().enumerate() {
            for base in self.baseline.iter().take(self.phases) {
                take(change * base, [i, i]);
                take(change * change * base, [i, i]);
                take(change * base * base, [i, i]);
            }
        }
    }

    /// Terms of a leak residual over so many phases, with the load or without.
    pub fn terms(phases: usize, knows_load: bool) -> usize {
        let n = phases + usize::from(knows_load);
        n + n * (n + 1) / 2 + 3 * n * phases
    }

    /// The leak residual, m², and each change's share of it: of a product of two, half each.
    pub fn leak_residual(&self, coefficients: &[f64], contributions: &mut [f64; MAX_CHANGES]) -> f64 {
        let mut coefficients = coefficients.iter();
        let mut sum = 0.0;
        self.each_term(|term, [i, j]| {
            let part = coefficients.next().copied().unwrap_or(0.0) * term;
            contributions[i] += 0.5 * part;
            contributions[j] += 0.5 * part;
            sum += part;
        });
        sum
    }

    /// Inputs of the trees: baseline and changes by phase, logarithm of the leak residual.
    pub fn of_trees(&self, logarithm: f64) -> [f64; MAX_INPUTS] {
        let mut inputs = [0.0; MAX_INPUTS];
        let n = self.phases;
        let values = self.baseline.iter().take(n).chain(self.phase_changes()).chain([&logarithm]);
        for (slot, value) in inputs.iter_mut().zip(values) {
            *slot = *value;
        }
        inputs
    }

    /// How many inputs the trees have.
    pub fn tree_inputs(phases: usize) -> usize {
        2 * phases + 1
    }
}

/// The logarithm that the trees correct.
pub fn log_leak_residual(leak_residual_m2: f64, offset_m2: f64) -> f64 {
    libm::log(leak_residual_m2.max(-LEAST_RESIDUAL * offset_m2) + offset_m2)
}
