//! What a plant has to offer so that its gap can be diagnosed.

use std::collections::BTreeMap;
use std::sync::Arc;

use seepd_signals::Signal;
use seepd_sim::DutyCycle;
use seepd_sim::cycle::{DriveSample, RunStart};
use seepd_sim::effects::{EffectInfo, Parameter};
use seepd_sim::learned::{LearnedLaw, Site};

use crate::record::RecordedCycle;
use crate::simulate::BinnedSignals;

/// Values of effects by effect and parameter.
pub type EffectValues = BTreeMap<String, BTreeMap<String, f64>>;

/// A parameter that a fit may change.
#[derive(Debug, Clone)]
pub struct CalibratedParameter {
    /// Key in the plant file, or the name that the user's simulator has for it.
    pub key: Arc<str>,
    /// Symbol in reports.
    pub symbol: Arc<str>,
    /// Least and largest value, SI.
    pub bounds: (f64, f64),
    /// How it is counted.
    pub scale: Scale,
    /// Standard deviation of what is known of it beforehand, on its scale; `None` for nothing.
    pub sigma: Option<f64>,
    /// Whether logs hardly tell it. A diagnosis frees it, so that no effect is called for it; a calibration leaves it.
    pub hardly_told: bool,
}

/// How a parameter is counted in a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// By its logarithm.
    Logarithmic,
    /// In units of this size.
    Linear(f64),
}

/// Balances of a plant on recorded or simulated signals: equation, and imbalance in each bin over the size of its largest term.
pub type Imbalances = Vec<(&'static str, Vec<f64>)>;

/// A plant with its controller and duty cycle: parameters with bounds, effects, balances, simulation.
pub trait SimulatedAxis: Clone + Send + Sync {
    /// Whether a run is so dear that a fit tries fewer steps side by side.
    const IS_DEAR: bool = false;
    /// Effects that can be added to it.
    fn catalogue(&self) -> Vec<&'static EffectInfo>;
    /// Laws of its parts as data sheets have them: a calibration may fit them, a diagnosis does not add them.
    fn laws_of_parts(&self) -> Vec<&'static EffectInfo> {
        Vec::new()
    }
    /// Laws without a name that can be learned where none of these explains a log.
    fn learnable(&self) -> &'static [&'static LearnedLaw] {
        &[]
    }
    /// Size of a noticeable law at a place, in the place's unit.
    fn learned_unit(&self, _site: Site) -> f64 {
        1.0
    }
    /// Signals that are compared where a log has them; command and position first.
    fn signals(&self) -> Vec<Signal>;
    /// Parameters that calibration may change.
    fn calibrated_parameters(&self) -> Vec<CalibratedParameter>;
    /// The parameter that wear changes: it is fitted in every machine, and no gap.
    fn wear(&self) -> Option<CalibratedParameter>;
    /// A parameter's value; NaN for a key that it lacks.
    fn parameter(&self, key: &str) -> f64;
    /// Sets a parameter; nothing for a key that it lacks.
    fn set_parameter(&mut self, key: &str, value: f64);
    /// Its effects.
    fn effects(&self) -> &EffectValues;
    /// Its effects, to change.
    fn effects_mut(&mut self) -> &mut EffectValues;
    /// An effect's parameter's range on this machine.
    fn range(&self, effect: &EffectInfo, parameter: &Parameter) -> (f64, f64);
    /// Whether an effect's parameter changes anything on this machine.
    fn acts(&self, effect: &EffectInfo, parameter: &Parameter) -> bool;
    /// Its duty cycle.
    fn duty_cycle(&self) -> &DutyCycle;
    /// Controller period, s.
    fn tick_s(&self) -> f64;
    /// Stroke, m.
    fn stroke_m(&self) -> f64;
    /// What the controller must have been asked for, m, tick by tick, to give those commands at those positions. It serves to find where
    /// the cycles of a log without a demand begin; `None` where the controller's law is not known.
    fn asked_m(&self, command: &[f64], position_m: &[f64]) -> Option<Vec<f64>>;
    /// Simulates machines along a drive, closed loop, and bins what they show after the first `warm_up` ticks. A simulation that goes out
    /// of bounds shows NaN.
    fn run(
        machines: &[Self],
        drive: &[DriveSample],
        warm_up: usize,
        signals: &[Signal],
    ) -> Vec<BinnedSignals>;
    /// The same from where a run begins, under the drive's commands: for axes that can do without a controller.
    fn run_from(
        machines: &[Self],
        _start: &RunStart,
        drive: &[DriveSample],
        signals: &[Signal],
    ) -> Vec<BinnedSignals> {
        Self::run(machines, drive, 0, signals)
    }
    /// Whether it has no controller: its logs are runs, whose recorded command drives the plant.
    fn is_open_loop(&self) -> bool {
        false
    }
    /// The axis with a run in the place of its duty cycle: its length, and position and load in bins. Axes with a controller stay as they
    /// are.
    fn along(&self, _period_s: f64, _position_m: &[f64], _load_n: &[f64]) -> Self {
        self.clone()
    }
    /// The balances that the signals allow; empty where the equations are not known.
    fn imbalances(&self, signals: &[Signal], view: &BinnedSignals) -> Imbalances;
    /// Whether what may be simulated is used up: a search then ends with what it has.
    fn is_spent(&self) -> bool {
        false
    }
    /// What about a cycle cannot be on such an axis, in a sentence.
    fn contradiction(&self, signals: &[Signal], cycle: &RecordedCycle) -> Option<String>;
}
