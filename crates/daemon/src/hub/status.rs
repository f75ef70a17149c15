//! What is true now: the condition of axes, their sources and the sinks, and what a page draws of them.

use std::collections::{BTreeMap, VecDeque};

use seepd_monitor::alarm::AlarmConfig;
use seepd_monitor::baseline::CusumFinding;
use seepd_monitor::cause::course::Condition;
use seepd_monitor::energy::Loss;
use seepd_monitor::event::Flag;
use seepd_monitor::pipeline::Monitor;
use seepd_monitor::reason::NO_CYCLE_YET;
use seepd_monitor::relative::RelativeMonitor;
use seepd_monitor::repair::Repaired;
use serde::{Deserialize, Serialize};

use super::course::{Course, HealthyCourse, PhaseSpan};
use crate::config::Money;
use crate::verdict::Verdict;

/// Cycles whose course is kept for the dashboard.
const COURSES: usize = 6;
/// Estimates kept for the trend; when there are as many, every second one goes.
const TREND: usize = 2000;
/// Entries of the repair log that a status has.
pub const REPAIRS_TOLD: usize = 20;
/// Points of the live command that are kept.
pub const LIVE_POINTS: usize = 1500;

/// An axis's condition: `seepd.status/1`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisStatus {
    /// `seepd.status/1`.
    pub schema: &'static str,
    /// Name.
    pub axis: String,
    /// Condition now.
    pub flag: Flag,
    /// Since when it is so, ns on the daemon's line of time; null where it was so when the axis was first watched.
    pub since_ns: Option<i64>,
    /// Time of the newest sample, ns on the daemon's line of time.
    pub t_sample_ns: Option<i64>,
    /// The condition in words, with what to do.
    #[serde(flatten)]
    pub verdict: Verdict,
    /// Why there is no estimate.
    pub reason: Option<&'static str>,
    /// What was seen and what to do, where there is no estimate.
    pub advice: Option<String>,
    /// Period at which the command repeats, where there is no estimate, s.
    pub observed_period_s: Option<f64>,
    /// The leak's level, kept while there is no estimate.
    pub level: Flag,
    /// The highest flag since it was last acknowledged.
    pub latched: Option<Flag>,
    /// Whether somebody has taken note of it.
    pub acknowledged: bool,
    /// Who has, and when; null where nobody has.
    pub acknowledgement: Option<Acknowledgement>,
    /// Flows from which the flags rise, L/min.
    pub thresholds: Thresholds,
    /// Whether the input has gone.
    pub stale: bool,
    /// Last estimate, m².
    pub leak_area_m2: Option<f64>,
    /// Interval that holds the truth nine times in ten, m².
    pub interval90_m2: Option<[f64; 2]>,
    /// Last estimate as a flow at the reference pressure difference, L/min.
    pub leak_flow_lpm: Option<f64>,
    /// Reference pressure difference, Pa.
    pub reference_dp_pa: f64,
    /// Flow of 1 m² at that difference, L/min.
    pub lpm_per_m2: f64,
    /// What it costs; its fields are absent where there is no estimate.
    #[serde(flatten)]
    pub loss: Option<Loss>,
    /// The energy's price in a year; absent where no price is configured, or there is no estimate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leak_cost_per_year: Option<Money>,
    /// Projected time until the flag `leak`, s; null where nothing is projected.
    pub time_to_leak_s: Option<f64>,
    /// The shortest and the longest that the points so far admit, s.
    pub time_to_leak_range_s: Option<[f64; 2]>,
    /// What estimates are relative to; of several duty cycles, that of the last cycle's.
    pub baseline: BaselineStatus,
    /// The duty cycles, where there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub duty_cycles: Vec<DutyCycleStatus>,
    /// What the sums over cycles say against the baseline.
    pub finding: CusumFinding,
    /// What has changed beside the seal since the baseline, in words, with what to do; null where nothing has.
    pub condition: Option<String>,
    /// Causes beside the seal that have been found over cycles, the surest first.
    pub conditions: Vec<Condition>,
    /// The last entries of the repair log that were heeded, the newest last.
    pub repairs: Vec<Repaired>,
    /// What has changed since the baseline, on an axis without a model; absent elsewhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relative: Option<RelativeStatus>,
    /// Number of the last cycle.
    pub cycle: Option<u64>,
    /// End of the last cycle, ns on the daemon's line of time.
    pub t_last_cycle_ns: Option<i64>,
    /// From the sample that closed the last cycle to its publication, s; the segmenter's look-ahead is not in it. None where a log is read
    /// as fast as can be, whose times are its own.
    pub publication_delay_s: Option<f64>,
    /// Cycles with an estimate.
    pub cycles: u64,
    /// Cycles without one, by reason.
    pub rejected: BTreeMap<&'static str, u64>,
    /// Samples left out or filled in, by reason.
    pub samples_rejected: BTreeMap<&'static str, u64>,
    /// The input.
    pub source: SourceHealth,
}

impl AxisStatus {
    /// An axis of which nothing is known yet.
    pub fn new(axis: &str, reference_dp_pa: f64) -> Self {
        AxisStatus {
            schema: "seepd.status/1",
            axis: axis.into(),
            flag: Flag::NoEstimate,
            since_ns: None,
            t_sample_ns: None,
            verdict: Verdict::of(Flag::NoEstimate, Some(NO_CYCLE_YET), false),
            reason: Some(NO_CYCLE_YET),
            advice: None,
            observed_period_s: None,
            level: Flag::Healthy,
            latched: None,
            acknowledged: false,
            acknowledgement: None,
            thresholds: Thresholds::of(&AlarmConfig::default()),
            stale: false,
            leak_area_m2: None,
            interval90_m2: None,
            leak_flow_lpm: None,
            reference_dp_pa,
            lpm_per_m2: 0.0,
            loss: None,
            leak_cost_per_year: None,
            time_to_leak_s: None,
            time_to_leak_range_s: None,
            baseline: BaselineStatus::default(),
            duty_cycles: Vec::new(),
            finding: CusumFinding::None,
            condition: None,
            conditions: Vec::new(),
            repairs: Vec::new(),
            relative: None,
            cycle: None,
            t_last_cycle_ns: None,
            publication_delay_s: None,
            cycles: 0,
            rejected: BTreeMap::new(),
            samples_rejected: BTreeMap::new(),
            source: SourceHealth::default(),
        }
    }
}

/// Flows from which the flags rise, L/min at the reference pressure difference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Thresholds {
    /// Watch.
    pub watch_lpm: f64,
    /// Leak.
    pub leak_lpm: f64,
    /// Severe.
    pub severe_lpm: f64,
}

impl Thresholds {
    /// Those of a configuration.
    pub fn of(alarm: &AlarmConfig) -> Self {
        let AlarmConfig { watch_lpm, leak_lpm, severe_lpm, .. } = *alarm;
        Thresholds { watch_lpm, leak_lpm, severe_lpm }
    }
}

/// Who took note of a latched flag.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Acknowledgement {
    /// When, ns on the daemon's line of time.
    pub t_ns: i64,
    /// Who, as people say it themselves.
    pub who: Option<String>,
    /// What they noted.
    pub note: Option<String>,
}

/// Oil lost on the rod side, growing.
#[cfg(test)]
pub(crate) fn condition_for_tests() -> Condition {
    use seepd_model::causes::{Cause, Kind, Side, SizeUnit};
    use seepd_monitor::baseline::trend::TimeTo;
    use seepd_monitor::cause::course::{Manner, Severity, matters_from};

    let kind = Kind { cause: Cause::ExternalLeak, side: Some(Side::Rod), unit: SizeUnit::Conductance };
    let onset_ns = 1_750_000_000_000_000_000;
    Condition {
        kind,
        probability: 0.9,
        size: 1e-12,
        interval90: [0.9e-12, 1.1e-12],
        sum: 12.0,
        onset_cycle: Some(7),
        onset_cycles: Some([5, 9]),
        onset_ns,
        onset_range_ns: [onset_ns; 2],
        manner: Manner::Drift,
        rate_per_day: Some(2e-13),
        rate90_per_day: Some([1e-13, 3e-13]),
        severity: Severity::Slight,
        matters_from: matters_from(kind),
        time_to_matter: Some(TimeTo { expected_s: 3600.0, earliest_s: 1800.0, latest_s: 7200.0 }),
    }
}

/// One of an axis's several duty cycles.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DutyCycleStatus {
    /// Name.
    pub name: String,
    /// Cycles with an estimate.
    pub cycles: u64,
    /// Its baseline.
    pub baseline: BaselineStatus,
}

impl DutyCycleStatus {
    /// What a monitor is at; nothing for the only one of an axis.
    pub fn of(monitor: &Monitor) -> Option<Self> {
        let name = monitor.name()?.to_owned();
        Some(DutyCycleStatus { name, cycles: monitor.cycles(), baseline: BaselineStatus::of(monitor) })
    }
}

/// What has changed on an axis without a model.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct RelativeStatus {
    /// Whether something has.
    pub changed: bool,
    /// About when it began, ns on the daemon's line of time.
    pub since_ns: Option<i64>,
    /// What has changed, the surest first: `mean.PHASE`, `rise.PHASE`.
    pub features: Vec<String>,
}

impl RelativeStatus {
    /// What a monitor has found.
    pub fn of(monitor: &RelativeMonitor) -> Self {
        monitor.change().map_or_else(Self::default, |change| RelativeStatus {
            changed: true,
            since_ns: Some(change.onset_ns),
            features: change.features,
        })
    }
}

/// What a duty cycle's estimates are relative to.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct BaselineStatus {
    /// Cycles of the baseline in force; null where there is none.
    pub learned_cycles: Option<usize>,
    /// What it was learned for.
    pub occasion: Option<String>,
    /// Where one is being learned: cycles so far, and cycles that are wanted.
    pub learning: Option<[usize; 2]>,
}

impl BaselineStatus {
    /// What an axis without a model is at.
    pub fn of_relative(monitor: &RelativeMonitor) -> Self {
        BaselineStatus {
            learned_cycles: monitor.baseline().map(|baseline| baseline.cycles),
            occasion: monitor.baseline().map(|baseline| baseline.occasion.clone()),
            learning: monitor.learner().map(|learner| [learner.cycles(), learner.wanted()]),
        }
    }

    /// What a duty cycle's monitor is at.
    pub fn of(monitor: &Monitor) -> Self {
        BaselineStatus {
            learned_cycles: monitor.baseline().map(|baseline| baseline.cycles),
            occasion: monitor.baseline().map(|baseline| baseline.occasion.clone()),
            learning: monitor.learner().map(|learner| [learner.cycles(), learner.wanted()]),
        }
    }
}

/// A point of the leak's trend.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrendPoint {
    /// End of the cycle, ns on the daemon's line of time.
    pub t_ns: i64,
    /// Estimate, m².
    pub leak_area_m2: f64,
    /// Its interval, m².
    pub interval90_m2: [f64; 2],
    /// The same as a flow, L/min.
    pub leak_flow_lpm: f64,
    /// Condition after the cycle.
    pub flag: Flag,
}

/// What the dashboard draws of an axis.
#[derive(Debug, Clone, Default)]
pub struct AxisView {
    /// Leak by cycle.
    pub trend: VecDeque<TrendPoint>,
    /// The last cycles.
    pub courses: VecDeque<Course>,
    /// What a healthy cycle is like.
    pub healthy: HealthyCourse,
    /// The duty cycle's stretches.
    pub phases: Vec<PhaseSpan>,
    /// The command lately: time on the line (ns), mean over 20 ms.
    pub live: VecDeque<(i64, f32)>,
}

impl AxisView {
    /// Adds an estimate; a full trend loses every second one.
    pub fn add_trend(&mut self, point: TrendPoint) {
        if self.trend.len() >= TREND {
            let mut keep = false;
            self.trend.retain(|_| {
                keep = !keep;
                keep
            });
        }
        self.trend.push_back(point);
    }

    /// Adds a cycle's course.
    pub fn add_course(&mut self, course: Course) {
        if self.courses.len() >= COURSES {
            self.courses.pop_front();
        }
        self.courses.push_back(course);
    }
}

/// How a sink is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SinkStatus {
    /// What it is and where.
    pub name: String,
    /// Whether it works.
    pub good: bool,
    /// What it is doing, or why it does not work.
    pub detail: String,
    /// Events or frames that went out.
    pub sent: u64,
    /// Events that wait.
    pub waiting: u64,
    /// Events, samples or frames that were given up.
    pub dropped: u64,
}

impl SinkStatus {
    /// A sink that has just been started.
    pub fn new(name: impl Into<String>) -> Self {
        SinkStatus {
            name: name.into(),
            good: true,
            detail: "starting".into(),
            sent: 0,
            waiting: 0,
            dropped: 0,
        }
    }
}

/// How an input is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SourceState {
    /// Nothing has come yet.
    #[default]
    Waiting,
    /// Samples come.
    Receiving,
    /// The bus is there, but no command comes.
    Silent,
    /// There is no such interface, or it is down.
    Down,
    /// The log has been read.
    Ended,
}

/// An input's condition and counts.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct SourceHealth {
    /// Interface or log.
    pub name: String,
    /// How it is.
    pub state: SourceState,
    /// Why it is so.
    pub detail: Option<String>,
    /// Frames received.
    pub frames: u64,
    /// Of these, such that gave a sample.
    pub samples: u64,
    /// Frames that the kernel dropped because the socket's buffer was full.
    pub dropped_in_socket: u64,
    /// Frames that the sender's counter says were lost.
    pub missing_by_counter: u64,
    /// Frames with the counter of the frame before: sent twice, or by two senders.
    pub repeated: u64,
    /// Times that the counter went back.
    pub counter_jumps: u64,
    /// Frames with a wrong size or length code.
    pub malformed: u64,
    /// Frames too short for a mapped signal.
    pub too_short: u64,
    /// Remote frames.
    pub remote: u64,
    /// Error frames.
    pub error: u64,
    /// Times that the socket was opened again.
    pub reopened: u64,
}
