//! What the pipeline says, in the form in which programs read it.

use std::collections::BTreeMap;
use std::fmt;

use seepd_model::causes::{Candidate, Cause, Side, SizeUnit};
use serde::ser::SerializeMap;
use serde::{Deserialize, Serialize, Serializer};

use crate::baseline::trend::TimeTo;
use crate::baseline::{CusumFinding, LoadKnowledge};
use crate::cause::LISTED_FROM;
use crate::cause::course::Condition;
use crate::energy::Loss;
use crate::pipeline::observer::Observation;
use crate::repair::Repaired;

/// L/min in a m³/s.
pub const LPM_PER_M3_PER_S: f64 = 60_000.0;

/// A machine's condition.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Flag {
    /// There is nothing to base a statement on.
    NoEstimate,
    /// No leak that matters.
    Healthy,
    /// A leak to keep an eye on.
    Watch,
    /// A leak at which the seal's change is to be planned.
    Leak,
    /// A leak that the machine should not run with.
    Severe,
}

impl Flag {
    /// The flag's name in messages.
    pub const fn name(self) -> &'static str {
        match self {
            Flag::NoEstimate => "no_estimate",
            Flag::Healthy => "healthy",
            Flag::Watch => "watch",
            Flag::Leak => "leak",
            Flag::Severe => "severe",
        }
    }
}

/// Names and values of a cycle's features, in the model's order.
#[derive(Debug, Clone, Copy)]
pub struct FeatureValues<'a> {
    /// Names.
    pub names: &'a [String],
    /// Values.
    pub values: &'a [f64],
}

impl FeatureValues<'_> {
    /// The value of that name.
    pub fn get(&self, name: &str) -> Option<f64> {
        let index = self.names.iter().position(|known| known == name)?;
        self.values.get(index).copied()
    }
}

impl Serialize for FeatureValues<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.values.len()))?;
        for (name, value) in self.names.iter().zip(self.values) {
            map.serialize_entry(name, value)?;
        }
        map.end()
    }
}

/// `seepd.cycle/1`: a cycle's line.
#[derive(Debug, Clone, Serialize)]
pub struct CycleLine<'a> {
    /// `seepd.cycle/1`.
    pub schema: &'static str,
    /// Machine axis.
    pub axis: &'a str,
    /// Number of the cycle, from 0; rejected cycles count too.
    pub cycle: u64,
    /// Name of the duty cycle, where the axis has several and one of them knows it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duty_cycle: Option<&'a str>,
    /// Start, s from the log's first sample.
    pub t_start_s: f64,
    /// End, s from the log's first sample.
    pub t_end_s: f64,
    /// Start, ns in the log's own time.
    pub t_start_ns: i64,
    /// Estimate, m².
    pub leak_area_m2: Option<f64>,
    /// Interval that holds the truth nine times in ten, m².
    pub interval90_m2: Option<[f64; 2]>,
    /// Flow of the leak orifice at the reference pressure difference, L/min.
    pub leak_flow_lpm: Option<f64>,
    /// Reference pressure difference, Pa.
    pub reference_dp_pa: f64,
    /// Condition after this cycle; `no_estimate` for a rejected one.
    pub flag: Flag,
    /// Why there is no estimate.
    pub reason: Option<&'static str>,
    /// What the simulator-trained model says by itself; its fields are absent for a rejected cycle.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub absolute: Option<AbsoluteLine<'a>>,
    /// What the comparison with a baseline says; its fields are absent where there is none.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub comparison: Option<ComparisonLine<'a>>,
    /// What has changed since the baseline; its fields are absent without one, or where the model names no causes.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub cause: Option<CauseLine<'a>>,
    /// What the comparison says on an axis without a model; its fields are absent elsewhere, and while the baseline is learned.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub relative: Option<RelativeLine<'a>>,
    /// Features by name; absent for a rejected cycle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub features: Option<FeatureValues<'a>>,
}

/// The simulator-trained estimate, which knows no baseline: fields of a cycle's line, and without a baseline the line's own estimate.
#[derive(Debug, Clone, Serialize)]
pub struct AbsoluteLine<'a> {
    /// Estimate, m².
    pub absolute_leak_area_m2: f64,
    /// Its interval, m².
    pub absolute_interval90_m2: [f64; 2],
    /// Out-of-distribution score: distance from the machines of training, over its limit; above 1 there is no estimate without a baseline.
    #[serde(rename = "absolute_novelty")]
    pub absolute_out_of_distribution: f64,
    /// What each feature contributes to the natural logarithm of the estimate: how far it lies from what training expects of any machine.
    pub absolute_why: FeatureValues<'a>,
}

/// A cycle's comparison with the machine's baseline: fields of its line. The line's own estimate is then relative to the baseline.
#[derive(Debug, Clone, Serialize)]
pub struct ComparisonLine<'a> {
    /// The leak residual, m²: around 0 for a machine that is as it was at its baseline, negative as often as not.
    #[serde(rename = "response_m2")]
    pub leak_residual_m2: f64,
    /// Out-of-distribution score: distance from what training has seen, over its limit; above 1 there is no estimate.
    #[serde(rename = "novelty")]
    pub out_of_distribution: f64,
    /// What is known of the load.
    pub load: LoadKnowledge,
    /// Load over the baseline's, less 1.
    pub load_change: Option<f64>,
    /// What the CUSUM says.
    pub finding: CusumFinding,
    /// CUSUM for a leak, standard deviations of the leak residual.
    #[serde(rename = "drift_sum")]
    pub cusum: f64,
    /// When the flag `leak` is to be expected, from the end of this cycle; null where no growth is certain.
    pub time_to_leak: Option<TimeTo>,
    /// The same for `severe`.
    pub time_to_severe: Option<TimeTo>,
    /// What each phase, and the load, contributes to the leak residual, m².
    pub why: FeatureValues<'a>,
}

/// What has changed since the baseline: fields of a cycle's line.
#[derive(Debug, Clone, Serialize)]
pub struct CauseLine<'a> {
    /// `none`, a cause, `unknown` or `cannot_tell`.
    pub cause: &'static str,
    /// Its probability.
    pub cause_probability: f64,
    /// The second of a pair; a leak comes first.
    pub cause_also: Option<&'static str>,
    /// What it may be, most probable first.
    pub cause_candidates: Candidates<'a>,
    /// What would tell the candidates apart; empty where one is named.
    pub distinguish: Vec<&'static str>,
    /// Number of the cycle in which the change was first seen; null where nothing has changed.
    pub onset_cycle: Option<u64>,
    /// Causes beside the seal that have been found over cycles, the surest first.
    pub conditions: &'a [Condition],
}

/// Candidates as they are written, without improbable ones.
#[derive(Debug, Clone, Copy)]
pub struct Candidates<'a>(pub &'a [Candidate]);

impl Serialize for Candidates<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Line {
            cause: Cause,
            #[serde(skip_serializing_if = "Option::is_none")]
            side: Option<Side>,
            probability: f64,
            size: f64,
            unit: SizeUnit,
            interval90: [f64; 2],
        }
        let listed = self.0.iter().filter(|candidate| candidate.probability >= LISTED_FROM);
        serializer.collect_seq(listed.map(|Candidate { kind, probability, size, interval90 }| Line {
            cause: kind.cause,
            side: kind.side,
            probability: *probability,
            size: *size,
            unit: kind.unit,
            interval90: *interval90,
        }))
    }
}

/// A cycle's comparison with the baseline of an axis without a model: fields of its line.
#[derive(Debug, Clone, Serialize)]
pub struct RelativeLine<'a> {
    /// Distance from the baseline: root mean square of the standardised numbers, about 1 for a healthy machine.
    pub distance: f64,
    /// Whether the sums over cycles find a change.
    pub changed: bool,
    /// The largest of the sums over its threshold.
    pub largest_sum: f64,
    /// About when the change began, s from the log's first sample; null where there is none.
    pub changed_since_s: Option<f64>,
    /// The numbers' differences from the baseline, in its standard deviations from cycle to cycle.
    pub standardised: FeatureValues<'a>,
}

impl CycleLine<'_> {
    /// End, ns in the log's own time.
    pub fn t_end_ns(&self) -> i64 {
        let length_ns = ((self.t_end_s - self.t_start_s) * 1e9).round() as i64;
        self.t_start_ns.saturating_add(length_ns)
    }
}

/// What a change of flag is based on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evidence {
    /// What has decided.
    pub grounds: Grounds,
    /// Cycles in a row that agree.
    pub cycles: u32,
    /// Smallest flow among them, L/min.
    pub lowest_lpm: Option<f64>,
    /// Largest flow among them, L/min.
    pub highest_lpm: Option<f64>,
    /// The threshold that was passed, L/min.
    pub threshold_lpm: Option<f64>,
    /// Why there is no estimate.
    pub reason: Option<&'static str>,
}

/// What decided a change of flag.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Grounds {
    /// Estimates at or above the flag's threshold.
    AboveThreshold,
    /// The sums over cycles, which find leaks below the threshold.
    SumOverCycles,
    /// Estimates below a share of the former flag's threshold.
    BelowThreshold,
    /// The sums over cycles of an axis without a model, which find that something has changed.
    Changed,
    /// They find no change any more, or none yet.
    AsAtBaseline,
    /// There is an estimate again.
    Estimate,
    /// There is none any more.
    NoEstimate,
}

impl fmt::Display for Evidence {
    /// The grounds in words, without a full stop.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(reason) = self.reason {
            return f.write_str(&reason.replace('_', " "));
        }
        let cycles = |count: u32| if count == 1 { "1 cycle".to_owned() } else { format!("{count} cycles") };
        match self.grounds {
            Grounds::Changed => {
                return write!(
                    f,
                    "the sums over cycles find a change since the baseline, {}",
                    cycles(self.cycles)
                );
            }
            Grounds::AsAtBaseline => return write!(f, "{} as at the baseline", cycles(self.cycles)),
            _ => {}
        }
        if self.grounds == Grounds::SumOverCycles {
            f.write_str("the CUSUM finds more leakage than at the baseline, ")?;
        }
        match self.cycles {
            1 => f.write_str("1 cycle at ")?,
            cycles => write!(f, "{cycles} cycles at ")?,
        }
        let (low, high) = (self.lowest_lpm.unwrap_or(0.0), self.highest_lpm.unwrap_or(0.0));
        if self.cycles > 1 {
            write!(f, "{low:.3} … ")?;
        }
        write!(f, "{high:.3} L/min")?;
        match (self.grounds, self.threshold_lpm) {
            (Grounds::AboveThreshold, Some(threshold)) => write!(f, ", threshold {threshold} L/min"),
            (Grounds::BelowThreshold, Some(threshold)) => {
                write!(f, ", below the threshold of {threshold} L/min")
            }
            _ => Ok(()),
        }
    }
}

/// `seepd.event/1`: a raise, a clear or a loss of estimate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlagEvent<'a> {
    /// `seepd.event/1`.
    pub schema: &'static str,
    /// Machine axis.
    pub axis: &'a str,
    /// Flag before.
    pub flag_from: Flag,
    /// Flag now.
    pub flag_to: Flag,
    /// Number of the cycle that decided.
    pub cycle: u64,
    /// Time, s from the log's first sample.
    pub t_s: f64,
    /// Time, ns in the log's own time.
    pub t_ns: i64,
    /// On what grounds.
    pub evidence: Evidence,
    /// The grounds in words.
    pub text: String,
}

/// What a notice is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NoticeKind {
    /// A baseline has been learned.
    BaselineLearned,
    /// The cycles gave no baseline; learning begins anew.
    BaselineFailed,
    /// The sums over cycles find a leak.
    LeakFound,
    /// They do not any more.
    LeakGone,
    /// There is less leakage than at the baseline.
    Improved,
    /// The load's signal stands still.
    LoadFrozen,
    /// Something other than the seal has changed; leaks are sized beside it where it is known.
    ConditionFound,
    /// It has not any more.
    ConditionGone,
    /// It grows, or has the size from which it matters.
    ConditionGrown,
    /// An entry of the repair log has been heeded.
    RepairNoted,
    /// The cycles since bear it out, or show nothing of it.
    RepairJudged,
    /// They contradict it, or the baseline was learned while it was done.
    RepairContradicted,
    /// The machine is like none of training, and has no baseline to be compared with.
    UnlikeTraining,
    /// The machine has become another one: it needs a new baseline.
    UnlikeBaseline,
    /// Something has changed on an axis without a model.
    ChangeFound,
    /// It has not any more.
    ChangeGone,
}

/// `seepd.notice/1`: something that a person should know, and that is no change of flag.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Notice<'a> {
    /// `seepd.notice/1`.
    pub schema: &'static str,
    /// Machine axis.
    pub axis: &'a str,
    /// What it is about.
    pub notice: NoticeKind,
    /// The same in words, with what to do.
    pub text: String,
    /// Number of the cycle that decided.
    pub cycle: u64,
    /// Time, s from the log's first sample.
    pub t_s: f64,
    /// Time, ns in the log's own time.
    pub t_ns: i64,
}

/// `seepd.summary/1`: the last line.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// `seepd.summary/1`.
    pub schema: &'static str,
    /// Machine axis.
    pub axis: String,
    /// Samples with a command.
    pub samples: u64,
    /// Samples left out or filled in, by reason.
    pub samples_rejected: BTreeMap<&'static str, u64>,
    /// Cycles with an estimate.
    pub cycles: u64,
    /// The same by duty cycle, where the axis has several.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub duty_cycles: BTreeMap<String, u64>,
    /// Cycles without one, by reason.
    pub rejected: BTreeMap<&'static str, u64>,
    /// Condition at the end.
    pub flag: Flag,
    /// Why there is no estimate at the end.
    pub reason: Option<&'static str>,
    /// Median of the last estimates, m²; null where fewer than [`LEAST_ESTIMATES`](crate::pipeline::LEAST_ESTIMATES) cycles, or fewer than
    /// half, have one.
    pub leak_area_m2: Option<f64>,
    /// The same as a flow at the reference pressure difference, L/min.
    pub leak_flow_lpm: Option<f64>,
    /// What has changed beside the seal since the baseline, in words; absent where nothing has.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub condition: Option<String>,
    /// Causes beside the seal that have been found over cycles, the surest first; absent where none has.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<Condition>,
    /// Entries of the repair log that fell into the record; absent where none did.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub repairs: Vec<Repaired>,
    /// Why there is no size; null where there is one.
    pub size_withheld: Option<&'static str>,
    /// What the command looks like where there is no size; null where there is one.
    pub observed: Option<Observation>,
    /// Reference pressure difference, Pa.
    pub reference_dp_pa: f64,
    /// What it costs; its fields are absent where there is no estimate.
    #[serde(flatten)]
    pub loss: Option<Loss>,
    /// Highest flag reached.
    pub highest_flag: Flag,
    /// Length of the log, s.
    pub duration_s: f64,
}

/// What the pipeline says.
#[expect(clippy::large_enum_variant, reason = "an event lives for one call and is handed on by reference")]
#[derive(Debug, Clone)]
pub enum Event<'a> {
    /// A cycle, with an estimate or rejected.
    Cycle(CycleLine<'a>),
    /// A change of flag.
    Flag(FlagEvent<'a>),
    /// Something else that a person should know.
    Notice(Notice<'a>),
}
