//! The healthy machine as it was when it was commissioned, and what has become of it since.
//!
//! [`learner`] gathers a baseline from the first cycles; [`comparator`] compares each later cycle with it, by a cumulative sum over
//! cycles ([`cusum`]) and a trend with a date ([`trend`]).

pub mod comparator;
pub mod cusum;
mod error;
pub mod learner;
pub mod trend;

use seepd_model::{Model, Relative};
use serde::{Deserialize, Serialize};

pub use comparator::{BaselineComparator, LoadKnowledge};
pub use cusum::{Cusum, CusumFinding};
pub use error::BaselineError;
pub use learner::Learner;

/// Version of the file.
const SCHEMA: &str = "seepd.baseline/1";
/// Name of an axis to which nobody has given one. A baseline of such an axis can be any one's.
pub const UNNAMED_AXIS: &str = "axis";
/// Least cycles of a baseline.
pub const LEAST_CYCLES: usize = 20;
/// Most cycles of a baseline.
pub const MOST_CYCLES: usize = 1000;
/// Largest rise over a phase, share of full command: a line through samples may rise by one and a half times their range, 2.
const MOST_RISE: f64 = 3.3;
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
    /// What the command rises by over each phase, share of full command; empty in baselines of versions that named no causes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rise: Vec<f64>,
    /// Standard deviation from cycle to cycle, by phase: the machine's repeatability.
    pub deviation: Vec<f64>,
    /// The same of what the command rises by over each phase; empty in baselines of versions that did not ask.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rise_deviation: Vec<f64>,
    /// Standard deviation of the leak residual from cycle to cycle with the command alone, m².
    #[serde(rename = "response_deviation_m2")]
    pub residual_deviation_m2: f64,
    /// The same with the load, where it is known, m².
    #[serde(rename = "load_response_deviation_m2")]
    pub load_residual_deviation_m2: Option<f64>,
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
    /// [`BaselineError`]: no baseline, of a later version, learned with another model, or with numbers that make no sense.
    pub fn parse(text: &str, model: &Model) -> Result<Self, BaselineError> {
        let file: BaselineFile = serde_json::from_str(text)?;
        if file.schema != SCHEMA {
            return Err(BaselineError::OtherVersion { schema: file.schema, read: SCHEMA });
        }
        let relative = relative_of(model)?;
        if file.plant_sha256 != model.file().plant_sha256 || file.phases != phase_names(model) {
            return Err(BaselineError::OtherModel);
        }
        file.baselines.iter().try_for_each(|baseline| baseline.check(relative))?;
        Ok(file)
    }

    /// Checks that it may be an axis's; one without a name is any one's.
    ///
    /// # Errors
    /// [`BaselineError::OtherAxis`].
    pub fn check_axis(&self, axis: &str) -> Result<(), BaselineError> {
        if self.axis == axis || self.axis == UNNAMED_AXIS || axis == UNNAMED_AXIS {
            return Ok(());
        }
        Err(BaselineError::OtherAxis { of: self.axis.clone(), wanted: axis.into() })
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
/// [`BaselineError::CannotCompare`] where the model has no such part.
pub fn relative_of(model: &Model) -> Result<&Relative, BaselineError> {
    model.relative().ok_or(BaselineError::CannotCompare)
}

fn phase_names(model: &Model) -> Vec<String> {
    model.file().cycle.phases.iter().map(|phase| phase.name.clone()).collect()
}

impl Baseline {
    fn check(&self, relative: &Relative) -> Result<(), BaselineError> {
        let phases = relative.phases();
        let given = |values| if Vec::is_empty(values) { &self.mean } else { values };
        let most = 1.1;
        for (key, values, most) in [
            ("mean", &self.mean, most),
            ("rise", given(&self.rise), MOST_RISE),
            ("deviation", &self.deviation, most),
            ("rise_deviation", given(&self.rise_deviation), MOST_RISE),
        ] {
            // Negated, so that what is no number is caught as well.
            if values.len() != phases || !values.iter().all(|value| value.abs() <= most) {
                return Err(BaselineError::PhaseValues { key, phases });
            }
        }
        let positive = [self.residual_deviation_m2, self.noise]
            .into_iter()
            .chain(self.load_residual_deviation_m2)
            .all(|value| value.is_finite() && value >= 0.0);
        if !positive {
            return Err(BaselineError::Deviations);
        }
        if self.load_n.is_some_and(|load_n| !(LEAST_LOAD_N..1e12).contains(&load_n.abs())) {
            return Err(BaselineError::Load { least_n: LEAST_LOAD_N });
        }
        Ok(())
    }
}
