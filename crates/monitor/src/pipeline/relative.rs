//! What is told of a cycle on an axis without a model.

use seepd_features::Outcome;

use super::MonitorConfig;
use super::progress::{Progress, span_of};
use super::repairs::of_two_machines;
use crate::alarm::Change as FlagChange;
use crate::event::{CycleLine, Event, FeatureValues, Flag, NoticeKind, RelativeLine};
use crate::reason::LEARNING_BASELINE;
use crate::relative::charts::{Change, Charts};
use crate::relative::monitor::{RelativeEstimator, Step};

/// Phases that a notice names.
const PHASES_NAMED: usize = 4;

impl Progress {
    /// Takes a cycle of an axis without a model.
    pub(super) fn take_relative(
        &mut self,
        config: &MonitorConfig,
        estimator: &mut RelativeEstimator,
        outcome: &Outcome<'_>,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        let (start_ns, end_ns) = span_of(outcome);
        self.last_cycle_ns = end_ns.max(self.last_cycle_ns.min(self.newest_ns));
        let change = match outcome {
            Outcome::Rejected(rejected) => self.reject(config, rejected, sink),
            Outcome::Valid(valid) if self.was_repaired_within(valid) => {
                self.reject(config, &of_two_machines(valid), sink)
            }
            Outcome::Valid(valid) => {
                let step = estimator.take(valid, &config.axis);
                let compared = estimator.charts().filter(|_| matches!(step, Step::Compared));
                let change = self.judge(config, compared);
                let line = CycleLine {
                    flag: if compared.is_some() { self.alarm.flag() } else { Flag::NoEstimate },
                    reason: compared.is_none().then_some(LEARNING_BASELINE),
                    relative: compared.map(|charts| self.relative_line(charts)),
                    features: Some(FeatureValues { names: &estimator.names, values: &estimator.values }),
                    ..self.blank_line(config, start_ns, end_ns)
                };
                sink(&Event::Cycle(line));
                self.tell_step(config, estimator, step, end_ns, sink);
                change
            }
        };
        self.end_cycle(config, change, end_ns, sink);
    }

    /// The change of flag by a cycle that was compared, or by one that is only learned from.
    fn judge(&mut self, config: &MonitorConfig, compared: Option<&Charts>) -> Option<FlagChange> {
        let Some(charts) = compared else {
            self.count_rejection(LEARNING_BASELINE);
            return self.alarm.rejected(&config.alarm, LEARNING_BASELINE);
        };
        self.valid += 1;
        self.alarm.compared(&config.alarm, charts.has_changed())
    }

    fn relative_line<'l>(&self, charts: &'l Charts) -> RelativeLine<'l> {
        RelativeLine {
            distance: charts.distance(),
            changed: charts.has_changed(),
            largest_sum: charts.largest(),
            changed_since_s: charts.change().map(|change| self.seconds(change.onset_ns)),
            standardised: FeatureValues { names: charts.names(), values: charts.standardised() },
        }
    }

    /// Tells what has become of the baseline, and what has changed since, once each.
    fn tell_step(
        &self,
        config: &MonitorConfig,
        estimator: &mut RelativeEstimator,
        step: Step,
        at_ns: i64,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        let news = match step {
            Step::Learning => return,
            Step::Learned(text) => (NoticeKind::BaselineLearned, text),
            Step::Failed(text) => (NoticeKind::BaselineFailed, text),
            Step::Compared => {
                let change = estimator.charts().and_then(Charts::change);
                let before = std::mem::replace(&mut estimator.announced, change.is_some());
                match change {
                    Some(change) if !before => (NoticeKind::ChangeFound, self.in_words(&change)),
                    None if before => {
                        (NoticeKind::ChangeGone, "the command is that of the baseline again".to_owned())
                    }
                    _ => return,
                }
            }
        };
        self.tell(config, None, news, at_ns, sink);
    }

    fn in_words(&self, change: &Change) -> String {
        let mut phases: Vec<&str> = Vec::new();
        for name in &change.features {
            let phase = name.split_once('.').map_or(name.as_str(), |(_, phase)| phase);
            if !phases.contains(&phase) {
                phases.push(phase);
            }
        }
        let others = if phases.len() > PHASES_NAMED { " and others" } else { "" };
        phases.truncate(PHASES_NAMED);
        format!(
            "the command has changed since the baseline, most in {}{others}, from about {:.1} s on. Without a plant model there is no L/min: \
             `seepd adopt LOG --out FOLDER` gives sizes",
            phases.join(", "),
            self.seconds(change.onset_ns)
        )
    }
}
