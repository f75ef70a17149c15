//! From a machine's file to a model.

use rayon::prelude::*;
use seepd_features::statistics::CycleStatistics;
use seepd_features::{CycleDefinition, Feature, Kalman, Phase, Projections};
use seepd_model::schema::{
    Cycle, Filter, Golden, ModelFile, Orifice, ProjectionFile, SCHEMA, Training, Transform,
};
use seepd_model::{Model, ModelError};
use seepd_sim::noise::Noise;
use seepd_sim::{MachineSpec, SpecError};
use sha2::{Digest, Sha256};

use crate::calibration::{self, CalibrationSets};
use crate::causes::{self, CauseSimulator};
use crate::dataset::{self, Observation, Reading, Spread};
use crate::duty;
use crate::forest::{Forest, ForestParams, Table};
use crate::leak_range::LeakRange;
use crate::pca;
use crate::portions::{Portions, Row, Share};
use crate::relative::{self, Conditions, RelativeReport};
use crate::report::{self, Report};
use crate::search::{self, BestForest};

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

/// Random streams that share no machine; the calibration has 4 and 5.
mod purpose {
    pub(super) const TEMPLATE: u64 = 1;
    pub(super) const LEARN: u64 = 2;
    pub(super) const HELD_OUT: u64 = 3;
    pub(super) const LARGEST: u64 = 6;
}

/// Machines from which templates are made.
const TEMPLATE_MACHINES: usize = 64;
/// Principal components that become features.
const COMPONENTS: usize = 3;
/// Bytes of a node in the file, at most: its feature, value and right child with their commas.
const NODE_BYTES: usize = 20;
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
    learn_cases(spec, settings, reading, &mut portions, tell)?;
    CalibrationSets::draw(spec, settings).read(settings, reading, &mut portions, |_| ())?;
    relative::simulate(spec, settings, reading, &mut portions, &mut |done, all| {
        tell(Stage::Compare, done, all);
    })?;
    let simulator = CauseSimulator { spec, settings, reading };
    causes::simulate(&simulator, &mut portions, &mut |done, all| tell(Stage::Causes, done, all))?;
    report::read(&held_out(spec, settings), settings, reading, &mut portions, |_| ())?;
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

    let learned = learn_set(spec, settings, &reading, &mut portions, tell)?;
    let rows: Vec<Vec<f32>> = learned.iter().map(|case| case.mixed.bins().to_vec()).collect();
    let projections = pca::components(&rows, COMPONENTS);
    let all = feature_names(&cycle, &projections);
    let names = steady_features(&Features::new(&all, &reading, &projections), &learned);
    let features = Features::new(&names, &reading, &projections);

    let transform = Transform::LnOffset(LeakRange::of(spec).offset_m2());
    let target: Vec<f64> = learned.iter().map(|case| transform.forward(case.leak_area_m2)).collect();
    let table = features.table(learned.iter().map(|case| &case.mixed), &target);
    let found = search::search(
        &table,
        settings.most_bytes / NODE_BYTES,
        settings.trials,
        settings.seed,
        &mut |done, all| {
            tell(Stage::Search, done, all);
        },
    )?;
    let forest = Forest::grow(&table, found.params, settings.seed);
    let (calibration, training_distributions) = calibration::calibrate(
        &CalibrationSets::draw(spec, settings),
        (settings, &reading),
        &features,
        &learned,
        &forest,
        transform,
        &mut portions,
    )?;
    let relative = relative::learn(spec, settings, &reading, &mut portions, &mut |done, all| {
        tell(Stage::Compare, done, all);
    })?
    .ok_or(TrainError::Comparison { simulated: settings.relative_machines })?;

    let mut file = ModelFile {
        schema: SCHEMA.into(),
        created_by: concat!("seepd ", env!("CARGO_PKG_VERSION")).into(),
        sample_rate_hz: frame.sample_rate_hz,
        filter: settings.filter.map(Filter::Kalman),
        cycle: cycle.clone(),
        projections: projections.clone(),
        features: names.clone(),
        target: "leak_area".into(),
        unit: "m2".into(),
        transform,
        trees: forest.trees,
        calibration,
        training_distributions,
        orifice: Orifice {
            discharge_coefficient: spec.plant.discharge_coefficient,
            density_kg_per_m3: spec.plant.density_kg_per_m3,
        },
        plant_sha256: plant_sha256(spec)?,
        golden: Vec::new(),
        relative: Some(relative.clone()),
        causes: causes::learn(
            &CauseSimulator { spec, settings, reading: &reading },
            &mut portions,
            &mut |done, all| {
                tell(Stage::Causes, done, all);
            },
        )?,
        training: None,
    };
    let model = Model::from_file(file.clone()).map_err(TrainError::Model)?;
    file.golden = golden(&model, &table);

    tell(Stage::Measure, 0, 1);
    let subject = report::Subject {
        model: &model,
        features: &features,
        reading: &reading,
        observations: &held_out(spec, settings),
        learned: &learned,
        leaks,
        params: found.params,
        settings,
    };
    let report = report::measure(&subject, &mut portions)?;
    tell(Stage::Measure, 1, 1);
    let relative =
        relative::measure(spec, settings, &reading, (&file, relative), &mut portions, &mut |done, all| {
            tell(Stage::Measure, done, all);
        })?;
    file.training = Some(Training {
        seed: settings.seed,
        observations: learned.len(),
        r2: report.accuracy.r2_area,
        r2_transformed: report.accuracy.r2_transformed,
        median_relative_error: report
            .accuracy
            .decades
            .iter()
            // A small valve's leaks do not reach the largest decades.
            .filter(|decade| decade.median_relative_error.is_finite())
            .map(|decade| (decade.from_m2, decade.to_m2, decade.median_relative_error))
            .collect(),
    });
    let mut json = serde_json::to_vec(&file)?;
    json.push(b'\n');
    let model = Model::from_json(&json).map_err(TrainError::Model)?;
    let learned =
        Table { target: learned.iter().map(|case| case.leak_area_m2).collect(), columns: table.columns };
    Ok(Trained { json, model, report, relative, found, learned })
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

/// A simulated machine's cycle as it was read.
pub(crate) struct Case {
    pub(crate) leak_area_m2: f64,
    /// With a noise drawn from the training's range, filtered.
    pub(crate) mixed: CycleStatistics,
    /// With the article's noise, filtered and, for the noise table only, unfiltered.
    pub(crate) quiet: [Option<CycleStatistics>; 2],
    /// With the largest noise of the training's range, filtered.
    loud: Option<CycleStatistics>,
}

impl Case {
    fn stored((leak_area_m2, rows): (f64, [Option<Row>; 4])) -> Option<Self> {
        let [mixed, quiet, unfiltered, loud] = rows.map(|row| row.as_ref().and_then(Row::statistics));
        Some(Case { leak_area_m2, mixed: mixed?, quiet: [quiet, unfiltered], loud })
    }
}

/// The article's measurement noise.
pub(crate) const ARTICLE_NOISE: f64 = 0.001;

/// The cycles that are learned from.
///
/// # Errors
/// [`TrainError::Unrecognised`] where too few are.
fn learn_set(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    reading: &Reading<'_>,
    portions: &mut Portions,
    tell: &mut dyn FnMut(Stage, usize, usize),
) -> Result<Vec<Case>, TrainError> {
    let cases = learn_cases(spec, settings, reading, portions, tell)?;
    let (found, simulated) = (cases.len(), settings.observations);
    if (found as f64) < settings.least_recognised * simulated as f64 {
        return Err(TrainError::Unrecognised { found, simulated });
    }
    Ok(cases)
}

fn learn_cases(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    reading: &Reading<'_>,
    portions: &mut Portions,
    tell: &mut dyn FnMut(Stage, usize, usize),
) -> Result<Vec<Case>, TrainError> {
    let leaks = settings.leaks_of(spec);
    let observations =
        dataset::draw(spec, &settings.spread, leaks, settings.observations, settings.seed, purpose::LEARN);
    let (mut cases, mut done) = (Vec::with_capacity(observations.len()), 0);
    let read = |observation: &Observation, commands: &[f64]| {
        let mut noise = noise_of(observation, settings);
        let sigma = log_uniform(&mut noise, settings.noise);
        let unit = dataset::unit_noise(&mut noise, commands.len());
        let read = |filter, sigma| reading.read(commands, filter, sigma, &unit);
        let mixed = read(settings.filter, sigma)?;
        let quiet = read(settings.filter, ARTICLE_NOISE);
        let loud = read(settings.filter, settings.noise.1);
        let unfiltered = settings.noise_table.then(|| read(None, ARTICLE_NOISE)).flatten();
        let rows = [Some(mixed), quiet, unfiltered, loud].map(|statistics| statistics.map(Row::from));
        Some((observation.leak_area_m2, rows))
    };
    dataset::in_portions(("learned", portions), &observations, read, |case| {
        cases.extend(case.and_then(Case::stored));
        done += 1;
        tell(Stage::Simulate, done, observations.len());
    })?;
    Ok(cases)
}

/// The random stream of an observation's measurement noise, apart from the one of its parameters.
pub(crate) fn noise_of(observation: &Observation, settings: &TrainingSettings) -> Noise {
    Noise::new(settings.seed ^ 0x006e_6f69_7365, observation.stream)
}

fn log_uniform(noise: &mut Noise, (low, high): (f64, f64)) -> f64 {
    low * libm::pow(high / low, noise.uniform(0.0, 1.0))
}

/// The duty cycle with its templates, and the leaks with which it can be followed and recognised.
fn recognisable(spec: &MachineSpec, settings: &TrainingSettings) -> Result<(Cycle, LeakRange), TrainError> {
    let mut leaks = settings.leaks_of(spec);
    loop {
        let cycle = with_templates(spec, settings, leaks)?;
        let lowered =
            if recognises_the_largest(spec, settings, leaks, &cycle) { None } else { leaks.lowered() };
        match lowered {
            Some(lower) => leaks = lower,
            None => return Ok((cycle, leaks)),
        }
    }
}

/// Whether cycles with the largest leaks are recognised as those without one are, but for what chance leaves out: a machine that cannot
/// follow its cycle whatever its seal says nothing of leaks.
fn recognises_the_largest(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    leaks: LeakRange,
    cycle: &Cycle,
) -> bool {
    let mut observations =
        dataset::draw(spec, &settings.spread, leaks, TEMPLATE_MACHINES, settings.seed, purpose::LARGEST);
    let [tight, worn] = [0.0, leaks.top_m2()].map(|leak_area_m2| {
        observations.iter_mut().for_each(|observation| observation.leak_area_m2 = leak_area_m2);
        recognised_of(&observations, spec, settings, cycle)
    });
    let share = settings.least_recognised.max(LEAST_OF_THE_LARGEST) - FEWER_OF_THE_LARGEST;
    worn as f64 >= share * tight as f64
}

/// How many of these machines' cycles are recognised.
fn recognised_of(
    observations: &[Observation],
    spec: &MachineSpec,
    settings: &TrainingSettings,
    cycle: &Cycle,
) -> usize {
    let phases = cycle.phase_list();
    let sample_rate_hz = 1.0 / spec.controller.log_period_s();
    let reading = Reading { cycle, phases: &phases, sample_rate_hz, projections: Projections::NONE };
    let read = dataset::simulate(observations, |index, commands| {
        let mut noise = noise_of(&observations[index], settings);
        let unit = dataset::unit_noise(&mut noise, commands.len());
        reading.read(commands, settings.filter, settings.noise.1, &unit).is_some()
    });
    read.into_iter().filter(|recognised| *recognised).count()
}

/// Least share of the machines that follow their cycle without a leak that have to do so with the largest.
const LEAST_OF_THE_LARGEST: f64 = 0.8;

/// With the largest leak so much less of the machines may be recognised: it is drawn seldom.
const FEWER_OF_THE_LARGEST: f64 = 0.04;

/// Fills the anchors' templates from simulated machines.
fn with_templates(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    leaks: LeakRange,
) -> Result<Cycle, TrainError> {
    let mut cycle = duty::cycle_of(spec)?;
    let windows = duty::template_windows(spec)?;
    let rate = 1.0 / spec.controller.log_period_s();
    let observations =
        dataset::draw(spec, &settings.spread, leaks, TEMPLATE_MACHINES, settings.seed, purpose::TEMPLATE);
    let bin_samples = cycle.bin_samples;
    let shapes: Vec<Shapes> = dataset::simulate(&observations, |index, commands| {
        let mut noise = noise_of(&observations[index], settings);
        let filter = settings.filter;
        let mut state = seepd_features::KalmanState::default();
        let filtered: Vec<f64> = commands
            .iter()
            .map(|command| {
                let noisy = command + noise.normal(ARTICLE_NOISE);
                filter.map_or(noisy, |kalman| kalman.step(&mut state, noisy))
            })
            .collect();
        let lead = dataset::lead(&observations[index]);
        let binned = |from: usize, to: usize| -> Vec<f64> {
            let bins = filtered[from..to].chunks_exact(bin_samples);
            bins.map(|bin| bin.iter().sum::<f64>() / bin.len() as f64).collect()
        };
        let at = |at_s: f64| lead + (at_s * rate).round() as usize;
        Shapes {
            strokes: windows.iter().map(|(from_s, to_s)| binned(at(*from_s), at(*to_s))).collect(),
            cycle: binned(at(0.0), at(spec.cycle.period_s * observations[index].stretch)),
        }
    });
    let anchors = cycle.anchors.iter_mut().chain(&mut cycle.further_anchors);
    for (which, (anchor, window)) in anchors.zip(&windows).enumerate() {
        let centred: Vec<Vec<f64>> = shapes.iter().map(|shape| normalised(&shape.strokes[which])).collect();
        let mean: Vec<f64> =
            (0..centred[0].len()).map(|bin| centred.iter().map(|shape| shape[bin]).sum()).collect();
        let template = normalised(&mean);
        let least = centred
            .iter()
            .map(|shape| shape.iter().zip(&template).map(|(a, b)| a * b).sum::<f64>())
            .fold(f64::INFINITY, f64::min);
        let deviation =
            shapes.iter().map(|shape| deviation(&shape.strokes[which])).fold(f64::INFINITY, f64::min);
        // Room for what the simulator does not know; other parts of the cycle are told apart by their order.
        anchor.least_correlation = round_to(0.9 * least, 3).clamp(0.3, 0.9);
        let least_deviation = round_to(0.3 * deviation, 4);
        anchor.least_deviation = least_deviation;
        let own = (window.0 * rate / bin_samples as f64).round() as usize;
        let rival = shapes
            .iter()
            .map(|shape| best_elsewhere(&shape.cycle, &template, own, least_deviation))
            .fold(0.0, f64::max);
        // Half way between the best of the rest and a perfect match.
        anchor.sure_correlation = round_to(0.5 * (1.0 + rival), 3).clamp(anchor.least_correlation, 1.0);
        anchor.template = template.iter().map(|value| *value as f32).collect();
        // Whole bins only: the template may end before its window does.
        let bins = template.len() as f64 * bin_samples as f64;
        anchor.end_s = round_to(window.0 + bins / rate, 6);
    }
    Ok(cycle)
}

/// A simulated cycle for making templates, in bins.
struct Shapes {
    strokes: Vec<Vec<f64>>,
    cycle: Vec<f64>,
}

/// The best normalised correlation of a template with the cycle, run in a ring, away from its own place.
fn best_elsewhere(cycle: &[f64], template: &[f64], own: usize, least_deviation: f64) -> f64 {
    let bins = cycle.len();
    let away = (AWAY_SHARE * bins as f64) as usize;
    let window =
        |start: usize| -> Vec<f64> { (0..template.len()).map(|bin| cycle[(start + bin) % bins]).collect() };
    (0..bins)
        .filter(|start| {
            let distance = start.abs_diff(own);
            distance.min(bins - distance) > away
        })
        .map(window)
        .filter(|shape| deviation(shape) > least_deviation)
        .map(|shape| normalised(&shape).iter().zip(template).map(|(a, b)| a * b).sum::<f64>())
        .fold(0.0, f64::max)
}

/// Closer than this share of the period a match is still the stroke's own.
const AWAY_SHARE: f64 = 0.08;

pub(crate) fn round_to(value: f64, digits: i32) -> f64 {
    let scale = 10f64.powi(digits);
    (value * scale).round() / scale
}

fn deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

/// Mean 0, sum of squares 1.
fn normalised(values: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let norm = deviation(values) * (values.len() as f64).sqrt();
    values.iter().map(|value| (value - mean) / norm.max(1e-12)).collect()
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
    fn new(names: &[String], reading: &'a Reading<'a>, projections: &'a [ProjectionFile]) -> Self {
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

/// Machines that nothing is learned from, for the report.
fn held_out(spec: &MachineSpec, settings: &TrainingSettings) -> Vec<Observation> {
    let leaks = settings.leaks_of(spec);
    dataset::draw(spec, &settings.spread, leaks, settings.held_out, settings.seed, purpose::HELD_OUT)
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
