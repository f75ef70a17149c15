//! The calibration of intervals, and what ordinary cycles look like, on machines that were not learned from.

use seepd_features::statistics::CycleStatistics;
use seepd_model::Ensemble;
use seepd_model::schema::{Calibration, TrainingDistribution, Transform};
use seepd_sim::MachineSpec;

use crate::absolute::Features;
use crate::cases::Case;
use crate::conformal::{self, Prediction};
use crate::dataset::{self, Observation, Reading, purpose};
use crate::forest::Forest;
use crate::portions::{Portions, Row};
use crate::train::{TrainError, TrainingSettings};
use crate::{out_of_distribution, relative, report};

/// For so many machines that are learned from there is one more with a leak beyond, by which such leaks are known.
const LEARNED_TO_BEYOND: usize = 16;

/// Machines that calibrate intervals, and some with leaks beyond those that are learned.
pub(crate) struct CalibrationSets {
    within: Vec<Observation>,
    beyond: Vec<Observation>,
}

impl CalibrationSets {
    pub(crate) fn draw(spec: &MachineSpec, settings: &TrainingSettings) -> Self {
        let leaks = settings.leaks_of(spec);
        let draw =
            |count, purpose| dataset::draw(spec, &settings.spread, leaks, count, settings.seed, purpose);
        let count = settings.observations / LEARNED_TO_BEYOND;
        let mut beyond = draw(count, purpose::BEYOND);
        for (index, observation) in beyond.iter_mut().enumerate() {
            observation.leak_area_m2 = leaks.beyond_m2(index as f64 / count as f64);
        }
        CalibrationSets { within: draw(settings.calibrated_on, purpose::CALIBRATE), beyond }
    }

    /// What `of` makes of each machine's cycle at each level of noise: of those within, and of those beyond.
    pub(crate) fn read<R>(
        &self,
        settings: &TrainingSettings,
        reading: &Reading<'_>,
        portions: &mut Portions,
        of: impl Fn(&CycleStatistics) -> R,
    ) -> Result<[Vec<report::AtEachNoise<R>>; 2], TrainError> {
        let mut read = |name, observations: &[Observation]| {
            let mut all = Vec::with_capacity(observations.len());
            let statistics = |observation: &Observation, commands: &[f64]| {
                report::read_at_each_noise(reading, settings, (observation, commands), settings.filter)
            };
            dataset::in_portions((name, &mut *portions), observations, statistics, |read| {
                all.push(read.map(|level| level.as_ref().and_then(Row::statistics).as_ref().map(&of)));
            })?;
            Ok::<_, TrainError>(all)
        };
        Ok([read("calibration", &self.within)?, read("beyond", &self.beyond)?])
    }
}

/// The intervals' calibration and what cycles look like, on machines that were not learned from, at each level of noise.
pub(crate) fn calibrate(
    sets: &CalibrationSets,
    (settings, reading): (&TrainingSettings, &Reading<'_>),
    features: &Features<'_>,
    learned: &[Case],
    forest: &Forest,
    transform: Transform,
    portions: &mut Portions,
) -> Result<(Calibration, Vec<TrainingDistribution>), TrainError> {
    let levels = &relative::CALIBRATED_NOISE;
    let [readings, beyond] =
        sets.read(settings, reading, portions, |statistics| features.read(statistics))?;
    let ensemble = Ensemble::new(&forest.trees, features.names.len()).map_err(TrainError::Model)?;
    let predict = |level: usize, is_wanted: &dyn Fn(f64) -> bool| -> Vec<Prediction> {
        let cases = sets.within.iter().zip(&readings).filter(|(case, _)| is_wanted(case.leak_area_m2));
        cases
            .filter_map(|(case, reading)| {
                let (mean, spread) = ensemble.vote(&reading[level].as_ref()?.0);
                Some(Prediction { truth: transform.forward(case.leak_area_m2), mean, spread })
            })
            .collect()
    };
    let by_noise: Vec<(f64, Vec<Prediction>)> = levels
        .iter()
        .enumerate()
        .map(|(level, noise)| (*noise, predict(level, &|area| area > 0.0)))
        .collect();
    let healthy = (0..levels.len()).flat_map(|level| predict(level, &|area| area == 0.0));
    let calibration = conformal::calibration(&by_noise, healthy.map(|one| transform.back(one.mean).max(0.0)));
    Ok((calibration, describe_cycles(&ensemble, features, learned, &readings, &beyond)))
}

/// What cycles look like: learned from the model's own machines and half of those with leaks beyond, limits from the others.
fn describe_cycles<const LEVELS: usize>(
    ensemble: &Ensemble,
    features: &Features<'_>,
    learned: &[Case],
    others: &[[Option<report::Read>; LEVELS]],
    beyond: &[[Option<report::Read>; LEVELS]],
) -> Vec<TrainingDistribution> {
    let row = |(values, means): &report::Read| (ensemble.vote(values).0, means.clone());
    // Leaks ascend, so that each half has all sizes.
    let half = |from: usize| beyond.iter().skip(from).step_by(2).flatten().flatten().map(row);
    let learned = learned.iter().map(|case| row(&features.read(&case.mixed))).chain(half(0)).collect();
    let others = others.iter().flatten().flatten().map(row).chain(half(1));
    out_of_distribution::describe(learned, others).unwrap_or_default()
}
