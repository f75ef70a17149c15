//! The plant file for an FMU of ours: the press or the electric axis as a simulator like any other, with the same parameters, priors and
//! effects as natively.

use std::collections::BTreeMap;
use std::path::PathBuf;

use seepd_gap::simulated_axis::{CalibratedParameter, Scale, SimulatedAxis};
use seepd_signals::Signal;
use seepd_sim::effects::EffectInfo;
use seepd_sim::electric::ElectricAxis;
use seepd_sim::{Controller, DutyCycle, MachineSpec, Size, effects};

use crate::spec::{
    FmuSpec, FmuVariable, Kind, NOMINAL_FORCE_N, OwnEffectSpec, ParameterSpec, SimulatorSpec, VELOCITY,
};

/// What both machines have.
struct Exported {
    file: PathBuf,
    with_controller: bool,
    period_s: f64,
    stroke_m: f64,
    full_force_n: f64,
    cycle: DutyCycle,
    start_time: Option<String>,
}

impl Exported {
    fn spec(
        self,
        signals: &[Signal],
        parameters: &[CalibratedParameter],
        axis: &impl SimulatedAxis,
    ) -> SimulatorSpec {
        let same = |name: &str| (name.to_owned(), FmuVariable::Name(name.to_owned()));
        let reference = if self.with_controller { Signal::Demand } else { Signal::Command };
        let outputs = signals.iter().filter(|signal| self.with_controller || **signal != Signal::Command);
        let parameter = |known: &CalibratedParameter| {
            let key = format!("plant.{}", known.key);
            (
                key,
                parameter(
                    known,
                    axis.parameter(&known.key),
                    axis.wear().is_some_and(|wear| wear.key == known.key),
                ),
            )
        };
        SimulatorSpec {
            kind: Kind::Simulator,
            period_s: self.with_controller.then_some(self.period_s),
            stroke_m: self.stroke_m,
            full_force_n: self.full_force_n,
            process: None,
            fmu: Some(FmuSpec {
                file: self.file,
                inputs: [same(reference.name()), same("load")].into(),
                outputs: outputs.map(|signal| same(signal.name())).chain([same(VELOCITY)]).collect(),
                set: BTreeMap::new(),
                start_position: Some("start_position".into()),
                start_time: self.start_time,
                preload: Vec::new(),
                timeout_s: 60.0,
            }),
            parameters: parameters.iter().map(parameter).collect(),
            effects: BTreeMap::new(),
            inside: BTreeMap::new(),
            with: BTreeMap::new(),
            controller: None,
            cycle: self.cycle,
        }
    }
}

/// A parameter of a native axis as a simulator's file has it.
fn parameter(known: &CalibratedParameter, start: f64, wear: bool) -> ParameterSpec {
    let (unit, sigma) = match known.scale {
        Scale::Logarithmic => (None, known.sigma),
        Scale::Linear(unit) => (Some(unit), known.sigma.map(|sigma| sigma * unit)),
    };
    ParameterSpec {
        start,
        bounds: Some([known.bounds.0, known.bounds.1]),
        sigma,
        unit,
        hardly_told: known.hardly_told,
        symbol: Some(known.symbol.to_string()),
        wear,
    }
}

/// The plant file for the press as an FMU.
pub fn press(spec: &MachineSpec, file: PathBuf, with_controller: bool) -> SimulatorSpec {
    let exported = Exported {
        file,
        with_controller,
        period_s: spec.controller.period_s,
        stroke_m: spec.plant.stroke_m,
        full_force_n: NOMINAL_FORCE_N * Size::of(spec).force,
        cycle: spec.cycle.clone(),
        start_time: Some("start_time".into()),
    };
    let mut parameters = spec.calibrated_parameters();
    parameters.extend(SimulatedAxis::wear(spec));
    let mut simulator = exported.spec(&spec.signals(), &parameters, spec);
    let acting =
        effects::ALL.iter().filter(|effect| with_controller || !effect.key().starts_with("controller_"));
    simulator.inside = acting.map(|effect| inside(effect.info())).collect();
    simulator.controller = (!with_controller).then(|| Controller::clone(&spec.controller));
    simulator.with = spec.effects.clone();
    simulator
}

/// The plant file for the electric axis, with its controller, as an FMU.
pub fn electric_axis(axis: &ElectricAxis, file: PathBuf) -> SimulatorSpec {
    let exported = Exported {
        file,
        with_controller: true,
        period_s: axis.controller.period_s,
        stroke_m: axis.plant.stroke_m,
        full_force_n: axis.plant.full_force_n,
        cycle: axis.cycle.clone(),
        start_time: None,
    };
    let mut simulator = exported.spec(&axis.signals(), &axis.calibrated_parameters(), axis);
    let key = "asymmetric_friction";
    let info = axis.catalogue().into_iter().find(|info| info.key == key);
    if let Some((info, parameter)) = info.and_then(|info| Some((info, info.parameters.first()?))) {
        let (low, high) = axis.range(info, parameter);
        let own = OwnEffectSpec {
            parameter: format!("effects.{key}.{}", parameter.name),
            neutral: parameter.neutral,
            range: [low, high],
            unit: parameter.unit.into(),
            law: info.law.into(),
        };
        if let Some(value) = axis.effects.get(key).and_then(|values| values.values().next()) {
            simulator.with.insert(key.into(), [(own.parameter.clone(), *value)].into());
        }
        simulator.effects.insert(key.into(), own);
    }
    // Frictions have the catalogue's names and parameters, and are tried where they natively are.
    for info in axis.catalogue().into_iter().filter(|info| effects::find(info.key).is_some()) {
        simulator.inside.extend([inside(info)]);
        simulator
            .with
            .extend(axis.effects.get_key_value(info.key).map(|(key, given)| (key.clone(), given.clone())));
    }
    simulator
}

/// An effect of the catalogue by the names that our FMUs have for its parameters.
fn inside(info: &'static EffectInfo) -> (String, BTreeMap<String, String>) {
    let variable = |name: &str| (name.to_owned(), format!("effects.{}.{name}", info.key));
    (info.key.to_owned(), info.parameters.iter().map(|parameter| variable(parameter.name)).collect())
}
