//! From samples to events: the one object that replayed and live data go through.
//!
//! No clock (time is the sample's), no input or output, and no allocation for a sample; at a cycle's end the fit of a leak's growth and
//! the words of flags and notices allocate, and give back what they took (`tests/allocations.rs` counts). A [`Monitor`] for each of the axis's duty cycles
//! reads every sample; where there are several, the arbiter says whose a cycle is.

mod arbiter;
mod monitor;
pub mod observer;
mod progress;

use std::collections::BTreeMap;
use std::sync::Arc;

use seepd_features::{Counts, ReaderError, Reason};
use seepd_model::Model;
use seepd_signals::Sample;

use crate::alarm::{Alarm, AlarmConfig};
use crate::baseline::{BaselineError, CusumFinding};
use crate::energy::Loss;
use crate::event::{Event, LPM_PER_M3_PER_S, Summary};
use crate::reason::{NO_CYCLE_FOUND, STALE, TOO_FEW_ESTIMATES};

use arbiter::Arbiter;
pub use monitor::{DutyCycle, Monitor};
use observer::{CommandObserver, Observation};
use progress::Progress;

/// What the pipeline needs to know.
#[derive(Debug, Clone)]
pub struct MonitorConfig {
    /// Machine axis, for messages.
    pub axis: String,
    /// Its duty cycles, at least one; their models read at the same rate.
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
}

impl Pipeline {
    /// Starts with an empty memory.
    ///
    /// # Errors
    /// [`ReaderError`] of a model that has more features, phases or bins than the reader has room for.
    pub fn new(config: MonitorConfig) -> Result<Self, ReaderError> {
        let monitors: Vec<_> = config.duty_cycles.iter().map(Monitor::new).collect::<Result<_, _>>()?;
        Ok(Pipeline {
            arbiter: Arbiter::new(monitors.len()),
            period_s: DutyCycle::longest_period_s(&config.duty_cycles),
            config,
            monitors,
            progress: Progress::default(),
            observer: CommandObserver::default(),
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
        if let [Monitor { reader, state, estimator }] = self.monitors.as_mut_slice() {
            let (config, progress) = (&self.config, &mut self.progress);
            reader
                .get()
                .push(state, sample, &mut |outcome| progress.take(config, estimator, &outcome, false, sink));
        } else {
            self.push_to_all(sample, sink);
        }
        let silent_ns = sample.time_ns.saturating_sub(self.progress.last_cycle_ns);
        if silent_ns as f64 > PATIENCE_PERIODS * self.period_s * 1e9 {
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

    /// The alarm.
    pub fn alarm(&self) -> &Alarm {
        &self.progress.alarm
    }

    /// Why there have been no cycles for long.
    fn silence_reason(&self) -> &'static str {
        let Some(Monitor { reader, state, .. }) = self.monitors.first() else { return NO_CYCLE_FOUND };
        let counts = state.counts();
        let long = reader.get().definition().cycle_samples() as i64;
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
        if let [Monitor { reader, state, estimator }] = self.monitors.as_mut_slice() {
            let (config, progress) = (&self.config, &mut self.progress);
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

    /// Samples used and left out so far. Every monitor reads the same samples.
    pub fn counts(&self) -> Counts {
        self.monitors.first().map(|monitor| *monitor.state.counts()).unwrap_or_default()
    }

    /// The samples' rate, Hz, where it is not the model's.
    pub fn wrong_rate_hz(&self) -> Option<f64> {
        self.monitors.first().and_then(|monitor| monitor.state.wrong_rate_hz())
    }

    /// What it all comes to.
    pub fn summary(&self) -> Summary {
        let progress = &self.progress;
        let is_sized = self.is_sized();
        let of_duty_cycle = |monitor: &Monitor| Some((monitor.name()?.to_owned(), monitor.cycles()));
        let area = progress.recent_area_m2().filter(|_| is_sized);
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
            size_withheld: (!is_sized).then_some(TOO_FEW_ESTIMATES),
            observed: (!is_sized).then(|| self.observation()),
            loss: area.map(|area| self.config.loss(self.config.flow_lpm(area))),
            reference_dp_pa: self.config.reference_dp_pa,
            highest_flag: progress.alarm.highest(),
            duration_s: progress
                .first_ns
                .map_or(0.0, |first| (progress.newest_ns.saturating_sub(first)) as f64 / 1e9),
        }
    }

    /// Whether enough cycles have an estimate for a size of the record's leak: a few, and half of all.
    fn is_sized(&self) -> bool {
        self.progress.valid >= LEAST_ESTIMATES && 2 * self.progress.valid >= self.progress.cycle
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
