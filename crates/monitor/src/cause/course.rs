//! Each cause over cycles: a sum that finds it, when it began, whether it came at once or grows, and when it will matter.
//!
//! The sum is Page's, as the leak's is, of the logarithm of the odds that the cycles since the last change give a cause. The odds have what
//! noise, load, oil and supply do by themselves in them already; what a cycle adds is bounded, so that none decides alone. The seal has its
//! own CUSUM and trend.

use seepd_model::causes::{Candidate, Cause, ChangeVerdict, Explanation, Kind, SizeUnit};
use serde::{Deserialize, Serialize};

use super::Explained;
use super::condition::{size_of, words_of};
use crate::baseline::trend::{Slope, TimeTo, Trend};

/// Odds that neither add to a sum nor take from it, as a logarithm: probability 0.62, about that from which a cause is named.
const ALLOWANCE: f64 = 0.5;
/// Most that a cycle adds to a sum or takes from it.
const MOST_STEP: f64 = 2.0;
/// A cause is found from here on: after three cycles that leave no doubt, or as many more as leave some.
const THRESHOLD: f64 = 6.0;
/// The sums end here: what has gone is soon known to have gone.
const CEILING: f64 = 2.0 * THRESHOLD;
/// Cycles whose ends are remembered, to date what began some cycles ago.
const REMEMBERED: usize = 64;
/// Cycles whose mean is explained, at most; from there on the mean forgets by this share a cycle.
const MEAN_OF: f64 = 16.0;
/// A size that has changed by less than this share since its cause was found came at once.
const DRIFT_SHARE: f64 = 0.3;
/// Seconds of a day.
const DAY_S: f64 = 86_400.0;

/// Size from which a cause matters: at which it moves the command about as much as a leak of 1 L/min does, in its unit.
pub const fn matters_from(kind: Kind) -> f64 {
    match (kind.cause, kind.unit) {
        (Cause::PistonSeal, _) => 1.9e-7,
        (Cause::ValveLands, _) => 1.0 / 60_000.0,
        (Cause::ExternalLeak, _) => 1.0 / 60_000.0 / 8e6,
        (Cause::Friction, _) | (Cause::Load, SizeUnit::Force) => 1000.0,
        (Cause::Spring, _) => 1e4,
        (Cause::OilViscosity, _) => 0.35,
        (Cause::Load | Cause::Supply | Cause::Controller, _) => 0.1,
        (Cause::ValveNull | Cause::PositionScale | Cause::ValveHysteresis | Cause::ValveDeadBand, _) => 0.01,
    }
}

/// Whether it can wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// It is seen, and below the size from which it matters.
    Slight,
    /// It matters.
    Matters,
}

/// How a cause came.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Manner {
    /// At once.
    Step,
    /// It has been growing, or shrinking, since.
    Drift,
}

/// A cause that has been found, as it is told: in a cycle's line, the summary and the status.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Condition {
    /// What has changed, on which side, and the unit of its size.
    #[serde(flatten)]
    pub kind: Kind,
    /// Its probability.
    pub probability: f64,
    /// Its size.
    pub size: f64,
    /// Interval that holds the size nine times in ten, where this is the cause.
    pub interval90: [f64; 2],
    /// The sum over cycles; found from 6 on.
    pub sum: f64,
    /// Number of the cycle in which it began; null where that was in an earlier run of the daemon.
    pub onset_cycle: Option<i64>,
    /// The first and the last cycle in which it may have begun.
    pub onset_cycles: Option<[i64; 2]>,
    /// End of the cycle in which it began, ns in the samples' time.
    pub onset_ns: i64,
    /// The same of the first and of the last in which it may have.
    pub onset_range_ns: [i64; 2],
    /// At once, or growing.
    pub manner: Manner,
    /// How it grows, in its unit a day; null where it came at once.
    pub rate_per_day: Option<f64>,
    /// The interval of that, 90 %.
    pub rate90_per_day: Option<[f64; 2]>,
    /// Whether it can wait.
    pub severity: Severity,
    /// Size from which it matters.
    pub matters_from: f64,
    /// When it will have that size; null where it has it, or does not grow.
    pub time_to_matter: Option<TimeTo>,
}

impl Condition {
    /// A size of it, with its unit.
    pub fn told(&self, size: f64) -> String {
        let Condition { kind, probability, interval90, .. } = *self;
        size_of(&Candidate { kind, probability, size, interval90 })
    }

    /// Its size, with its unit.
    pub fn told_size(&self) -> String {
        self.told(self.size)
    }

    /// What it is and when it came, for a terminal.
    pub fn line(&self) -> String {
        let words = words_of(self.kind.cause, self.kind.side);
        let came = match self.manner {
            Manner::Step => "came at once",
            Manner::Drift => "has been growing",
        };
        let matters = match self.severity {
            Severity::Matters => "it matters".to_owned(),
            Severity::Slight => format!("it matters from {} on", self.told(self.matters_from)),
        };
        let since = match (self.onset_cycle, self.onset_cycles) {
            (Some(cycle), Some([from, to])) => format!("since cycle {cycle} ({from} … {to})"),
            _ => "since an earlier run".to_owned(),
        };
        format!("{words}: {came} {since}; {matters}")
    }
}

/// What outlives the program of a cause that has been found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CourseState {
    kind: Kind,
    sum: f64,
    onset: Onset,
    told_drift: bool,
    told_size: bool,
}

/// When a cause began to show.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Onset {
    /// Cycle; of an earlier run none.
    #[serde(skip)]
    cycle: Option<u64>,
    /// Its end, ns.
    at_ns: i64,
    /// The mean's size then, and of how many cycles it was.
    size: f64,
    mean_of: f64,
    /// Time from cycle to cycle about then, ns.
    period_ns: i64,
}

/// A cause's course.
#[derive(Debug, Clone)]
struct Course {
    kind: Kind,
    sum: f64,
    is_found: bool,
    onset: Option<Onset>,
    probability: f64,
    size: f64,
    interval90: [f64; 2],
    /// Sizes of single cycles since it began to show.
    trend: Trend,
    /// Whether it has been found for the first time, and what has been told since.
    is_new: bool,
    told_drift: bool,
    told_size: bool,
}

/// The courses of all causes but the seal's.
#[derive(Debug, Clone, Default)]
pub struct Courses {
    courses: Vec<Course>,
    /// Number and end of the last cycles, the newest last.
    ends: Vec<(u64, i64)>,
    /// The sum of the odds that anything has changed at all.
    anything: f64,
}

/// What a cycle adds to a sum that is about something of that probability.
fn step_of(probability: f64) -> f64 {
    let odds = probability.max(1e-9) / (1.0 - probability).max(1e-9);
    (odds.ln() - ALLOWANCE).clamp(-MOST_STEP, MOST_STEP)
}

/// A cycle that has been explained.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AtCycle {
    pub(crate) number: u64,
    pub(crate) end_ns: i64,
}

impl Courses {
    /// Takes a cycle's explanation.
    pub(crate) fn take(&mut self, explained: &Explained, at: AtCycle) {
        if self.ends.capacity() == 0 {
            self.ends.reserve(REMEMBERED);
        }
        if self.ends.len() == REMEMBERED {
            self.ends.remove(0);
        }
        self.ends.push((at.number, at.end_ns));
        let explanation = &explained.explanation;
        self.anything = (self.anything + step_of(1.0 - explanation.none)).clamp(0.0, CEILING);
        for candidate in explanation.candidates() {
            let is_known = self.courses.iter().any(|course| course.kind == candidate.kind);
            if !is_known && candidate.probability > 0.5 && candidate.kind.cause != Cause::PistonSeal {
                self.courses.push(Course::new(candidate.kind));
            }
        }
        let period_ns = self.period_ns();
        for course in &mut self.courses {
            course.take(explanation, explained.mean_of as f64, (at, period_ns));
        }
    }

    /// Time from cycle to cycle lately, ns: the median, since machines pause.
    fn period_ns(&self) -> i64 {
        let mut periods = [0; REMEMBERED];
        let pairs = self.ends.windows(2);
        let count = pairs.len();
        for (slot, pair) in periods.iter_mut().zip(pairs) {
            let cycles = pair[1].0.saturating_sub(pair[0].0).max(1) as i64;
            *slot = pair[1].1.saturating_sub(pair[0].1) / cycles;
        }
        periods[..count].sort_unstable();
        periods[..count].get(count / 2).copied().unwrap_or(0)
    }

    /// End of a cycle, ns; of one that is not remembered by the period.
    fn end_of(&self, cycle: f64, onset: &Onset) -> i64 {
        let at = onset.cycle.map_or(0.0, |cycle| cycle as f64);
        let remembered = onset.cycle.and_then(|_| {
            let after = self.ends.partition_point(|(number, _)| (*number as f64) < cycle);
            self.ends.get(after).filter(|_| self.ends.first().is_some_and(|first| first.0 as f64 <= cycle))
        });
        remembered.map_or_else(
            || onset.at_ns.saturating_sub(((at - cycle) * onset.period_ns as f64) as i64),
            |(_, end_ns)| *end_ns,
        )
    }

    /// What has been found, the surest first.
    pub fn found(&self) -> Vec<Condition> {
        let found = self.courses.iter().filter(|course| course.is_found);
        let mut conditions: Vec<Condition> = found.filter_map(|course| self.condition(course)).collect();
        conditions.sort_by(|a, b| b.sum.total_cmp(&a.sum).then(b.probability.total_cmp(&a.probability)));
        conditions
    }

    /// Whether cycles have found what a verdict says of causes beside the seal.
    pub(crate) fn bear_out(&self, explanation: &Explanation) -> bool {
        let is_found =
            |cause: Cause| self.courses.iter().any(|course| course.is_found && course.kind.cause == cause);
        match explanation.verdict {
            ChangeVerdict::Nothing | ChangeVerdict::Named(Cause::PistonSeal, None) => {
                self.courses.iter().all(|course| !course.is_found)
            }
            ChangeVerdict::Named(first, second) => is_found(second.unwrap_or(first)),
            ChangeVerdict::CannotTell | ChangeVerdict::Unknown => self.anything >= THRESHOLD,
        }
    }

    /// What has not been told yet of these: that one grows, or matters. It counts as told from then on.
    pub(crate) fn news(&mut self, conditions: &[Condition]) -> Option<Condition> {
        let is_news = |course: &mut Course, condition: &Condition| {
            let grows = condition.manner == Manner::Drift && !course.told_drift;
            let matters = condition.severity == Severity::Matters && !course.told_size;
            // One that is large from the beginning was told as it was found.
            let is_told_already = course.is_new && !grows;
            course.told_drift |= condition.manner == Manner::Drift;
            course.told_size |= condition.severity == Severity::Matters;
            course.is_new = false;
            (grows || matters) && !is_told_already
        };
        conditions.iter().copied().find(|condition| {
            let course = self.courses.iter_mut().find(|course| course.kind == condition.kind);
            course.is_some_and(|course| is_news(course, condition))
        })
    }

    fn condition(&self, course: &Course) -> Option<Condition> {
        let onset = course.onset?;
        let drift = course.drift();
        let open = 0.5 * (course.interval90[1] - course.interval90[0]);
        let now_s = self.ends.last().map_or(0.0, |(_, end_ns)| *end_ns as f64 / 1e9);
        let base = onset.cycle.map_or(0.0, |cycle| cycle as f64);
        let [low, best, high] = match drift {
            Some(slope) => {
                let ago = slope.times_since_nothing();
                let cycle_of = |ago_s: f64| {
                    let since_ns = (slope.to_s - ago_s) * 1e9 - onset.at_ns as f64;
                    base + since_ns / onset.period_ns.max(1) as f64
                };
                // It cannot have begun after it was seen.
                [ago[1], ago[0], ago[2]].map(|ago_s| cycle_of(ago_s).min(base))
            }
            None => onset.of_step(course.size).map(|ago| base - ago),
        };
        let low = low.min(best);
        let ends_ns = [low, best, high].map(|cycle| self.end_of(cycle.round(), &onset));
        let is_numbered = onset.cycle.is_some();
        let number = |cycle: f64| cycle.round() as i64;
        let day = |slope: f64| slope * DAY_S;
        let matters_from = matters_from(course.kind);
        let is_large = course.size.abs() >= matters_from;
        Some(Condition {
            kind: course.kind,
            probability: course.probability,
            size: course.size,
            interval90: course.interval90,
            sum: course.sum,
            onset_cycle: is_numbered.then(|| number(best)),
            onset_cycles: is_numbered.then(|| [number(low), number(high)]),
            onset_ns: ends_ns[1],
            onset_range_ns: [ends_ns[0], ends_ns[2]],
            manner: if drift.is_some() { Manner::Drift } else { Manner::Step },
            rate_per_day: drift.map(|slope| day(slope.per_s[0])),
            rate90_per_day: drift.map(|slope| [day(slope.per_s[1]), day(slope.per_s[2])]),
            severity: if is_large { Severity::Matters } else { Severity::Slight },
            matters_from,
            time_to_matter: drift
                .filter(|_| !is_large)
                .and_then(|slope| slope.time_to(matters_from.copysign(course.size), open, now_s)),
        })
    }

    /// What outlives the program.
    pub fn state(&self) -> Vec<CourseState> {
        let found = self.courses.iter().filter(|course| course.is_found);
        found
            .filter_map(|course| {
                let Course { kind, sum, told_drift, told_size, .. } = *course;
                Some(CourseState { kind, sum, onset: course.onset?, told_drift, told_size })
            })
            .collect()
    }

    /// Takes the courses up where an earlier run left them.
    pub fn restore(&mut self, states: &[CourseState]) {
        self.courses = states
            .iter()
            .map(|CourseState { kind, sum, onset, told_drift, told_size }| Course {
                sum: sum.clamp(0.0, CEILING),
                told_drift: *told_drift,
                told_size: *told_size,
                is_found: true,
                onset: Some(*onset),
                size: onset.size,
                interval90: [onset.size; 2],
                is_new: false,
                ..Course::new(*kind)
            })
            .collect();
    }

    /// Something was done to the machine that is about these causes: their courses begin anew.
    pub(crate) fn forget(&mut self, is_about: impl Fn(Cause) -> bool) {
        self.courses.retain(|course| !is_about(course.kind.cause));
    }
}

impl Course {
    fn new(kind: Kind) -> Self {
        Course {
            kind,
            sum: 0.0,
            is_found: false,
            onset: None,
            probability: 0.0,
            size: 0.0,
            interval90: [0.0; 2],
            trend: Trend::default(),
            is_new: true,
            told_drift: false,
            told_size: false,
        }
    }

    fn take(&mut self, explanation: &Explanation, mean_of: f64, (at, period_ns): (AtCycle, i64)) {
        let candidate = explanation.candidates().iter().find(|candidate| candidate.kind == self.kind);
        let probability = candidate.map_or(0.0, |candidate| candidate.probability);
        self.sum = (self.sum + step_of(probability)).clamp(0.0, CEILING);
        self.probability = probability;
        if self.sum == 0.0 {
            *self = Course { probability, trend: std::mem::take(&mut self.trend), ..Course::new(self.kind) };
            self.trend.clear();
            return;
        }
        self.is_found |= self.sum >= THRESHOLD;
        let Some(Candidate { size, interval90, .. }) = candidate else { return };
        // The size of this cycle alone, of which the mean's size has moved by a share: without it a mean that follows would look like a
        // drift.
        let before = if self.onset.is_some() { self.size } else { *size };
        let alone = before + mean_of.clamp(1.0, MEAN_OF) * (size - before);
        (self.size, self.interval90) = (*size, *interval90);
        self.onset.get_or_insert(Onset {
            cycle: Some(at.number),
            at_ns: at.end_ns,
            size: *size,
            mean_of,
            period_ns,
        });
        self.trend.take(at.end_ns as f64 / 1e9, alone);
    }

    /// How it grows, where it does so beyond what its size leaves open.
    fn drift(&self) -> Option<Slope> {
        let slope = self.trend.slope()?;
        let [_, low, high] = slope.per_s;
        let grown = slope.per_s[0].abs() * (slope.to_s - slope.from_s);
        let open = (DRIFT_SHARE * self.size.abs()).max(0.5 * (self.interval90[1] - self.interval90[0]));
        (low * high > 0.0 && grown > open).then_some(slope)
    }
}

impl Onset {
    /// Cycles before the first one that showed it in which a step of that size came: at the latest, best guess, at the earliest.
    ///
    /// The mean of the last cycles had a part of the size by then, which tells how many of these cycles had all of it.
    fn of_step(&self, size: f64) -> [f64; 3] {
        let share = if size == 0.0 { 1.0 } else { (self.size / size).clamp(0.0, 0.95) };
        let cycles = |share: f64| {
            let of_mean = self.mean_of.max(1.0);
            if of_mean < MEAN_OF { share * of_mean } else { (1.0 - share).ln() / (1.0 - 1.0 / MEAN_OF).ln() }
        };
        let best = (cycles(share) - 1.0).max(0.0);
        // The sizes are those of a mean that is noisy: as many again.
        [2.0 * best + 1.0, best, 0.0]
    }
}
