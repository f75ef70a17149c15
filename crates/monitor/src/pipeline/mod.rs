//! From samples to events: the one object that replayed and live data go through.
//!
//! No clock (time is the sample's), no input or output, and no allocation for a sample; at a cycle's end the fit of a leak's growth and
//! the words of flags and notices allocate, and give back what they took (`tests/allocations.rs` counts). A [`Monitor`] for each of the
//! axis's duty cycles reads every sample; where there are several, the arbiter says whose a cycle is.

mod arbiter;
mod monitor;
pub mod observer;
mod progress;
mod relative;
mod repairs;

use std::collections::BTreeMap;
use std::sync::Arc;

use seepd_features::{Counts, CycleReader, CycleState, ReaderError, Reason};
use seepd_model::Model;
use seepd_signals::Sample;

use crate::alarm::{Alarm, AlarmConfig};
use crate::baseline::{BaselineError, CusumFinding};
use crate::cause::course::Condition;
use crate::energy::Loss;
use crate::event::{Event, LPM_PER_M3_PER_S, Summary};
use crate::reason::{NO_CYCLE_FOUND, NO_PLANT_MODEL, STALE, TOO_FEW_ESTIMATES};
use crate::relative::RelativeMonitor;

use arbiter::Arbiter;
pub use monitor::{DutyCycle, Monitor};
use observer::{CommandObserver, Observation};
use progress::Progress;

/// What the pipeline needs to know.
#[derive(Debug, Clone)]
pub struct MonitorConfig {
    /// Machine axis, for messages.
    pub axis: String,
    /// Its duty cycles, whose models read at the same rate; none: the axis is watched relative to its own healthy cycles, without sizes.
    pub duty_cycles: Vec<DutyCycle>,
    /// Alarm thresholds.
    pub alarm: AlarmConfig,
    /// Pressure difference at which leaks are given as flows, Pa.
    pub reference_dp_pa: f64,
    /// Hours that the machine runs in a year.
    pub operating_hours_per_year: f64,
}

/// Pressure difference at which leaks are given as flows unless another is named, Pa.
pub const REFERENCE_DP_PA: f64 = 7e6;
/// Hours of a year, for machines that never rest.
pub const HOURS_PER_YEAR: f64 = 8760.0;
/// Periods without a cycle after which there is no estimate.
const PATIENCE_PERIODS: f64 = 3.0;
/// Fewest estimates that a summary's size is the median of.
pub const LEAST_ESTIMATES: u64 = 3;

/// A machine axis's way from samples to events.
pub struct Pipeline {
    config: MonitorConfig,
    monitors: Vec<Monitor>,
    arbiter: Arbiter,
    /// The longest duty cycle's period, s.
    period_s: f64,
    progress: Progress,
    observer: CommandObserver,
    /// Where there is no model.
    relative: Option<RelativeMonitor>,
}

impl Pipeline {
    /// Starts with an empty memory.
    ///
    /// # Errors
    /// [`ReaderError`] of a model that has more features, phases or bins than the reader has room for.
    pub fn new(config: MonitorConfig) -> Result<Self, ReaderError> {
        let relative = config.duty_cycles.is_empty().then(RelativeMonitor::default);
        let monitors: Vec<_> = config.duty_cycles.iter().map(Monitor::new).collect::<Result<_, _>>()?;
        Ok(Pipeline {
            arbiter: Arbiter::new(monitors.len()),
            period_s: DutyCycle::longest_period_s(&config.duty_cycles),
            config,
            monitors,
            progress: Progress::default(),
            observer: CommandObserver::default(),
            relative,
        })
    }

    /// The configuration.
    pub fn config(&self) -> &MonitorConfig {
        &self.config
    }

    /// What watches each duty cycle, in the configuration's order.
    pub fn monitors(&self) -> &[Monitor] {
        &self.monitors
    }

    /// The same, to set baselines.
    pub fn monitors_mut(&mut self) -> &mut [Monitor] {
        &mut self.monitors
    }

    /// Takes a sample; `sink` hears of each cycle that it ends and each flag that it changes.
    #[inline]
    pub fn push(&mut self, sample: &Sample, sink: &mut impl FnMut(&Event<'_>)) {
        self.progress.note_time(sample.time_ns);
        self.observer.take(sample);
        let (config, progress) = (&self.config, &mut self.progress);
        if let Some(relative) = &mut self.relative {
            relative.push(sample, &self.observer, &mut |estimator, outcome| {
                progress.take_relative(config, estimator, outcome, sink);
            });
        } else if let [Monitor { reader, state, estimator }] = self.monitors.as_mut_slice() {
            reader
                .get()
                .push(state, sample, &mut |outcome| progress.take(config, estimator, &outcome, false, sink));
        } else {
            self.push_to_all(sample, sink);
        }
        let silent_ns = sample.time_ns.saturating_sub(self.progress.last_cycle_ns);
        let period_s = self.relative.as_ref().map_or(self.period_s, RelativeMonitor::period_s);
        if silent_ns as f64 > PATIENCE_PERIODS * period_s * 1e9 {
            self.lose_patience(sink);
        }
    }

    fn push_to_all(&mut self, sample: &Sample, sink: &mut impl FnMut(&Event<'_>)) {
        let arbiter = &mut self.arbiter;
        for (which, Monitor { reader, state, estimator }) in self.monitors.iter_mut().enumerate() {
            reader.get().push(state, sample, &mut |outcome| arbiter.hear(which, estimator, &outcome));
        }
        if self.arbiter.is_waiting() {
            self.settle(sample.time_ns, sink);
        }
    }

    /// Tells of the cycles of which it is certain by now whose they are.
    fn settle(&mut self, now_ns: i64, sink: &mut impl FnMut(&Event<'_>)) {
        let patience_ns = (self.period_s * 1e9) as i64;
        loop {
            let monitors = &self.monitors;
            let begun_ns = |which: usize| {
                monitors.get(which).and_then(|monitor| monitor.reader.get().begun_ns(&monitor.state))
            };
            let Some(told) = self.arbiter.settled(begun_ns, now_ns, patience_ns) else { return };
            let found_elsewhere = self
                .monitors
                .iter()
                .enumerate()
                .any(|(which, monitor)| which != told.which && monitor.finding() == CusumFinding::Leak);
            if let Some(Monitor { estimator, .. }) = self.monitors.get_mut(told.which) {
                self.progress.take(&self.config, estimator, &told.outcome(), found_elsewhere, sink);
            }
        }
    }

    #[cold]
    fn lose_patience(&mut self, sink: &mut impl FnMut(&Event<'_>)) {
        self.progress.last_cycle_ns = self.progress.newest_ns;
        let reason = self.silence_reason();
        self.progress.lose(&self.config, reason, sink);
        if let Some(relative) = &mut self.relative {
            relative.doubt();
        }
    }

    /// The input has gone; what was under way is kept, in case it comes back.
    pub fn stale(&mut self, sink: &mut impl FnMut(&Event<'_>)) {
        self.progress.lose(&self.config, STALE, sink);
    }

    /// Takes the alarm up where an earlier run left it.
    pub fn restore(&mut self, alarm: Alarm) {
        self.progress.alarm = alarm;
    }

    /// Learns a baseline of each duty cycle from its next cycles, and compares with it from then on.
    ///
    /// # Errors
    /// [`BaselineError::CannotCompare`] of a model that cannot.
    pub fn learn(&mut self, occasion: &str, cycles: usize) -> Result<(), BaselineError> {
        self.monitors.iter_mut().try_for_each(|monitor| monitor.learn(occasion, cycles))
    }

    /// What the sums over cycles say: a leak where any duty cycle shows it.
    pub fn finding(&self) -> CusumFinding {
        let findings = self.monitors.iter().map(Monitor::finding);
        findings.fold(CusumFinding::None, |worst, finding| match (worst, finding) {
            (CusumFinding::Leak, _) | (_, CusumFinding::Leak) => CusumFinding::Leak,
            (CusumFinding::None, other) => other,
            (worst, _) => worst,
        })
    }

    /// What has changed beside the seal since the baseline, in words; `None` where nothing has.
    pub fn condition(&self) -> Option<&str> {
        self.progress.condition.as_deref()
    }

    /// Causes beside the seal that have been found over cycles, by duty cycle and the surest first.
    pub fn conditions(&self) -> impl Iterator<Item = &Condition> {
        self.monitors.iter().flat_map(Monitor::conditions)
    }

    /// The alarm.
    pub fn alarm(&self) -> &Alarm {
        &self.progress.alarm
    }

    /// Why there have been no cycles for long.
    fn silence_reason(&self) -> &'static str {
        let Some((reader, state)) = self.reading() else { return NO_CYCLE_FOUND };
        let counts = state.counts();
        let long = reader.definition().cycle_samples() as i64;
        if state.wrong_rate_hz().is_some() {
            Reason::WrongRate.name()
        } else if counts.not_a_number * 2 > counts.samples {
            Reason::NotANumber.name()
        } else if counts.out_of_range * 2 > counts.samples {
            Reason::OutOfRange.name()
        } else if state.standstill_samples() > long {
            Reason::Stuck.name()
        } else {
            NO_CYCLE_FOUND
        }
    }

    /// Ends the stream; a cycle under way is rejected as incomplete.
    pub fn finish(&mut self, sink: &mut impl FnMut(&Event<'_>)) {
        if self.progress.first_ns.is_some() && self.progress.cycle == 0 && !self.arbiter.is_waiting() {
            let reason = self.silence_reason();
            self.progress.alarm.lost(reason);
        }
        let (config, progress) = (&self.config, &mut self.progress);
        if let Some(relative) = &mut self.relative {
            relative.finish(&mut |estimator, outcome| {
                progress.take_relative(config, estimator, outcome, sink);
            });
            return;
        }
        if let [Monitor { reader, state, estimator }] = self.monitors.as_mut_slice() {
            reader
                .get()
                .finish(state, &mut |outcome| progress.take(config, estimator, &outcome, false, sink));
            return;
        }
        for (which, Monitor { reader, state, estimator }) in self.monitors.iter_mut().enumerate() {
            let arbiter = &mut self.arbiter;
            reader.get().finish(state, &mut |outcome| arbiter.hear(which, estimator, &outcome));
        }
        self.settle(i64::MAX, sink);
    }

    /// The reader of the first duty cycle, and what it remembers.
    fn reading(&self) -> Option<(&CycleReader<'_>, &CycleState<Vec<f32>>)> {
        let of_model = self.monitors.first().map(|monitor| (monitor.reader.get(), &monitor.state));
        of_model.or_else(|| self.relative.as_ref()?.reading())
    }

    /// What watches an axis without a model.
    pub fn relative(&self) -> Option<&RelativeMonitor> {
        self.relative.as_ref()
    }

    /// The same, to set its baseline.
    pub fn relative_mut(&mut self) -> Option<&mut RelativeMonitor> {
        self.relative.as_mut()
    }

    /// Samples used and left out so far. Every monitor reads the same samples.
    pub fn counts(&self) -> Counts {
        self.reading().map(|(_, state)| *state.counts()).unwrap_or_default()
    }

    /// The samples' rate, Hz, where it is not the model's.
    pub fn wrong_rate_hz(&self) -> Option<f64> {
        self.reading().and_then(|(_, state)| state.wrong_rate_hz())
    }

    /// What it all comes to.
    pub fn summary(&self) -> Summary {
        let progress = &self.progress;
        let size_withheld = self.size_withheld();
        let of_duty_cycle = |monitor: &Monitor| Some((monitor.name()?.to_owned(), monitor.cycles()));
        let area = progress.recent_area_m2().filter(|_| size_withheld.is_none());
        Summary {
            schema: "seepd.summary/1",
            axis: self.config.axis.to_owned(),
            samples: self.counts().samples,
            samples_rejected: self.samples_rejected(),
            cycles: self.cycles(),
            duty_cycles: self.monitors.iter().filter_map(of_duty_cycle).collect(),
            rejected: self.rejected(),
            flag: progress.alarm.flag(),
            reason: progress.alarm.reason(),
            leak_area_m2: area,
            leak_flow_lpm: area.map(|area| self.config.flow_lpm(area)),
            condition: progress.condition.clone(),
            conditions: self.conditions().cloned().collect(),
            repairs: progress.repairs.clone(),
            size_withheld,
            observed: size_withheld.map(|_| self.observation()),
            loss: area.map(|area| self.config.loss(self.config.flow_lpm(area))),
            reference_dp_pa: self.config.reference_dp_pa,
            highest_flag: progress.alarm.highest(),
            duration_s: progress
                .first_ns
                .map_or(0.0, |first| (progress.newest_ns.saturating_sub(first)) as f64 / 1e9),
        }
    }

    /// Why there is no size of the record's leak: it takes a model, and estimates of a few cycles and of half of all.
    fn size_withheld(&self) -> Option<&'static str> {
        let Progress { valid, cycle, .. } = self.progress;
        let is_sized = valid >= LEAST_ESTIMATES && 2 * valid >= cycle;
        match &self.relative {
            Some(_) => Some(NO_PLANT_MODEL),
            None => (!is_sized).then_some(TOO_FEW_ESTIMATES),
        }
    }

    /// What the command looks like by itself. Looking for its period takes a millisecond.
    pub fn observation(&self) -> Observation {
        Observation { wrong_rate_hz: self.wrong_rate_hz(), ..self.observer.observation() }
    }

    /// Cycles with an estimate.
    pub fn cycles(&self) -> u64 {
        self.progress.valid
    }

    /// Cycles without one, by reason.
    pub fn rejected(&self) -> BTreeMap<&'static str, u64> {
        self.progress.rejections()
    }

    /// Samples left out or filled in, by reason.
    pub fn samples_rejected(&self) -> BTreeMap<&'static str, u64> {
        let counts = self.counts();
        let by_reason = [
            ("bridged", counts.bridged),
            ("duplicate", counts.duplicate),
            ("missing", counts.missing),
            ("not_a_number", counts.not_a_number),
            ("out_of_order", counts.out_of_order),
            ("out_of_range", counts.out_of_range),
            ("wrong_rate", counts.wrong_rate),
        ];
        by_reason.into_iter().filter(|(_, count)| *count > 0).collect()
    }
}

impl MonitorConfig {
    /// An axis with one duty cycle, and what is usual for the rest.
    pub fn new(axis: impl Into<String>, model: impl Into<Arc<Model>>) -> Self {
        MonitorConfig {
            axis: axis.into(),
            duty_cycles: vec![DutyCycle::only(model)],
            alarm: AlarmConfig::default(),
            reference_dp_pa: REFERENCE_DP_PA,
            operating_hours_per_year: HOURS_PER_YEAR,
        }
    }

    /// Flow of a leak at the reference pressure difference, L/min; counts the leak orifice only, which is the machine's and the same in
    /// every duty cycle.
    pub fn flow_lpm(&self, area_m2: f64) -> f64 {
        let model = self.duty_cycles.first().map(|duty_cycle| &duty_cycle.model);
        model.map_or(0.0, |model| model.leak_flow_m3_per_s(area_m2, self.reference_dp_pa) * LPM_PER_M3_PER_S)
    }

    /// What a leak of that flow costs.
    pub fn loss(&self, flow_lpm: f64) -> Loss {
        Loss::of(flow_lpm, self.reference_dp_pa, self.operating_hours_per_year)
    }
}
