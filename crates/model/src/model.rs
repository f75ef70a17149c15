//! A checked model, ready for use.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use seepd_features::{CycleReader, Feature, Kalman, Phase, PistonAreas, Projections, ReaderError};

use crate::attribution::Attribution;
use crate::causes::Causes;
use crate::check;
use crate::ensemble::{Ensemble, Estimate};
use crate::error::ModelError;
use crate::out_of_distribution::OutOfDistribution;
use crate::relative::Relative;
use crate::schema::{Filter, ModelFile, ProjectionFile};

/// Relative difference that a golden output may show: the platforms' arithmetic is the same, text is not kept
/// beyond 17 digits.
const GOLDEN_TOLERANCE: f64 = 1e-9;

/// A model: what turns the samples of a command into estimates of the leak.
///
/// The [crate's page](crate) has an example.
#[derive(Debug, Clone)]
pub struct Model {
    file: ModelFile,
    features: Vec<Feature>,
    phases: Vec<Phase>,
    /// Means and loadings of the projections.
    projections: Vec<f32>,
    ensemble: Ensemble,
    relative: Option<Relative>,
    causes: Option<Causes>,
}

impl Model {
    /// Reads and checks a `seepd.model/2` file, or one of version 1.
    ///
    /// # Errors
    /// [`ModelError`] with the JSON path: not JSON, a wrong structure, an unknown schema or feature, a tree that is no
    /// tree, a number that is none, or golden pairs that the model does not meet.
    pub fn from_json(json: &[u8]) -> Result<Self, ModelError> {
        Self::from_file(check::parse(json)?)
    }

    /// Checks a model that is at hand as a structure.
    ///
    /// # Errors
    /// As [`Model::from_json`].
    pub fn from_file(file: ModelFile) -> Result<Self, ModelError> {
        check::check(&file)?;
        let features = file.features.iter().filter_map(|name| check::feature(&file, name)).collect();
        let phases = file.cycle.phase_list();
        let projections = ProjectionFile::values(&file.projections);
        let ensemble = Ensemble::from_checked(&file.trees);
        let mut model = Model { file, features, phases, projections, ensemble, relative: None, causes: None };
        model.check_golden()?;
        // The trees live on in the ensemble.
        model.file.trees = Vec::new();
        model.relative = model.file.relative.take().map(Relative::from_checked).transpose()?;
        model.causes = model.file.causes.take().map(Causes::from_checked).transpose()?;
        Ok(model)
    }

    fn check_golden(&self) -> Result<(), ModelError> {
        for (index, golden) in self.file.golden.iter().enumerate() {
            let path = format!("golden[{index}]");
            check::check_length(&format!("{path}.features"), golden.features.len(), self.features.len())?;
            let given = self.estimate(&golden.features);
            agree(&path, [(golden.estimate, given.value)])?;
            agree(&path, golden.interval.into_iter().zip(given.interval))?;
        }
        Ok(())
    }

    /// The file without its trees.
    pub fn file(&self) -> &ModelFile {
        &self.file
    }

    /// The trees.
    pub fn ensemble(&self) -> &Ensemble {
        &self.ensemble
    }

    /// Names of the features in their order.
    pub fn feature_names(&self) -> &[String] {
        &self.file.features
    }

    /// Estimates the leak area, m², from a cycle's features in the model's order.
    pub fn estimate(&self, features: &[f64]) -> Estimate {
        self.estimated(features, None)
    }

    /// The same with an interval for a command with that standard deviation of noise.
    pub fn estimate_at(&self, features: &[f64], noise: f64) -> Estimate {
        self.estimated(features, Some(noise))
    }

    fn estimated(&self, features: &[f64], noise: Option<f64>) -> Estimate {
        let (mean, spread) = self.ensemble.vote(features);
        Estimate::around(mean, spread, noise, self.file.transform, &self.file.calibration)
    }

    /// What each feature contributes to estimates; kept beside the model by those who ask.
    pub fn attribution(&self) -> Attribution {
        Attribution::new(&self.ensemble)
    }

    /// How far a cycle with these mean commands by phase, share of full command, lies from the training data of machines with such
    /// an estimate.
    pub fn out_of_distribution(&self, estimate: &Estimate, phase_means: &[f64]) -> OutOfDistribution {
        let known = phase_means.get(..self.phases.len()).unwrap_or(phase_means);
        OutOfDistribution::of(&self.file.training_distributions, estimate.transformed, known)
    }

    /// Estimates relative to a baseline, if the model has them.
    pub fn relative(&self) -> Option<&Relative> {
        self.relative.as_ref()
    }

    /// Causes of changes since a baseline, if the model names them.
    pub fn causes(&self) -> Option<&Causes> {
        self.causes.as_ref()
    }

    /// Flow of a leak of that area at a pressure difference, m³/s: `C_d A √(2 Δp / ρ)`, the orifice alone.
    pub fn leak_flow_m3_per_s(&self, area_m2: f64, pressure_difference_pa: f64) -> f64 {
        let orifice = &self.file.orifice;
        orifice.discharge_coefficient
            * area_m2
            * libm::sqrt(2.0 * pressure_difference_pa / orifice.density_kg_per_m3)
    }

    /// The projections of the cycles' bins.
    pub fn projections(&self) -> Projections<'_> {
        let bins = self.file.projections.first().map_or(0, |projection| projection.mean.len());
        Projections::new(bins, &self.projections)
    }

    /// The configuration that reads cycles for this model.
    ///
    /// # Errors
    /// [`ReaderError`] where the reader has no room for the model's features, phases or bins, which the model's own check rules out.
    pub fn reader(&self) -> Result<CycleReader<'_>, ReaderError> {
        let definition =
            self.file.cycle.definition(self.file.sample_rate_hz, &self.phases, self.projections());
        let areas = self.relative.as_ref().map(|relative| {
            let [cap_m2, annulus_m2] = relative.file().piston_areas_m2;
            PistonAreas { cap_m2, annulus_m2 }
        });
        let reader = CycleReader::new(self.filter(), definition, &self.features)?;
        Ok(reader.with_piston_areas(areas))
    }

    fn filter(&self) -> Option<Kalman> {
        self.file.filter.as_ref().map(|Filter::Kalman(kalman)| *kalman)
    }
}

/// Checks that outputs are as the file expects them: pairs of the file's and the model's own.
pub(crate) fn agree(path: &str, pairs: impl IntoIterator<Item = (f64, f64)>) -> Result<(), ModelError> {
    for (expected, given) in pairs {
        let scale = libm::fabs(expected).max(1e-12);
        let agrees = libm::fabs(expected - given) <= GOLDEN_TOLERANCE * scale;
        if !agrees {
            return Err(ModelError::Golden { path: path.into(), expected, given });
        }
    }
    Ok(())
}
