//! What a trained model is worth on machines that it has not seen.

use rayon::prelude::*;
use seepd_features::Kalman;
use seepd_features::statistics::CycleStatistics;
use seepd_model::Model;
use seepd_model::accuracy::{Decade, Judged, coverage, decades, mean_absolute_error, r_squared};
use seepd_model::schema::Transform;
use serde::Serialize;

use crate::absolute::{Features, grow_like};
use crate::cases::{ARTICLE_NOISE, Case, noise_of};
use crate::dataset::{self, Observation, Reading};
use crate::forest::{Forest, ForestParams, predict};
use crate::leak_range::LeakRange;
use crate::portions::{Portions, Row};
use crate::train::{TrainError, TrainingSettings};

/// Standard deviations of the command's noise in the article's figures 8 and 9.
pub const NOISE_LEVELS: [f64; 5] = [0.001, 0.003, 0.005, 0.007, 0.01];

/// Accuracy at one noise level.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Accuracy {
    /// Standard deviation of the command's noise.
    pub noise: f64,
    /// Machines measured, with a leak or without.
    pub machines: usize,
    /// Coefficient of determination on the area, over the main range.
    pub r2_area: f64,
    /// Coefficient of determination on ln(area + offset), over the main range.
    pub r2_transformed: f64,
    /// Mean absolute error, m², over the main range.
    pub mean_absolute_error_m2: f64,
    /// Median relative error by range of area.
    pub decades: Vec<Decade>,
    /// Largest estimate of a machine without a leak, m².
    pub largest_healthy_m2: f64,
    /// Share of machines in the main range whose truth lies within the 90 % interval.
    pub coverage: f64,
    /// Share of all machines whose out-of-distribution score exceeds 1.
    #[serde(rename = "novel")]
    pub out_of_distribution: f64,
}

/// The noise table's line: learned at the article's noise, tested at another.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NoiseLine {
    /// Standard deviation of the command's noise in the test.
    pub noise: f64,
    /// Mean absolute error, m², with the filter and without.
    pub mean_absolute_error_m2: [f64; 2],
    /// Largest RMS change of a feature against the article's noise, over its range over leaks; with the filter
    /// and without.
    pub largest_feature_change: [f64; 2],
    /// The feature of that change.
    pub feature: [String; 2],
}

/// Everything that was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// The model at the article's noise.
    pub accuracy: Accuracy,
    /// The model at every noise level.
    pub by_noise: Vec<Accuracy>,
    /// The article's experiment: learned at 0.001, tested at each level, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_table: Option<Vec<NoiseLine>>,
}

/// What is measured, and on what.
pub(crate) struct Subject<'a> {
    pub(crate) model: &'a Model,
    pub(crate) features: &'a Features<'a>,
    pub(crate) reading: &'a Reading<'a>,
    pub(crate) observations: &'a [Observation],
    pub(crate) learned: &'a [Case],
    pub(crate) leaks: LeakRange,
    pub(crate) params: ForestParams,
    pub(crate) settings: &'a TrainingSettings,
}

/// A machine's cycle as the model reads it: features, and mean commands by phase.
pub(crate) type Read = (Vec<f64>, Vec<f64>);

/// A cycle at each of the [`NOISE_LEVELS`]; `None` where it was not found.
pub(crate) type AtEachNoise<T> = [Option<T>; NOISE_LEVELS.len()];

/// A machine at each noise level, with the filter and, for the noise table only, without.
type Readings<T> = [AtEachNoise<T>; 2];

/// What `of` makes of each machine's cycle.
pub(crate) fn read<R>(
    observations: &[Observation],
    settings: &TrainingSettings,
    reading: &Reading<'_>,
    portions: &mut Portions,
    of: impl Fn(&CycleStatistics) -> R,
) -> Result<Vec<Readings<R>>, TrainError> {
    let statistics = |observation: &Observation, commands: &[f64]| -> Readings<Row> {
        let read = |filter| read_at_each_noise(reading, settings, (observation, commands), filter);
        [read(settings.filter), if settings.noise_table { read(None) } else { Default::default() }]
    };
    let mut all = Vec::with_capacity(observations.len());
    dataset::in_portions(("held out", portions), observations, statistics, |read| {
        all.push(read.map(|filtered| {
            filtered.map(|level| level.as_ref().and_then(Row::statistics).as_ref().map(&of))
        }));
    })?;
    Ok(all)
}

/// # Errors
/// [`TrainError`] for a portion that is damaged.
pub(crate) fn measure(subject: &Subject<'_>, portions: &mut Portions) -> Result<Report, TrainError> {
    let Subject { reading, features, settings, observations, .. } = subject;
    let readings = read(observations, settings, reading, portions, |statistics| features.read(statistics))?;
    let by_noise: Vec<Accuracy> =
        (0..NOISE_LEVELS.len()).map(|level| accuracy(subject, &readings, level)).collect();
    let noise_table = subject.settings.noise_table.then(|| noise_table(subject, &readings));
    Ok(Report { accuracy: by_noise[0].clone(), by_noise, noise_table })
}

/// A machine's cycle at each noise level; `None` where it was not found.
pub(crate) fn read_at_each_noise(
    reading: &Reading<'_>,
    settings: &TrainingSettings,
    (observation, commands): (&Observation, &[f64]),
    filter: Option<Kalman>,
) -> AtEachNoise<Row> {
    let unit = dataset::unit_noise(&mut noise_of(observation, settings), commands.len());
    NOISE_LEVELS.map(|sigma| reading.read(commands, filter, sigma, &unit).map(Row::from))
}

fn accuracy(subject: &Subject<'_>, readings: &[Readings<Read>], level: usize) -> Accuracy {
    let (cases, scores): (Vec<Judged>, Vec<f64>) = subject
        .observations
        .iter()
        .zip(readings)
        .filter_map(|(observation, reading)| {
            let (features, phase_means) = reading[0][level].as_ref()?;
            let estimate = subject.model.estimate_at(features, NOISE_LEVELS[level]);
            let score = subject.model.out_of_distribution(&estimate, phase_means).score;
            Some((Judged::new(observation.leak_area_m2, &estimate), score))
        })
        .unzip();
    let main: Vec<Judged> =
        cases.iter().filter(|case| subject.leaks.is_main(case.truth_m2)).copied().collect();
    let transform = subject.model.file().transform;
    let pairs = |map: &dyn Fn(f64) -> f64| -> Vec<(f64, f64)> {
        main.iter().map(|case| (map(case.truth_m2), map(case.estimate_m2))).collect()
    };
    let decades = decades(&main);
    Accuracy {
        noise: NOISE_LEVELS[level],
        machines: cases.len(),
        r2_area: r_squared(&pairs(&|area| area)),
        r2_transformed: r_squared(&pairs(&|area| transform.forward(area))),
        mean_absolute_error_m2: mean_absolute_error(&pairs(&|area| area)),
        decades,
        largest_healthy_m2: cases
            .iter()
            .filter(|case| case.truth_m2 == 0.0)
            .map(|case| case.estimate_m2)
            .fold(0.0, f64::max),
        coverage: coverage(main.iter()),
        out_of_distribution: scores.iter().filter(|score| **score > 1.0).count() as f64
            / scores.len().max(1) as f64,
    }
}

fn noise_table(subject: &Subject<'_>, readings: &[Readings<Read>]) -> Vec<NoiseLine> {
    let forests: Vec<Option<Forest>> = (0..2)
        .map(|which| {
            let transform = subject.model.file().transform;
            grow_like(
                subject.features,
                subject.learned,
                which,
                subject.params,
                transform,
                subject.settings.seed,
            )
        })
        .collect();
    NOISE_LEVELS
        .iter()
        .enumerate()
        .map(|(level, noise)| {
            let mut line = NoiseLine {
                noise: *noise,
                mean_absolute_error_m2: [0.0; 2],
                largest_feature_change: [0.0; 2],
                feature: [String::new(), String::new()],
            };
            for (which, forest) in forests.iter().enumerate() {
                line.mean_absolute_error_m2[which] = forest
                    .as_ref()
                    .map_or(f64::NAN, |forest| forest_error(subject, readings, forest, which, level));
                let (change, feature) = largest_feature_change(subject, readings, which, level);
                line.largest_feature_change[which] = change;
                line.feature[which] = feature;
            }
            line
        })
        .collect()
}

fn forest_error(
    subject: &Subject<'_>,
    readings: &[Readings<Read>],
    forest: &Forest,
    which: usize,
    level: usize,
) -> f64 {
    let transform: Transform = subject.model.file().transform;
    let pairs: Vec<(f64, f64)> = subject
        .observations
        .par_iter()
        .zip(readings)
        .filter(|(observation, _)| subject.leaks.is_main(observation.leak_area_m2))
        .filter_map(|(observation, reading)| {
            let (features, _) = reading[which][level].as_ref()?;
            let sum: f64 = forest.trees.iter().map(|tree| predict(tree, |feature| features[feature])).sum();
            Some((observation.leak_area_m2, transform.back(sum / forest.trees.len() as f64).max(0.0)))
        })
        .collect();
    mean_absolute_error(&pairs)
}

/// RMS change of each feature against the article's noise, over its range over all leaks; the largest.
fn largest_feature_change(
    subject: &Subject<'_>,
    readings: &[Readings<Read>],
    which: usize,
    level: usize,
) -> (f64, String) {
    debug_assert_eq!(NOISE_LEVELS[0], ARTICLE_NOISE);
    let mut largest = (0.0, String::new());
    for (index, name) in subject.features.names.iter().enumerate() {
        let pairs: Vec<(f64, f64)> = readings
            .iter()
            .filter_map(|reading| {
                Some((reading[which][0].as_ref()?.0[index], reading[which][level].as_ref()?.0[index]))
            })
            .collect();
        let change = relative_change(&pairs);
        if change > largest.0 {
            largest = (change, name.clone());
        }
    }
    largest
}

/// RMS difference of the pairs over the range of their first members.
pub(crate) fn relative_change(pairs: &[(f64, f64)]) -> f64 {
    let low = pairs.iter().map(|pair| pair.0).fold(f64::INFINITY, f64::min);
    let high = pairs.iter().map(|pair| pair.0).fold(f64::NEG_INFINITY, f64::max);
    let square = pairs.iter().map(|(a, b)| (a - b).powi(2)).sum::<f64>() / pairs.len().max(1) as f64;
    square.sqrt() / (high - low)
}
