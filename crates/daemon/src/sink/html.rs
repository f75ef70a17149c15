//! What a report page shows of a record, collected as it is read; bounded, whatever the record's length.

use std::collections::{BTreeMap, VecDeque};

use seepd_monitor::event::{CycleLine, Event, FeatureValues, Flag, FlagEvent, Notice};
use seepd_monitor::pipeline::DutyCycle;
use seepd_signals::{Sample, Signal};

/// Points of a cycle's curve.
pub const CURVE_BINS: usize = 400;
/// Cycles whose mean is the earlier curve, and the present one.
pub const CURVE_CYCLES: usize = 5;
/// Cycles that are kept for the charts; of longer records every second, fourth … is.
const POINTS_KEPT: usize = 2000;
/// Flag changes that are kept.
const CHANGES_KEPT: usize = 500;
/// Rejected cycles of a reason that are named.
pub const REJECTED_NAMED: usize = 12;
/// Periods of the command that are held until their cycle is known.
const PERIODS_HELD: f64 = 3.5;

/// A cycle with an estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Number.
    pub cycle: u64,
    /// Estimate, m².
    pub leak_area_m2: f64,
    /// Interval, m².
    pub interval_m2: [f64; 2],
    /// Flow at the reference pressure difference, L/min.
    pub leak_flow_lpm: f64,
    /// What the model says without the baseline that the estimate is relative to, m²; `None` where there is no baseline.
    pub absolute_m2: Option<f64>,
    /// Features in the order of their names; not a number where the cycle's model has no such feature.
    pub features: Vec<f64>,
}

/// What an estimate comes from: names with their contributions, the largest first.
#[derive(Debug, Clone, PartialEq)]
pub enum Why {
    /// Phases and load, m² of the response against the baseline.
    Changes(Vec<(String, f64)>),
    /// Features, in the natural logarithm of the estimate.
    Features(Vec<(String, f64)>),
}

impl Why {
    fn of(line: &CycleLine<'_>) -> Option<Self> {
        let sorted = |parts: &FeatureValues<'_>| {
            let mut parts: Vec<(String, f64)> =
                parts.names.iter().cloned().zip(parts.values.iter().copied()).collect();
            parts.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
            parts
        };
        let changes = line.comparison.as_ref().map(|comparison| Why::Changes(sorted(&comparison.why)));
        changes.or_else(|| Some(Why::Features(sorted(&line.absolute.as_ref()?.absolute_why))))
    }
}

/// A flag that rose or fell.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// Cycle that decided.
    pub cycle: u64,
    /// Time, s from the record's first sample.
    pub t_s: f64,
    /// Time, ns in the log's own time.
    pub t_ns: i64,
    /// Flag before.
    pub from: Flag,
    /// Flag now.
    pub to: Flag,
    /// On what grounds.
    pub grounds: String,
}

/// Cycles that were rejected for one reason.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Rejected {
    /// How many.
    pub count: u64,
    /// Number and start, s from the record's first sample, of the first of them.
    pub first: Vec<(u64, f64)>,
}

/// A log of the record.
#[derive(Debug, Clone, PartialEq)]
pub struct LogEntry {
    /// Name.
    pub name: String,
    /// First sample, ns in the log's own time.
    pub start_ns: Option<i64>,
    /// From its first to its last sample, s.
    pub duration_s: f64,
    /// Samples with a command.
    pub samples: u64,
    /// Number of the first cycle that ends in it.
    pub first_cycle: u64,
    /// What was damaged or left out.
    pub notes: Vec<String>,
}

/// See the [module](self).
pub struct HtmlSink {
    period_s: f64,
    /// The duty cycle whose command is drawn, where there are several.
    pub drawn: Option<String>,
    /// Names of the features, in the points' order.
    pub feature_names: Vec<String>,
    /// Cycles with an estimate below this flow, L/min, are drawn as those before.
    pub before_below_lpm: f64,
    ring: VecDeque<(i64, f32)>,
    ring_samples: usize,
    /// Mean command of the first cycles below that flow, in bins over the period, and how many they are.
    below: Mean,
    /// The same of the first cycles with any estimate.
    first: Mean,
    recent: VecDeque<Vec<f32>>,
    /// Cycles for the charts.
    pub points: Thinned<Point>,
    /// What the last estimate comes from.
    pub why: Option<Why>,
    /// Flag changes.
    pub changes: Vec<Change>,
    /// Notices: cycle, time in ns, words.
    pub notices: Vec<(u64, i64, String)>,
    /// Rejected cycles by reason.
    pub rejected: BTreeMap<&'static str, Rejected>,
    /// Logs.
    pub logs: Vec<LogEntry>,
    cycles: u64,
}

impl HtmlSink {
    /// A collector that draws the present command beside the first cycles with an estimate below a flow, L/min; flags need a few cycles to
    /// rise, so that they do not tell of the first ones. Of several duty cycles the first one's command is drawn.
    pub fn new(duty_cycles: &[DutyCycle], before_below_lpm: f64) -> Self {
        let first = duty_cycles.first().map(|first| first.model.file());
        let rate_hz = first.map_or(0.0, |first| first.sample_rate_hz);
        let ring_samples = (PERIODS_HELD * DutyCycle::longest_period_s(duty_cycles) * rate_hz) as usize;
        HtmlSink {
            period_s: first.map_or(1.0, |first| first.cycle.period_s),
            drawn: duty_cycles.first().and_then(|first| first.name.clone()),
            feature_names: DutyCycle::feature_names(duty_cycles),
            before_below_lpm,
            ring: VecDeque::with_capacity(ring_samples),
            ring_samples,
            below: Mean::default(),
            first: Mean::default(),
            recent: VecDeque::new(),
            points: Thinned::new(POINTS_KEPT),
            why: None,
            changes: Vec::new(),
            notices: Vec::new(),
            rejected: BTreeMap::new(),
            logs: Vec::new(),
            cycles: 0,
        }
    }

    /// A log begins.
    pub fn begin_log(&mut self, name: &str) {
        self.logs.push(LogEntry {
            name: name.into(),
            start_ns: None,
            duration_s: 0.0,
            samples: 0,
            first_cycle: self.cycles,
            notes: Vec::new(),
        });
    }

    /// A log has ended; what was damaged or left out of it.
    pub fn end_log(&mut self, notes: &[String]) {
        if let Some(log) = self.logs.last_mut() {
            log.notes = notes.to_vec();
        }
    }

    /// A sample, in the pipeline's time and before the pipeline hears of it.
    pub fn take_sample(&mut self, sample: &Sample) {
        let Some(command) = sample.get(Signal::Command) else { return };
        if self.ring.len() >= self.ring_samples {
            self.ring.pop_front();
        }
        self.ring.push_back((sample.time_ns, command as f32));
        if let Some(log) = self.logs.last_mut() {
            let start_ns = *log.start_ns.get_or_insert(sample.time_ns);
            log.duration_s = sample.time_ns.saturating_sub(start_ns) as f64 / 1e9;
            log.samples += 1;
        }
    }

    /// An event.
    pub fn take_event(&mut self, event: &Event<'_>) {
        match event {
            Event::Cycle(line) => self.take_cycle(line),
            Event::Flag(flag) => self.take_change(flag),
            Event::Notice(notice) => self.take_notice(notice),
        }
    }

    fn take_cycle(&mut self, line: &CycleLine<'_>) {
        self.cycles = line.cycle + 1;
        if let Some(reason) = line.reason {
            let rejected = self.rejected.entry(reason).or_default();
            rejected.count += 1;
            if rejected.first.len() < REJECTED_NAMED {
                rejected.first.push((line.cycle, line.t_start_s));
            }
        }
        let (Some(leak_area_m2), Some(interval_m2), Some(leak_flow_lpm), Some(features)) =
            (line.leak_area_m2, line.interval90_m2, line.leak_flow_lpm, line.features)
        else {
            return;
        };
        if line.duty_cycle == self.drawn.as_deref() {
            self.draw(line, leak_flow_lpm);
        }
        let of_name = |name: &String| features.get(name).unwrap_or(f64::NAN);
        let features = self.feature_names.iter().map(of_name).collect();
        let alone = line.absolute.as_ref().filter(|_| line.comparison.is_some());
        let absolute_m2 = alone.map(|alone| alone.absolute_leak_area_m2);
        self.why = Why::of(line);
        self.points.push(Point {
            cycle: line.cycle,
            leak_area_m2,
            interval_m2,
            leak_flow_lpm,
            absolute_m2,
            features,
        });
    }

    fn draw(&mut self, line: &CycleLine<'_>, leak_flow_lpm: f64) {
        let curve = self.curve(line);
        self.first.add(&curve);
        if leak_flow_lpm < self.before_below_lpm {
            self.below.add(&curve);
        }
        if self.recent.len() == CURVE_CYCLES {
            self.recent.pop_front();
        }
        self.recent.push_back(curve);
    }

    /// A cycle's command in bins over the period; not a number where there is no sample.
    fn curve(&self, line: &CycleLine<'_>) -> Vec<f32> {
        let mut sums = vec![(0.0f32, 0u32); CURVE_BINS];
        let length_s = (line.t_end_s - line.t_start_s).min(self.period_s);
        for (time_ns, command) in &self.ring {
            let at_s = time_ns.saturating_sub(line.t_start_ns) as f64 / 1e9;
            if (0.0..length_s).contains(&at_s) {
                let bin = (at_s / self.period_s * CURVE_BINS as f64) as usize;
                if let Some((sum, count)) = sums.get_mut(bin) {
                    *sum += command;
                    *count += 1;
                }
            }
        }
        sums.into_iter().map(|(sum, count)| sum / count as f32).collect()
    }

    fn take_notice(&mut self, notice: &Notice<'_>) {
        if self.notices.len() < CHANGES_KEPT {
            self.notices.push((notice.cycle, notice.t_ns, notice.text.clone()));
        }
    }

    fn take_change(&mut self, event: &FlagEvent<'_>) {
        if self.changes.len() >= CHANGES_KEPT {
            return;
        }
        self.changes.push(Change {
            cycle: event.cycle,
            t_s: event.t_s,
            t_ns: event.t_ns,
            from: event.flag_from,
            to: event.flag_to,
            grounds: event.text.clone(),
        });
    }

    /// The command of the first cycles, below the flow if there are any, and of the last ones: time in the cycle, s, and command. `None`
    /// without a cycle.
    pub fn curves(&self) -> Option<Curves> {
        let mut now = Mean::default();
        for curve in &self.recent {
            now.add(curve);
        }
        let is_below = self.below.cycles > 0;
        let before = if is_below { &self.below } else { &self.first };
        (now.cycles > 0).then(|| Curves {
            before: before.points(self.period_s),
            now: now.points(self.period_s),
            is_below,
            cycles: (before.cycles, now.cycles),
        })
    }
}

/// Two curves of the command.
#[derive(Debug, Clone, PartialEq)]
pub struct Curves {
    /// The first cycles: time in the cycle, s, and mean command.
    pub before: Vec<(f64, f64)>,
    /// The last ones.
    pub now: Vec<(f64, f64)>,
    /// Whether the first ones have estimates below the flow.
    pub is_below: bool,
    /// How many cycles each is the mean of.
    pub cycles: (usize, usize),
}

/// Mean of the first few curves.
#[derive(Default)]
struct Mean {
    sum: Vec<f64>,
    cycles: usize,
}

impl Mean {
    fn add(&mut self, curve: &[f32]) {
        if self.cycles == CURVE_CYCLES {
            return;
        }
        self.sum.resize(curve.len(), 0.0);
        for (sum, value) in self.sum.iter_mut().zip(curve) {
            *sum += f64::from(*value);
        }
        self.cycles += 1;
    }

    fn points(&self, period_s: f64) -> Vec<(f64, f64)> {
        let at = |bin: usize| (bin as f64 + 0.5) / self.sum.len() as f64 * period_s;
        let points = self.sum.iter().enumerate().map(|(bin, sum)| (at(bin), sum / self.cycles as f64));
        points.filter(|(_, command)| command.is_finite()).collect()
    }
}

/// At most so many of what is pushed: every first, every second, every fourth …, and the newest.
#[derive(Debug, Clone)]
pub struct Thinned<T> {
    kept: Vec<T>,
    newest: Option<T>,
    most: usize,
    stride: u64,
    pushed: u64,
}

impl<T> Thinned<T> {
    /// Keeps at most `most`, and the newest.
    pub fn new(most: usize) -> Self {
        Thinned { kept: Vec::new(), newest: None, most, stride: 1, pushed: 0 }
    }

    /// Adds one.
    pub fn push(&mut self, value: T) {
        if self.pushed.is_multiple_of(self.stride) {
            if self.kept.len() == self.most {
                let mut index = 0;
                self.kept.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
                self.stride *= 2;
            }
            if self.pushed.is_multiple_of(self.stride) {
                self.kept.push(value);
                self.newest = None;
                self.pushed += 1;
                return;
            }
        }
        self.newest = Some(value);
        self.pushed += 1;
    }

    /// What was kept, in order.
    pub fn iter(&self) -> impl Iterator<Item = &T> + Clone {
        self.kept.iter().chain(&self.newest)
    }

    /// Every so many are kept.
    pub fn stride(&self) -> u64 {
        self.stride
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_thinned_keeps_a_bounded_even_choice_and_the_newest() {
        for count in [0u64, 1, 7, 8, 9, 100, 1000] {
            let mut thinned = Thinned::new(8);
            (0..count).for_each(|value| thinned.push(value));
            let kept: Vec<u64> = thinned.iter().copied().collect();
            assert!(kept.len() <= 9, "{kept:?}");
            assert_eq!(kept.last().copied(), count.checked_sub(1));
            let (stride, even) = (thinned.stride(), kept.len().saturating_sub(1));
            assert!(kept[..even].iter().all(|value| value % stride == 0), "{kept:?}");
            assert!(kept.windows(2).all(|pair| pair[1] > pair[0] && pair[1] - pair[0] <= stride));
        }
    }
}
