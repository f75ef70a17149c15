//! Machines of one series, and one machine from day to day.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::effects::{self, Effect, ValveDeadband, ValveOverlap};
use crate::noise::Noise;
use crate::oil;
use crate::size::Size;
use crate::spec::MachineSpec;

/// The parameters that differ from one machine of a series to the next. Areas and stroke are machined, density
/// and discharge coefficient go with the oil and the orifice, whose product the leak area stands for.
const VARIED: [&str; 15] = [
    "bulk_modulus_pa",
    "pump_flow_m3_per_s",
    "supply_volume_m3",
    "inlet_volume_m3",
    "relief_pressure_pa",
    "relief_resistance_pa_s_per_m3",
    "return_pressure_pa",
    "line_m3_per_s_sqrt_pa",
    "valve_m3_per_s_sqrt_pa",
    "cap_dead_volume_m3",
    "rod_dead_volume_m3",
    "mass_kg",
    "viscous_friction_n_s_per_m",
    "seal_resistance_pa_s_per_m3",
    "valve_rod_resistance_pa_s_per_m3",
];

/// How far the parameters of one machine may be from those of another.
#[derive(Debug, Clone, PartialEq)]
pub struct Tolerances {
    /// Share to either side of every parameter that differs from machine to machine.
    pub share: f64,
    /// The share of single parameters, by key.
    pub of: BTreeMap<String, f64>,
    /// What is off together beside that.
    pub together: Vec<Direction>,
}

/// Changes of parameters that go together, one standard deviation long: a fit that cannot tell a larger valve from a higher pressure leaves
/// their product known.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Direction {
    /// Changes of the logarithms of plant parameters, by key.
    pub plant: BTreeMap<String, f64>,
    /// Changes of plant parameters that may be zero, SI, by key: as a share of a return pressure of 0.2 bar, one of 2 bar would be without
    /// bound. None goes below zero.
    pub plant_by_addition: BTreeMap<String, f64>,
    /// Changes of effects' parameters, SI, by effect and parameter; an effect that a machine lacks stays away.
    pub effects: BTreeMap<String, BTreeMap<String, f64>>,
}

impl Tolerances {
    /// The same share for all.
    pub fn even(share: f64) -> Self {
        Tolerances { share, of: BTreeMap::new(), together: Vec::new() }
    }
}

/// Another machine of the series: every parameter that differs is drawn uniformly within its tolerance, and the machine is moved along each
/// direction by a uniform number of standard deviation 1.
pub fn vary(spec: &MachineSpec, tolerances: &Tolerances, noise: &mut Noise) -> MachineSpec {
    let mut varied = spec.clone();
    for name in VARIED {
        if let Some(value) = varied.plant.get_mut(name) {
            *value *= noise.factor(tolerances.of.get(name).copied().unwrap_or(tolerances.share));
        }
    }
    for direction in &tolerances.together {
        move_along(&mut varied, direction, noise.uniform(-UNIFORM, UNIFORM));
    }
    varied
}

/// A uniform distribution of this half width has the standard deviation of 1.
const UNIFORM: f64 = 1.732_050_8;

fn move_along(spec: &mut MachineSpec, direction: &Direction, by: f64) {
    let size = Size::of(spec);
    for (key, change) in &direction.plant {
        if let Some(value) = spec.plant.get_mut(key) {
            *value *= libm::exp(by * change);
        }
    }
    for (key, change) in &direction.plant_by_addition {
        if let Some(value) = spec.plant.get_mut(key) {
            *value = (*value + by * change).max(0.0);
        }
    }
    for effect in effects::every() {
        let (Some(values), Some(changes)) =
            (spec.effects.get_mut(effect.key()), direction.effects.get(effect.key()))
        else {
            continue;
        };
        for parameter in effect.parameters() {
            if let (Some(value), Some(change)) = (values.get_mut(parameter.name), changes.get(parameter.name))
            {
                let (low, high) = size.range_of(parameter);
                *value = (*value + by * change).clamp(low, high);
            }
        }
    }
}

/// The machine with so much more overlap of its valve's lands, share of full command: the effect `valve_deadband`, up to its largest value.
pub fn with_more_deadband(spec: &MachineSpec, half_width: f64) -> MachineSpec {
    let (effect, parameter) = (&ValveDeadband, &ValveDeadband.parameters()[0]);
    let [there, of_parts] = [effect as &dyn Effect, &ValveOverlap].map(|law| spec.effect_values(law)[0]);
    let wider = (there + half_width).min((Size::of(spec).range_of(parameter).1 - of_parts).max(there));
    let mut overlapped = spec.clone();
    overlapped.effects.entry(effect.key().into()).or_default().insert(parameter.name.into(), wider);
    overlapped
}

/// Half width of a machine's dead band, share of full command.
pub fn deadband(spec: &MachineSpec) -> f64 {
    let laws: [&dyn Effect; 2] = [&ValveDeadband, &ValveOverlap];
    laws.map(|law| spec.effect_values(law)[0]).iter().sum()
}

/// The machine with oil of another temperature, °C, and its relief pressure over its own. The oil does what the effect
/// `oil_viscosity.factor` does, without a law that is asked at each step. Warm oil makes the line stiffer:
/// [`MachineSpec::stable_steps`] tells how many steps it needs.
pub fn on_a_day(spec: &MachineSpec, oil_c: f64, supply: f64) -> MachineSpec {
    let mut today = spec.clone();
    let factor = oil::viscosity_factor(oil_c);
    let plant = &mut today.plant;
    plant.viscous_friction_n_s_per_m *= factor;
    plant.seal_resistance_pa_s_per_m3 *= factor;
    plant.valve_return_resistance_pa_s_per_m3 *= factor;
    plant.valve_rod_resistance_pa_s_per_m3 *= factor;
    plant.transition_pressure_pa *= factor * factor;
    plant.relief_pressure_pa *= supply;
    today
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cycle::Schedule;
    use crate::machine::{Input, Machine};

    /// What goes together keeps its product: a valve that is larger by what the pressure's root is smaller. An effect stays in its range,
    /// and one that the machine lacks stays away. What moves by addition stays within it and never goes below zero.
    #[test]
    fn directions_keep_what_a_fit_knows() {
        let mut spec = MachineSpec::default();
        spec.set_effect("coulomb_friction.force_n=100").unwrap();
        spec.plant.return_pressure_pa = 2e4;
        let one = |key: &str, by: f64| BTreeMap::from([(key.to_owned(), by)]);
        let direction = Direction {
            plant: BTreeMap::from([
                ("valve_m3_per_s_sqrt_pa".to_owned(), 0.1),
                ("relief_pressure_pa".to_owned(), -0.2),
            ]),
            effects: BTreeMap::from([
                ("coulomb_friction".to_owned(), one("force_n", 400.0)),
                ("valve_bias".to_owned(), one("offset", 0.1)),
            ]),
            plant_by_addition: one("return_pressure_pa", 1e5),
        };
        let tolerances = Tolerances { together: vec![direction], ..Tolerances::even(0.0) };
        let mut noise = Noise::new(1, 1);
        let product =
            |spec: &MachineSpec| spec.plant.valve_m3_per_s_sqrt_pa * spec.plant.relief_pressure_pa.sqrt();
        let machines: Vec<MachineSpec> = (0..2000).map(|_| vary(&spec, &tolerances, &mut noise)).collect();
        let mut logarithms = Vec::new();
        for machine in &machines {
            assert!((product(machine) / product(&spec) - 1.0).abs() < 1e-12);
            assert!(machine.effects["coulomb_friction"]["force_n"] >= 0.0);
            assert!(!machine.effects.contains_key("valve_bias"));
            let return_pressure_pa = machine.plant.return_pressure_pa;
            assert!((0.0..=2e4 + UNIFORM * 1e5).contains(&return_pressure_pa), "{return_pressure_pa}");
            logarithms.push((machine.plant.valve_m3_per_s_sqrt_pa / spec.plant.valve_m3_per_s_sqrt_pa).ln());
        }
        let variance = logarithms.iter().map(|value| value * value).sum::<f64>() / 2000.0;
        // The standard error of a uniform distribution's variance: 0.9 / √2000 = 2 %.
        assert!((variance / 0.01 - 1.0).abs() < 0.08, "{variance}");
        assert!(machines.iter().any(|machine| machine.effects["coulomb_friction"]["force_n"] > 600.0));
    }

    #[test]
    fn warm_oil_is_the_effect_of_less_viscosity() {
        let spec = MachineSpec::default();
        let mut by_effect = spec.clone();
        by_effect.set_effect(&format!("oil_viscosity.factor={}", oil::viscosity_factor(52.0))).unwrap();
        let mut by_day = on_a_day(&spec, 52.0, 1.0);
        for machine in [&mut by_effect, &mut by_day] {
            machine.controller.steps_per_period = 20;
        }
        let commands = |spec: &MachineSpec| -> Vec<f64> {
            let machine = Machine::<f64>::new(&[spec]);
            let mut state = machine.start();
            let schedule = Schedule::new(&spec.cycle, spec.controller.period_s, Vec::new());
            schedule.take(3000).map(|at| machine.tick(&mut state, &Input::gather(&[at])).command).collect()
        };
        for (a, b) in commands(&by_effect).iter().zip(commands(&by_day)) {
            assert!((a - b).abs() < 1e-9, "{a} {b}");
        }
    }
}
