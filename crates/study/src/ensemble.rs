//! The article's ensemble (five features, 1,200 observations, 27 learners) against the program's model.

use seepd_model::accuracy::{mean_absolute_error, median, r_squared};
use seepd_model::schema::Tree;
use seepd_sim::MachineSpec;
use seepd_sim::noise::Noise;
use seepd_train::Spread;
use seepd_train::dataset;
use seepd_train::forest::{Forest, ForestParams, Table, predict};
use seepd_train::leak_range::LeakRange;
use serde::Serialize;

use crate::features::{Cycle, Lens, presses};
use crate::{AREAS_M2, NOISE_LEVELS, StudyError};

/// Observations and learners of the article.
pub const OBSERVATIONS: usize = 1200;
/// See [`OBSERVATIONS`].
pub const LEARNERS: usize = 27;
/// Least observations in a leaf: what the bagging of common tools takes for regression, since the article does not say.
const LEAST_LEAF: usize = 5;
/// Machines of each test.
const TESTED: usize = 600;
/// The trees' target in this unit, mm² in a m²: numbers of the order of 1.
const MM2_PER_M2: f64 = 1e6;
/// Random streams that share no machine.
const LEARN_STREAM: u64 = 3 << 40;
const TEST_STREAM: u64 = 4 << 40;
const SERIES_PURPOSE: u64 = 77;

/// The article's ensemble: trees on the five features, which predict the area itself.
pub(crate) struct Taught {
    trees: Vec<Tree>,
}

/// Accuracy on some machines at one noise level.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EnsembleAccuracy {
    /// `article` or `seepd`.
    pub ensemble: &'static str,
    /// `press` (the machine that it learned from) or `series` (others of its kind).
    pub machines: &'static str,
    /// Standard deviation of the command's noise.
    pub noise: f64,
    /// Machines tested.
    pub count: usize,
    /// Coefficient of determination on the area.
    pub r2: f64,
    /// Mean absolute error, m².
    pub mean_absolute_error_m2: f64,
    /// Median of |estimate − truth| / truth in 5e-8…1e-7, 1e-7…1e-6 and 1e-6…1e-5 m².
    pub median_relative_error: [f64; 3],
}

/// The comparison.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EnsembleComparison {
    /// Both ensembles on both kinds of machines at each noise level, filtered.
    pub accuracy: Vec<EnsembleAccuracy>,
    /// The article's ensemble learned and tested without the filter, on its own press.
    pub article_unfiltered: Vec<EnsembleAccuracy>,
}

/// Learns the article's way: areas uniform over its range, one press, noise 0.001, the Kalman filter.
pub(crate) fn teach(lens: &Lens<'_>, spec: &MachineSpec, seed: u64) -> Result<[Taught; 2], StudyError> {
    let mut noise = Noise::new(seed, LEARN_STREAM);
    let areas: Vec<f64> = (0..OBSERVATIONS)
        .map(|index| {
            let share = (index as f64 + noise.uniform(0.0, 1.0)) / OBSERVATIONS as f64;
            AREAS_M2.0 + (AREAS_M2.1 - AREAS_M2.0) * share
        })
        .collect();
    let machines = presses(spec, &areas, LEARN_STREAM);
    let params = ForestParams { learners: LEARNERS, least_leaf: LEAST_LEAF, feature_share: 1.0 };
    let learn = |filter| -> Result<Taught, StudyError> {
        let cycles = lens.read(&machines, filter, &NOISE_LEVELS[..1], seed)?;
        let rows: Vec<[f64; 5]> = cycles.iter().map(|cycle| lens.five(&cycle.by_noise[0])).collect();
        let table = Table {
            columns: (0..5).map(|k| rows.iter().map(|row| row[k]).collect()).collect(),
            target: cycles.iter().map(|cycle| cycle.leak_area_m2 * MM2_PER_M2).collect(),
        };
        Ok(Taught { trees: Forest::grow(&table, params, seed).trees })
    };
    Ok([learn(lens.filter)?, learn(None)?])
}

impl Taught {
    pub(crate) fn estimate(&self, five: &[f64; 5]) -> f64 {
        let sum: f64 = self.trees.iter().map(|tree| predict(tree, |k| five[k])).sum();
        sum / self.trees.len() as f64 / MM2_PER_M2
    }
}

/// Tests both ensembles on presses like the one that the article's learned from, and on others of the series. Areas are spread
/// evenly over the decades.
pub(crate) fn compare(
    lens: &Lens<'_>,
    spec: &MachineSpec,
    taught: &[Taught; 2],
    seed: u64,
) -> Result<EnsembleComparison, StudyError> {
    let mut noise = Noise::new(seed, TEST_STREAM);
    let areas: Vec<f64> = (0..TESTED)
        .map(|index| {
            let share = (index as f64 + noise.uniform(0.0, 1.0)) / TESTED as f64;
            AREAS_M2.0 * (AREAS_M2.1 / AREAS_M2.0).powf(share)
        })
        .collect();
    let same = presses(spec, &areas, TEST_STREAM);
    let mut series =
        dataset::draw(spec, &Spread::default(), LeakRange::of(spec), TESTED, seed, SERIES_PURPOSE);
    for (machine, area) in series.iter_mut().zip(&areas) {
        machine.leak_area_m2 = *area;
    }
    let mut accuracy = Vec::new();
    let by_article = |cycle: &Cycle, level: usize| taught[0].estimate(&lens.five(&cycle.by_noise[level]));
    let by_model = |cycle: &Cycle, level: usize| lens.model.estimate(&lens.all(&cycle.by_noise[level])).value;
    for (machines, observations) in [("press", &same), ("series", &series)] {
        let cycles = lens.read(observations, lens.filter, &NOISE_LEVELS, seed)?;
        accuracy.extend(measure("article", machines, &cycles, &by_article));
        accuracy.extend(measure("seepd", machines, &cycles, &by_model));
    }
    let unfiltered = lens.read(&same, None, &NOISE_LEVELS, seed)?;
    let without = |cycle: &Cycle, level: usize| taught[1].estimate(&lens.five(&cycle.by_noise[level]));
    Ok(EnsembleComparison {
        accuracy,
        article_unfiltered: measure("article", "press", &unfiltered, &without),
    })
}

fn measure(
    ensemble: &'static str,
    machines: &'static str,
    cycles: &[Cycle],
    estimate: &dyn Fn(&Cycle, usize) -> f64,
) -> Vec<EnsembleAccuracy> {
    let at = |(level, noise): (usize, &f64)| {
        let pairs: Vec<(f64, f64)> =
            cycles.iter().map(|cycle| (cycle.leak_area_m2, estimate(cycle, level))).collect();
        let relative = |low: f64, high: f64| {
            let inside = pairs.iter().filter(|(truth, _)| (low..high).contains(truth));
            median(inside.map(|(truth, estimate)| (estimate - truth).abs() / truth).collect())
        };
        EnsembleAccuracy {
            ensemble,
            machines,
            noise: *noise,
            count: pairs.len(),
            r2: r_squared(&pairs),
            mean_absolute_error_m2: mean_absolute_error(&pairs),
            median_relative_error: [relative(5e-8, 1e-7), relative(1e-7, 1e-6), relative(1e-6, 1.01e-5)],
        }
    };
    NOISE_LEVELS.iter().enumerate().map(at).collect()
}
