#![doc = include_str!("../README.md")]

pub mod claims;
pub mod cycles;
pub mod ensemble;
pub mod features;
pub mod holding;
pub mod limits;

use seepd_model::Model;
use seepd_sim::MachineSpec;
use seepd_train::report::NOISE_LEVELS;
use serde::Serialize;

/// Smallest and largest leak area of the article's experiments, m².
pub const AREAS_M2: (f64, f64) = (0.5e-7, 1e-5);

/// Everything that the study found: `seepd.study/1`.
#[derive(Debug, Clone, Serialize)]
pub struct Study {
    /// `seepd.study/1`.
    pub schema: &'static str,
    /// Seed of all random choices.
    pub seed: u64,
    /// Figures 2 and 5.
    pub cycles: Vec<cycles::CycleCurve>,
    /// Figure 6.
    pub leak_rates: Vec<cycles::LeakRate>,
    /// Figure 7.
    pub features: features::FeatureStudy,
    /// Figures 8 and 9.
    pub noise: features::NoiseStudy,
    /// The article's ensemble against the program's.
    pub ensembles: ensemble::EnsembleComparison,
    /// The smallest leak that one cycle shows.
    pub limits: Vec<limits::Limit>,
    /// The largest leak that the controller holds.
    pub holding: holding::Holding,
    /// Whether each figure agrees with the article.
    #[serde(rename = "verdicts")]
    pub claims: Vec<claims::ClaimOutcome>,
}

/// Why there is no study.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StudyError {
    /// The model was made for another cycle than the press's.
    #[error("the model does not read the nominal press's cycles: {found} of {simulated} were recognised")]
    Unrecognised {
        /// Cycles recognised.
        found: usize,
        /// Cycles simulated.
        simulated: usize,
    },
    /// The model lacks one of the article's features.
    #[error("the model has no feature `{0}`")]
    NoFeature(&'static str),
    /// The system gives no thread.
    #[error("the system gives no thread")]
    NoThread,
}

/// Steps of the study, for a progress bar.
pub const STEPS: usize = 7;

/// Makes the study for the nominal press with the model that the program brings; `tell` hears of each finished step.
///
/// # Errors
/// [`StudyError`] for a model of another machine.
pub fn run(model: &Model, seed: u64, tell: &mut dyn FnMut(usize)) -> Result<Study, StudyError> {
    let spec = MachineSpec::default();
    let mut done = 0;
    let mut step = || {
        done += 1;
        tell(done);
    };
    let cycles = cycles::curves(&spec);
    let leak_rates = cycles::leak_rates(&spec);
    step();
    let lens = features::Lens::new(model)?;
    let features = features::by_area(&lens, &spec, seed)?;
    step();
    let noise = features::by_noise(&lens, &spec, seed)?;
    step();
    let taught = ensemble::teach(&lens, &spec, seed)?;
    step();
    let ensembles = ensemble::compare(&lens, &spec, &taught, seed)?;
    step();
    let limits = limits::measure(&lens, &spec, &taught[0], seed)?;
    step();
    let holding = holding::sweep(&spec);
    step();
    let schema = "seepd.study/1";
    let mut study = Study {
        schema,
        seed,
        cycles,
        leak_rates,
        features,
        noise,
        ensembles,
        limits,
        holding,
        claims: Vec::new(),
    };
    study.claims = claims::outcomes(&study);
    Ok(study)
}

/// Values from `low` to `high` in equal ratios.
pub(crate) fn geometric(low: f64, high: f64, count: usize) -> Vec<f64> {
    (0..count).map(|index| low * (high / low).powf(index as f64 / (count - 1).max(1) as f64)).collect()
}
