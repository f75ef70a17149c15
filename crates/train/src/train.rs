//! From a machine's file to a model.

use seepd_features::{Kalman, Phase, Projections};
use seepd_model::schema::{Cycle, Filter, Golden, ModelFile, Orifice, SCHEMA, Training};
use seepd_model::{Model, ModelError};
use seepd_sim::{MachineSpec, SpecError};
use sha2::{Digest, Sha256};

use crate::absolute::{self, AbsoluteEstimate, Features};
use crate::calibration::CalibrationSets;
use crate::cases;
use crate::causes::{self, CauseSimulator};
use crate::dataset::{Reading, Spread};
use crate::forest::Table;
use crate::leak_range::LeakRange;
use crate::portions::{Portions, Share};
use crate::relative::{self, Conditions, RelativeReport};
use crate::report::{self, Report};
use crate::search::BestForest;
use crate::templates::recognisable;

/// What training is asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingSettings {
    /// Seed of all random choices.
    pub seed: u64,
    /// Simulated machines to learn from.
    pub observations: usize,
    /// Simulated machines to measure on.
    pub held_out: usize,
    /// Trials of the hyperparameter search.
    pub trials: usize,
    /// How machines differ.
    pub spread: Spread,
    /// Leaks to train for; without, those of a valve of the machine's size.
    pub leaks: Option<LeakRange>,
    /// Smallest and largest standard deviation of the command's noise in training.
    pub noise: (f64, f64),
    /// Filter.
    pub filter: Option<Kalman>,
    /// What changes on a machine that is compared with its own baseline.
    pub conditions: Conditions,
    /// Machines from which that comparison is learned.
    pub relative_machines: usize,
    /// Machines with which each range of sizes of each cause is simulated; 0: the model names no causes.
    pub cause_machines: usize,
    /// Whether a force may press in the holds of which nothing is known: causes then have leaks under each.
    pub unknown_hold_force: bool,
    /// Whether the plant was fitted to the machine's own log.
    pub fitted: bool,
    /// Whether the plant has the machine's own dead band, or is known to have none.
    pub knows_dead_band: bool,
    /// Cosine of a cause's response and a leak's from which on the two are one class.
    pub alike_from: f64,
    /// Least share of the simulated cycles that must be recognised for a model to be made; the others are left out.
    pub least_recognised: f64,
    /// Machines that calibrate intervals and out-of-distribution limits.
    pub calibrated_on: usize,
    /// Machines that the comparison is measured on.
    pub tested_on: usize,
    /// Whether the article's experiment is repeated: see [`Report::noise_table`].
    pub noise_table: bool,
    /// Largest size of `model.json`, bytes.
    pub most_bytes: usize,
}

impl Default for TrainingSettings {
    fn default() -> Self {
        TrainingSettings {
            seed: 1,
            observations: 4096,
            held_out: 1024,
            trials: 24,
            spread: Spread::default(),
            leaks: None,
            noise: (0.001, 0.01),
            filter: Some(Kalman::default()),
            conditions: Conditions::default(),
            relative_machines: 640,
            cause_machines: 16,
            unknown_hold_force: false,
            fitted: false,
            knows_dead_band: false,
            alike_from: 0.95,
            least_recognised: 0.99,
            calibrated_on: 2048,
            tested_on: 512,
            noise_table: false,
            most_bytes: 1_000_000,
        }
    }
}

impl TrainingSettings {
    /// The leaks that a machine is trained for.
    pub(crate) fn leaks_of(&self, spec: &MachineSpec) -> LeakRange {
        self.leaks.unwrap_or_else(|| LeakRange::of(spec))
    }
}

/// Why there is no model.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// The duty cycle has no move out and back.
    #[error(
        "the duty cycle has no move out and back, by which its cycles could be found; see [cycle] in the plant file"
    )]
    NoStroke,
    /// The plant file cannot be written out, and so has no hash.
    #[error(transparent)]
    Spec(#[from] SpecError),
    /// Too few simulated cycles were recognised.
    #[error(
        "only {found} of {simulated} simulated cycles were recognised by the shape of their strokes: \
         the plant does not follow its duty cycle over these leaks"
    )]
    Unrecognised {
        /// Cycles recognised.
        found: usize,
        /// Cycles simulated.
        simulated: usize,
    },
    /// Too few machines were recognised before and after a change to learn estimates relative to a baseline from.
    #[error(
        "estimates relative to a baseline cannot be learned from {simulated} simulated machines: too few of their cycles were \
         recognised, or their command says nothing of the leak"
    )]
    Comparison {
        /// Machines simulated.
        simulated: usize,
    },
    /// The search failed.
    #[error("hyperparameter search: {0}")]
    Search(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// No forest that was tried fits the file's limit.
    #[error("hyperparameter search: no forest of at most {most_nodes} nodes was found")]
    NoForest {
        /// Nodes that the file has room for.
        most_nodes: usize,
    },
    /// The finished model does not pass its own checks.
    #[error("the trained model fails its own checks: {0}")]
    Model(ModelError),
    /// A file that should hold a share of the simulation holds something else.
    #[error("it is no share of a training's simulation, or a damaged one")]
    NotAShare,
    /// A share of the simulation is another training's.
    #[error("it is a share of another training: plant, settings or the program's version differ")]
    ForeignShare,
    /// A share cannot be written, or was damaged.
    #[error("a share of the simulation: {0}")]
    Share(#[from] postcard::Error),
    /// The finished model cannot be written.
    #[error("writing the model: {0}")]
    Json(#[from] serde_json::Error),
}

/// Where training stands, for a progress bar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Simulating machines.
    Simulate,
    /// Simulating machines with their baselines.
    Compare,
    /// Simulating machines with causes other than leaks.
    Causes,
    /// Searching hyperparameters.
    Search,
    /// Measuring on machines not seen.
    Measure,
}

/// A trained model.
#[derive(Debug)]
pub struct Trained {
    /// Content of `model.json`.
    pub json: Vec<u8>,
    /// The model, checked.
    pub model: Model,
    /// What was measured.
    pub report: Report,
    /// What was measured of estimates relative to a baseline.
    pub relative: RelativeReport,
    /// What the search found.
    pub found: BestForest,
    /// What the model learned from: its features by column, and the leak areas, m².
    pub learned: Table,
}

/// Golden pairs in the file.
const GOLDEN: usize = 12;

/// Trains a model for a machine; the same seed on the same platform gives the same bytes. `tell` hears of the
/// progress: stage, steps done, steps in all.
///
/// # Errors
/// [`TrainError`] for a machine whose cycles cannot be found or whose command says nothing of the leak.
pub fn train(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    tell: &mut dyn FnMut(Stage, usize, usize),
) -> Result<Trained, TrainError> {
    train_with(spec, settings, Portions::default(), tell)
}

/// Simulates one share of the machines that a training with these settings learns from, and gives it as bytes for [`Portions::add`].
///
/// # Errors
/// As [`train`], as far as the simulation tells.
pub fn simulate_share(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    share: Share,
    tell: &mut dyn FnMut(Stage, usize, usize),
) -> Result<Vec<u8>, TrainError> {
    let mut portions = Portions::only(spec, settings, share)?;
    let (cycle, leaks) = recognisable(spec, settings)?;
    let settings = &TrainingSettings { leaks: Some(leaks), ..settings.clone() };
    let frame = ReadingFrame::of(spec, &cycle);
    let reading = &frame.reading(&cycle);
    cases::simulate(spec, settings, reading, &mut portions, tell)?;
    CalibrationSets::draw(spec, settings).read(settings, reading, &mut portions, |_| ())?;
    relative::simulate(spec, settings, reading, &mut portions, &mut |done, all| {
        tell(Stage::Compare, done, all);
    })?;
    let simulator = CauseSimulator { spec, settings, reading };
    causes::simulate(&simulator, &mut portions, &mut |done, all| tell(Stage::Causes, done, all))?;
    report::read(&cases::held_out(spec, settings), settings, reading, &mut portions, |_| ())?;
    portions.into_bytes()
}

/// Trains as [`train`] does, to the same bytes, with what was simulated elsewhere.
///
/// # Errors
/// As [`train`], and [`TrainError::Share`] for a damaged portion.
pub fn train_with(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    mut portions: Portions,
    tell: &mut dyn FnMut(Stage, usize, usize),
) -> Result<Trained, TrainError> {
    let (cycle, leaks) = recognisable(spec, settings)?;
    let settings = &TrainingSettings { leaks: Some(leaks), ..settings.clone() };
    let frame = ReadingFrame::of(spec, &cycle);
    let reading = frame.reading(&cycle);

    let learned = cases::simulate(spec, settings, &reading, &mut portions, tell)?;
    cases::check_enough(&learned, settings)?;
    let absolute = absolute::learn(spec, settings, &reading, &learned, &mut portions, &mut |done, all| {
        tell(Stage::Search, done, all);
    })?;
    let relative = relative::learn(spec, settings, &reading, &mut portions, &mut |done, all| {
        tell(Stage::Compare, done, all);
    })?
    .ok_or(TrainError::Comparison { simulated: settings.relative_machines })?;
    let simulator = CauseSimulator { spec, settings, reading: &reading };
    let causes = causes::learn(&simulator, &mut portions, &mut |done, all| {
        tell(Stage::Causes, done, all);
    })?;
    let mut file = ModelFile {
        relative: Some(relative.clone()),
        causes,
        ..file_of(spec, settings, &reading, &absolute)?
    };
    let model = Model::from_file(file.clone()).map_err(TrainError::Model)?;
    file.golden = golden(&model, &absolute.table);

    tell(Stage::Measure, 0, 1);
    let subject = report::Subject {
        model: &model,
        features: &Features::new(&absolute.features, &reading, &absolute.projections),
        reading: &reading,
        observations: &cases::held_out(spec, settings),
        learned: &learned,
        leaks,
        params: absolute.found.params,
        settings,
    };
    let report = report::measure(&subject, &mut portions)?;
    tell(Stage::Measure, 1, 1);
    let relative =
        relative::measure(spec, settings, &reading, (&file, relative), &mut portions, &mut |done, all| {
            tell(Stage::Measure, done, all);
        })?;
    file.training = Some(provenance(&report, settings, learned.len()));
    let mut json = serde_json::to_vec(&file)?;
    json.push(b'\n');
    let model = Model::from_json(&json).map_err(TrainError::Model)?;
    let target = learned.iter().map(|case| case.leak_area_m2).collect();
    let learned = Table { target, columns: absolute.table.columns };
    Ok(Trained { json, model, report, relative, found: absolute.found, learned })
}

/// The model's file with what estimates from one cycle alone.
fn file_of(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    reading: &Reading<'_>,
    absolute: &AbsoluteEstimate,
) -> Result<ModelFile, TrainError> {
    Ok(ModelFile {
        schema: SCHEMA.into(),
        created_by: concat!("seepd ", env!("CARGO_PKG_VERSION")).into(),
        sample_rate_hz: reading.sample_rate_hz,
        filter: settings.filter.map(Filter::Kalman),
        cycle: reading.cycle.clone(),
        projections: absolute.projections.clone(),
        features: absolute.features.clone(),
        target: "leak_area".into(),
        unit: "m2".into(),
        transform: absolute.transform,
        trees: absolute.forest.trees.clone(),
        calibration: absolute.calibration.clone(),
        training_distributions: absolute.training_distributions.clone(),
        orifice: Orifice {
            discharge_coefficient: spec.plant.discharge_coefficient,
            density_kg_per_m3: spec.plant.density_kg_per_m3,
        },
        plant_sha256: plant_sha256(spec)?,
        golden: Vec::new(),
        relative: None,
        causes: None,
        training: None,
    })
}

/// How the model was trained and what it measured, as its file says.
fn provenance(report: &Report, settings: &TrainingSettings, observations: usize) -> Training {
    let accuracy = &report.accuracy;
    Training {
        seed: settings.seed,
        observations,
        r2: accuracy.r2_area,
        r2_transformed: accuracy.r2_transformed,
        median_relative_error: accuracy
            .decades
            .iter()
            // A small valve's leaks do not reach the largest decades.
            .filter(|decade| decade.median_relative_error.is_finite())
            .map(|decade| (decade.from_m2, decade.to_m2, decade.median_relative_error))
            .collect(),
    }
}

/// What [`Reading`] borrows: cycles are binned for a projection onto nothing, as principal components come of these bins.
struct ReadingFrame {
    phases: Vec<Phase>,
    sample_rate_hz: f64,
    bins: usize,
    nothing: Vec<f32>,
}

impl ReadingFrame {
    fn of(spec: &MachineSpec, cycle: &Cycle) -> Self {
        let phases = cycle.phase_list();
        let sample_rate_hz = 1.0 / spec.controller.log_period_s();
        let bins = cycle.definition(sample_rate_hz, &phases, Projections::NONE).cycle_bins();
        ReadingFrame { nothing: vec![0.0; 2 * bins], phases, sample_rate_hz, bins }
    }

    fn reading<'a>(&'a self, cycle: &'a Cycle) -> Reading<'a> {
        let projections = Projections::new(self.bins, &self.nothing);
        Reading { cycle, phases: &self.phases, sample_rate_hz: self.sample_rate_hz, projections }
    }
}

/// Hash by which a model names the plant file that it was trained on: SHA-256 of the file with every value
/// written out.
///
/// # Errors
/// [`TrainError::Spec`] where the machine cannot be written out.
pub fn plant_sha256(spec: &MachineSpec) -> Result<String, TrainError> {
    let digest = Sha256::digest(spec.to_toml()?.as_bytes());
    Ok(digest.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Pairs spread over the range of the target.
fn golden(model: &Model, table: &Table) -> Vec<Golden> {
    let step = (table.len() / GOLDEN).max(1);
    (0..table.len())
        .step_by(step)
        .take(GOLDEN)
        .map(|index| {
            let features = table.row(index);
            let estimate = model.estimate(&features);
            Golden { features, estimate: estimate.value, interval: estimate.interval }
        })
        .collect()
}

/// Rounds what the file says to so many decimals.
pub(crate) fn round_to(value: f64, digits: i32) -> f64 {
    let scale = 10f64.powi(digits);
    (value * scale).round() / scale
}
