//! The leak's size from one cycle alone: features, trees and the calibration of their intervals.

use rayon::prelude::*;
use seepd_features::statistics::CycleStatistics;
use seepd_features::{CycleDefinition, Feature, Projections};
use seepd_model::schema::{Calibration, Cycle, ProjectionFile, TrainingDistribution, Transform};
use seepd_sim::MachineSpec;

use crate::calibration::{self, CalibrationSets};
use crate::cases::Case;
use crate::dataset::Reading;
use crate::forest::{Forest, ForestParams, Table};
use crate::leak_range::LeakRange;
use crate::portions::Portions;
use crate::search::{self, BestForest};
use crate::train::{TrainError, TrainingSettings};
use crate::{pca, report};

/// Principal components that become features.
const COMPONENTS: usize = 3;
/// Bytes of a node in the file, at most: its feature, value and right child with their commas.
const NODE_BYTES: usize = 20;

/// What gives the leak's size from one cycle alone, as it was learned.
pub(crate) struct AbsoluteEstimate {
    pub(crate) projections: Vec<ProjectionFile>,
    /// The features that are read, in the table's order.
    pub(crate) features: Vec<String>,
    pub(crate) transform: Transform,
    pub(crate) found: BestForest,
    pub(crate) forest: Forest,
    pub(crate) calibration: Calibration,
    pub(crate) training_distributions: Vec<TrainingDistribution>,
    /// What the forest has learned: features by column, and the leak areas as transformed.
    pub(crate) table: Table,
}

/// Learns it from cycles; `tell` hears of the search's trials.
///
/// # Errors
/// [`TrainError`] of the search, and of the machines that calibrate.
pub(crate) fn learn(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    reading: &Reading<'_>,
    learned: &[Case],
    portions: &mut Portions,
    tell: &mut dyn FnMut(usize, usize),
) -> Result<AbsoluteEstimate, TrainError> {
    let rows: Vec<Vec<f32>> = learned.iter().map(|case| case.mixed.bins().to_vec()).collect();
    let projections = pca::components(&rows, COMPONENTS);
    let all = feature_names(reading.cycle, &projections);
    let names = steady_features(&Features::new(&all, reading, &projections), learned);
    let features = Features::new(&names, reading, &projections);

    let transform = Transform::LnOffset(LeakRange::of(spec).offset_m2());
    let target: Vec<f64> = learned.iter().map(|case| transform.forward(case.leak_area_m2)).collect();
    let table = features.table(learned.iter().map(|case| &case.mixed), &target);
    let most_nodes = settings.most_bytes / NODE_BYTES;
    let found = search::search(&table, most_nodes, settings.trials, settings.seed, tell)?;
    let forest = Forest::grow(&table, found.params, settings.seed);
    let (calibration, training_distributions) = calibration::calibrate(
        &CalibrationSets::draw(spec, settings),
        (settings, reading),
        &features,
        learned,
        &forest,
        transform,
        portions,
    )?;
    Ok(AbsoluteEstimate {
        projections,
        features: names,
        transform,
        found,
        forest,
        calibration,
        training_distributions,
        table,
    })
}

/// Every feature that a cycle of these phases has.
fn feature_names(cycle: &Cycle, projections: &[ProjectionFile]) -> Vec<String> {
    let mut names: Vec<String> = Feature::names().map(str::to_owned).collect();
    names.extend(projections.iter().map(|projection| projection.name.clone()));
    for phase in &cycle.phases {
        names.push(format!("mean.{}", phase.name));
        names.push(format!("relative.{}", phase.name));
    }
    names
}

/// Largest RMS change of a feature from the article's noise to the training's largest, over the feature's range
/// over leaks, with which it is still used. The requirement is 5 %; the rest is for machines not seen.
const LARGEST_CHANGE: f64 = 0.04;

/// The features that measurement noise leaves alone, as far as the filter can.
fn steady_features(features: &Features<'_>, learned: &[Case]) -> Vec<String> {
    let rows: Vec<(Vec<f64>, Vec<f64>)> = learned
        .par_iter()
        .filter_map(|case| Some((features.of(case.quiet[0].as_ref()?), features.of(case.loud.as_ref()?))))
        .collect();
    let is_steady = |index: usize| {
        let pairs: Vec<(f64, f64)> = rows.iter().map(|(quiet, loud)| (quiet[index], loud[index])).collect();
        report::relative_change(&pairs) <= LARGEST_CHANGE
    };
    features
        .names
        .iter()
        .enumerate()
        .filter(|(index, _)| is_steady(*index))
        .map(|(_, name)| name.clone())
        .collect()
}

/// Reads features by name off cycles' statistics.
pub(crate) struct Features<'a> {
    pub(crate) names: Vec<String>,
    kinds: Vec<Feature>,
    reading: &'a Reading<'a>,
    bins: usize,
    projections: Vec<f32>,
}

impl<'a> Features<'a> {
    pub(crate) fn new(names: &[String], reading: &'a Reading<'a>, projections: &'a [ProjectionFile]) -> Self {
        let phase_names = reading.cycle.phases.iter().map(|phase| phase.name.as_str());
        let kinds = names
            .iter()
            .filter_map(|name| {
                Feature::from_name(name, phase_names.clone(), projections.iter().map(|p| p.name.as_str()))
            })
            .collect();
        let bins = reading.definition().cycle_bins();
        Features {
            names: names.to_vec(),
            kinds,
            reading,
            bins,
            projections: ProjectionFile::values(projections),
        }
    }

    pub(crate) fn of(&self, statistics: &CycleStatistics) -> Vec<f64> {
        let projections = Projections::new(self.bins, &self.projections);
        let definition = CycleDefinition { projections, ..self.reading.definition() };
        self.kinds.iter().map(|kind| kind.of(&definition, statistics)).collect()
    }

    /// Features, and mean commands by phase.
    pub(crate) fn read(&self, statistics: &CycleStatistics) -> report::Read {
        (self.of(statistics), statistics.phase_means()[..self.reading.phases.len()].to_vec())
    }

    pub(crate) fn table<'s>(
        &self,
        cases: impl Iterator<Item = &'s CycleStatistics>,
        target: &[f64],
    ) -> Table {
        let statistics: Vec<&CycleStatistics> = cases.collect();
        let rows: Vec<Vec<f64>> = statistics.par_iter().map(|case| self.of(case)).collect();
        let columns = (0..self.names.len()).map(|j| rows.iter().map(|row| row[j]).collect()).collect();
        Table { columns, target: target.to_vec() }
    }
}

/// A forest for the noise table: grown as the model's own, on other readings of the same machines.
pub(crate) fn grow_like(
    features: &Features<'_>,
    learned: &[Case],
    which: usize,
    params: ForestParams,
    transform: Transform,
    seed: u64,
) -> Option<Forest> {
    let cases: Vec<(&CycleStatistics, f64)> = learned
        .iter()
        .filter_map(|case| {
            case.quiet[which].as_ref().map(|quiet| (quiet, transform.forward(case.leak_area_m2)))
        })
        .collect();
    let target: Vec<f64> = cases.iter().map(|case| case.1).collect();
    (!cases.is_empty())
        .then(|| Forest::grow(&features.table(cases.iter().map(|case| case.0), &target), params, seed))
}
