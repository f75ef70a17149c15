//! A user's simulator as an axis whose gap is diagnosed.

use std::sync::Arc;

use rayon::prelude::*;
use seepd_gap::BinnedSignals;
use seepd_gap::record::RecordedCycle;
use seepd_gap::simulated_axis::{CalibratedParameter, EffectValues, Imbalances, Scale, SimulatedAxis};
use seepd_signals::Signal;
use seepd_sim::DutyCycle;
use seepd_sim::cycle::DriveSample;
use seepd_sim::effects::{self, EffectInfo, Equation, Parameter};
use seepd_sim::ports::port_of;

use crate::demand;
use crate::simulators::{RunError, Simulators};
use crate::spec::{NOMINAL_FORCE_N, NOMINAL_STROKE_M, ParameterSpec, SimulatorSpec};

/// A machine as a user's simulator has it.
#[derive(Debug, Clone)]
pub struct SimulatorAxis {
    spec: SimulatorSpec,
    catalogue: Arc<[&'static EffectInfo]>,
    simulators: Arc<Simulators>,
}

impl SimulatorAxis {
    /// An axis, with the simulators that it is run by.
    pub fn new(spec: SimulatorSpec, simulators: Simulators) -> Self {
        let catalogue = catalogue(&spec);
        SimulatorAxis { spec, catalogue, simulators: Arc::new(simulators) }
    }

    /// The file's content, as it is now.
    pub fn spec(&self) -> &SimulatorSpec {
        &self.spec
    }

    /// The simulators.
    pub fn simulators(&self) -> &Simulators {
        &self.simulators
    }

    /// One run of the duty cycle, to see whether the simulator answers at all.
    ///
    /// # Errors
    /// [`RunError`].
    pub fn tried(&self) -> Result<(), RunError> {
        let period_s = self.tick_s();
        let ticks = (self.spec.cycle.period_s / period_s).round() as usize;
        let drive: Vec<DriveSample> = (0..ticks)
            .map(|tick| {
                let at_s = tick as f64 * period_s;
                DriveSample::new(at_s, self.spec.cycle.demand_m(at_s), self.spec.cycle.load_n(at_s))
            })
            .collect();
        self.simulators.run(&self.spec, &drive, 0, &self.signals()).map(|_| ())
    }
}

/// Effects that the simulator has a way for: at its ports, on its demand, and its own.
fn catalogue(spec: &SimulatorSpec) -> Arc<[&'static EffectInfo]> {
    let at_ports = effects::ALL
        .iter()
        .filter(|effect| {
            spec.inside.contains_key(effect.key()) || port_of(effect.key()).is_some_and(|port| spec.has(port))
        })
        .map(|effect| effect.info());
    let on_demand = demand::CATALOGUE.iter().filter(|_| spec.controller.is_none() && !spec.is_stepped());
    at_ports.chain(on_demand).chain(own_effects(spec)).collect()
}

/// What the file says of effects of the simulator's own. The catalogue is for as long as the program runs, and so are they: a file is read
/// once.
fn own_effects(spec: &SimulatorSpec) -> Vec<&'static EffectInfo> {
    let text = |text: &str| -> &'static str { Box::leak(text.to_owned().into_boxed_str()) };
    let info = |(key, effect): (&String, &crate::spec::OwnEffectSpec)| -> &'static EffectInfo {
        let parameter = Parameter {
            name: text(&effect.parameter),
            unit: text(&effect.unit),
            neutral: effect.neutral,
            range: (effect.range[0], effect.range[1]),
            source: "the simulator's file",
        };
        let law = if effect.law.is_empty() {
            format!("the simulator's parameter `{}`", effect.parameter)
        } else {
            effect.law.clone()
        };
        Box::leak(Box::new(EffectInfo {
            key: text(key),
            parameters: Box::leak(Box::new([parameter])),
            law: text(&law),
            signature: "as the simulator has it",
            equation: Equation::Force,
        }))
    };
    spec.effects.iter().map(info).collect()
}

fn calibrated(name: &str, parameter: &ParameterSpec) -> CalibratedParameter {
    let bounds = parameter.bounds();
    let positive = bounds.0 > 0.0 && !parameter.wear;
    let unit = parameter.unit.unwrap_or(0.2 * (bounds.1 - bounds.0));
    CalibratedParameter {
        key: name.into(),
        symbol: parameter.symbol.as_deref().unwrap_or(name).into(),
        bounds,
        scale: if positive { Scale::Logarithmic } else { Scale::Linear(unit) },
        sigma: match (parameter.sigma, positive) {
            (Some(sigma), true) => Some(sigma),
            (Some(sigma), false) => Some(sigma / unit),
            (None, true) => Some(std::f64::consts::LN_2),
            (None, false) => None,
        },
        hardly_told: parameter.hardly_told,
    }
}

seepd_gap::diagnosable!(SimulatorAxis);

impl SimulatedAxis for SimulatorAxis {
    const IS_DEAR: bool = true;

    fn is_spent(&self) -> bool {
        self.simulators.is_spent()
    }

    fn catalogue(&self) -> Vec<&'static EffectInfo> {
        self.catalogue.to_vec()
    }

    fn signals(&self) -> Vec<Signal> {
        self.spec.signals()
    }

    fn calibrated_parameters(&self) -> Vec<CalibratedParameter> {
        let parameters = self.spec.parameters.iter().filter(|(_, parameter)| !parameter.wear);
        parameters.map(|(name, parameter)| calibrated(name, parameter)).collect()
    }

    fn wear(&self) -> Option<CalibratedParameter> {
        let (name, parameter) = self.spec.parameters.iter().find(|(_, parameter)| parameter.wear)?;
        Some(calibrated(name, parameter))
    }

    fn parameter(&self, key: &str) -> f64 {
        self.spec.parameters.get(key).map_or(f64::NAN, |parameter| parameter.start)
    }

    fn set_parameter(&mut self, key: &str, value: f64) {
        if let Some(parameter) = self.spec.parameters.get_mut(key) {
            parameter.start = value;
        }
    }

    fn effects(&self) -> &EffectValues {
        &self.spec.with
    }

    fn effects_mut(&mut self) -> &mut EffectValues {
        &mut self.spec.with
    }

    /// Forces are in proportion to the drive's, lengths to the stroke, times end with the cycle; the simulator's own are as its file says.
    fn range(&self, effect: &EffectInfo, parameter: &Parameter) -> (f64, f64) {
        let (low, high) = parameter.range;
        let force = self.spec.full_force_n / NOMINAL_FORCE_N;
        let length = self.spec.stroke_m / NOMINAL_STROKE_M;
        let scale = match parameter.unit {
            _ if self.spec.effects.contains_key(effect.key) => 1.0,
            "N" => force,
            "N/m" => force / length,
            "m" => length,
            _ => 1.0,
        };
        match parameter.name {
            "start_s" | "duration_s" => (low, high.min(self.spec.cycle.period_s)),
            "neutral_position_m" => (low, self.spec.stroke_m),
            _ => (scale * low, scale * high),
        }
    }

    /// A factor on a gain of 0 is none.
    fn acts(&self, effect: &EffectInfo, parameter: &Parameter) -> bool {
        if self.spec.inside.get(effect.key).is_some_and(|variables| !variables.contains_key(parameter.name)) {
            return false;
        }
        let is_braking = effect.key == "controller_gains" && parameter.name == "kd";
        !(is_braking && self.spec.controller.as_ref().is_some_and(|controller| controller.kd == 0.0))
    }

    fn duty_cycle(&self) -> &DutyCycle {
        &self.spec.cycle
    }

    fn tick_s(&self) -> f64 {
        self.spec.tick_s()
    }

    fn stroke_m(&self) -> f64 {
        self.spec.stroke_m
    }

    fn asked_m(&self, command: &[f64], position_m: &[f64]) -> Option<Vec<f64>> {
        let controller = self.spec.controller.as_ref()?;
        Some(controller.asked_m(command, position_m, self.spec.cycle.period_s))
    }

    fn run(
        machines: &[Self],
        drive: &[DriveSample],
        warm_up: usize,
        signals: &[Signal],
    ) -> Vec<BinnedSignals> {
        let view = |machine: &Self| -> BinnedSignals {
            let shown = machine.simulators.run(&machine.spec, drive, warm_up, signals);
            // A run that failed is counted, and is as far off as can be.
            shown.unwrap_or_else(|_| vec![vec![f64::NAN; seepd_gap::record::BINS]; signals.len()])
        };
        machines.par_iter().with_max_len(1).map(view).collect()
    }

    fn imbalances(&self, _signals: &[Signal], _view: &BinnedSignals) -> Imbalances {
        Vec::new()
    }

    fn contradiction(&self, _signals: &[Signal], _cycle: &RecordedCycle) -> Option<String> {
        None
    }
}
