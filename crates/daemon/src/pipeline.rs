//! From samples to events: the one object that replayed and live data go through.
//!
//! No clock (time is the sample's), no input or output, no allocation after start.

use seepd_features::segment::Projection;
use seepd_features::{Counts, CycleReader, CycleState, Outcome, ValidCycle};
use seepd_model::{Estimate, Model};
use seepd_signals::Sample;

use crate::alarm::{Alarm, AlarmConfig, Change};
use crate::baseline::follower::Followed;
use crate::baseline::{Baseline, Drift, Finding, Follower, Learner, LoadKnowledge};
use crate::config::Config;
use crate::energy::Loss;
use crate::event::{
    ComparisonLine, CycleLine, Event, FeatureValues, Flag, FlagEvent, LPM_PER_M3_PER_S, Notice, NoticeKind,
    Summary,
};

/// What the pipeline needs to know.
#[derive(Debug, Clone, Copy)]
pub struct PipelineConfig<'m> {
    /// Machine axis, for messages.
    pub axis: &'m str,
    /// The model.
    pub model: &'m Model,
    /// The model's projections, from [`Model::projections`].
    pub projections: &'m [Projection<'m>],
    /// Alarm thresholds.
    pub alarm: &'m AlarmConfig,
    /// Pressure difference at which leaks are given as flows, Pa.
    pub reference_dp_pa: f64,
    /// Hours that the machine runs in a year.
    pub operating_hours_per_year: f64,
}

/// Rejections by reason, in [`Reason`](seepd_features::Reason)'s order of first appearance.
const REASONS: usize = 9;
/// Reason of cycles that differ from the baseline as nothing in training does.
const UNLIKE_BASELINE: &str = "unlike_baseline";
/// Estimates whose median is the summary's.
const RECENT: usize = 9;
/// Cycles in a row that are unlike the baseline before a new one is asked for.
const UNLIKE_CYCLES: u32 = 5;
/// Periods without a cycle after which there is no estimate.
const PATIENCE_PERIODS: f64 = 3.0;

/// Names of what contributes to a response: the phases, then the load.
fn contributors(model: &Model) -> Vec<String> {
    let phases = model.file().cycle.phases.iter().map(|phase| phase.name.clone());
    phases.chain(["load".to_owned()]).collect()
}

/// Whether cycles are compared with a baseline.
#[derive(Debug, Clone)]
enum Commissioning {
    /// They are not.
    Absent,
    /// They are to become one.
    Learning(Learner),
    /// They are.
    Following(Box<Follower>),
}

/// What the pipeline remembers between cycles.
#[derive(Debug, Clone)]
struct Progress {
    alarm: Alarm,
    commissioning: Commissioning,
    contributors: Vec<String>,
    /// What was last told of the baseline, so that each is told once.
    finding: Finding,
    load: LoadKnowledge,
    /// Cycles in a row that are unlike the baseline.
    unlike: u32,
    first_ns: Option<i64>,
    newest_ns: i64,
    /// End of the last cycle, used or rejected, or the first sample's time.
    last_cycle_ns: i64,
    cycle: u64,
    valid: u64,
    rejected: [(&'static str, u64); REASONS],
    recent_m2: [f64; RECENT],
}

/// A machine axis's way from samples to events.
pub struct Pipeline<'m> {
    config: PipelineConfig<'m>,
    reader: CycleReader<'m>,
    state: CycleState<Vec<f32>>,
    progress: Progress,
}

impl<'m> Pipeline<'m> {
    /// Starts with an empty memory.
    pub fn new(config: PipelineConfig<'m>) -> Self {
        let reader = config.model.reader(config.projections);
        let ring = vec![0.0; reader.definition().ring_samples()];
        Pipeline {
            config,
            reader,
            state: CycleState::new(ring),
            progress: Progress {
                alarm: Alarm::default(),
                commissioning: Commissioning::Absent,
                contributors: contributors(config.model),
                finding: Finding::None,
                load: LoadKnowledge::Inferred,
                unlike: 0,
                first_ns: None,
                newest_ns: 0,
                last_cycle_ns: 0,
                cycle: 0,
                valid: 0,
                rejected: [("", 0); REASONS],
                recent_m2: [0.0; RECENT],
            },
        }
    }

    /// The configuration.
    pub fn config(&self) -> &PipelineConfig<'m> {
        &self.config
    }

    /// Takes a sample; `sink` hears of each cycle that it ends and each flag that it changes.
    #[inline]
    pub fn push(&mut self, sample: &Sample, sink: &mut impl FnMut(&Event<'_>)) {
        if self.progress.first_ns.is_none() {
            self.progress.first_ns = Some(sample.time_ns);
            self.progress.last_cycle_ns = sample.time_ns;
        }
        self.progress.newest_ns = sample.time_ns;
        let Pipeline { config, reader, state, progress } = self;
        reader.push(state, sample, &mut |outcome| progress.take(config, &outcome, sink));
        let patience_ns = PATIENCE_PERIODS * reader.definition().period_s * 1e9;
        let silent_ns = sample.time_ns.saturating_sub(progress.last_cycle_ns);
        if silent_ns as f64 > patience_ns {
            self.lose_patience(sink);
        }
    }

    #[cold]
    fn lose_patience(&mut self, sink: &mut impl FnMut(&Event<'_>)) {
        let reason = self.silence_reason();
        let progress = &mut self.progress;
        progress.last_cycle_ns = progress.newest_ns;
        if let Some(change) = progress.alarm.lost(reason) {
            sink(&progress.flag_event(&self.config, change, progress.newest_ns));
        }
    }

    /// The input has gone; what was under way is kept, in case it comes back.
    pub fn stale(&mut self, sink: &mut impl FnMut(&Event<'_>)) {
        let progress = &mut self.progress;
        if let Some(change) = progress.alarm.lost("stale") {
            sink(&progress.flag_event(&self.config, change, progress.newest_ns));
        }
    }

    /// Takes the alarm up where an earlier run left it.
    pub fn restore(&mut self, alarm: Alarm) {
        self.progress.alarm = alarm;
    }

    /// Compares cycles with a baseline from now on.
    pub fn follow(&mut self, baseline: Baseline) {
        self.progress.follow(baseline);
    }

    /// Learns a baseline from the next cycles, and compares with it from then on.
    pub fn learn(&mut self, occasion: &str, cycles: usize) {
        self.progress.commissioning = Commissioning::Learning(Learner::new(occasion, cycles));
        self.progress.finding = Finding::None;
    }

    /// The baseline that cycles are compared with.
    pub fn baseline(&self) -> Option<&Baseline> {
        match &self.progress.commissioning {
            Commissioning::Following(follower) => Some(follower.baseline()),
            _ => None,
        }
    }

    /// What gathers a baseline, while it does.
    pub fn learner(&self) -> Option<&Learner> {
        match &self.progress.commissioning {
            Commissioning::Learning(learner) => Some(learner),
            _ => None,
        }
    }

    /// The sums over cycles, where there is a baseline.
    pub fn drift(&self) -> Option<Drift> {
        match &self.progress.commissioning {
            Commissioning::Following(follower) => Some(*follower.drift()),
            _ => None,
        }
    }

    /// Takes the sums up where an earlier run left them.
    pub fn restore_drift(&mut self, drift: Drift) {
        if let Commissioning::Following(follower) = &mut self.progress.commissioning {
            follower.restore(drift);
            self.progress.finding = drift.finding();
        }
    }

    /// The alarm.
    pub fn alarm(&self) -> &Alarm {
        &self.progress.alarm
    }

    /// Why there have been no cycles for long.
    fn silence_reason(&self) -> &'static str {
        let counts = self.state.counts();
        let long = self.reader.definition().cycle_samples() as i64;
        if self.state.wrong_rate_hz().is_some() {
            "wrong_rate"
        } else if counts.not_a_number * 2 > counts.samples {
            "not_a_number"
        } else if counts.out_of_range * 2 > counts.samples {
            "out_of_range"
        } else if self.state.standstill_samples() > long {
            "stuck"
        } else {
            "no_cycle_found"
        }
    }

    /// Ends the stream; a cycle under way is rejected as incomplete.
    pub fn finish(&mut self, sink: &mut impl FnMut(&Event<'_>)) {
        if self.progress.first_ns.is_some() && self.progress.cycle == 0 {
            let reason = self.silence_reason();
            self.progress.alarm.lost(reason);
        }
        let Pipeline { config, reader, state, progress } = self;
        reader.finish(state, &mut |outcome| progress.take(config, &outcome, sink));
    }

    /// Samples used and left out so far.
    pub fn counts(&self) -> &Counts {
        self.state.counts()
    }

    /// The samples' rate, Hz, where it is not the model's.
    pub fn wrong_rate_hz(&self) -> Option<f64> {
        self.state.wrong_rate_hz()
    }

    /// What it all comes to.
    pub fn summary(&self) -> Summary {
        let (progress, counts) = (&self.progress, self.counts());
        let samples_rejected = [
            ("bridged", counts.bridged),
            ("duplicate", counts.duplicate),
            ("missing", counts.missing),
            ("not_a_number", counts.not_a_number),
            ("out_of_order", counts.out_of_order),
            ("out_of_range", counts.out_of_range),
            ("wrong_rate", counts.wrong_rate),
        ];
        let area = progress.recent_area_m2();
        Summary {
            schema: "seepd.summary/1",
            axis: self.config.axis.to_owned(),
            samples: counts.samples,
            samples_rejected: samples_rejected.into_iter().filter(|(_, count)| *count > 0).collect(),
            cycles: progress.valid,
            rejected: progress.rejected.iter().copied().filter(|(_, count)| *count > 0).collect(),
            flag: progress.alarm.flag(),
            reason: progress.alarm.reason(),
            leak_area_m2: area,
            leak_flow_lpm: area.map(|area| self.config.flow_lpm(area)),
            loss: area.map(|area| self.config.loss(self.config.flow_lpm(area))),
            reference_dp_pa: self.config.reference_dp_pa,
            highest_flag: progress.alarm.highest(),
            duration_s: progress
                .first_ns
                .map_or(0.0, |first| (progress.newest_ns.saturating_sub(first)) as f64 / 1e9),
        }
    }
}

impl<'m> PipelineConfig<'m> {
    /// What an axis's configuration says; `projections` are the model's.
    pub fn new(config: &'m Config, model: &'m Model, projections: &'m [Projection<'m>]) -> Self {
        PipelineConfig {
            axis: &config.axis,
            model,
            projections,
            alarm: &config.alarm,
            reference_dp_pa: config.reference_dp_pa,
            operating_hours_per_year: config.operating_hours_per_year,
        }
    }
}

impl PipelineConfig<'_> {
    /// Flow of a leak at the reference pressure difference, L/min; counts the leak orifice only.
    pub fn flow_lpm(&self, area_m2: f64) -> f64 {
        self.model.leak_flow_m3_per_s(area_m2, self.reference_dp_pa) * LPM_PER_M3_PER_S
    }

    /// What a leak of that flow costs, L/min.
    pub fn loss(&self, flow_lpm: f64) -> Loss {
        Loss::of(flow_lpm, self.reference_dp_pa, self.operating_hours_per_year)
    }
}

impl Progress {
    fn seconds(&self, time_ns: i64) -> f64 {
        time_ns.saturating_sub(self.first_ns.unwrap_or(0)) as f64 / 1e9
    }

    fn take(
        &mut self,
        config: &PipelineConfig<'_>,
        outcome: &Outcome<'_>,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        let (start_ns, end_ns) = match outcome {
            Outcome::Valid(valid) => (valid.start_ns, valid.end_ns),
            Outcome::Rejected(rejected) => (rejected.start_ns, rejected.end_ns),
        };
        self.last_cycle_ns = end_ns.max(self.last_cycle_ns.min(self.newest_ns));
        let change = match outcome {
            Outcome::Valid(valid) => self.take_valid(config, valid, sink),
            Outcome::Rejected(rejected) => {
                let reason = rejected.reason.name();
                self.count_rejection(reason);
                let line = CycleLine { reason: Some(reason), ..self.blank_line(config, start_ns, end_ns) };
                sink(&Event::Cycle(line));
                self.alarm.rejected(config.alarm, reason)
            }
        };
        if let Some(change) = change {
            sink(&self.flag_event(config, change, end_ns));
        }
        self.cycle += 1;
    }

    /// A cycle's line without an estimate.
    fn blank_line<'l>(&self, config: &PipelineConfig<'l>, start_ns: i64, end_ns: i64) -> CycleLine<'l> {
        CycleLine {
            schema: "seepd.cycle/1",
            axis: config.axis,
            cycle: self.cycle,
            t_start_s: self.seconds(start_ns),
            t_end_s: self.seconds(end_ns),
            t_start_ns: start_ns,
            leak_area_m2: None,
            interval90_m2: None,
            leak_flow_lpm: None,
            reference_dp_pa: config.reference_dp_pa,
            flag: Flag::NoEstimate,
            reason: None,
            comparison: None,
            features: None,
        }
    }

    fn take_valid(
        &mut self,
        config: &PipelineConfig<'_>,
        valid: &ValidCycle<'_>,
        sink: &mut impl FnMut(&Event<'_>),
    ) -> Option<Change> {
        let absolute = config.model.estimate_at(valid.features, valid.statistics.noise);
        let end_s = self.seconds(valid.end_ns);
        let followed = match &mut self.commissioning {
            Commissioning::Following(follower) => follower.take(config.model, valid, end_s),
            _ => None,
        };
        let is_new = followed.is_some_and(|followed| followed.estimate.novelty > 1.0);
        let estimate = followed.map_or(absolute, |followed| followed.estimate.estimate);
        let flow_lpm = config.flow_lpm(estimate.value);
        let change = if is_new {
            self.count_rejection(UNLIKE_BASELINE);
            self.alarm.rejected(config.alarm, UNLIKE_BASELINE)
        } else {
            self.recent_m2[(self.valid % RECENT as u64) as usize] = estimate.value;
            self.valid += 1;
            let found = followed.is_some_and(|followed| followed.finding == Finding::Leak);
            self.alarm.estimated_with(config.alarm, flow_lpm, found)
        };
        let line = CycleLine {
            leak_area_m2: (!is_new).then_some(estimate.value),
            interval90_m2: (!is_new).then_some(estimate.interval),
            leak_flow_lpm: (!is_new).then_some(flow_lpm),
            flag: if is_new { Flag::NoEstimate } else { self.alarm.flag() },
            reason: is_new.then_some(UNLIKE_BASELINE),
            comparison: followed.as_ref().map(|followed| self.comparison_line(config, followed, absolute)),
            features: Some(FeatureValues { names: config.model.feature_names(), values: valid.features }),
            ..self.blank_line(config, valid.start_ns, valid.end_ns)
        };
        sink(&Event::Cycle(line));
        if let Some(followed) = &followed {
            self.tell_findings(config, valid.end_ns, followed, sink);
        }
        self.learn_from(config, valid, absolute, sink);
        change
    }

    fn comparison_line<'l>(
        &'l self,
        config: &PipelineConfig<'_>,
        followed: &'l Followed,
        absolute: Estimate,
    ) -> ComparisonLine<'l> {
        let Followed { estimate, load, load_change, finding, sum, growth } = followed;
        let known = self.contributors.len() - usize::from(load_change.is_none());
        let area_of = |flow_lpm: f64| flow_lpm / config.flow_lpm(1.0);
        let until = |flow_lpm| growth.map(|growth| growth.time_to(area_of(flow_lpm)));
        ComparisonLine {
            absolute_leak_area_m2: absolute.value,
            absolute_interval90_m2: absolute.interval,
            response_m2: estimate.response_m2,
            novelty: estimate.novelty,
            load: *load,
            load_change: *load_change,
            finding: *finding,
            drift_sum: *sum,
            time_to_leak: until(config.alarm.leak_lpm),
            time_to_severe: until(config.alarm.severe_lpm),
            why: FeatureValues {
                names: self.contributors.get(..known).unwrap_or_default(),
                values: estimate.contributions_m2.get(..known).unwrap_or_default(),
            },
        }
    }

    fn follow(&mut self, baseline: Baseline) {
        self.commissioning = Commissioning::Following(Box::new(Follower::new(baseline)));
        (self.finding, self.load, self.unlike) = (Finding::None, LoadKnowledge::Inferred, 0);
    }

    /// A cycle on the way to a baseline.
    fn learn_from(
        &mut self,
        config: &PipelineConfig<'_>,
        valid: &ValidCycle<'_>,
        absolute: Estimate,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        let Commissioning::Learning(learner) = &mut self.commissioning else { return };
        learner.take(valid, absolute);
        if !learner.is_full() {
            return;
        }
        match learner.baseline(config.model) {
            Ok(baseline) => {
                let mut text = format!("a baseline of {} cycles has been learned", baseline.cycles);
                for remark in &baseline.remarks {
                    text.push_str("; ");
                    text.push_str(remark);
                }
                self.follow(baseline);
                sink(&self.notice(config, NoticeKind::BaselineLearned, text, valid.end_ns));
            }
            Err(message) => {
                let wanted = learner.wanted();
                self.commissioning = Commissioning::Learning(Learner::new(learner.occasion(), wanted));
                let text = format!("no baseline: {message}; learning begins anew");
                sink(&self.notice(config, NoticeKind::BaselineFailed, text, valid.end_ns));
            }
        }
    }

    /// Tells what has changed against the baseline, once each.
    fn tell_findings(
        &mut self,
        config: &PipelineConfig<'_>,
        at_ns: i64,
        followed: &Followed,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        let before = std::mem::replace(&mut self.finding, followed.finding);
        if before != followed.finding {
            let flow_lpm = config.flow_lpm(followed.estimate.estimate.value);
            let (kind, text) = match followed.finding {
                Finding::Leak => {
                    let text = format!("more leakage than at the baseline: about {flow_lpm:.3} L/min");
                    (NoticeKind::LeakFound, text)
                }
                Finding::Improved => {
                    let text = "less leakage than at the baseline: it was learned from a machine that leaked, or the seal has been \
                                replaced; learn a new baseline";
                    (NoticeKind::Improved, text.to_owned())
                }
                Finding::None => (NoticeKind::LeakGone, "as at the baseline again".to_owned()),
            };
            sink(&self.notice(config, kind, text, at_ns));
        }
        let before = std::mem::replace(&mut self.load, followed.load);
        if followed.load == LoadKnowledge::Frozen && before != LoadKnowledge::Frozen {
            let text =
                "the load's signal stands still over a whole cycle: it is not used; look at its sensor"
                    .to_owned();
            sink(&self.notice(config, NoticeKind::LoadFrozen, text, at_ns));
        }
        self.unlike = if followed.estimate.novelty > 1.0 { self.unlike.saturating_add(1) } else { 0 };
        if self.unlike == UNLIKE_CYCLES {
            let text = format!(
                "{UNLIKE_CYCLES} cycles in a row differ from the baseline as no leak, load, oil or supply of the training explains \
                 (distance {:.1} times the limit, most of it in {}): has a valve, a sensor or the duty cycle been changed? If the \
                 seal is good, learn a new baseline",
                followed.estimate.novelty,
                self.contributors.get(followed.estimate.newest_phase).map_or("", String::as_str)
            );
            sink(&self.notice(config, NoticeKind::UnlikeBaseline, text, at_ns));
        }
    }

    fn notice<'a>(
        &self,
        config: &PipelineConfig<'a>,
        notice: NoticeKind,
        text: String,
        at_ns: i64,
    ) -> Event<'a> {
        Event::Notice(Notice {
            schema: "seepd.notice/1",
            axis: config.axis,
            notice,
            text,
            cycle: self.cycle,
            t_s: self.seconds(at_ns),
            t_ns: at_ns,
        })
    }

    fn flag_event<'a>(&self, config: &PipelineConfig<'a>, change: Change, at_ns: i64) -> Event<'a> {
        Event::Flag(FlagEvent {
            schema: "seepd.event/1",
            axis: config.axis,
            flag_from: change.from,
            flag_to: change.to,
            cycle: self.cycle,
            t_s: self.seconds(at_ns),
            t_ns: at_ns,
            evidence: change.evidence,
        })
    }

    fn count_rejection(&mut self, reason: &'static str) {
        let slot = self.rejected.iter_mut().find(|(known, count)| *known == reason || *count == 0);
        if let Some(slot) = slot {
            *slot = (reason, slot.1 + 1);
        }
    }

    /// Median of the last estimates, m².
    fn recent_area_m2(&self) -> Option<f64> {
        let count = (self.valid as usize).min(RECENT);
        let mut recent = self.recent_m2;
        let recent = recent.get_mut(..count)?;
        recent.sort_by(f64::total_cmp);
        recent.get(count / 2).copied()
    }
}
