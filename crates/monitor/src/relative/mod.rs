//! Monitoring without a plant: the machine's own healthy cycles as the only measure.
//!
//! Where nobody has a plant file, and so no model, the command still tells whether the machine is as it was. Its duty cycle is found
//! from the command alone ([`shape`]); the first healthy cycles give the mean and the slope of each phase and how far they scatter
//! ([`learner`]); from then on a pair of cumulative sums for each of these numbers finds what has changed for good, in which phases and
//! since when ([`charts`]). What a change is, and how large a leak, this cannot tell: there is never a size.

pub mod charts;
mod error;
pub mod learner;
pub mod monitor;
pub mod shape;

use seepd_features::{Feature, Kalman};
use seepd_model::schema::Cycle;
use serde::{Deserialize, Serialize};

use crate::baseline::UNNAMED_AXIS;

pub use charts::{Change, Charts};
pub use error::RelativeError;
pub use learner::Learner;
pub use monitor::RelativeMonitor;

/// Version of the file.
const SCHEMA: &str = "seepd.relative-baseline/1";
/// Least cycles of a baseline: from 20 that follow one another closely neither mean nor scatter is known well enough for an alarm a year.
pub const LEAST_CYCLES: usize = 30;
/// Cycles of a baseline where nobody asks for another number.
pub const USUAL_CYCLES: usize = 50;
/// The command is taken as it is: means over phases need no filter.
const NO_FILTER: Option<Kalman> = None;

/// `seepd.relative-baseline/1`: a machine's duty cycle and what its healthy cycles were like.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RelativeBaseline {
    /// `seepd.relative-baseline/1`.
    pub schema: String,
    /// Machine axis.
    pub axis: String,
    /// Program and version that wrote the file.
    pub created_by: String,
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
    /// Samples a second, Hz.
    pub sample_rate_hz: f64,
    /// The duty cycle as the command shows it.
    pub cycle: Cycle,
    /// What is compared, by its name: the mean command of each phase (`mean.PHASE`), and what the command rises by over it (`rise.PHASE`).
    pub features: Vec<FeatureBaseline>,
    /// What a person should know before trusting it.
    pub remarks: Vec<String>,
}

/// A number of the healthy cycles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FeatureBaseline {
    /// Name.
    pub name: String,
    /// Mean, share of full command.
    pub mean: f64,
    /// Standard deviation from cycle to cycle, share of full command.
    pub deviation: f64,
    /// Correlation of a cycle with the next one: what drifts slowly scatters less than it wanders.
    pub autocorrelation: f64,
}

impl RelativeBaseline {
    /// Reads and checks a file's text.
    ///
    /// # Errors
    /// [`RelativeError`]: no such baseline, of a later version, or with numbers that make no sense.
    pub fn parse(text: &str) -> Result<Self, RelativeError> {
        let file: RelativeBaseline = serde_json::from_str(text)?;
        if file.schema != SCHEMA {
            return Err(RelativeError::OtherVersion { schema: file.schema, read: SCHEMA });
        }
        file.check()?;
        Ok(file)
    }

    /// Checks that it may be an axis's; one without a name is any one's.
    ///
    /// # Errors
    /// [`RelativeError::OtherAxis`].
    pub fn check_axis(&self, axis: &str) -> Result<(), RelativeError> {
        if self.axis == axis || self.axis == UNNAMED_AXIS || axis == UNNAMED_AXIS {
            return Ok(());
        }
        Err(RelativeError::OtherAxis { of: self.axis.clone(), wanted: axis.into() })
    }

    /// The file's text.
    ///
    /// # Errors
    /// None that is known: every number of a baseline is finite.
    pub fn to_json(&self) -> serde_json::Result<String> {
        serde_json::to_string_pretty(self).map(|text| text + "\n")
    }

    fn check(&self) -> Result<(), RelativeError> {
        let wrong = |what: &'static str| Err(RelativeError::Values { what });
        if !(1.0..=100_000.0).contains(&self.sample_rate_hz) {
            return wrong("sample_rate_hz must lie in 1 … 100000");
        }
        if !(0.1..=3600.0).contains(&self.cycle.period_s) {
            return wrong("cycle.period_s must lie in 0.1 … 3600");
        }
        if self.cycle.bin_samples == 0 {
            return wrong("cycle.bin_samples must not be 0");
        }
        if !(0.0..=0.5).contains(&self.cycle.tolerance) {
            return wrong("cycle.tolerance must lie in 0 … 0.5");
        }
        let ends =
            self.cycle.anchors.iter().all(|anchor| (0.0..=self.cycle.period_s).contains(&anchor.end_s));
        if !ends || self.cycle.anchors[0].end_s >= self.cycle.anchors[1].end_s {
            return wrong("cycle.anchors must end one after the other within the period");
        }
        if self.features.len() != 2 * self.cycle.phases.len() || self.features.is_empty() {
            return wrong("features must be two for each phase");
        }
        if self.cycles < LEAST_CYCLES {
            return wrong("cycles must be at least 30");
        }
        let sensible = |feature: &FeatureBaseline| {
            feature.mean.abs() <= 10.0
                && (0.0..=10.0).contains(&feature.deviation)
                && (-1.0..=1.0).contains(&feature.autocorrelation)
        };
        if !self.features.iter().all(sensible) {
            return wrong("features: mean, deviation and autocorrelation must be those of a command");
        }
        // What the reader has no room for it says itself.
        shape::DefinedCycle::open(self.cycle.clone(), self.sample_rate_hz).map(drop)
    }
}

/// What is compared of a cycle, in the baseline's order: means, then rises.
fn features_of(phases: usize) -> Vec<Feature> {
    let index = |phase: usize| u8::try_from(phase).unwrap_or(u8::MAX);
    let means = (0..phases).map(|phase| Feature::PhaseMean(index(phase)));
    means.chain((0..phases).map(|phase| Feature::PhaseSlope(index(phase)))).collect()
}

/// Names of the same.
fn feature_names(cycle: &Cycle) -> Vec<String> {
    let named = |kind: &str| {
        let kind = kind.to_owned();
        cycle.phases.iter().map(move |phase| format!("{kind}.{}", phase.name))
    };
    named("mean").chain(named("rise")).collect()
}
