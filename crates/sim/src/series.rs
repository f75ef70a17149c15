//! Machines of one series, and one machine from day to day.

use std::collections::BTreeMap;

use crate::effects::{Effect, ValveDeadband};
use crate::noise::Noise;
use crate::oil;
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
}

impl Tolerances {
    /// The same share for all.
    pub fn even(share: f64) -> Self {
        Tolerances { share, of: BTreeMap::new() }
    }
}

/// Another machine of the series: every parameter that differs is drawn uniformly within its tolerance.
pub fn vary(spec: &MachineSpec, tolerances: &Tolerances, noise: &mut Noise) -> MachineSpec {
    let mut varied = spec.clone();
    for name in VARIED {
        if let Some(value) = varied.plant.get_mut(name) {
            *value *= noise.factor(tolerances.of.get(name).copied().unwrap_or(tolerances.share));
        }
    }
    varied
}

/// The machine with so much more overlap of its valve's lands, share of full command: the effect `valve_deadband`, up to its largest value.
pub fn with_more_deadband(spec: &MachineSpec, half_width: f64) -> MachineSpec {
    let (effect, parameter) = (&ValveDeadband, &ValveDeadband.parameters()[0]);
    let wider = (deadband(spec) + half_width).min(parameter.range.1);
    let mut overlapped = spec.clone();
    overlapped.effects.entry(effect.key().into()).or_default().insert(parameter.name.into(), wider);
    overlapped
}

/// Half width of a machine's dead band, share of full command.
pub fn deadband(spec: &MachineSpec) -> f64 {
    spec.effect_values(&ValveDeadband)[0]
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
