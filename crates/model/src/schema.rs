//! The structure of `model.json`, as written in the file.

use alloc::string::String;
use alloc::vec::Vec;

use seepd_features::{Anchor, Anchors, CycleDefinition, DemandMark, Kalman, Phase, PhaseKind, Projections};
use serde::{Deserialize, Serialize};

use crate::causes::Kind;

/// The `schema` field of this version.
pub const SCHEMA: &str = "seepd.model/2";
/// What is read: version 1 is version 2 without `causes`.
pub const READ_SCHEMAS: [&str; 2] = ["seepd.model/1", SCHEMA];

/// A `seepd.model/2` file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelFile {
    /// One of [`READ_SCHEMAS`].
    pub schema: String,
    /// Program and version that wrote the file.
    pub created_by: String,
    /// Samples a second of the command, Hz.
    pub sample_rate_hz: f64,
    /// Filter before everything else; absent: none.
    #[serde(default)]
    pub filter: Option<Filter>,
    /// The duty cycle.
    pub cycle: Cycle,
    /// Directions in the space of the cycle's bins, read as features by their names.
    #[serde(default)]
    pub projections: Vec<ProjectionFile>,
    /// Names of the features, in the order in which the trees count them.
    pub features: Vec<String>,
    /// What is estimated: `leak_area`.
    pub target: String,
    /// Its unit: `m2`.
    pub unit: String,
    /// Between the trees' values and the target.
    pub transform: Transform,
    /// The trees, each with the same weight.
    pub trees: Vec<Tree>,
    /// Interval around the estimate.
    pub calibration: Calibration,
    /// What the phases' mean commands look like, by range of the estimate, ascending; empty: not known, and
    /// no cycle counts as out of distribution.
    #[serde(rename = "novelty", default, skip_serializing_if = "Vec::is_empty")]
    pub training_distributions: Vec<TrainingDistribution>,
    /// How an area becomes a flow.
    pub orifice: Orifice,
    /// SHA-256 of the plant file on which the model was trained, hexadecimal; empty if there was none.
    pub plant_sha256: String,
    /// Inputs with the outputs that the model must give for them.
    pub golden: Vec<Golden>,
    /// Estimates relative to a baseline; absent: none.
    #[serde(default)]
    pub relative: Option<RelativeFile>,
    /// Causes of changes since a baseline; absent: changes are taken for leaks, or refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub causes: Option<CausesFile>,
    /// What the training measured, for people.
    #[serde(default)]
    pub training: Option<Training>,
}

/// The filter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Filter {
    /// One-dimensional Kalman filter of a random walk.
    Kalman(Kalman),
}

/// The duty cycle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cycle {
    /// Period, s.
    pub period_s: f64,
    /// Samples in a bin.
    pub bin_samples: usize,
    /// How far the distance between the anchors may be off plan, share of the period; with further anchors, of that distance.
    pub tolerance: f64,
    /// The largest stroke out and the largest back, in time order, by whose shape cycles are found.
    pub anchors: [Anchor<Vec<f32>>; 2],
    /// Other strokes: with them cycles are found by the order of all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub further_anchors: Vec<Anchor<Vec<f32>>>,
    /// Where the demand tells the start of a cycle.
    #[serde(default)]
    pub demand_mark: Option<DemandMark>,
    /// Parts of the cycle.
    pub phases: Vec<PhaseFile>,
}

impl Cycle {
    /// The phases as the reader wants them.
    pub fn phase_list(&self) -> Vec<Phase> {
        self.phases
            .iter()
            .map(|phase| Phase { from_s: phase.from_s, to_s: phase.to_s, kind: phase.kind })
            .collect()
    }

    /// The cycle as the reader wants it; `phases` from [`Cycle::phase_list`], `projections` of values from [`ProjectionFile::values`].
    pub fn definition<'m>(
        &'m self,
        sample_rate_hz: f64,
        phases: &'m [Phase],
        projections: Projections<'m>,
    ) -> CycleDefinition<'m> {
        let [first, last] = &self.anchors;
        CycleDefinition {
            sample_rate_hz,
            period_s: self.period_s,
            bin_samples: self.bin_samples,
            anchors: Anchors::new(
                [first.borrowed(), last.borrowed()],
                self.further_anchors.iter().map(Anchor::borrowed),
            ),
            demand_mark: self.demand_mark,
            tolerance: self.tolerance,
            phases,
            projections,
        }
    }
}

/// A part of the cycle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhaseFile {
    /// Name, as in features such as `mean.NAME`.
    pub name: String,
    /// Start in the cycle, s.
    pub from_s: f64,
    /// End in the cycle, s.
    pub to_s: f64,
    /// Moving or standing.
    pub kind: PhaseKind,
}

/// A direction in the space of the cycle's bins.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProjectionFile {
    /// Name, as in `features`.
    pub name: String,
    /// Bin values to subtract.
    pub mean: Vec<f32>,
    /// Direction.
    pub loading: Vec<f32>,
}

impl ProjectionFile {
    /// Means and loadings one after the other, as [`Projections`] wants them.
    pub fn values(projections: &[ProjectionFile]) -> Vec<f32> {
        projections
            .iter()
            .flat_map(|projection| projection.mean.iter().chain(&projection.loading))
            .copied()
            .collect()
    }
}

/// Between the trees' values y and the target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Transform {
    /// y is the target.
    Identity,
    /// y = ln(target + offset): relative errors count alike over decades, and 0 is admitted.
    LnOffset(f64),
}

/// A tree as flat arrays in preorder: an inner node's left child is the next node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tree {
    /// Index into the features; −1 for a leaf.
    pub feature: Vec<i32>,
    /// Threshold of an inner node (left where value ≤ threshold); prediction of a leaf.
    pub value: Vec<f64>,
    /// Index of an inner node's right child; 0 for a leaf.
    pub right: Vec<u32>,
}

/// Interval around the estimate, calibrated on observations that a tree has not seen.
///
/// Half width in the transformed target: factor(y) · (spread of the trees + `spread_floor`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Share of machines whose truth the interval holds.
    pub level: f64,
    /// Added to the spread.
    pub spread_floor: f64,
    /// Prediction y and factor there, ascending in y; linear between. Where the noise is not known.
    pub factors: Vec<(f64, f64)>,
    /// The same for standard deviations of the command's noise, ascending; linear between in the noise's logarithm.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub by_noise: Vec<(f64, Vec<(f64, f64)>)>,
    /// Largest estimate that a machine without a leak gives, in the target's unit: the interval of anything up to it begins at 0.
    #[serde(default)]
    pub healthy_limit: f64,
}

/// How a leak is estimated relative to the healthy machine's own baseline: from the change of each phase's mean command.
///
/// With the changes δ, the baseline's means less their own mean, standardised, as b, and where known the load's relative change as one more
/// δ, the
/// *leak residual* is the polynomial `Σ c δ_i + Σ c δ_i δ_j (i ≤ j) + Σ (c δ_i b_j + c' δ_i² b_j + c" δ_i b_j²)`, in m² of leak area, coefficients in
/// this order. It may be negative. The trees, over b, δ (without the load) and `ln(residual + offset)`, correct the latter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RelativeFile {
    /// Mean over healthy machines of each phase's mean command less that of all phases, in the phases' order.
    pub baseline_mean: Vec<f64>,
    /// Their standard deviation.
    pub baseline_scale: Vec<f64>,
    /// The dead band of a valve, as its baseline shows it.
    pub deadband: DeadbandFile,
    /// Offset of the logarithm, m².
    pub offset_m2: f64,
    /// With the command alone.
    pub command: ViewFile,
    /// With the command and the load.
    pub load: ViewFile,
    /// The trees.
    pub trees: Vec<Tree>,
    /// What changes look like, by range of the estimate, ascending.
    #[serde(rename = "novelty")]
    pub training_distributions: Vec<TrainingDistribution>,
    /// Largest relative change of the load that is like training.
    pub largest_load_change: f64,
    /// Where the change counts as a leak, by a cumulative sum over cycles.
    pub detection: DetectionFile,
    /// The piston's areas, for a load from the chambers' pressures: cap side and annulus, m².
    pub piston_areas_m2: [f64; 2],
    /// Inputs with the outputs that must come out.
    pub golden: Vec<RelativeGolden>,
}

/// How a baseline shows the dead band of the machine's valve beyond that of the plant file: half width, share of full command, linear in
/// the baseline's means less their own mean, standardised. Estimates for a machine with a dead band are less certain, and load, oil and
/// supply move its leak residual more: each view has a [`KindFile`] for machines without and one for machines with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeadbandFile {
    /// Where every standardised mean is 0.
    pub intercept: f64,
    /// What it grows by with each of them.
    pub slopes: Vec<f64>,
    /// Most that the baseline of a machine without one shows.
    pub limit: f64,
}

/// The estimate from certain signals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewFile {
    /// Coefficients of the leak residual, m².
    #[serde(rename = "response")]
    pub leak_residual: Vec<f64>,
    /// For machines whose baseline shows no dead band.
    pub plain: KindFile,
    /// For those whose baseline shows one.
    pub deadband: KindFile,
}

/// How far estimates for machines of a kind go wrong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KindFile {
    /// Interval around the estimate.
    pub calibration: Calibration,
    /// Largest leak residual that load, oil and supply give a healthy machine for long, m².
    pub reference_m2: f64,
}

/// The training data where the transformed estimate y is at least `from_y`: the phases' mean commands, or the changes of these since the
/// baseline, as a normal distribution.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingDistribution {
    /// Least transformed estimate.
    pub from_y: f64,
    /// Mean by phase.
    pub mean: Vec<f64>,
    /// Inverse of the covariance's Cholesky factor, rows one after the other, each up to its diagonal.
    pub whitening: Vec<f64>,
    /// Largest distance (root mean square of the whitened difference from the mean) that counts as in distribution.
    pub limit: f64,
}

/// The CUSUM (Page, "Continuous inspection schemes", Biometrika 41 (1954)) of a machine's leak residuals: `S = max(0, S + (residual −
/// reference)/σ − 0.5)`, σ the baseline's own standard deviation of the leak residual.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DetectionFile {
    /// Value of the sum at which a change is reported, 1.
    pub threshold: f64,
    /// Cycles between two false alarms, on average, of a healthy machine at the worst of its conditions.
    pub cycles_between_false_alarms: f64,
}

/// An input of the relative estimate with its output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RelativeGolden {
    /// The baseline's mean command by phase.
    pub baseline: Vec<f64>,
    /// The cycle's mean command by phase.
    pub present: Vec<f64>,
    /// The load over the baseline's, less 1.
    #[serde(default)]
    pub load_change: Option<f64>,
    /// Standard deviation of the command's noise.
    pub noise: f64,
    /// Estimate, m².
    pub estimate: f64,
    /// Interval's ends, m².
    pub interval: [f64; 2],
    /// Leak residual, m².
    #[serde(rename = "response")]
    pub leak_residual: f64,
}

/// How causes of a change are told apart.
///
/// The change δ of the phases' means and rises, as `z = B δ`, has noise of variance σ² in each coordinate, where the command's has σ², and
/// of what load, oil and supply ordinarily do the variance `ordinary`, in no two coordinates together. With the weights `w = 1/√(σ² +
/// ordinary)` a cell's likelihood is normal about `w·mean`, with covariance `1 + error² |w·z|²/n` in each of the n coordinates, and that of
/// its directions. Means of two cells add, and so do their errors, that of the seal then of its own `|w·mean|² + Σ |w·direction|²`, that of
/// the other of what the seal's mean leaves of `w·z`. An error of 0.2 and more is that of a law that nobody has simulated: the likelihood
/// is the mean of that with it and of that with `error² − 0.2² + 0.05²`. Where [`errors_are_even`](Self::errors_are_even), the weights are
/// `w = 1/√(σ² + ordinary + e²)` with `e² = error² |z|²/n`, the covariance 1 and that of the directions, and lengths those without weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CausesFile {
    /// B, rows one after the other.
    pub basis: Vec<f64>,
    /// Its inverse.
    pub inverse: Vec<f64>,
    /// Variance of what load, oil and supply do within their ordinary range, by coordinate.
    pub ordinary: Vec<f64>,
    /// Squared distance over the number of coordinates from which on a change has none of these causes.
    pub known_limit: f64,
    /// Cosine of a cause's response and a leak's, both in units of noise and ordinary variation, from which on the two are one class.
    #[serde(default = "alike_from", skip_serializing_if = "is_usual_alike_from")]
    pub alike_from: f64,
    /// Whether a leak that is named has the middle size of its explanation's, the regression's and that without a baseline: the explanation's
    /// responses have room for a plant that is not quite the machine, which the regression of the leak residual has not. A leak in doubt is no
    /// larger than its explanation leaves open then, and a baseline that seems to show a dead band is explained all the same.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    pub sizes_leaks: bool,
    /// Whether the plant was fitted to the machine's own log. Of one that was not nobody knows the valve's null, which the estimate without a
    /// baseline takes for a leak: it has no vote on a leak's size.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    pub fitted: bool,
    /// Whether the plant has the machine's own dead band, or is known to have none: a baseline that seems to show a further one is explained
    /// all the same.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    pub knows_dead_band: bool,
    /// Whether a shifted null that answers as a leak does is weighed by its likelihood, and not by what was known beforehand alone: its
    /// response is exact.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    pub null_is_exact: bool,
    /// Whether laws' errors are as large in each coordinate of noise, and not in units of noise and ordinary variation.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    pub errors_are_even: bool,
    /// Causes at ranges of sizes.
    pub cells: Vec<CellFile>,
    /// Inputs with the outputs that must come out.
    pub golden: Vec<CausesGolden>,
}

/// Where a file does not say: responses whose angle is below 18 degrees.
fn alike_from() -> f64 {
    0.95
}

fn is_usual_alike_from(value: &f64) -> bool {
    *value == alike_from()
}

/// A cause at a range of sizes: the response's distribution over machines, days, laws, and sizes within the range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellFile {
    /// The cause.
    pub kind: Kind,
    /// Of a leak: whether it follows laws other than an orifice's, where the model's estimates have not learned them, or its plant is not known
    /// well enough to tell them.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    pub other_law: bool,
    /// Of another cause: whether it is one class with a leak whatever the responses say.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    pub alike: bool,
    /// Mean size, in the kind's unit.
    pub size: f64,
    /// What the size changes by along each direction's standard deviation.
    pub size_loadings: Vec<f64>,
    /// Standard deviation of the size beside that.
    pub size_rest: f64,
    /// Error of the response that no direction has, over its length.
    pub error: f64,
    /// Mean response, in coordinates.
    pub mean: Vec<f32>,
    /// Directions in which responses differ most, each as long as its standard deviation.
    pub directions: Vec<Vec<f32>>,
}

/// A change with what it must be taken for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CausesGolden {
    /// Changes of means, then of rises, by phase.
    pub numbers: Vec<f64>,
    /// Standard deviation of the noise left on the command.
    pub noise: f64,
    /// Probability that nothing has changed.
    pub none: f64,
    /// Probability that the seal has.
    pub seal: f64,
    /// Distance from the nearest hypothesis.
    pub distance: f64,
}

/// How an area becomes a flow: `C_d A √(2 Δp / ρ)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Orifice {
    /// Discharge coefficient, 1.
    pub discharge_coefficient: f64,
    /// Oil density, kg/m³.
    pub density_kg_per_m3: f64,
}

/// An input with its output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Golden {
    /// Features in the model's order.
    pub features: Vec<f64>,
    /// Target.
    pub estimate: f64,
    /// Interval's ends.
    pub interval: [f64; 2],
}

/// What the training measured on machines that it had not seen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Training {
    /// Seed.
    pub seed: u64,
    /// Observations.
    pub observations: usize,
    /// Coefficient of determination on the target.
    pub r2: f64,
    /// Coefficient of determination on the transformed target.
    pub r2_transformed: f64,
    /// Lower and upper end of a range of the target and the median relative error there.
    pub median_relative_error: Vec<(f64, f64, f64)>,
}
