//! What changes on machines that are watched from a baseline on: causes, leaks, both, or nothing, drawn from a seed.

pub mod score;

use std::collections::BTreeMap;

use seepd_sim::noise::Noise;
use seepd_sim::series::{self, Tolerances};
use seepd_sim::{Controller, DutyCycle, MachineSpec};
use serde::{Deserialize, Serialize};

use crate::press::{EffectValues, Press, PressSample, Variation};

/// Flow of 1 L/min, m³/s.
const LPM: f64 = 1.0 / 60_000.0;
/// Cycles of the baseline, half of them with oil as it was first, half as it was then.
pub const BASELINE_CYCLES: usize = 40;
/// Cycles after a step; a drift has as many at each of its stages.
pub const STEP_CYCLES: usize = 12;
/// Stages of a drift, shares of the size that it reaches.
const DRIFT: [f64; 3] = [0.25, 0.6, 1.0];
/// Cycles of each stage of a drift.
const STAGE_CYCLES: usize = 6;
/// Load from cycle to cycle, supply from day to day, parameters from machine to machine: shares to either side.
const LOAD: f64 = 0.02;
const SUPPLY: f64 = 0.01;
const PARAMETERS: f64 = 0.05;
/// Oil temperatures, °C.
const OIL_C: (f64, f64) = (30.0, 60.0);
/// Noise of the command.
pub const NOISE: f64 = 0.003;

/// What was planted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Name of the cause other than a leak of the seal, as monitors name it; `outside` is one that they have no name for.
    pub cause: Option<String>,
    /// Effects with their values at full size.
    pub effects: EffectValues,
    /// Load over the plan, and supply pressure.
    pub factors: [f64; 2],
    /// Leak at 7 MPa, L/min.
    pub leak_lpm: f64,
    /// Exponent of its law.
    pub leak_exponent: f64,
    /// Whether effects follow other laws than the catalogue's.
    pub other_law: bool,
    /// Whether it comes little by little.
    pub drifts: bool,
}

/// A machine to be watched.
#[derive(Debug, Clone)]
pub struct Watched {
    /// What changes on it.
    pub change: Change,
    machine: MachineSpec,
    seed: u64,
}

/// Causes other than the seal's leak, each with the same probability.
const CAUSES: [&str; 12] = [
    "valve_null",
    "valve_lands",
    "external_leak",
    "friction",
    "load",
    "spring",
    "oil_viscosity",
    "supply",
    "controller",
    "position_scale",
    "valve_hysteresis",
    "valve_dead_band",
];

/// Draws machines: a quarter unchanged, a quarter with a leak, of the rest three in twelve with a leak beside another cause and one in
/// twelve with a cause that has no name.
pub fn draw(seed: u64, machines: usize) -> Vec<Watched> {
    (0..machines)
        .map(|index| {
            let mut noise = Noise::new(seed, 1000 + index as u64);
            let machine = series::vary(&MachineSpec::default(), &Tolerances::even(PARAMETERS), &mut noise);
            let change = change(index, &mut noise);
            Watched { change, machine, seed: seed.wrapping_mul(1_000_003) + index as u64 }
        })
        .collect()
}

fn change(index: usize, noise: &mut Noise) -> Change {
    let mut change = Change {
        cause: None,
        effects: EffectValues::new(),
        factors: [1.0; 2],
        leak_lpm: 0.0,
        leak_exponent: if noise.uniform(0.0, 1.0) < 0.5 { 0.5 } else { noise.uniform(0.5, 1.0) },
        other_law: noise.uniform(0.0, 1.0) < 0.5,
        drifts: noise.uniform(0.0, 1.0) < 0.4,
    };
    let leak = log_uniform(noise, 0.1, 10.0);
    match index % 4 {
        0 => {}
        1 => change.leak_lpm = leak,
        _ => {
            let number = index / 4 * 2 + index % 2;
            plant(&mut change, CAUSES[number % CAUSES.len()], noise);
            match noise.uniform(0.0, 12.0) {
                at if at < 3.0 => change.leak_lpm = log_uniform(noise, 0.3, 3.0),
                at if at < 4.0 => {
                    change.effects.clear();
                    change.factors = [1.0; 2];
                    plant_outside(&mut change, noise);
                }
                _ => {}
            }
        }
    }
    change
}

fn log_uniform(noise: &mut Noise, low: f64, high: f64) -> f64 {
    low * (high / low).powf(noise.uniform(0.0, 1.0))
}

fn signed(noise: &mut Noise, low: f64, high: f64) -> f64 {
    let size = log_uniform(noise, low, high);
    if noise.uniform(0.0, 1.0) < 0.5 { size } else { -size }
}

/// Plants a cause at a size that can be seen.
fn plant(change: &mut Change, cause: &str, noise: &mut Noise) {
    let other_law = change.other_law;
    let mut set = |effect: &str, parameter: &str, value: f64| {
        change.effects.entry(effect.into()).or_default().insert(parameter.into(), value);
    };
    let kind = noise.uniform(0.0, 3.0) as usize;
    match cause {
        "valve_null" => set("valve_bias", "offset", signed(noise, 1e-3, 0.02)),
        "valve_lands" => {
            set("valve_wear", "land_flow_m3_per_s", LPM * log_uniform(noise, 0.2, 2.0));
            set("valve_wear", "decay_command", log_uniform(noise, 0.015, 0.15));
        }
        "external_leak" => {
            let side = if kind == 0 { "rod_m3_per_s_pa" } else { "cap_m3_per_s_pa" };
            set("external_leak", side, LPM / 8e6 * log_uniform(noise, 0.1, 3.0));
        }
        "friction" if kind == 0 => set("pressure_friction", "coefficient", log_uniform(noise, 0.02, 0.1)),
        // A law of dynamic friction has its bristles with either effect.
        "friction" if kind == 1 || other_law => {
            let force = log_uniform(noise, 500.0, 3e3);
            set("stribeck_friction", "force_n", force);
            set("stribeck_friction", "static_force_n", force * noise.uniform(1.2, 1.6));
            set("stribeck_friction", "stribeck_speed_m_per_s", log_uniform(noise, 0.01, 0.08));
        }
        "friction" => set("coulomb_friction", "force_n", log_uniform(noise, 500.0, 3e3)),
        "load" if kind < 2 => set("load_bias", "force_n", signed(noise, 300.0, 3e3)),
        "load" => change.factors[0] = 1.0 + signed(noise, 0.1, 0.4),
        "spring" => {
            set("spring_load", "stiffness_n_per_m", log_uniform(noise, 3e3, 4e4));
            set("spring_load", "neutral_position_m", noise.uniform(0.0, 0.4));
        }
        "oil_viscosity" => set("oil_viscosity", "factor", log_uniform(noise, 2.0, 4.0)),
        "supply" => change.factors[1] = 1.0 - log_uniform(noise, 0.07, 0.3),
        "controller" => {
            let gain = 1.0 + signed(noise, 0.04, 0.4);
            if kind != 1 {
                set("controller_gains", "kp", gain);
            }
            if kind != 0 {
                set("controller_gains", "ki", gain);
            }
        }
        "position_scale" => set("position_scale", "factor", 1.0 + signed(noise, 0.02, 0.06)),
        "valve_hysteresis" => set("valve_hysteresis", "width", log_uniform(noise, 2e-3, 0.04)),
        _ => set("valve_deadband", "half_width", log_uniform(noise, 1e-3, 0.03)),
    }
    change.cause = Some(cause.to_owned());
}

/// Plants what monitors have no name for.
fn plant_outside(change: &mut Change, noise: &mut Noise) {
    let mut set = |effect: &str, parameter: &str, value: f64| {
        change.effects.entry(effect.into()).or_default().insert(parameter.into(), value);
    };
    match noise.uniform(0.0, 4.0) as usize {
        0 => set("valve_flow_shape", "exponent", noise.uniform(1.1, 1.4)),
        1 => set("position_lag", "time_constant_s", noise.uniform(0.005, 0.03)),
        2 => {
            set("shared_supply", "flow_m3_per_s", noise.uniform(2e-4, 8e-4));
            set("shared_supply", "start_s", noise.uniform(1.0, 7.0));
            set("shared_supply", "duration_s", noise.uniform(0.5, 1.5));
        }
        _ => set("valve_asymmetry", "b_side_ratio", noise.uniform(0.7, 0.9)),
    }
    change.cause = Some("outside".to_owned());
}

impl Watched {
    /// Runs the machine: its baseline, then what has changed. `sink` has each sample with the number of its stage, 0 for the baseline.
    /// Whether all stayed finite.
    pub fn run(&self, mut sink: impl FnMut(usize, PressSample)) -> bool {
        let mut noise = Noise::new(self.seed, 5);
        let day = |noise: &mut Noise| {
            let oil_c = noise.uniform(OIL_C.0, OIL_C.1);
            series::on_a_day(&self.machine, oil_c, noise.factor(SUPPLY))
        };
        for part in 0..2 {
            let machine = day(&mut noise);
            let press = self.press(&machine, 0.0);
            let variation = Variation { load: LOAD, jitter_s: 0.0, seed: self.seed + part };
            if !press.run(BASELINE_CYCLES / 2, variation, |sample| sink(0, sample)) {
                return false;
            }
        }
        let (stages, cycles): (&[f64], usize) =
            if self.change.drifts { (&DRIFT, STAGE_CYCLES) } else { (&[1.0], STEP_CYCLES) };
        stages.iter().enumerate().all(|(stage, share)| {
            let machine = day(&mut noise);
            let variation = Variation { load: LOAD, jitter_s: 0.0, seed: self.seed + 7 + stage as u64 };
            self.press(&machine, *share).run(cycles, variation, |sample| sink(1 + stage, sample))
        })
    }

    /// The machine with a share of what changes.
    fn press(&self, machine: &MachineSpec, share: f64) -> Press {
        let change = &self.change;
        let mut plant = machine.plant.clone();
        let [load, supply] = change.factors.map(|factor| 1.0 + share * (factor - 1.0));
        plant.relief_pressure_pa *= supply;
        plant.load_scale *= load;
        let one_lpm_m2 = LPM / plant.orifice_flow_m3_per_s(1.0, 7e6);
        plant.leak_area_m2 = share * change.leak_lpm * one_lpm_m2;
        let mut planted = EffectValues::new();
        if share > 0.0 {
            planted.extend(change.effects.iter().map(|(key, values)| (key.clone(), shared(values, share))));
            planted
                .insert("turbulent_leak".into(), BTreeMap::from([("exponent".into(), change.leak_exponent)]));
        }
        Press {
            plant,
            controller: Controller::default(),
            cycle: DutyCycle::default(),
            planted,
            other_law: change.other_law,
            foreign: None,
        }
    }
}

/// A share of an effect: its sizes, not its shape.
fn shared(values: &BTreeMap<String, f64>, share: f64) -> BTreeMap<String, f64> {
    let of = |name: &str, value: f64| match name {
        "decay_command" | "neutral_position_m" | "stribeck_speed_m_per_s" | "start_s" | "duration_s" => value,
        "factor" | "kp" | "ki" | "exponent" | "b_side_ratio" => 1.0 + share * (value - 1.0),
        _ => share * value,
    };
    values.iter().map(|(name, value)| (name.clone(), of(name, *value))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_is_unchanged_and_a_quarter_leaks_alone() {
        let drawn = draw(3, 96);
        let count = |is: &dyn Fn(&Change) -> bool| drawn.iter().filter(|one| is(&one.change)).count();
        assert_eq!(count(&|change| change.cause.is_none() && change.leak_lpm == 0.0), 24);
        assert_eq!(count(&|change| change.cause.is_none() && change.leak_lpm > 0.0), 24);
        let named = CAUSES.map(|cause| count(&|change| change.cause.as_deref() == Some(cause)));
        assert!(named.iter().all(|count| (1..=4).contains(count)), "{named:?}");
        assert!((4..20).contains(&count(&|change| change.cause.is_some() && change.leak_lpm > 0.0)));
    }

    /// At no share of its size a change is none: the press is the machine's own.
    #[test]
    fn neutral_before_its_change_a_machine_has_none() {
        let watched = &draw(5, 8)[7];
        let machine = MachineSpec::default();
        let press = watched.press(&machine, 0.0);
        assert!(press.planted.is_empty() && press.plant.leak_area_m2 == 0.0);
        assert_eq!(press.plant.relief_pressure_pa.to_bits(), machine.plant.relief_pressure_pa.to_bits());
    }
}
