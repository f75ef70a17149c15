//! The hydraulic press as a model: by its own equations and laws, with the controller inside or outside.

use std::sync::Arc;

use seepd_sim::cycle::DriveSample;
use seepd_sim::effects::{self, Effect};
use seepd_sim::machine::{Input, Machine, MachineState};
use seepd_sim::spec::refuse_open_loop;
use seepd_sim::{Controller, MachineSpec, PlantParameters, Size};

use crate::machine::{Engine, periods_in};
use crate::resources::{Placement, Resources};
use crate::simulation::ModelError;
use crate::variable::Variables;

/// Steps in which a delayed command is remembered at least: as many as the law has room for.
const REMEMBERED_STEPS: f64 = 30.0;
const DELAY: &str = "command_delay";
const LEAK: &str = "leak_area_m2";

/// What a parameter of the model sets in the machine.
#[derive(Clone, Copy)]
enum Setting {
    Plant(&'static str),
    Effect(&'static dyn Effect, usize),
    Controller(fn(&mut Controller) -> &mut f64),
}

/// Where variables are among the values.
#[derive(Clone)]
struct Places {
    reference: usize,
    load: usize,
    start_position: usize,
    start_time: usize,
    leak: usize,
    command: Option<usize>,
    position: usize,
    velocity: usize,
    pressures: [usize; 4],
    leak_flow: usize,
    settings: Vec<(usize, Setting)>,
}

/// What runs.
#[derive(Clone)]
struct Running {
    machine: Arc<Machine<f64>>,
    state: MachineState<f64>,
    /// Measured position at the end of the last step, m.
    seen: f64,
    delay_s: f64,
    /// Time in the duty cycle, which is not brought back to 0 at a cycle's end, s.
    time_s: f64,
}

/// The press.
#[derive(Clone)]
pub(crate) struct PressEngine {
    spec: MachineSpec,
    placement: Placement,
    places: Places,
    running: Option<Running>,
}

/// Gains by their keys, with their units.
type Gain = (&'static str, &'static str, fn(&mut Controller) -> &mut f64);
const GAINS: [Gain; 5] = [
    ("kp", "1/m", |controller| &mut controller.kp),
    ("ki", "1/(m s)", |controller| &mut controller.ki),
    ("kd", "s/m", |controller| &mut controller.kd),
    ("velocity_feed_forward_s_per_m", "s/m", |controller| &mut controller.velocity_feed_forward_s_per_m),
    ("dead_band_compensation", "1", |controller| &mut controller.dead_band_compensation),
];

impl PressEngine {
    pub(crate) fn new(resources: &Resources, variables: &mut Variables) -> Result<Self, ModelError> {
        let spec = MachineSpec::from_toml(&resources.text)?;
        let placement = resources.placement;
        if placement == Placement::Inside {
            // Such a part takes its demand from the position, and from outside comes a demand.
            refuse_open_loop(&spec.cycle, "an FMU with the controller inside")?;
        }
        let start_m = spec.cycle.start_position_m();
        let reference = match placement {
            Placement::Outside => variables.input("command", "1", 0.0, COMMAND),
            Placement::Inside => variables.input("demand", "m", start_m, "position demand"),
        };
        let load = variables.input("load", "N", spec.cycle.load_n(0.0), "load force, positive outwards");
        let command = (placement == Placement::Inside).then(|| variables.output("command", "1", COMMAND));
        let position = variables.output("position", "m", "measured position, 0 fully retracted");
        let velocity = variables.output("velocity", "m/s", "velocity of the piston");
        let pressures = PRESSURES.map(|(name, what)| variables.output(name, "Pa", what));
        let leak_flow = variables.output("leak_flow", "m3/s", "flow past the piston, cap to rod");
        let start_position = variables.parameter(
            ("start_position", "m"),
            start_m,
            (Some(0.0), Some(spec.plant.stroke_m)),
            "position at the start, at rest",
        );
        let start_time = variables.parameter(
            ("start_time", "s"),
            0.0,
            (Some(0.0), None),
            "time in the duty cycle at the start, for effects that come at a time of it",
        );
        let (leak, settings) = settings(&spec, placement, variables);
        let places = Places {
            reference,
            load,
            start_position,
            start_time,
            leak,
            command,
            position,
            velocity,
            pressures,
            leak_flow,
            settings,
        };
        Ok(PressEngine { spec, placement, places, running: None })
    }

    /// The machine that the parameters make.
    fn machine(&self, values: &[f64]) -> Result<(MachineSpec, f64), ModelError> {
        let mut spec = self.spec.clone();
        let mut delay_s = 0.0;
        for (place, setting) in &self.places.settings {
            let value = values[*place];
            match setting {
                Setting::Plant(key) => {
                    if let Some(slot) = spec.plant.get_mut(key) {
                        *slot = value;
                    }
                }
                Setting::Controller(slot) => *slot(&mut spec.controller) = value,
                Setting::Effect(effect, index) => {
                    let name = effect.parameters()[*index].name;
                    spec.effects.entry(effect.key().into()).or_default().insert(name.into(), value);
                    delay_s = if effect.key() == DELAY { value } else { delay_s };
                }
            }
        }
        // Bounds are for calibration; a parameter may be set beyond them. Effects have the ranges that the description states.
        spec.bounds.clear();
        let spec = spec.with_stable_steps();
        spec.check_as(Size::of(&self.spec))?;
        Ok((spec, delay_s))
    }
}

const COMMAND: &str = "valve command, share of full command, positive outwards";
const PRESSURES: [(&str, &str); 4] = [
    ("p_supply", "supply pressure, gauge"),
    ("p_inlet", "pressure at the valve's inlet, gauge"),
    ("p_cap", "pressure in the cap chamber, gauge"),
    ("p_rod", "pressure in the rod chamber, gauge"),
];

/// The parameters that set something in the machine, and among them the leak's place.
fn settings(
    spec: &MachineSpec,
    placement: Placement,
    variables: &mut Variables,
) -> (usize, Vec<(usize, Setting)>) {
    let mut settings = Vec::new();
    let mut leak = 0;
    for info in PlantParameters::ALL {
        let start = spec.plant.get(info.key).unwrap_or(f64::NAN);
        let (low, high) = spec.bounds_of(info.key).unzip();
        let name = format!("plant.{}", info.key);
        let bounds = (low.or(Some(if info.minimum > 0.0 { f64::MIN_POSITIVE } else { 0.0 })), high);
        let place = variables.parameter((&name, info.unit), start, bounds, info.description);
        if info.key == LEAK {
            leak = place;
            variables.tunable(place);
        }
        settings.push((place, Setting::Plant(info.key)));
    }
    let is_inside = placement == Placement::Inside;
    for (key, unit, slot) in GAINS.iter().filter(|_| is_inside) {
        let start = *slot(&mut spec.controller.clone());
        let name = format!("controller.{key}");
        let what = "controller, as in the plant file";
        settings.push((
            variables.parameter((&name, unit), start, (Some(0.0), None), what),
            Setting::Controller(*slot),
        ));
    }
    // Whoever has the controller has its faults.
    let acting = effects::ALL.iter().filter(|effect| is_inside || !effect.key().starts_with("controller_"));
    for effect in acting {
        for (index, parameter) in effect.parameters().iter().enumerate() {
            let start = spec.effect_values(*effect)[index];
            let (low, high) = Size::of(spec).range_of(parameter);
            let bounds = (Some(low.min(parameter.neutral)), Some(high.max(parameter.neutral)));
            let name = format!("effects.{}.{}", effect.key(), parameter.name);
            let what = format!("{}; without effect at {:?}", effect.info().law, parameter.neutral);
            let place = variables.parameter((&name, parameter.unit), start, bounds, &what);
            settings.push((place, Setting::Effect(*effect, index)));
        }
    }
    (leak, settings)
}

impl Running {
    fn input(&self, places: &Places, values: &[f64], cycle_s: f64) -> Input<f64> {
        let at_s = self.time_s.rem_euclid(cycle_s);
        let leak_area_m2 = values[places.leak].max(0.0);
        DriveSample { leak_area_m2, ..DriveSample::new(at_s, values[places.reference], values[places.load]) }
            .into()
    }

    fn show(&self, places: &Places, values: &mut [f64]) {
        let plant = &self.state.plant;
        values[places.position] = self.seen;
        values[places.velocity] = plant.v;
        for (place, pressure) in places.pressures.iter().zip([plant.p_s, plant.p_3, plant.p_1, plant.p_2]) {
            values[*place] = pressure;
        }
        let area = values[places.leak].max(0.0);
        values[places.leak_flow] = self.machine.leak_flow(&self.state, area);
    }
}

impl Engine for PressEngine {
    fn initialise(&mut self, values: &mut [f64]) -> Result<(), ModelError> {
        let (spec, delay_s) = self.machine(values)?;
        let machine = Arc::new(Machine::<f64>::new(&[&spec]));
        let at_s = values[self.places.start_time].rem_euclid(self.spec.cycle.period_s);
        let position_m = values[self.places.start_position].clamp(0.0, spec.plant.stroke_m);
        let start = Input::from(DriveSample::new(at_s, position_m, values[self.places.load]));
        let mut state = machine.start_at(&start);
        let seen = machine.sense(&mut state);
        let running = Running { machine, state, seen, delay_s, time_s: at_s };
        running.show(&self.places, values);
        if let Some(command) = self.places.command {
            values[command] = 0.0;
        }
        self.running = Some(running);
        Ok(())
    }

    fn step(&mut self, values: &mut [f64], step_s: f64) -> Result<(), ModelError> {
        let (places, cycle_s, period_s) =
            (&self.places, self.spec.cycle.period_s, self.spec.controller.period_s);
        let Some(running) = &mut self.running else {
            return Err(ModelError::Order("the model is not initialised"));
        };
        match self.placement {
            Placement::Outside => {
                if running.delay_s > REMEMBERED_STEPS * step_s {
                    let why = format!(
                        "effects.{DELAY} of {} s is more than {REMEMBERED_STEPS} of them",
                        running.delay_s
                    );
                    return Err(ModelError::Step { step_s, why });
                }
                let input = running.input(places, values, cycle_s);
                let command = input.demand.clamp(-1.0, 1.0);
                running.machine.run_for(&mut running.state, command, &input, step_s);
                running.seen = running.machine.sense_after(&mut running.state, step_s);
                running.time_s += step_s;
            }
            Placement::Inside => {
                for _ in 0..periods_in(step_s, period_s)? {
                    let input = running.input(places, values, cycle_s);
                    let command = running.machine.command(&mut running.state, input.demand, running.seen);
                    running.machine.run(&mut running.state, command, &input);
                    running.seen = running.machine.sense(&mut running.state);
                    running.time_s += period_s;
                    if let Some(place) = places.command {
                        values[place] = command;
                    }
                }
            }
        }
        running.show(places, values);
        let mut shown = [places.position, places.velocity].into_iter().chain(places.pressures);
        if shown.all(|place| values[place].is_finite()) {
            Ok(())
        } else {
            Err(ModelError::OutOfBounds(running.time_s))
        }
    }

    fn reset(&mut self) -> Result<(), ModelError> {
        self.running = None;
        Ok(())
    }

    fn copied(&self) -> Option<Box<dyn Engine>> {
        Some(Box::new(self.clone()))
    }

    fn step_s(&self) -> (f64, bool) {
        (self.spec.controller.period_s, self.placement == Placement::Inside)
    }

    fn cycle_s(&self) -> f64 {
        self.spec.cycle.period_s
    }
}
