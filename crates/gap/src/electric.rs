//! The electric positioning axis as an axis whose gap is diagnosed.

use rayon::prelude::*;
use seepd_signals::Signal;
use seepd_sim::DutyCycle;
use seepd_sim::cycle::DriveSample;
use seepd_sim::effects::{EffectInfo, Parameter};
use seepd_sim::electric::{CATALOGUE, ElectricAxis};

use crate::record::{BINS, RecordedCycle, binned};
use crate::simulate::{BinnedSignals, bins_of};
use crate::simulated_axis::{CalibratedParameter, EffectValues, Imbalances, Scale, SimulatedAxis};

/// The drive's force for which the catalogue states its ranges, N.
const REFERENCE_FORCE_N: f64 = 1e3;

crate::diagnosable!(ElectricAxis);

impl SimulatedAxis for ElectricAxis {
    fn catalogue(&self) -> Vec<&'static EffectInfo> {
        CATALOGUE.iter().collect()
    }

    fn signals(&self) -> Vec<Signal> {
        vec![Signal::Command, Signal::Position]
    }

    fn calibrated_parameters(&self) -> Vec<CalibratedParameter> {
        let by_factor = |key: &str, symbol: &str| {
            let nominal = self.parameter(key);
            (nominal > 0.0).then_some(CalibratedParameter {
                key: key.into(),
                symbol: symbol.into(),
                bounds: (nominal / 4.0, nominal * 4.0),
                scale: Scale::Logarithmic,
                sigma: Some(std::f64::consts::LN_2),
                hardly_told: false,
            })
        };
        [by_factor("mass_kg", "M"), by_factor("viscous_friction_n_s_per_m", "F_v")]
            .into_iter()
            .flatten()
            .collect()
    }

    fn wear(&self) -> Option<CalibratedParameter> {
        None
    }

    fn parameter(&self, key: &str) -> f64 {
        match key {
            "mass_kg" => self.plant.mass_kg,
            "viscous_friction_n_s_per_m" => self.plant.viscous_friction_n_s_per_m,
            _ => f64::NAN,
        }
    }

    fn set_parameter(&mut self, key: &str, value: f64) {
        match key {
            "mass_kg" => self.plant.mass_kg = value,
            "viscous_friction_n_s_per_m" => self.plant.viscous_friction_n_s_per_m = value,
            _ => {}
        }
    }

    fn effects(&self) -> &EffectValues {
        &self.effects
    }

    fn effects_mut(&mut self) -> &mut EffectValues {
        &mut self.effects
    }

    /// Forces are in proportion to the drive's.
    fn range(&self, _effect: &EffectInfo, parameter: &Parameter) -> (f64, f64) {
        let (low, high) = parameter.range;
        let scale =
            if parameter.unit.starts_with('N') { self.plant.full_force_n / REFERENCE_FORCE_N } else { 1.0 };
        (low * scale, high * scale)
    }

    fn acts(&self, _effect: &EffectInfo, _parameter: &Parameter) -> bool {
        true
    }

    fn duty_cycle(&self) -> &DutyCycle {
        &self.cycle
    }

    fn tick_s(&self) -> f64 {
        self.controller.period_s
    }

    fn stroke_m(&self) -> f64 {
        self.plant.stroke_m
    }

    /// The cascade solved for the demand, with the speed over ten ticks.
    fn asked_m(&self, command: &[f64], position_m: &[f64]) -> Option<Vec<f64>> {
        const REACH: usize = 5;
        let c = &self.controller;
        let speed = |tick: usize| {
            let (from, to) = (tick.saturating_sub(REACH), (tick + REACH).min(position_m.len() - 1));
            (position_m[to] - position_m[from]) / ((to - from).max(1) as f64 * c.period_s)
        };
        let pairs = command.iter().zip(position_m).enumerate();
        let asked = pairs
            .map(|(tick, (u, x))| x + (u / c.velocity_gain_s_per_m + speed(tick)) / c.position_gain_per_s);
        Some(asked.collect())
    }

    fn run(
        machines: &[Self],
        drive: &[DriveSample],
        warm_up: usize,
        signals: &[Signal],
    ) -> Vec<BinnedSignals> {
        let view = |machine: &Self| -> BinnedSignals {
            let mut values = vec![Vec::with_capacity(drive.len() - warm_up); signals.len()];
            machine.follow(drive, |tick, record| {
                if tick < warm_up {
                    return;
                }
                for (signal, values) in signals.iter().zip(&mut values) {
                    values.push(match signal {
                        Signal::Command => record.command,
                        _ => record.position_m,
                    });
                }
            });
            values.iter().map(|values| binned(values)).collect()
        };
        machines.par_iter().map(view).collect()
    }

    /// The balance of forces, over the drive's full force.
    fn imbalances(&self, signals: &[Signal], view: &BinnedSignals) -> Imbalances {
        let bins = |signal: Signal| bins_of(signals, signal, view);
        let (Some(u), Some(x)) = (bins(Signal::Command), bins(Signal::Position)) else { return Vec::new() };
        let dt = self.cycle.period_s / BINS as f64;
        let force = (0..BINS).map(|bin| {
            let (next, before) = (x[(bin + 1) % BINS], x[(bin + BINS - 1) % BINS]);
            let (v, a) = ((next - before) / (2.0 * dt), (next - 2.0 * x[bin] + before) / (dt * dt));
            u[bin]
                - (self.plant.mass_kg * a + self.plant.viscous_friction_n_s_per_m * v)
                    / self.plant.full_force_n
        });
        vec![("force", force.collect())]
    }

    /// Force and acceleration have the same sign.
    fn contradiction(&self, signals: &[Signal], cycle: &RecordedCycle) -> Option<String> {
        let imbalance = |sign: f64| -> f64 {
            let mut turned = cycle.bins.clone();
            turned.iter_mut().take(1).flatten().for_each(|u| *u *= sign);
            let balances = self.imbalances(signals, &turned);
            balances.iter().flat_map(|(_, force)| force).map(|value| value * value).sum()
        };
        (imbalance(-1.0) < 0.25 * imbalance(1.0))
            .then(|| "the command's sign is inverted: mass and friction balance with the other one; set scale = -1 in the mapping".to_owned())
    }
}
