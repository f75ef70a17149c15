//! What an axis remembers between cycles, and what it tells of each.

use std::collections::BTreeMap;

use seepd_features::{Outcome, RejectedCycle, ValidCycle};
use seepd_model::OutOfDistribution;

use super::MonitorConfig;
use seepd_model::causes::{Cause, ChangeVerdict, Explanation, Kind};

use super::monitor::{Absolute, CycleEstimator};
use super::repairs::of_two_machines;
use crate::alarm::{Alarm, Change};
use crate::baseline::comparator::ComparedCycle;
use crate::baseline::{CusumFinding, LoadKnowledge};
use crate::cause::course::{AtCycle, Condition, Severity};
use crate::cause::{Explained, TOLD_AFTER, condition, name_of};
use crate::event::{
    AbsoluteLine, Candidates, CauseLine, ComparisonLine, CycleLine, Event, FeatureValues, Flag, FlagEvent,
    Notice, NoticeKind,
};
use crate::reason::{UNLIKE_BASELINE, UNLIKE_TRAINING};
use crate::repair::Repaired;

/// Rejections by reason, in order of first appearance: those of [`Reason`](seepd_features::Reason), and [`UNLIKE_BASELINE`],
/// [`UNLIKE_TRAINING`] and [`LEARNING_BASELINE`](crate::reason::LEARNING_BASELINE).
const REASONS: usize = 12;
/// Estimates whose median is the summary's.
const RECENT: usize = 9;
/// Cycles in a row that are unlike the baseline or training before a person is told.
const UNLIKE_CYCLES: u32 = 5;

/// What the pipeline remembers between cycles.
#[derive(Debug, Clone, Default)]
pub(super) struct Progress {
    pub(super) alarm: Alarm,
    pub(super) first_ns: Option<i64>,
    pub(super) newest_ns: i64,
    /// End of the last cycle, used or rejected, or the first sample's time.
    pub(super) last_cycle_ns: i64,
    pub(super) cycle: u64,
    pub(super) valid: u64,
    rejected: [(&'static str, u64); REASONS],
    recent_m2: [f64; RECENT],
    /// Estimates among these: those of a seal that has been replaced do not count.
    pub(super) recent: u64,
    /// What has changed beside the seal, in words.
    pub(super) condition: Option<String>,
    /// Entries of the repair log that were heeded.
    pub(super) repairs: Vec<Repaired>,
    /// Cycles that began before are not of the machine as it is since the last repair, ns.
    pub(super) anew_from_ns: Option<i64>,
}

impl Progress {
    /// A sample of that time has come.
    #[inline]
    pub(super) fn note_time(&mut self, time_ns: i64) {
        if self.first_ns.is_none() {
            self.first_ns = Some(time_ns);
            self.last_cycle_ns = time_ns;
        }
        self.newest_ns = time_ns;
    }

    pub(super) fn seconds(&self, time_ns: i64) -> f64 {
        self.first_ns.map_or(0.0, |first_ns| time_ns.saturating_sub(first_ns) as f64 / 1e9)
    }

    /// There is nothing to base a statement on.
    pub(super) fn lose(
        &mut self,
        config: &MonitorConfig,
        reason: &'static str,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        if let Some(change) = self.alarm.lost(reason) {
            sink(&self.flag_event(config, change, self.newest_ns));
        }
    }

    /// Takes a cycle of a duty cycle; `found_elsewhere` where another one's sums have found a leak.
    pub(super) fn take(
        &mut self,
        config: &MonitorConfig,
        estimator: &mut CycleEstimator,
        outcome: &Outcome<'_>,
        found_elsewhere: bool,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        let (_, end_ns) = span_of(outcome);
        self.last_cycle_ns = end_ns.max(self.last_cycle_ns.min(self.newest_ns));
        let change = match outcome {
            Outcome::Valid(valid) if self.was_repaired_within(valid) => {
                self.reject(config, &of_two_machines(valid), sink)
            }
            Outcome::Valid(valid) => self.take_valid(config, estimator, valid, found_elsewhere, sink),
            Outcome::Rejected(rejected) => self.reject(config, rejected, sink),
        };
        self.end_cycle(config, change, end_ns, sink);
    }

    pub(super) fn end_cycle(
        &mut self,
        config: &MonitorConfig,
        change: Option<Change>,
        end_ns: i64,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        if let Some(change) = change {
            sink(&self.flag_event(config, change, end_ns));
        }
        self.cycle += 1;
    }

    pub(super) fn reject(
        &mut self,
        config: &MonitorConfig,
        rejected: &RejectedCycle,
        sink: &mut impl FnMut(&Event<'_>),
    ) -> Option<Change> {
        let reason = rejected.reason.name();
        self.count_rejection(reason);
        let blank = self.blank_line(config, rejected.start_ns, rejected.end_ns);
        sink(&Event::Cycle(CycleLine { reason: Some(reason), ..blank }));
        self.alarm.rejected(&config.alarm, reason)
    }

    /// A cycle's line without an estimate.
    pub(super) fn blank_line<'l>(
        &self,
        config: &'l MonitorConfig,
        start_ns: i64,
        end_ns: i64,
    ) -> CycleLine<'l> {
        CycleLine {
            schema: "seepd.cycle/1",
            axis: &config.axis,
            cycle: self.cycle,
            duty_cycle: None,
            t_start_s: self.seconds(start_ns),
            t_end_s: self.seconds(end_ns),
            t_start_ns: start_ns,
            leak_area_m2: None,
            interval90_m2: None,
            leak_flow_lpm: None,
            reference_dp_pa: config.reference_dp_pa,
            flag: Flag::NoEstimate,
            reason: None,
            absolute: None,
            comparison: None,
            cause: None,
            relative: None,
            features: None,
        }
    }

    fn take_valid(
        &mut self,
        config: &MonitorConfig,
        estimator: &mut CycleEstimator,
        valid: &ValidCycle<'_>,
        found_elsewhere: bool,
        sink: &mut impl FnMut(&Event<'_>),
    ) -> Option<Change> {
        let absolute = estimator.absolute(valid);
        let is_like_training = absolute.out_of_distribution.score <= 1.0;
        let absolute_m2 = is_like_training.then_some(absolute.estimate.value);
        let compared = estimator.compare_cycle(valid, self.seconds(valid.end_ns), absolute_m2);
        let out_of_distribution =
            compared.map_or(absolute.out_of_distribution, |compared| compared.estimate.out_of_distribution);
        let reason = match &compared {
            Some(compared) => compared.is_unlike.then_some(UNLIKE_BASELINE),
            None => (out_of_distribution.score > 1.0).then_some(UNLIKE_TRAINING),
        };
        let estimate = compared.map_or(absolute.estimate, |compared| compared.estimate.estimate);
        let flow_lpm = config.flow_lpm(estimate.value);
        let change = if let Some(reason) = reason {
            self.count_rejection(reason);
            self.alarm.rejected(&config.alarm, reason)
        } else {
            self.recent_m2[(self.recent % RECENT as u64) as usize] = estimate.value;
            self.recent += 1;
            self.valid += 1;
            estimator.cycles += 1;
            let found =
                found_elsewhere || compared.is_some_and(|compared| compared.finding == CusumFinding::Leak);
            self.alarm.estimated_with(&config.alarm, flow_lpm, found)
        };
        if let Some(explained) = compared.as_ref().and_then(|compared| compared.explained.as_ref()) {
            estimator.courses.take(explained, AtCycle { number: self.cycle, end_ns: valid.end_ns });
            estimator.conditions = estimator.courses.found();
        }
        let names = estimator.model.feature_names();
        let is_known = reason.is_none();
        let line = CycleLine {
            duty_cycle: estimator.name.as_deref(),
            leak_area_m2: is_known.then_some(estimate.value),
            interval90_m2: is_known.then_some(estimate.interval),
            leak_flow_lpm: is_known.then_some(flow_lpm),
            flag: if is_known { self.alarm.flag() } else { Flag::NoEstimate },
            reason,
            absolute: Some(absolute_line(&absolute, names)),
            comparison: compared.as_ref().map(|compared| comparison_line(config, estimator, compared)),
            cause: compared.as_ref().and_then(|compared| self.cause_line(compared, &estimator.conditions)),
            features: Some(FeatureValues { names, values: valid.features }),
            ..self.blank_line(config, valid.start_ns, valid.end_ns)
        };
        sink(&Event::Cycle(line));
        if let Some(compared) = &compared {
            self.tell_findings(config, estimator, valid.end_ns, compared, sink);
            if let Some(explained) = &compared.explained {
                self.tell_condition(config, estimator, valid.end_ns, explained, sink);
            }
            self.tell_growth(config, estimator, valid.end_ns, sink);
        }
        self.tell_out_of_distribution(config, estimator, valid.end_ns, (out_of_distribution, reason), sink);
        if is_known {
            self.judge_repairs(config, estimator, valid.end_ns, estimate.value, sink);
        }
        if let Some(learned) = estimator.learn_from(valid, absolute.estimate) {
            let news = match learned {
                Ok(text) => (NoticeKind::BaselineLearned, text),
                Err(text) => (NoticeKind::BaselineFailed, text),
            };
            self.tell(config, estimator.name.as_deref(), news, valid.end_ns, sink);
        }
        change
    }

    fn cause_line<'l>(
        &self,
        compared: &'l ComparedCycle,
        conditions: &'l [Condition],
    ) -> Option<CauseLine<'l>> {
        let Explained { explanation, changed, .. } = compared.explained.as_ref()?;
        let also = match explanation.verdict {
            ChangeVerdict::Named(_, also) => also,
            _ => None,
        };
        Some(CauseLine {
            cause: name_of(explanation.verdict),
            cause_probability: explanation.probability,
            cause_also: also.map(Cause::name),
            cause_candidates: Candidates(explanation.candidates()),
            distinguish: condition::distinguish(explanation),
            onset_cycle: (*changed > 0).then(|| (self.cycle + 1).saturating_sub(*changed)),
            conditions,
        })
    }

    /// Tells what has changed against the baseline, once each.
    fn tell_findings(
        &self,
        config: &MonitorConfig,
        estimator: &mut CycleEstimator,
        at_ns: i64,
        compared: &ComparedCycle,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        let before = std::mem::replace(&mut estimator.announced.finding, compared.finding);
        if before != compared.finding {
            let flow_lpm = config.flow_lpm(compared.estimate.estimate.value);
            let news = match compared.finding {
                CusumFinding::Leak => {
                    let text = format!("more leakage than at the baseline: about {flow_lpm:.3} L/min");
                    (NoticeKind::LeakFound, text)
                }
                CusumFinding::Improved => {
                    let text = "less leakage than at the baseline: it was learned from a machine that leaked, or the seal has been \
                                replaced; learn a new baseline";
                    (NoticeKind::Improved, text.to_owned())
                }
                CusumFinding::None => {
                    (NoticeKind::LeakGone, "the leakage is that of the baseline again".to_owned())
                }
            };
            self.tell(config, estimator.name.as_deref(), news, at_ns, sink);
        }
        let before = std::mem::replace(&mut estimator.announced.load, compared.load);
        if compared.load == LoadKnowledge::Frozen && before != LoadKnowledge::Frozen {
            let text = "the load signal stands still over a whole cycle and is not used; check its sensor"
                .to_owned();
            self.tell(config, estimator.name.as_deref(), (NoticeKind::LoadFrozen, text), at_ns, sink);
        }
    }

    /// Tells a condition other than the seal's once it has lasted, and that it has passed.
    fn tell_condition(
        &mut self,
        config: &MonitorConfig,
        estimator: &mut CycleEstimator,
        at_ns: i64,
        explained: &Explained,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        if explained.agreeing < TOLD_AFTER || !estimator.courses.bear_out(&explained.explanation) {
            return;
        }
        let explanation = &explained.explanation;
        let sentence = condition::sentence(explanation);
        // Sizes go on changing: news is another cause.
        let verdict = sentence.as_ref().map(|_| explanation.verdict);
        let is_news = estimator.announced.condition != verdict;
        if is_news {
            estimator.announced.brought_by = estimator.repair_behind(explanation);
        }
        let after = |what| condition::sentence_after(explanation, what);
        let mut sentence = estimator.announced.brought_by.and_then(after).or(sentence);
        if let (Some(sentence), Some(kind)) = (&mut sentence, named_beside(explanation))
            && let Some(growth) =
                estimator.conditions.iter().find(|one| one.kind == kind).and_then(condition::growth_sentence)
        {
            sentence.push(' ');
            sentence.push_str(&growth);
        }
        self.condition.clone_from(&sentence);
        estimator.announced.condition = verdict;
        if !is_news {
            return;
        }
        let news = match (sentence, explained.explanation.verdict) {
            (Some(sentence), ChangeVerdict::Named(..)) => {
                let text =
                    format!("{sentence} The baseline is carried over this change: leaks are sized beside it");
                (NoticeKind::ConditionFound, text)
            }
            (Some(sentence), _) => (NoticeKind::ConditionFound, sentence.trim_end_matches('.').to_owned()),
            (None, _) => (
                NoticeKind::ConditionGone,
                "nothing but the seal is otherwise than at the baseline any more".to_owned(),
            ),
        };
        self.tell(config, estimator.name.as_deref(), news, at_ns, sink);
    }

    /// Tells, once each, that a condition grows, and that it has the size from which it matters.
    fn tell_growth(
        &self,
        config: &MonitorConfig,
        estimator: &mut CycleEstimator,
        at_ns: i64,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        while let Some(condition) = estimator.courses.news(&estimator.conditions) {
            let words = condition::words_of(condition.kind.cause, condition.kind.side);
            let growth = condition::growth_sentence(&condition).unwrap_or_default();
            let text = match condition.severity {
                Severity::Matters => {
                    format!("{words}: it has a size that matters, {}. {growth}", condition.told_size())
                }
                Severity::Slight => format!("{words}: it grows, {} now. {growth}", condition.told_size()),
            };
            let text = text.trim_end().trim_end_matches('.').to_owned();
            self.tell(config, estimator.name.as_deref(), (NoticeKind::ConditionGrown, text), at_ns, sink);
        }
    }

    /// Tells that several cycles in a row are unlike the baseline, or unlike training where there is none.
    fn tell_out_of_distribution(
        &self,
        config: &MonitorConfig,
        estimator: &mut CycleEstimator,
        at_ns: i64,
        (out_of_distribution, reason): (OutOfDistribution, Option<&str>),
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        estimator.announced.unlike =
            if reason.is_some() { estimator.announced.unlike.saturating_add(1) } else { 0 };
        if estimator.announced.unlike != UNLIKE_CYCLES {
            return;
        }
        let where_most =
            estimator.contributors.get(out_of_distribution.most_unusual).map_or("", String::as_str);
        let distance = format!(
            "(distance {:.1} times the limit, most of it in {where_most})",
            out_of_distribution.score
        );
        let news = if reason == Some(UNLIKE_BASELINE) {
            let text = format!(
                "{UNLIKE_CYCLES} cycles in a row differ from the baseline in a way that no leak, load, oil or supply of the training \
                 explains {distance}: has a valve, a sensor or the duty cycle been changed? If the seal is good, learn a new baseline"
            );
            (NoticeKind::UnlikeBaseline, text)
        } else {
            let text = format!(
                "{UNLIKE_CYCLES} cycles in a row are like no machine that the model was trained on {distance}: if the seal is good, learn \
                 a baseline; or train a model on this machine's plant file and duty cycle"
            );
            (NoticeKind::UnlikeTraining, text)
        };
        self.tell(config, estimator.name.as_deref(), news, at_ns, sink);
    }

    pub(super) fn tell(
        &self,
        config: &MonitorConfig,
        duty_cycle: Option<&str>,
        (notice, text): (NoticeKind, String),
        at_ns: i64,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        let text = duty_cycle.map_or_else(|| text.clone(), |name| format!("duty cycle {name}: {text}"));
        sink(&Event::Notice(Notice {
            schema: "seepd.notice/1",
            axis: &config.axis,
            notice,
            text,
            cycle: self.cycle,
            t_s: self.seconds(at_ns),
            t_ns: at_ns,
        }));
    }

    pub(super) fn flag_event<'a>(&self, config: &'a MonitorConfig, change: Change, at_ns: i64) -> Event<'a> {
        Event::Flag(FlagEvent {
            schema: "seepd.event/1",
            axis: &config.axis,
            flag_from: change.from,
            flag_to: change.to,
            cycle: self.cycle,
            t_s: self.seconds(at_ns),
            t_ns: at_ns,
            text: change.evidence.to_string(),
            evidence: change.evidence,
        })
    }

    pub(super) fn count_rejection(&mut self, reason: &'static str) {
        let slot = self.rejected.iter_mut().find(|(known, count)| *known == reason || *count == 0);
        if let Some(slot) = slot {
            *slot = (reason, slot.1 + 1);
        }
    }

    /// Rejected cycles by reason.
    pub(super) fn rejections(&self) -> BTreeMap<&'static str, u64> {
        self.rejected.iter().copied().filter(|(_, count)| *count > 0).collect()
    }

    /// Median of the last estimates, m².
    pub(super) fn recent_area_m2(&self) -> Option<f64> {
        let count = (self.recent as usize).min(RECENT);
        let mut recent = self.recent_m2;
        let recent = recent.get_mut(..count)?;
        recent.sort_by(f64::total_cmp);
        recent.get(count / 2).copied()
    }
}

/// The kind beside the seal that is named.
fn named_beside(explanation: &Explanation) -> Option<Kind> {
    let ChangeVerdict::Named(first, second) = explanation.verdict else { return None };
    explanation.candidate(second.unwrap_or(first)).map(|candidate| candidate.kind)
}

pub(super) fn span_of(outcome: &Outcome<'_>) -> (i64, i64) {
    match outcome {
        Outcome::Valid(valid) => (valid.start_ns, valid.end_ns),
        Outcome::Rejected(rejected) => (rejected.start_ns, rejected.end_ns),
    }
}

fn absolute_line<'l>(absolute: &'l Absolute, names: &'l [String]) -> AbsoluteLine<'l> {
    AbsoluteLine {
        absolute_leak_area_m2: absolute.estimate.value,
        absolute_interval90_m2: absolute.estimate.interval,
        absolute_out_of_distribution: absolute.out_of_distribution.score,
        absolute_why: FeatureValues {
            names,
            values: absolute.contributions.get(..names.len()).unwrap_or_default(),
        },
    }
}

fn comparison_line<'l>(
    config: &MonitorConfig,
    estimator: &'l CycleEstimator,
    compared: &'l ComparedCycle,
) -> ComparisonLine<'l> {
    let ComparedCycle { estimate, load, load_change, finding, sum, growth, .. } = compared;
    let known = estimator.contributors.len() - usize::from(load_change.is_none());
    let area_of = |flow_lpm: f64| flow_lpm / config.flow_lpm(1.0);
    let until = |flow_lpm| growth.map(|growth| growth.time_to(area_of(flow_lpm)));
    ComparisonLine {
        leak_residual_m2: estimate.leak_residual_m2,
        out_of_distribution: estimate.out_of_distribution.score,
        load: *load,
        load_change: *load_change,
        finding: *finding,
        cusum: *sum,
        time_to_leak: until(config.alarm.leak_lpm),
        time_to_severe: until(config.alarm.severe_lpm),
        why: FeatureValues {
            names: estimator.contributors.get(..known).unwrap_or_default(),
            values: estimate.contributions_m2.get(..known).unwrap_or_default(),
        },
    }
}
