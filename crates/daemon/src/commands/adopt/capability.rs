//! What the adopted machine's monitoring will be able to tell.

use seepd_model::Model;
use seepd_model::relative::DRIFT_ALLOWANCE;
use seepd_monitor::alarm::AlarmConfig;
use seepd_monitor::baseline::BaselineFile;
use seepd_monitor::event::LPM_PER_M3_PER_S;
use seepd_monitor::pipeline::{HOURS_PER_YEAR, REFERENCE_DP_PA};
use seepd_sim::MachineSpec;
use seepd_train::Trained;
use seepd_train::leak_range::LeakRange;
use seepd_train::relative::cycles_between_false_alarms;
use serde::Serialize;

/// Numbers of cycles within which the smallest leak is told.
const WITHIN_CYCLES: [u32; 3] = [20, 100, 500];
/// A watch threshold lies so far above the smallest leak that is found within 100 cycles.
const ROOM: f64 = 1.2;

/// What the monitoring can tell, by simulation of this machine and by how its own cycles repeat.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Capability {
    /// Smallest leak found within so many cycles, L/min at 70 bar: cycles, command alone, with the load measured.
    pub(crate) smallest_lpm: Vec<(u32, f64, f64)>,
    /// What load, oil and supply by themselves can look like, L/min.
    pub(crate) confounded_lpm: f64,
    /// How far a cycle's estimate is off by noise and repeatability, standard deviation, L/min.
    pub(crate) repeatability_lpm: f64,
    /// Median relative error of leaks above 1 % of the valve's flow; `None` where the model is an older one.
    pub(crate) size_error: Option<f64>,
    /// Share of leaks whose truth lies within the 90 % interval.
    pub(crate) coverage: Option<f64>,
    /// False alarms a year at the cycle's rate, by design of the sums.
    pub(crate) false_alarms_per_year: f64,
    /// What limits it, and what would help, a sentence each.
    pub(crate) advice: Vec<String>,
}

impl Capability {
    /// Of a model and a baseline that were made for the machine.
    pub(crate) fn of(model: &Model, baseline: &BaselineFile, trained: Option<&Trained>) -> Self {
        let per_m2 = LPM_PER_M3_PER_S * model.leak_flow_m3_per_s(1.0, REFERENCE_DP_PA);
        let newest = baseline.newest();
        let deviation = newest.map_or(f64::NAN, |baseline| baseline.residual_deviation_m2);
        let (mut smallest, mut confounded, mut years) = (Vec::new(), f64::NAN, f64::NAN);
        if let (Some(relative), Some(newest)) = (model.relative(), newest) {
            let detection = &relative.file().detection;
            let reference = |knows_load: bool| relative.kind(knows_load, &newest.mean).reference_m2;
            let found = |knows_load: bool, cycles: u32| {
                let height = DRIFT_ALLOWANCE + detection.threshold / f64::from(cycles);
                per_m2 * (reference(knows_load) + deviation * height)
            };
            smallest = WITHIN_CYCLES
                .iter()
                .map(|cycles| (*cycles, found(false, *cycles), found(true, *cycles)))
                .collect();
            confounded = per_m2 * reference(false);
            let cycles_a_year = HOURS_PER_YEAR * 3600.0 / model.file().cycle.period_s;
            // At its baseline the residual's mean is 0: the sums fall by the reference and the allowance in each cycle.
            let allowance = reference(false) / deviation + DRIFT_ALLOWANCE;
            years = cycles_a_year / cycles_between_false_alarms(detection.threshold, allowance);
        }
        let accuracy = trained.and_then(|trained| trained.relative.command.get(1));
        let mut capability = Capability {
            smallest_lpm: smallest,
            confounded_lpm: confounded,
            repeatability_lpm: per_m2 * deviation,
            size_error: accuracy
                .map(|accuracy| accuracy.median_error_above_1_lpm)
                .filter(|error| error.is_finite()),
            coverage: accuracy.map(|accuracy| accuracy.coverage),
            false_alarms_per_year: years,
            advice: Vec::new(),
        };
        capability.advise();
        capability
    }

    /// False alarms a year in words.
    pub(crate) fn false_alarms(&self) -> String {
        if self.false_alarms_per_year < 1e-3 {
            "fewer than one in a thousand years".into()
        } else {
            format!("{:.3} a year", self.false_alarms_per_year)
        }
    }

    fn advise(&mut self) {
        let within_100 = self.smallest_lpm.iter().find(|(cycles, ..)| *cycles == 100).copied();
        let Some((_, alone, with_load)) = within_100 else { return };
        if self.confounded_lpm > 0.5 * alone {
            self.advice.push(format!(
                "What limits it: load, oil and supply by themselves look like up to {:.3} L/min; the machine's own noise would allow {:.3}.",
                self.confounded_lpm,
                alone - self.confounded_lpm
            ));
        } else {
            self.advice.push(format!(
                "What limits it: from cycle to cycle the machine repeats within {:.3} L/min; longer records find smaller leaks.",
                self.repeatability_lpm
            ));
        }
        if with_load < 0.8 * alone {
            self.advice.push(format!(
                "A measured load would lower the smallest leak found within 100 cycles from {alone:.3} to {with_load:.3} L/min."
            ));
        }
    }

    /// Thresholds in proportion to the valve, and above what can be found.
    pub(crate) fn alarm(&self, plant: &MachineSpec) -> AlarmConfig {
        // The usual thresholds are those of the nominal press.
        let usual = AlarmConfig::default();
        let scale = LeakRange::of(plant).scale();
        let found =
            self.smallest_lpm.iter().find(|(cycles, ..)| *cycles == 100).map_or(0.0, |found| ROOM * found.1);
        let watch = rounded((scale * usual.watch_lpm).max(found));
        AlarmConfig {
            watch_lpm: watch,
            leak_lpm: rounded(watch * usual.leak_lpm / usual.watch_lpm),
            severe_lpm: rounded(watch * usual.severe_lpm / usual.watch_lpm),
            ..usual
        }
    }
}

/// Two significant digits.
fn rounded(value: f64) -> f64 {
    let unit = 10f64.powf(value.abs().max(1e-12).log10().floor() - 1.0);
    let digits = (1.0 - value.abs().max(1e-12).log10().floor()).max(0.0) as i32;
    let scale = 10f64.powi(digits);
    ((value / unit).round() * unit * scale).round() / scale
}
