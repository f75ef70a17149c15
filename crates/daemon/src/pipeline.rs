//! From samples to events: the one object that replayed and live data go through.
//!
//! No clock (time is the sample's), no input or output, no allocation after start.

use seepd_features::segment::Projection;
use seepd_features::{Counts, CycleReader, CycleState, Outcome};
use seepd_model::Model;
use seepd_signals::Sample;

use crate::alarm::{Alarm, AlarmConfig, Change};
use crate::config::Config;
use crate::event::{CycleLine, Event, FeatureValues, Flag, FlagEvent, LPM_PER_M3_PER_S, Summary};

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
}

/// Rejections by reason, in [`Reason`](seepd_features::Reason)'s order of first appearance.
const REASONS: usize = 8;
/// Estimates whose median is the summary's.
const RECENT: usize = 9;
/// Periods without a cycle after which there is no estimate.
const PATIENCE_PERIODS: f64 = 3.0;

/// What the pipeline remembers between cycles.
#[derive(Debug, Clone)]
struct Progress {
    alarm: Alarm,
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
        let Config { axis, alarm, reference_dp_pa, .. } = config;
        PipelineConfig { axis, model, projections, alarm, reference_dp_pa: *reference_dp_pa }
    }
}

impl PipelineConfig<'_> {
    /// Flow of a leak at the reference pressure difference, L/min; counts the leak orifice only.
    pub fn flow_lpm(&self, area_m2: f64) -> f64 {
        self.model.leak_flow_m3_per_s(area_m2, self.reference_dp_pa) * LPM_PER_M3_PER_S
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
        let cycle = self.cycle;
        let (start_ns, end_ns) = match outcome {
            Outcome::Valid(valid) => (valid.start_ns, valid.end_ns),
            Outcome::Rejected(rejected) => (rejected.start_ns, rejected.end_ns),
        };
        let mut line = CycleLine {
            schema: "seepd.cycle/1",
            axis: config.axis,
            cycle,
            t_start_s: self.seconds(start_ns),
            t_end_s: self.seconds(end_ns),
            t_start_ns: start_ns,
            leak_area_m2: None,
            interval90_m2: None,
            leak_flow_lpm: None,
            reference_dp_pa: config.reference_dp_pa,
            flag: Flag::NoEstimate,
            reason: None,
            features: None,
        };
        let change = match outcome {
            Outcome::Valid(valid) => {
                let estimate = config.model.estimate(valid.features);
                let flow_lpm = config.flow_lpm(estimate.value);
                self.recent_m2[(self.valid % RECENT as u64) as usize] = estimate.value;
                self.valid += 1;
                let change = self.alarm.estimated(config.alarm, flow_lpm);
                line.leak_area_m2 = Some(estimate.value);
                line.interval90_m2 = Some(estimate.interval);
                line.leak_flow_lpm = Some(flow_lpm);
                line.flag = self.alarm.flag();
                line.features =
                    Some(FeatureValues { names: config.model.feature_names(), values: valid.features });
                change
            }
            Outcome::Rejected(rejected) => {
                let reason = rejected.reason.name();
                self.count_rejection(reason);
                line.reason = Some(reason);
                self.alarm.rejected(config.alarm, reason)
            }
        };
        self.last_cycle_ns = end_ns.max(self.last_cycle_ns.min(self.newest_ns));
        sink(&Event::Cycle(line));
        if let Some(change) = change {
            sink(&self.flag_event(config, change, end_ns));
        }
        self.cycle += 1;
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
