//! The healthy machine as it was when it was commissioned, and what has become of it since.
//!
//! [`learner`] gathers a baseline from the first cycles; [`follower`] compares each later cycle with it, by a cumulative sum over
//! cycles ([`drift`]) and a trend with a date ([`trend`]).

pub mod drift;
pub mod follower;
pub mod learner;
pub mod trend;

use std::path::Path;

use seepd_model::{Model, Relative};
use serde::{Deserialize, Serialize};

use crate::failure::Failure;
use crate::side_file;

pub use drift::{Drift, Finding};
pub use follower::{Follower, LoadKnowledge};
pub use learner::Learner;

/// Version of the file.
const SCHEMA: &str = "seepd.baseline/1";
/// Name of an axis to which nobody has given one. A baseline of such an axis can be any one's.
pub const UNNAMED_AXIS: &str = "axis";
/// Least cycles of a baseline.
pub const LEAST_CYCLES: usize = 20;
/// Most cycles of a baseline.
pub const MOST_CYCLES: usize = 1000;
/// Smallest mean load that can be a measure of others, N.
const LEAST_LOAD_N: f64 = 10.0;

/// A healthy machine's cycles in numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Baseline {
    /// What it was learned for: `commissioning`, `seal replaced`, or other words.
    pub occasion: String,
    /// Start of its first cycle, ns in the log's own time.
    pub from_ns: i64,
    /// End of its last cycle, ns in the log's own time.
    pub to_ns: i64,
    /// Cycles that it is the mean of.
    pub cycles: usize,
    /// Cycles that were unlike the others, and are not in it.
    pub left_out: usize,
    /// Mean command by phase, share of full command.
    pub mean: Vec<f64>,
    /// Standard deviation from cycle to cycle, by phase: the machine's repeatability.
    pub deviation: Vec<f64>,
    /// Standard deviation of the response from cycle to cycle with the command alone, m².
    pub response_deviation_m2: f64,
    /// The same with the load, where it is known, m².
    pub load_response_deviation_m2: Option<f64>,
    /// Mean load over the cycle, where it is known, N.
    pub load_n: Option<f64>,
    /// Standard deviation of the noise on the command, share of full command.
    pub noise: f64,
    /// What the simulator-trained estimate says of these cycles, m²: the median.
    pub absolute_leak_area_m2: f64,
    /// The interval of the same, m².
    pub absolute_interval90_m2: [f64; 2],
    /// What a person should know before trusting it.
    pub remarks: Vec<String>,
}

/// `seepd.baseline/1`: an axis's baselines, the newest last. Older ones are the record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BaselineFile {
    /// `seepd.baseline/1`.
    pub schema: String,
    /// Machine axis.
    pub axis: String,
    /// Program and version that wrote the file.
    pub created_by: String,
    /// Plant of the model with which it was learned, SHA-256.
    pub plant_sha256: String,
    /// Phases in the order of the means.
    pub phases: Vec<String>,
    /// Baselines, the newest last.
    pub baselines: Vec<Baseline>,
}

impl BaselineFile {
    /// A record without a baseline.
    pub fn new(axis: &str, model: &Model) -> Self {
        BaselineFile {
            schema: SCHEMA.into(),
            axis: axis.into(),
            created_by: concat!("seepd ", env!("CARGO_PKG_VERSION")).into(),
            plant_sha256: model.file().plant_sha256.clone(),
            phases: phase_names(model),
            baselines: Vec::new(),
        }
    }

    /// Reads and checks a file's text.
    ///
    /// # Errors
    /// One line: no baseline, of a later version, learned with another model, or with numbers that make no sense.
    pub fn parse(text: &str, model: &Model) -> Result<Self, String> {
        let file: BaselineFile =
            serde_json::from_str(text).map_err(|error| format!("is no baseline: {error}"))?;
        if file.schema != SCHEMA {
            return Err(format!("has the schema {}; this version reads {SCHEMA}", file.schema));
        }
        let relative = relative_of(model)?;
        if file.plant_sha256 != model.file().plant_sha256 || file.phases != phase_names(model) {
            return Err(
                "was learned with another model; learn it again with this one: seepd learn-baseline".into()
            );
        }
        file.baselines.iter().try_for_each(|baseline| baseline.check(relative))?;
        Ok(file)
    }

    /// Reads and checks an axis's file.
    ///
    /// # Errors
    /// [`Failure`] with the file's name, of another axis's file too.
    pub fn read(path: &Path, axis: &str, model: &Model) -> Result<Self, Failure> {
        let text = side_file::read_text(path).map_err(|error| Failure::reading(path, &error))?;
        let file = Self::parse(&text, model).map_err(|message| Failure::configuration(path, message))?;
        if file.axis != axis && file.axis != UNNAMED_AXIS && axis != UNNAMED_AXIS {
            let what = format!("is the baseline of axis {}, not of {axis}", file.axis);
            return Err(Failure::configuration(path, what));
        }
        Ok(file)
    }

    /// The baseline that counts.
    pub fn newest(&self) -> Option<&Baseline> {
        self.baselines.last()
    }

    /// The file's text.
    ///
    /// # Errors
    /// None that is known: every number of a baseline is finite.
    pub fn to_json(&self) -> serde_json::Result<String> {
        serde_json::to_string_pretty(self).map(|text| text + "\n")
    }
}

/// What compares with a baseline.
///
/// # Errors
/// One line where the model has no such part.
pub fn relative_of(model: &Model) -> Result<&Relative, String> {
    model
        .relative()
        .ok_or_else(|| "the model has no estimates relative to a baseline; train it anew: seepd train".into())
}

fn phase_names(model: &Model) -> Vec<String> {
    model.file().cycle.phases.iter().map(|phase| phase.name.clone()).collect()
}

impl Baseline {
    fn check(&self, relative: &Relative) -> Result<(), String> {
        let phases = relative.phases();
        for (name, values) in [("mean", &self.mean), ("deviation", &self.deviation)] {
            // Negated, so that what is no number is caught as well.
            if values.len() != phases || !values.iter().all(|value| value.abs() <= 1.1) {
                return Err(format!("baselines: {name} must have {phases} values within full command"));
            }
        }
        let positive = [self.response_deviation_m2, self.noise]
            .into_iter()
            .chain(self.load_response_deviation_m2)
            .all(|value| value.is_finite() && value >= 0.0);
        if !positive {
            return Err("baselines: deviations and noise must be finite and not negative".into());
        }
        if self.load_n.is_some_and(|load_n| !(LEAST_LOAD_N..1e12).contains(&load_n.abs())) {
            return Err(format!("baselines: load_n must be null, or {LEAST_LOAD_N} N at least"));
        }
        Ok(())
    }
}
