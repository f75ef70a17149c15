//! An axis at work: its source, its pipeline, its alarm; tells the hub.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use seepd_monitor::alarm::{Alarm, AlarmState, Latch};
use seepd_monitor::baseline::CusumFinding;
use seepd_monitor::baseline::trend::TimeTo;
use seepd_monitor::event::{CycleLine, Event, Flag, NoticeKind};
use seepd_monitor::pipeline::{DutyCycle, Monitor, Pipeline};
use seepd_monitor::reason::{LEARNING_BASELINE, NO_CYCLE_YET};
use seepd_monitor::repair::{Repair, RepairKind};
use seepd_signals::{Sample, Signal};
use tokio::sync::{mpsc, watch};

use super::commission::BaselineRecord;
use super::relative::RelativeRecord;
use super::repairs::RepairBook;
use super::source::{Input, LiveSource};
use super::state::{AxisState, DutyCycleState, Keeper, LastEstimate};
use super::systemd::ENDED;
use crate::advice::advice;
use crate::clock::Clock;
use crate::config::{AxisConfig, Pace};
use crate::hub::{
    Acknowledgement, AxisStatus, BaselineStatus, Course, DutyCycleStatus, HealthyCourse, Hub, LIVE_POINTS,
    NewRepair, Order, PhaseSpan, REPAIRS_TOLD, RelativeStatus, Signature, SourceState, Thresholds,
    TrendPoint,
};
use crate::sink::recording::Recorder;
use crate::verdict::Verdict;

/// A millisecond, ns.
const MS_NS: i64 = 1_000_000;
/// Time between points of the dashboard's curves, ns.
const POINT_NS: i64 = 20_000_000;
/// Conditions are told to the hub this often, ns.
const TELL_NS: i64 = 200_000_000;
/// Longest cycle whose curve is drawn where nobody knows beforehand how long cycles are, s.
const UNKNOWN_PERIOD_S: f64 = 60.0;
/// While there is no estimate the command is looked at this often, ns.
const LOOK_NS: i64 = 10_000_000_000;

/// What an axis needs beside its configuration.
pub(super) struct AxisContext {
    /// Where it tells.
    pub hub: Arc<Hub>,
    /// What keeps its state.
    pub keeper: Keeper,
    /// What records its samples, if something does.
    pub recorder: watch::Receiver<Option<Recorder>>,
    /// Time.
    pub clock: Clock,
    /// Folder of what outlives the daemon.
    pub folder: PathBuf,
    /// Raised whenever it has worked through what there was.
    pub progress: Arc<AtomicU64>,
}

/// Runs an axis until it is told to stop or its log ends. `true` where the log ended.
pub(super) async fn run(
    config: AxisConfig,
    duty_cycles: Vec<DutyCycle>,
    mut source: LiveSource,
    context: AxisContext,
    mut orders: mpsc::Receiver<Order>,
    mut stop: watch::Receiver<bool>,
) -> bool {
    let mut pipeline = match Pipeline::new(config.monitor(duty_cycles)) {
        Ok(pipeline) => pipeline,
        Err(error) => {
            tracing::error!(axis = config.axis, "{error}");
            return true;
        }
    };
    let mut reporter = AxisReporter::restored(&config, &mut pipeline, &context);
    context.hub.update_axis(&config.axis, |_, view| view.phases = phases(&pipeline));
    reporter.tell(&pipeline, &source);
    let mut samples = Vec::with_capacity(1024);
    loop {
        samples.clear();
        let input = tokio::select! {
            biased;
            _ = stop.changed() => break false,
            Some(order) = orders.recv() => {
                reporter.obey(order, &mut pipeline);
                continue;
            }
            input = source.read(&mut samples) => input,
        };
        reporter.take(&mut pipeline, &samples, &context.recorder);
        let ended = matches!(input, Input::End(_));
        if let Input::End(error) = &input {
            if let Some(error) = error {
                tracing::error!(axis = config.axis, "{error}");
            }
            pipeline.finish(&mut |event| reporter.publish(event));
        } else {
            reporter.heed_silence(&mut pipeline, &input);
        }
        reporter.tell_now_and_then(&pipeline, &source, ended);
        context.progress.fetch_add(1, Ordering::Relaxed);
        if ended {
            context.progress.store(ENDED, Ordering::Relaxed);
            break true;
        }
    }
}

/// Stretches of the duty cycle, of several that of the first.
fn phases(pipeline: &Pipeline) -> Vec<PhaseSpan> {
    let first = pipeline.config().duty_cycles.first();
    let phases = first.map_or(&[][..], |first| &first.model.file().cycle.phases);
    phases
        .iter()
        .map(|phase| PhaseSpan { name: phase.name.clone(), from_s: phase.from_s, to_s: phase.to_s })
        .collect()
}

/// Between pipeline and hub.
struct AxisReporter<'a> {
    config: &'a AxisConfig,
    context: &'a AxisContext,
    latch: Latch,
    /// Who acknowledged what is latched.
    acknowledgement: Option<Acknowledgement>,
    /// Since when the flag is what it is, ns.
    since_ns: Option<i64>,
    /// Baselines on disk, one record a duty cycle.
    records: Vec<BaselineRecord>,
    /// The same of an axis without a model.
    relative: Option<RelativeRecord>,
    /// What was done to the machine.
    book: RepairBook,
    /// A baseline has been learned and is not on disk yet.
    learned: bool,
    /// Why it is not; told once.
    unsaved: Option<String>,
    /// Index of the last cycle's duty cycle.
    duty_cycle: usize,
    time_to_leak: Option<TimeTo>,
    points: Points,
    /// Time of the sample that the pipeline is working on; before the first one, of the start.
    sample_ns: i64,
    has_sample: bool,
    last_sample_ns: i64,
    told_ns: i64,
    stale: bool,
    /// A cycle or a flag came since the hub was last told.
    news: bool,
    last: Option<LastCycle>,
    estimate: Option<LastEstimate>,
    /// The input's last complaint, so that each is logged once.
    complaint: Option<String>,
    advice: LiveAdvice,
}

/// What is told while there is no estimate.
#[derive(Default)]
struct LiveAdvice {
    text: Option<String>,
    period_s: Option<f64>,
    looked_ns: Option<i64>,
}

/// What is told of the newest cycle.
#[derive(Clone, Copy)]
struct LastCycle {
    cycle: u64,
    end_ns: i64,
    /// None where samples have a log's own time, which the clock's cannot be compared with.
    delay_s: Option<f64>,
}

impl<'a> AxisReporter<'a> {
    fn new(config: &'a AxisConfig, pipeline: &Pipeline, context: &'a AxisContext) -> Self {
        let now_ns = context.clock.now_ns();
        let period_s = match pipeline.relative() {
            Some(_) => UNKNOWN_PERIOD_S,
            None => DutyCycle::longest_period_s(&pipeline.config().duty_cycles),
        };
        let cycle_points = 3.5 * period_s * 1e9 / POINT_NS as f64;
        let record = |monitor| BaselineRecord::open(&context.folder, config, monitor);
        AxisReporter {
            config,
            context,
            latch: Latch::default(),
            acknowledgement: None,
            since_ns: None,
            records: pipeline.monitors().iter().enumerate().map(record).collect(),
            relative: pipeline.relative().map(|_| RelativeRecord::open(&context.folder, config)),
            book: RepairBook::open(&context.folder, config),
            learned: false,
            unsaved: None,
            duty_cycle: 0,
            time_to_leak: None,
            points: Points::new(cycle_points as usize),
            sample_ns: now_ns,
            has_sample: false,
            last_sample_ns: now_ns,
            told_ns: 0,
            stale: false,
            news: true,
            last: None,
            estimate: None,
            complaint: None,
            advice: LiveAdvice::default(),
        }
    }

    /// It and its pipeline, as the daemon left them when it last ran.
    fn restored(config: &'a AxisConfig, pipeline: &mut Pipeline, context: &'a AxisContext) -> Self {
        let mut reporter = Self::new(config, pipeline, context);
        let state = context.keeper.restored(&config.axis);
        let of_duty_cycles = state.as_ref().map(|state| &state.duty_cycles);
        for (record, monitor) in reporter.records.iter_mut().zip(pipeline.monitors_mut()) {
            let state = of_duty_cycles.and_then(|states| states.get(monitor.name().unwrap_or_default()));
            record.commission(monitor, state.cloned().unwrap_or_default());
        }
        if let (Some(record), Some(monitor)) = (&mut reporter.relative, pipeline.relative_mut()) {
            record.commission(
                monitor,
                state.as_ref().and_then(|state| state.relative.clone()).unwrap_or_default(),
            );
        }
        reporter.book.look(context.clock.now_ns(), |known| {
            state
                .as_ref()
                .is_some_and(|state| state.repairs.iter().any(|heeded| heeded.repair.is_same(known)))
        });
        if let Some(state) = state {
            pipeline.restore(Alarm::from(state.alarm));
            pipeline.restore_repairs(state.repairs);
            reporter.latch = state.latch;
            reporter.acknowledgement = state.acknowledgement;
            reporter.since_ns = state.since_ns;
            reporter.estimate = state.estimate;
        } else if config.source.log.is_none() {
            // The machine as it is found: what was done to it before is no news.
            reporter.book.skip_until(context.clock.now_ns());
        }
        reporter
    }

    /// How fast samples come; a bus has no other pace than its own.
    fn pace(&self) -> Pace {
        self.config.source.log.as_ref().map_or(Pace::Recorded, |_| self.config.source.pace)
    }

    fn take(
        &mut self,
        pipeline: &mut Pipeline,
        samples: &[Sample],
        recorder: &watch::Receiver<Option<Recorder>>,
    ) {
        let is_known =
            |repair: &Repair| pipeline.repairs().iter().any(|heeded| heeded.repair.is_same(repair));
        self.book.look(self.context.clock.now_ns(), is_known);
        if samples.is_empty() {
            return;
        }
        let recorder = recorder.borrow();
        let pace = self.pace();
        for sample in samples {
            self.points.take(sample);
            self.sample_ns = sample.time_ns;
            self.has_sample = true;
            if let Some(recorder) = recorder.as_ref() {
                recorder.sample(&self.config.axis, sample, pace);
            }
            while let Some(repair) = self.book.next_until(sample.time_ns) {
                self.heed_repair(pipeline, &repair);
            }
            pipeline.push(sample, &mut |event| self.publish(event));
        }
        self.last_sample_ns = self.context.clock.now_ns();
        if self.stale {
            self.stale = false;
            self.news = true;
            tracing::info!(axis = self.config.axis, "the input is back");
        }
    }

    fn publish(&mut self, event: &Event<'_>) {
        self.news = true;
        match event {
            Event::Cycle(line) => self.note_cycle(line),
            Event::Flag(flag) => {
                self.since_ns = Some(flag.t_ns);
                let (from, to) = (flag.flag_from.name(), flag.flag_to.name());
                let reason = flag.evidence.reason;
                if flag.flag_to > Flag::Healthy || flag.flag_to == Flag::NoEstimate {
                    tracing::warn!(axis = flag.axis, from, to, reason, "flag changed from {from} to {to}");
                } else {
                    tracing::info!(axis = flag.axis, from, to, "flag changed from {from} to {to}");
                }
            }
            Event::Notice(notice) => {
                self.learned |= notice.notice == NoticeKind::BaselineLearned;
                tracing::warn!(axis = notice.axis, cycle = notice.cycle, "{}", notice.text);
            }
        }
        self.context.hub.publish_event(event);
    }

    fn note_cycle(&mut self, line: &CycleLine<'_>) {
        let end_ns = line.t_end_ns();
        let delay_ns = self.context.clock.now_ns().saturating_sub(self.sample_ns);
        let delay_s = (self.pace() == Pace::Recorded).then_some(delay_ns.max(0) as f64 / 1e9);
        self.last = Some(LastCycle { cycle: line.cycle, end_ns, delay_s });
        let why = line.comparison.as_ref().map_or(Vec::new(), |comparison| {
            let parts = comparison.why.names.iter().cloned();
            parts.zip(comparison.why.values.iter().map(|value| *value as f32)).collect()
        });
        let is_healthy =
            line.reason == Some(LEARNING_BASELINE) || line.flag == Flag::Healthy && line.reason.is_none();
        let course = Course {
            cycle: line.cycle,
            duty_cycle: line.duty_cycle.map(str::to_owned),
            why,
            flag: line.flag,
            reason: line.reason,
            leak_flow_lpm: line.leak_flow_lpm,
            points: self.points.between(line.t_start_ns, end_ns),
        };
        let estimate = match (line.leak_area_m2, line.interval90_m2, line.leak_flow_lpm) {
            (Some(leak_area_m2), Some(interval90_m2), Some(leak_flow_lpm)) => {
                Some(LastEstimate { leak_area_m2, interval90_m2, leak_flow_lpm })
            }
            _ => None,
        };
        self.estimate = estimate.or(self.estimate);
        let time_to_leak = line.comparison.as_ref().and_then(|comparison| comparison.time_to_leak);
        if let Some(name) = line.duty_cycle {
            // What one duty cycle cannot tell another may have told.
            self.time_to_leak = time_to_leak.or(self.time_to_leak);
            let of_name = self.config.duty_cycles.iter().position(|known| known.name == name);
            self.duty_cycle = of_name.unwrap_or(self.duty_cycle);
        } else {
            self.time_to_leak = time_to_leak;
        }
        let point = estimate.map(|LastEstimate { leak_area_m2, interval90_m2, leak_flow_lpm }| TrendPoint {
            t_ns: end_ns,
            leak_area_m2,
            interval90_m2,
            leak_flow_lpm,
            flag: line.flag,
        });
        self.context.hub.update_axis(line.axis, |_, view| {
            if is_healthy {
                view.healthy.take(&course, end_ns);
            }
            view.add_course(course);
            if let Some(point) = point {
                view.add_trend(point);
            }
        });
        match line.reason {
            Some(reason) => {
                tracing::info!(axis = line.axis, cycle = line.cycle, reason, "cycle rejected: {reason}");
            }
            None => tracing::debug!(
                axis = line.axis,
                cycle = line.cycle,
                leak_flow_lpm = line.leak_flow_lpm,
                "cycle"
            ),
        }
    }

    /// Raises staleness where nothing usable has come for long, and tells why once.
    fn heed_silence(&mut self, pipeline: &mut Pipeline, input: &Input) {
        let complaint = match input {
            Input::Down(why) => Some(why.clone()),
            Input::Samples => None,
            _ => self.complaint.clone(),
        };
        if complaint != self.complaint {
            if let Some(why) = &complaint {
                tracing::warn!(axis = self.config.axis, "{why}");
            }
            self.complaint = complaint;
        }
        let silent_ns = self.context.clock.now_ns().saturating_sub(self.last_sample_ns);
        if !self.stale && silent_ns as f64 > self.config.source.stale_after_s * 1e9 {
            self.stale = true;
            self.news = true;
            tracing::warn!(
                axis = self.config.axis,
                "no command has come for {} s",
                self.config.source.stale_after_s
            );
            pipeline.stale(&mut |event| self.publish(event));
        }
    }

    fn obey(&mut self, order: Order, pipeline: &mut Pipeline) {
        match order {
            Order::Acknowledge(signature) => self.acknowledge(pipeline, signature),
            Order::Renew => self.renew(pipeline),
            Order::Repair(entry) => self.repair(pipeline, entry),
        }
    }

    fn acknowledge(&mut self, pipeline: &Pipeline, Signature { who, note }: Signature) {
        let latched = self.latch.latched;
        if self.latch.acknowledge(pipeline.alarm().level()) {
            tracing::info!(axis = self.config.axis, latched = latched.map(Flag::name), who, "acknowledged");
            let by = Acknowledgement { t_ns: self.now_ns(), who, note };
            self.context.hub.publish_acknowledged(&self.config.axis, latched, &by);
            self.acknowledgement = Some(by);
        }
        self.news = true;
        self.keep(pipeline);
        let latch = self.latch;
        self.context.hub.update_axis(&self.config.axis, |status, _| {
            status.latched = latch.latched;
            status.acknowledged = latch.acknowledged;
        });
    }

    /// Something was done to the machine: noted in the log, and heeded at once unless its time is still to come.
    fn repair(&mut self, pipeline: &mut Pipeline, entry: NewRepair) {
        let now_ns = self.now_ns();
        // Whole milliseconds read better in the file.
        let repair = entry.at(now_ns - now_ns.rem_euclid(MS_NS));
        self.book.add(repair.clone());
        if repair.at_ns <= now_ns {
            self.heed_repair(pipeline, &repair);
            self.keep(pipeline);
        }
        self.news = true;
    }

    /// Now, in the samples' time: a log's have their own.
    fn now_ns(&self) -> i64 {
        if self.config.source.log.is_some() { self.sample_ns } else { self.context.clock.now_ns() }
    }

    fn heed_repair(&mut self, pipeline: &mut Pipeline, repair: &Repair) {
        let is_of_seal = repair.what == RepairKind::SealReplaced;
        if pipeline.repaired(repair, &mut |event| self.publish(event)) && is_of_seal {
            // What was latched is another seal's, and so was the healthy cycle.
            self.latch = Latch::default();
            self.forget_healthy();
        }
    }

    /// The seal has been replaced: estimates count from here, as soon as there is a baseline.
    fn renew(&mut self, pipeline: &mut Pipeline) {
        let has_begun = |(record, monitor): (&BaselineRecord, &Monitor)| {
            record.is_renewing() && monitor.learner().is_some_and(|learner| learner.cycles() == 0)
        };
        if self.relative.is_none() && self.records.iter().zip(pipeline.monitors()).all(has_begun) {
            return;
        }
        tracing::info!(axis = self.config.axis, "a new baseline will be learned from the next cycles");
        self.forget_healthy();
        for (record, monitor) in self.records.iter_mut().zip(pipeline.monitors_mut()) {
            record.renew(monitor);
        }
        if let (Some(record), Some(monitor)) = (&mut self.relative, pipeline.relative_mut()) {
            record.renew(monitor);
        }
        self.news = true;
        self.keep(pipeline);
    }

    /// What a healthy cycle is like is to be seen anew.
    fn forget_healthy(&self) {
        self.context.hub.update_axis(&self.config.axis, |_, view| view.healthy = HealthyCourse::default());
    }

    /// Keeps a baseline that has been learned; one that the disk does not take is tried again after each cycle.
    fn keep_baseline(&mut self, pipeline: &Pipeline) {
        if !self.learned {
            return;
        }
        let mut records = self.records.iter_mut().zip(pipeline.monitors());
        let kept = records.try_for_each(|(record, monitor)| record.keep(monitor));
        let kept = kept.and_then(|()| match (&mut self.relative, pipeline.relative()) {
            (Some(record), Some(monitor)) => record.keep(monitor),
            _ => Ok(()),
        });
        self.learned = kept.is_err();
        let unsaved = kept.err().map(|error| format!("the baseline cannot be written: {error}"));
        if unsaved != self.unsaved {
            let axis = &self.config.axis;
            match &unsaved {
                Some(complaint) => tracing::error!(axis, "{complaint}; trying again after each cycle"),
                None => tracing::info!(axis, "the baseline has been written now"),
            }
        }
        self.unsaved = unsaved;
    }

    fn keep(&self, pipeline: &Pipeline) {
        let of_duty_cycle = |(record, monitor): (&BaselineRecord, &Monitor)| {
            let state = DutyCycleState {
                cusum: monitor.cusum(),
                renewing: record.is_renewing(),
                aftercare: monitor.aftercare().to_vec(),
                courses: monitor.courses(),
            };
            (monitor.name().unwrap_or_default().to_owned(), state)
        };
        let state = AxisState {
            alarm: AlarmState::from(pipeline.alarm()),
            latch: self.latch,
            acknowledgement: self.acknowledgement.clone(),
            since_ns: self.since_ns,
            estimate: self.estimate,
            duty_cycles: self.records.iter().zip(pipeline.monitors()).map(of_duty_cycle).collect(),
            relative: self
                .relative
                .as_ref()
                .zip(pipeline.relative())
                .map(|(record, monitor)| record.state(monitor)),
            repairs: pipeline.repairs().to_vec(),
        };
        self.context.keeper.keep(&self.config.axis, state);
    }

    fn tell_now_and_then(&mut self, pipeline: &Pipeline, source: &LiveSource, ended: bool) {
        let now_ns = self.context.clock.now_ns();
        if self.news {
            self.latch.take(pipeline.alarm().level());
            if !self.latch.acknowledged {
                self.acknowledgement = None;
            }
            self.keep_baseline(pipeline);
            self.keep(pipeline);
        }
        if self.news || ended || now_ns.saturating_sub(self.told_ns) >= TELL_NS {
            self.told_ns = now_ns;
            self.news = false;
            self.tell(pipeline, source);
        }
    }

    /// Looks now and then at what the command is like while there is no estimate.
    fn look_again(&mut self, pipeline: &Pipeline) {
        let now_ns = self.context.clock.now_ns();
        let is_due = |looked_ns: i64| now_ns.saturating_sub(looked_ns) >= LOOK_NS;
        let is_lost = pipeline
            .alarm()
            .reason()
            .is_some_and(|reason| ![NO_CYCLE_YET, LEARNING_BASELINE].contains(&reason));
        if !is_lost || self.stale {
            self.advice = LiveAdvice::default();
        } else if self.advice.looked_ns.is_none_or(is_due) {
            let observed = pipeline.observation();
            let source = self.config.command_source(self.config.source.log.as_deref());
            let text = advice(&pipeline.summary(), &observed, &pipeline.config().duty_cycles, &source);
            self.advice =
                LiveAdvice { text: Some(text), period_s: observed.period_s, looked_ns: Some(now_ns) };
        }
    }

    fn tell(&mut self, pipeline: &Pipeline, source: &LiveSource) {
        let alarm = pipeline.alarm();
        let mut health = source.health();
        if self.stale && health.state == SourceState::Receiving {
            health.state = SourceState::Silent;
        }
        let (latch, stale, last, estimate) = (self.latch, self.stale, self.last, self.estimate);
        let acknowledgement = self.acknowledgement.clone();
        let (since_ns, t_sample_ns) = (self.since_ns, self.has_sample.then_some(self.sample_ns));
        let loss = estimate.map(|estimate| pipeline.config().loss(estimate.leak_flow_lpm));
        let leak_cost_per_year = loss.and_then(|loss| self.config.energy.cost(loss.leak_energy_kwh_per_year));
        let monitors = pipeline.monitors();
        let finding = pipeline.finding();
        let time_to_leak = self.time_to_leak.filter(|_| finding == CusumFinding::Leak);
        let of_model = monitors.get(self.duty_cycle).map(BaselineStatus::of);
        let of_relative = || pipeline.relative().map(BaselineStatus::of_relative);
        let baseline = of_model.or_else(of_relative).unwrap_or_default();
        let relative = pipeline.relative().map(RelativeStatus::of);
        let duty_cycles = monitors.iter().filter_map(DutyCycleStatus::of).collect();
        self.look_again(pipeline);
        let (advice, observed_period_s) = (self.advice.text.clone(), self.advice.period_s);
        let fresh = &mut self.points.fresh;
        self.context.hub.update_axis(&self.config.axis, |status, view| {
            *status = AxisStatus {
                flag: alarm.flag(),
                since_ns,
                t_sample_ns,
                verdict: Verdict::of(alarm.flag(), alarm.reason(), pipeline.relative().is_some()),
                reason: alarm.reason(),
                advice,
                observed_period_s,
                level: alarm.level(),
                latched: latch.latched,
                acknowledged: latch.acknowledged,
                acknowledgement,
                thresholds: Thresholds::of(&self.config.alarm),
                stale,
                leak_area_m2: estimate.map(|estimate| estimate.leak_area_m2),
                interval90_m2: estimate.map(|estimate| estimate.interval90_m2),
                leak_flow_lpm: estimate.map(|estimate| estimate.leak_flow_lpm),
                lpm_per_m2: pipeline.config().flow_lpm(1.0),
                loss,
                leak_cost_per_year,
                time_to_leak_s: time_to_leak.map(|time| time.expected_s),
                time_to_leak_range_s: time_to_leak.map(|time| [time.earliest_s, time.latest_s]),
                baseline,
                duty_cycles,
                finding,
                condition: pipeline.condition().map(str::to_owned),
                conditions: pipeline.conditions().copied().collect(),
                repairs: pipeline.repairs().iter().rev().take(REPAIRS_TOLD).rev().cloned().collect(),
                relative,
                cycle: last.map(|last| last.cycle),
                t_last_cycle_ns: last.map(|last| last.end_ns),
                publication_delay_s: last.and_then(|last| last.delay_s),
                cycles: pipeline.cycles(),
                rejected: pipeline.rejected(),
                samples_rejected: pipeline.samples_rejected(),
                source: health,
                ..AxisStatus::new(&self.config.axis, self.config.reference_dp_pa)
            };
            view.live.extend(fresh.drain(..));
            let surplus = view.live.len().saturating_sub(LIVE_POINTS);
            view.live.drain(..surplus);
        });
    }
}

/// The command in steps of 20 ms, for curves.
struct Points {
    ring: VecDeque<(i64, f32)>,
    kept: usize,
    fresh: Vec<(i64, f32)>,
    begin_ns: Option<i64>,
    sum: f64,
    count: u32,
}

impl Points {
    fn new(kept: usize) -> Self {
        let kept = kept.clamp(100, 100_000);
        Points {
            ring: VecDeque::with_capacity(kept),
            kept,
            fresh: Vec::with_capacity(64),
            begin_ns: None,
            sum: 0.0,
            count: 0,
        }
    }

    fn take(&mut self, sample: &Sample) {
        let Some(command) = sample.get(Signal::Command).filter(|command| command.is_finite()) else { return };
        let begin_ns = *self.begin_ns.get_or_insert(sample.time_ns);
        let since_ns = sample.time_ns.saturating_sub(begin_ns);
        if !(0..POINT_NS).contains(&since_ns) {
            self.close(begin_ns);
            self.begin_ns = Some(sample.time_ns);
        }
        self.sum += command;
        self.count += 1;
    }

    fn close(&mut self, begin_ns: i64) {
        if self.count > 0 {
            let point = (begin_ns, (self.sum / f64::from(self.count)) as f32);
            if self.ring.len() >= self.kept {
                self.ring.pop_front();
            }
            self.ring.push_back(point);
            if self.fresh.len() < LIVE_POINTS {
                self.fresh.push(point);
            }
        }
        (self.sum, self.count) = (0.0, 0);
    }

    fn between(&self, start_ns: i64, end_ns: i64) -> Vec<(f32, f32)> {
        let within = self.ring.iter().filter(|(t_ns, _)| (start_ns..end_ns).contains(t_ns));
        within.map(|(t_ns, command)| (t_ns.saturating_sub(start_ns) as f32 / 1e9, *command)).collect()
    }
}
