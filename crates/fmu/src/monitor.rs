//! The leak monitor as a model: the command goes in, and after each duty cycle an estimate and the flags come out.

use std::sync::Arc;

use seepd_model::Model;
use seepd_monitor::event::LPM_PER_M3_PER_S;
use seepd_monitor::pipeline::REFERENCE_DP_PA;
use seepd_monitor::{Event, Flag, MonitorConfig, Pipeline};
use seepd_signals::Sample;

use crate::machine::Engine;
use crate::resources::Resources;
use crate::simulation::ModelError;
use crate::variable::{Kind, Variables};

/// Truths that the monitor shows, each for a flag; one of them is true, or none for a healthy machine.
pub const ALARM_OUTPUTS: [(Flag, &str, &str); 4] = [
    (Flag::NoEstimate, "no_estimate", "there is nothing to base a statement on"),
    (Flag::Watch, "watch", "a leak to keep an eye on"),
    (Flag::Leak, "leak", "a leak at which the seal's change is to be planned"),
    (Flag::Severe, "severe", "a leak that the machine should not run with"),
];

/// Least share of a sample's period before its time at which it is taken: communication points are sums of decimal fractions.
const EARLY: f64 = 1e-6;

/// The monitor.
pub(crate) struct MonitorEngine {
    config: MonitorConfig,
    pipeline: Pipeline,
    period_s: f64,
    cycle_s: f64,
    command: usize,
    reference_dp: usize,
    /// Area, its least and largest value, then the same as flows.
    estimate: [usize; 6],
    cycles: usize,
    flags: [usize; 4],
    /// Samples taken so far.
    samples: u64,
    since_start_s: f64,
}

impl MonitorEngine {
    pub(crate) fn new(resources: &Resources, variables: &mut Variables) -> Result<Self, ModelError> {
        let model = Arc::new(Model::from_json(resources.text.as_bytes())?);
        let (period_s, cycle_s) = (1.0 / model.file().sample_rate_hz, model.file().cycle.period_s);
        let config = MonitorConfig::new("axis", model);
        let pipeline = Pipeline::new(config.clone())?;
        let what = "valve command, share of full command, positive outwards";
        let command = variables.input("command", "1", 0.0, what);
        let estimate = ESTIMATE.map(|(name, unit, what)| variables.finding(name, Kind::Real, unit, what));
        let cycles = variables.finding("cycles", Kind::Real, "1", "duty cycles with an estimate so far");
        let flags = ALARM_OUTPUTS.map(|(_, name, what)| variables.finding(name, Kind::Boolean, "1", what));
        let what = "pressure difference at which leaks are given as flows";
        let bounds = (Some(1e5), Some(1e8));
        let reference_dp = variables.parameter(("reference_dp", "Pa"), REFERENCE_DP_PA, bounds, what);
        Ok(MonitorEngine {
            config,
            pipeline,
            period_s,
            cycle_s,
            command,
            reference_dp,
            estimate,
            cycles,
            flags,
            samples: 0,
            since_start_s: 0.0,
        })
    }
}

const ESTIMATE: [(&str, &str, &str); 6] = [
    ("leak_area", "m2", "leak area past the piston seal, of the last cycle that gave one"),
    ("leak_area_low", "m2", "least area of the interval that holds the truth nine times in ten"),
    ("leak_area_high", "m2", "largest area of that interval"),
    ("leak_flow", "m3/s", "flow of the leak at the reference pressure difference"),
    ("leak_flow_low", "m3/s", "least flow of the interval"),
    ("leak_flow_high", "m3/s", "largest flow of the interval"),
];

impl Engine for MonitorEngine {
    fn initialise(&mut self, values: &mut [f64]) -> Result<(), ModelError> {
        self.config.reference_dp_pa = values[self.reference_dp];
        self.reset()?;
        for place in self.estimate.iter().chain(&self.flags) {
            values[*place] = 0.0;
        }
        values[self.cycles] = 0.0;
        values[self.flags[0]] = 1.0;
        Ok(())
    }

    fn step(&mut self, values: &mut [f64], step_s: f64) -> Result<(), ModelError> {
        let (config, period_s) = (&self.config, self.period_s);
        let (estimate, flags) = (self.estimate, self.flags);
        let command = values[self.command];
        let end_s = self.since_start_s + step_s;
        let mut newest = None;
        // Samples that are due before the step's end have its command.
        while (self.samples as f64 + EARLY) * period_s < end_s {
            let time_ns = (self.samples as f64 * period_s * 1e9).round() as i64;
            self.pipeline.push(&Sample::command(time_ns, command), &mut |event| {
                if let Event::Cycle(line) = event
                    && let (Some(area), Some([low, high])) = (line.leak_area_m2, line.interval90_m2)
                {
                    newest = Some([area, low, high]);
                }
            });
            self.samples += 1;
        }
        self.since_start_s = end_s;
        if let Some(areas) = newest {
            for (index, area) in areas.into_iter().enumerate() {
                values[estimate[index]] = area;
                values[estimate[index + 3]] = config.flow_lpm(area) / LPM_PER_M3_PER_S;
            }
        }
        values[self.cycles] = self.pipeline.cycles() as f64;
        let flag = self.pipeline.alarm().flag();
        for (place, (of, _, _)) in flags.into_iter().zip(ALARM_OUTPUTS) {
            values[place] = f64::from(u8::from(of == flag));
        }
        Ok(())
    }

    fn reset(&mut self) -> Result<(), ModelError> {
        self.pipeline = Pipeline::new(self.config.clone())?;
        (self.samples, self.since_start_s) = (0, 0.0);
        Ok(())
    }

    /// What the readers remember is kept where it is: their buffers are large.
    fn copied(&self) -> Option<Box<dyn Engine>> {
        None
    }

    fn step_s(&self) -> (f64, bool) {
        (self.period_s, false)
    }

    fn cycle_s(&self) -> f64 {
        self.cycle_s
    }
}
