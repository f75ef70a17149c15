//! What a diagnosis says: `seepd.gap/1`.

use std::collections::BTreeMap;

use seepd_sim::SensorError;
use serde::Serialize;

use crate::course::ChangeKind;
use crate::next_test::NextTest;
use crate::simulate::BinnedSignals;

/// `seepd.gap/1`.
#[derive(Debug, Clone, Serialize)]
pub struct Diagnosis {
    /// `seepd.gap/1`.
    pub schema: &'static str,
    /// Cycles.
    pub cycles: CycleCounts,
    /// Signals that were compared.
    pub signals: Vec<&'static str>,
    /// RMS over range of each signal's cycle-to-cycle part.
    pub floor: BTreeMap<&'static str, f64>,
    /// RMS over range of the differences on held-out cycles.
    pub gap: Gaps,
    /// Where the calibrated machine's gap is, largest first; sums to 1.
    #[serde(rename = "where")]
    pub places: Vec<Place>,
    /// The conclusion.
    pub verdict: Verdict,
    /// Why there is none, or what limits it.
    pub reason: Option<String>,
    /// Wall time, s.
    pub seconds: f64,
    /// Effects, most likely first.
    pub effects: Vec<RankedEffect>,
    /// Probability that the cause is not in the catalogue.
    pub unknown_probability: f64,
    /// Probability that there is no effect.
    pub no_effect_probability: f64,
    /// Where no effect explains the log: the laws that were learned in its place, most likely first.
    pub learned: Vec<LearnedCurve>,
    /// What would tell the remaining explanations apart, where it was asked for.
    pub next_test: Option<NextTest>,
    /// Effects that the machine is given.
    pub chosen: Vec<&'static str>,
    /// How far the gap shrinks on held-out cycles.
    pub shrink: Shrink,
    /// The plant's own parameters as calibrated, by symbol.
    #[serde(rename = "retuned")]
    pub calibrated: BTreeMap<String, CalibratedValue>,
    /// The leak under each machine, m².
    pub leak: Leaks,
    /// What would tell apart what this log cannot.
    pub distinguish: Vec<String>,
    /// How far each pressure's sensor is most likely off, beside the machine as diagnosed; where that leaves a gap, only what a
    /// sensor of its class may be off by.
    pub sensors: BTreeMap<&'static str, SensorError>,
    /// How the machine changed within the log; what is diagnosed then is the machine as it is at its end.
    pub change: Option<ChangeWithin>,
    /// What to know of the log.
    pub notes: Vec<String>,
    /// What was recorded and simulated, for plots.
    #[serde(skip)]
    pub curves: Curves,
}

impl Diagnosis {
    /// What to say below the answers where two effects may be there at once, so that their presences come to more than 1 with the others.
    pub fn note_on_presences(&self) -> Option<&'static str> {
        let presences: f64 = self.effects.iter().map(|effect| effect.presence_probability).sum();
        let is_shared = presences + self.unknown_probability + self.no_effect_probability > 1.005;
        is_shared.then_some(
            "Causes may act together: each has the probability that it is there, whatever else is.",
        )
    }
}

/// Signals over a cycle, in bins, by place in [`Diagnosis::signals`].
#[derive(Debug, Clone, Default)]
pub struct Curves {
    /// Time in the cycle, s.
    pub t_s: Vec<f64>,
    /// Mean of the held-out cycles.
    pub recorded: BinnedSignals,
    /// The plant file's machine, its leak fitted.
    pub nominal: BinnedSignals,
    /// The calibrated machine.
    pub calibrated: BinnedSignals,
    /// The machine with the chosen effects.
    pub chosen: BinnedSignals,
    /// Name of each phase with its start and end, s.
    pub phases: Vec<(&'static str, f64, f64)>,
}

/// A change within a log.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChangeWithin {
    /// A step or a drift.
    pub kind: ChangeKind,
    /// Number of the first cycle of the machine as diagnosed, from 1, among those used.
    pub from_cycle: usize,
    /// Values of the chosen effects before it, of a drift at its beginning, by effect and parameter.
    pub before: BTreeMap<&'static str, BTreeMap<&'static str, f64>>,
}

/// Numbers of cycles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct CycleCounts {
    /// In all.
    pub used: usize,
    /// That were fitted to.
    pub fit: usize,
    /// That the gaps are of.
    pub held_out: usize,
}

/// Gaps by signal.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Gaps {
    /// Of the plant file's machine, its leak fitted.
    pub nominal: BTreeMap<&'static str, f64>,
    /// Of the calibrated machine.
    #[serde(rename = "retuned")]
    pub calibrated: BTreeMap<&'static str, f64>,
    /// Of the machine with the chosen effects.
    pub chosen: BTreeMap<&'static str, f64>,
}

/// A part of the gap.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Place {
    /// The equation that does not balance.
    pub equation: &'static str,
    /// Phase of the duty cycle.
    pub phase: &'static str,
    /// The signal that shows it most there.
    pub signal: &'static str,
    /// Share of the whole.
    pub share: f64,
}

/// The conclusion of a diagnosis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The plant file's machine shows what the log shows.
    NoGap,
    /// Other parameters explain the difference.
    Parameters,
    /// An effect does.
    Effect,
    /// There is a difference, and nothing that the catalogue has explains it.
    Unknown,
    /// The log does not tell.
    CannotTell,
}

/// An effect with its probability.
#[derive(Debug, Clone, Serialize)]
pub struct RankedEffect {
    /// Key.
    pub effect: &'static str,
    /// Its law.
    pub law: &'static str,
    /// Probability that it is the main cause; with those of no effect and of a cause that the catalogue lacks, these sum to 1.
    pub probability: f64,
    /// Probability that the machine has it, alone or beside others.
    pub presence_probability: f64,
    /// Values.
    pub parameters: BTreeMap<&'static str, f64>,
    /// Their 95 % intervals.
    pub interval95: BTreeMap<&'static str, [f64; 2]>,
    /// Share of the removable gap that it removes, with calibration, on held-out cycles.
    pub shrink: f64,
    /// Effects whose signature is the same in this log.
    pub equivalent: Vec<&'static str>,
}

/// A law without a name: a curve at a place of the machine.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LearnedCurve {
    /// Key in plant files.
    pub effect: &'static str,
    /// Where it acts, in words.
    pub place: &'static str,
    /// What it depends on, in words.
    pub argument: &'static str,
    /// Units of the argument and of the values.
    pub units: [&'static str; 2],
    /// How it acts, with its equation.
    pub law: &'static str,
    /// Probability that the cause is there, along that.
    pub probability: f64,
    /// Whether the machine was given it: the held-out cycles bear it out.
    pub adopted: bool,
    /// Share of the removable gap that it removes, with calibration, on held-out cycles.
    pub shrink: f64,
    /// What the curve resembles.
    pub resembles: String,
    /// The argument at the curve's knots.
    pub at: Vec<f64>,
    /// The curve.
    pub values: Vec<f64>,
    /// Its 95 % band.
    pub band95: Vec<[f64; 2]>,
    /// Whether the record says anything of it there.
    pub visited: Vec<bool>,
}

/// How far the gap shrinks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Shrink {
    /// With the chosen effects, share of what is above the floor.
    pub of_removable: f64,
    /// With the chosen effects, share of the whole.
    pub of_total: f64,
    /// With calibration alone, share of what is above the floor.
    #[serde(rename = "retune_only")]
    pub calibration_only: f64,
    /// Part of the first that each chosen effect has beyond calibration (Shapley values): with `calibration_only` they add up to it.
    pub by_effect: BTreeMap<&'static str, f64>,
}

/// A calibrated parameter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CalibratedValue {
    /// In the plant file.
    pub nominal: f64,
    /// As fitted.
    pub fitted: f64,
    /// Its 95 % interval.
    pub interval95: [f64; 2],
}

/// Leak estimates, m²; NaN (`null`) for an axis without a leak.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Leaks {
    /// By the plant file's machine.
    pub nominal_m2: f64,
    /// By the calibrated machine.
    #[serde(rename = "retuned_m2")]
    pub calibrated_m2: f64,
    /// With the chosen effects.
    pub chosen_m2: f64,
}
