//! The electric positioning axis as a model.

use std::sync::Arc;

use seepd_sim::electric::{CATALOGUE, ElectricAxis, ElectricMachine, ElectricState};

use crate::machine::{Engine, periods_in};
use crate::resources::{Placement, Resources};
use crate::simulation::ModelError;
use crate::variable::Variables;

/// What a parameter of the model sets in the axis.
#[derive(Clone, Copy)]
enum Setting {
    Number(fn(&mut ElectricAxis) -> &mut f64),
    Effect(&'static str, &'static str),
}

#[derive(Clone)]
struct Running {
    machine: Arc<ElectricMachine>,
    state: ElectricState,
    since_start_s: f64,
}

/// The axis.
#[derive(Clone)]
pub(crate) struct AxisEngine {
    axis: ElectricAxis,
    placement: Placement,
    reference: usize,
    load: usize,
    start_position: usize,
    command: Option<usize>,
    position: usize,
    velocity: usize,
    settings: Vec<(usize, Setting)>,
    running: Option<Running>,
}

/// Numbers by their keys, with unit and what they are.
type Number = (&'static str, &'static str, &'static str, fn(&mut ElectricAxis) -> &mut f64);
const PLANT: [Number; 4] = [
    ("plant.mass_kg", "kg", "moved mass with the drive's inertia", |axis| &mut axis.plant.mass_kg),
    ("plant.viscous_friction_n_s_per_m", "N s/m", "viscous friction", |axis| {
        &mut axis.plant.viscous_friction_n_s_per_m
    }),
    ("plant.full_force_n", "N", "force at full command", |axis| &mut axis.plant.full_force_n),
    ("plant.stroke_m", "m", "stroke", |axis| &mut axis.plant.stroke_m),
];
const CONTROLLER: [Number; 2] = [
    ("controller.position_gain_per_s", "1/s", "gain of the position loop", |axis| {
        &mut axis.controller.position_gain_per_s
    }),
    ("controller.velocity_gain_s_per_m", "s/m", "gain of the velocity loop", |axis| {
        &mut axis.controller.velocity_gain_s_per_m
    }),
];
const COMMAND: &str = "drive command, share of full command, positive outwards";

impl AxisEngine {
    pub(crate) fn new(resources: &Resources, variables: &mut Variables) -> Result<Self, ModelError> {
        let mut axis = ElectricAxis::from_toml(&resources.text)?;
        let placement = resources.placement;
        let start_m = axis.cycle.start_position_m();
        let reference = match placement {
            Placement::Outside => variables.input("command", "1", 0.0, COMMAND),
            Placement::Inside => variables.input("demand", "m", start_m, "position demand"),
        };
        let load = variables.input("load", "N", axis.cycle.load_n(0.0), "load force, positive outwards");
        let command = (placement == Placement::Inside).then(|| variables.output("command", "1", COMMAND));
        let position = variables.output("position", "m", "position");
        let velocity = variables.output("velocity", "m/s", "velocity");
        let what = "position at the start, at rest";
        let start_position = variables.parameter(("start_position", "m"), start_m, (None, None), what);
        let controller = CONTROLLER.iter().filter(|_| placement == Placement::Inside);
        let mut settings = Vec::new();
        for (name, unit, what, slot) in PLANT.iter().chain(controller) {
            let bounds = (Some(f64::MIN_POSITIVE), None);
            let place = variables.parameter((name, unit), *slot(&mut axis), bounds, what);
            settings.push((place, Setting::Number(*slot)));
        }
        // Ranges are of a drive of 1 kN, for others in proportion.
        let force = axis.plant.full_force_n / 1000.0;
        for info in &CATALOGUE {
            for parameter in info.parameters {
                let scale = if parameter.unit.starts_with('N') { force } else { 1.0 };
                let (low, high) = (scale * parameter.range.0, scale * parameter.range.1);
                let bounds = (Some(low.min(parameter.neutral)), Some(high.max(parameter.neutral)));
                let given = axis.effects.get(info.key).and_then(|values| values.get(parameter.name));
                let start = given.copied().unwrap_or(parameter.neutral);
                let name = format!("effects.{}.{}", info.key, parameter.name);
                let what = format!("{}; without effect at {:?}", info.law, parameter.neutral);
                let place = variables.parameter((&name, parameter.unit), start, bounds, &what);
                settings.push((place, Setting::Effect(info.key, parameter.name)));
            }
        }
        Ok(AxisEngine {
            axis,
            placement,
            reference,
            load,
            start_position,
            command,
            position,
            velocity,
            settings,
            running: None,
        })
    }

    fn machine(&self, values: &[f64]) -> Result<ElectricMachine, ModelError> {
        let mut axis = self.axis.clone();
        for (place, setting) in &self.settings {
            match setting {
                Setting::Number(slot) => *slot(&mut axis) = values[*place],
                Setting::Effect(effect, parameter) => {
                    axis.effects
                        .entry((*effect).into())
                        .or_default()
                        .insert((*parameter).into(), values[*place]);
                }
            }
        }
        axis.check()?;
        Ok(ElectricMachine::new(&axis))
    }

    fn show(&self, state: &ElectricState, values: &mut [f64]) {
        values[self.position] = state.position_m;
        values[self.velocity] = state.velocity_m_per_s;
    }
}

impl Engine for AxisEngine {
    fn initialise(&mut self, values: &mut [f64]) -> Result<(), ModelError> {
        let machine = Arc::new(self.machine(values)?);
        let state = ElectricState::at_rest(values[self.start_position]);
        self.show(&state, values);
        if let Some(command) = self.command {
            values[command] = 0.0;
        }
        self.running = Some(Running { machine, state, since_start_s: 0.0 });
        Ok(())
    }

    fn step(&mut self, values: &mut [f64], step_s: f64) -> Result<(), ModelError> {
        let period_s = self.axis.controller.period_s;
        let (reference, load_n) = (values[self.reference], values[self.load]);
        let Some(running) = &mut self.running else {
            return Err(ModelError::Order("the model is not initialised"));
        };
        match self.placement {
            Placement::Outside => {
                running.machine.run_for(&mut running.state, reference.clamp(-1.0, 1.0), load_n, step_s);
            }
            Placement::Inside => {
                for _ in 0..periods_in(step_s, period_s)? {
                    let command = running.machine.command(&running.state, reference);
                    running.machine.run(&mut running.state, command, load_n);
                    if let Some(place) = self.command {
                        values[place] = command;
                    }
                }
            }
        }
        running.since_start_s += step_s;
        let (state, now_s) = (running.state, running.since_start_s);
        self.show(&state, values);
        let is_finite = state.position_m.is_finite() && state.velocity_m_per_s.is_finite();
        if is_finite { Ok(()) } else { Err(ModelError::OutOfBounds(now_s)) }
    }

    fn reset(&mut self) -> Result<(), ModelError> {
        self.running = None;
        Ok(())
    }

    fn copied(&self) -> Option<Box<dyn Engine>> {
        Some(Box::new(self.clone()))
    }

    fn step_s(&self) -> (f64, bool) {
        (self.axis.controller.period_s, self.placement == Placement::Inside)
    }

    fn cycle_s(&self) -> f64 {
        self.axis.cycle.period_s
    }
}
