//! The hydraulic press as an axis whose gap is diagnosed.

use rayon::prelude::*;
use seepd_signals::Signal;
use seepd_sim::SimulatedSignals;
use seepd_sim::batch::follow;
use seepd_sim::cycle::{DriveSample, LoadCorner, Move, RunStart};
use seepd_sim::effects::{self, EffectInfo, Parameter};
use seepd_sim::learned::{self, LearnedLaw, Site};
use seepd_sim::real::{LANES, Lanes};
use seepd_sim::{DutyCycle, MachineSpec, PlantParameters, Size, Steps};

use crate::balance;
use crate::record::{BINS, RecordedCycle, bin_of, correlation};
use crate::simulate::{BinnedSignals, bins_of};
use crate::simulated_axis::{CalibratedParameter, EffectValues, Imbalances, Scale, SimulatedAxis};

/// What calibration may change: bounds as factors, and a prior as a standard deviation of the logarithm: 15 % where data sheets are good, a
/// factor of 2 where they are not.
const BY_FACTOR: &[(&str, f64, f64, f64)] = &[
    ("valve_m3_per_s_sqrt_pa", 0.5, 2.0, 0.15),
    ("viscous_friction_n_s_per_m", 0.25, 4.0, std::f64::consts::LN_2),
    ("mass_kg", 0.25, 4.0, std::f64::consts::LN_2),
    ("pump_flow_m3_per_s", 0.5, 2.0, std::f64::consts::LN_2),
    ("relief_pressure_pa", 0.5, 1.2, 0.15),
    ("relief_resistance_pa_s_per_m3", 0.5, 2.0, std::f64::consts::LN_2),
    ("bulk_modulus_pa", 0.5, 2.0, 0.15),
    ("line_m3_per_s_sqrt_pa", 0.5, 2.0, 0.15),
    ("seal_resistance_pa_s_per_m3", 1.0 / 3.0, 3.0, std::f64::consts::LN_2),
    ("load_scale", 0.7, 1.3, std::f64::consts::LN_2),
];
/// Constants that logs hardly tell, alike: volumes from drawings, leakage of a valve as new, the square-root law's end.
const HARDLY_TOLD: &[(&str, f64, f64, f64)] = &[
    ("supply_volume_m3", 0.5, 2.0, 0.2),
    ("inlet_volume_m3", 0.5, 2.0, 0.2),
    ("cap_dead_volume_m3", 0.4, 2.5, 0.3),
    ("rod_dead_volume_m3", 0.4, 2.5, 0.3),
    ("valve_rod_resistance_pa_s_per_m3", 0.125, 8.0, std::f64::consts::LN_2),
    ("valve_return_resistance_pa_s_per_m3", 0.125, 8.0, std::f64::consts::LN_2),
    ("transition_pressure_pa", 0.5, 2.0, 0.3),
];
/// The return pressure is calibrated by addition: largest value, and standard deviation, Pa.
const RETURN_PRESSURE_PA: (f64, f64) = (2.5e6, 2e5);
/// Effects of the loop: without a controller there are none.
const OF_A_LOOP: [&str; 2] = ["controller_gains", "controller_clock"];
/// Largest leak that is fitted, and its unit in the fit, m², for a valve of the nominal size.
const LEAK_M2: (f64, f64) = (3e-5, 1e-7);

/// Whether an effect is an event at a time in the duty cycle.
fn has_times(effect: &EffectInfo) -> bool {
    (0..effect.parameters.len()).any(|index| effect.is_time(index))
}

/// The prior of a parameter whose bounds the file gives: one who gives wide bounds knows little.
fn prior_within((low, high): (f64, f64), usual: f64) -> f64 {
    usual.max(0.5 * (high / low.max(f64::MIN_POSITIVE)).ln())
}

fn symbol_of(key: &'static str) -> &'static str {
    PlantParameters::ALL.iter().find(|info| info.key == key).map_or(key, |info| info.symbol)
}

crate::diagnosable!(MachineSpec);

impl SimulatedAxis for MachineSpec {
    /// Without a controller, what acts on one and what happens at a time in a duty cycle is no explanation.
    fn catalogue(&self) -> Vec<&'static EffectInfo> {
        let can_be =
            |info: &&EffectInfo| !self.is_open_loop() || !(OF_A_LOOP.contains(&info.key) || has_times(info));
        effects::ALL.iter().map(|effect| effect.info()).filter(can_be).collect()
    }

    fn laws_of_parts(&self) -> Vec<&'static EffectInfo> {
        effects::OF_DATA_SHEETS.iter().map(|law| law.info()).collect()
    }

    fn learnable(&self) -> &'static [&'static LearnedLaw] {
        if self.is_open_loop() { learned::of_open_loop() } else { &learned::ALL }
    }

    /// Some percent of what the machine's own forces and flows are.
    fn learned_unit(&self, site: Site) -> f64 {
        let p = &self.plant;
        let valve_flow = p.valve_m3_per_s_sqrt_pa * (0.5 * p.relief_pressure_pa).sqrt();
        match site {
            Site::Force | Site::Friction => 0.02 * p.cap_area_m2 * p.relief_pressure_pa,
            Site::Spool => 0.01,
            Site::RodPort => 0.1,
            Site::Seal | Site::CapFlow | Site::RodFlow => 0.005 * valve_flow,
            Site::Supply => 0.03 * p.pump_flow_m3_per_s,
            Site::Sensor | Site::Controller => 0.002 * p.stroke_m,
        }
    }

    fn signals(&self) -> Vec<Signal> {
        vec![Signal::Command, Signal::Position, Signal::PSupply, Signal::PInlet, Signal::PCap, Signal::PRod]
    }

    fn calibrated_parameters(&self) -> Vec<CalibratedParameter> {
        let told = BY_FACTOR.iter().map(|of| (of, false)).chain(HARDLY_TOLD.iter().map(|of| (of, true)));
        let by_factor = told.filter_map(|((key, low, high, sigma), hardly_told)| {
            let nominal = self.plant.get(key).filter(|value| *value > 0.0)?;
            let given = self.bounds_of(key);
            Some(CalibratedParameter {
                key: (*key).into(),
                symbol: symbol_of(key).into(),
                bounds: given.unwrap_or((nominal * low, nominal * high)),
                scale: Scale::Logarithmic,
                sigma: Some(given.map_or(*sigma, |bounds| prior_within(bounds, *sigma))),
                hardly_told,
            })
        });
        let (most, sigma) = RETURN_PRESSURE_PA;
        let key = "return_pressure_pa";
        let returned = CalibratedParameter {
            key: key.into(),
            symbol: symbol_of(key).into(),
            bounds: self.bounds_of(key).unwrap_or((0.0, most)),
            scale: Scale::Linear(sigma),
            sigma: Some(1.0),
            hardly_told: false,
        };
        by_factor.chain([returned]).collect()
    }

    fn wear(&self) -> Option<CalibratedParameter> {
        let key = "leak_area_m2";
        let valve = Size::of(self).valve;
        let bounds = self.bounds_of(key).unwrap_or((0.0, valve * LEAK_M2.0));
        Some(CalibratedParameter {
            key: key.into(),
            symbol: symbol_of(key).into(),
            bounds,
            scale: Scale::Linear(valve * LEAK_M2.1),
            sigma: None,
            hardly_told: false,
        })
    }

    fn parameter(&self, key: &str) -> f64 {
        self.plant.get(key).unwrap_or(f64::NAN)
    }

    fn set_parameter(&mut self, key: &str, value: f64) {
        if let Some(slot) = self.plant.get_mut(key) {
            *slot = value;
        }
    }

    fn effects(&self) -> &EffectValues {
        &self.effects
    }

    fn effects_mut(&mut self) -> &mut EffectValues {
        &mut self.effects
    }

    /// Times end with the cycle, places with the stroke; forces, volumes and flows go with the machine.
    fn range(&self, _effect: &EffectInfo, parameter: &Parameter) -> (f64, f64) {
        let (low, high) = Size::of(self).range_of(parameter);
        match parameter.name {
            "start_s" | "duration_s" => (low, high.min(self.cycle.period_s)),
            "neutral_position_m" => (low, self.plant.stroke_m),
            _ => (low, high),
        }
    }

    /// A factor on a gain of 0 is none.
    fn acts(&self, effect: &EffectInfo, parameter: &Parameter) -> bool {
        !(effect.key == "controller_gains" && parameter.name == "kd" && self.controller.kd == 0.0)
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

    fn asked_m(&self, command: &[f64], position_m: &[f64]) -> Option<Vec<f64>> {
        Some(self.controller.asked_m(command, position_m, self.cycle.period_s))
    }

    fn run(
        machines: &[Self],
        drive: &[DriveSample],
        warm_up: usize,
        signals: &[Signal],
    ) -> Vec<BinnedSignals> {
        simulated(machines, drive, (warm_up, None), signals)
    }

    fn run_from(
        machines: &[Self],
        start: &RunStart,
        drive: &[DriveSample],
        signals: &[Signal],
    ) -> Vec<BinnedSignals> {
        simulated(machines, drive, (0, Some(start)), signals)
    }

    fn is_open_loop(&self) -> bool {
        self.controller.is_none()
    }

    fn along(&self, period_s: f64, position_m: &[f64], load_n: &[f64]) -> Self {
        if self.is_open_loop() { with_run(self, period_s, position_m, load_n) } else { self.clone() }
    }

    fn imbalances(&self, signals: &[Signal], view: &BinnedSignals) -> Imbalances {
        balance::imbalances(self, signals, view)
    }

    fn contradiction(&self, signals: &[Signal], cycle: &RecordedCycle) -> Option<String> {
        inverted_command(signals, cycle).or_else(|| swapped_chambers(self, signals, cycle))
    }
}

/// What machines show in bins along a drive: after a warm-up of some ticks, or from where a run starts.
fn simulated(
    machines: &[MachineSpec],
    drive: &[DriveSample],
    (warm_up, start): (usize, Option<&RunStart>),
    signals: &[Signal],
) -> Vec<BinnedSignals> {
    let ticks = drive.len() - warm_up;
    machines
        .par_chunks(LANES)
        .flat_map_iter(|machines| {
            let machines: Vec<MachineSpec> = machines.iter().map(softer_at_the_inlet).collect();
            let mut sums = vec![vec![[0.0; LANES]; BINS]; signals.len()];
            let mut counts = vec![0u32; BINS];
            follow(&machines, drive, start, Steps::Fewest, |tick, record| {
                let Some(tick) = tick.checked_sub(warm_up) else { return };
                let bin = bin_of(tick, ticks);
                counts[bin] += 1;
                for (signal, sums) in signals.iter().zip(&mut sums) {
                    for (sum, value) in sums[bin].iter_mut().zip(of(record, *signal).0) {
                        *sum += value;
                    }
                }
            });
            let view = |lane: usize| -> BinnedSignals {
                let mean = |bins: &Vec<[f64; LANES]>| {
                    bins.iter()
                        .zip(&counts)
                        .map(|(sum, count)| sum[lane] / f64::from((*count).max(1)))
                        .collect()
                };
                sums.iter().map(mean).collect()
            };
            (0..machines.len()).map(view).collect::<Vec<BinnedSignals>>()
        })
        .collect()
}

/// The machine with a run in the place of its duty cycle.
fn with_run(machine: &MachineSpec, period_s: f64, position_m: &[f64], load_n: &[f64]) -> MachineSpec {
    let (Some(first), Some(last)) = (position_m.first(), position_m.last()) else { return machine.clone() };
    let at_s = |bin: usize| (bin as f64 + 0.5) * period_s / load_n.len() as f64;
    let stroke = |from_s: f64, to_s: f64, to_m: f64, course: Vec<f64>| Move {
        name: "run".into(),
        from_s,
        to_s,
        to_m,
        course,
        wait_s: 0.0,
        open_loop: None,
    };
    // A move goes from 0 to 1: a run that ends where it began goes there in two.
    let turn = furthest_from(position_m, *first);
    let turn_s = period_s * turn as f64 / position_m.len() as f64;
    let share = |from: f64, to: f64| {
        move |x: &f64| if to == from { 0.0 } else { ((x - from) / (to - from)).clamp(-0.5, 1.5) }
    };
    let (out, back) = position_m.split_at(turn);
    let (end_m, begin_s) = (position_m[turn], 1e-3 * period_s);
    let mut machine = machine.clone();
    machine.cycle.period_s = period_s;
    machine.cycle.moves = vec![
        stroke(0.0, begin_s, *first, Vec::new()),
        stroke(begin_s, turn_s.max(2.0 * begin_s), end_m, out.iter().map(share(*first, end_m)).collect()),
        stroke(turn_s.max(2.0 * begin_s), period_s, *last, back.iter().map(share(end_m, *last)).collect()),
    ];
    let corner = |(bin, force_n): (usize, &f64)| LoadCorner { at_s: at_s(bin), force_n: *force_n };
    machine.cycle.load = load_n.iter().enumerate().map(corner).collect();
    machine
}

/// The bin at which the piston is furthest from a place, within the run.
fn furthest_from(position_m: &[f64], place_m: f64) -> usize {
    let distance = |bin: &usize| (position_m[*bin] - place_m).abs();
    (1..position_m.len().max(2) - 1).max_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
}

/// The machine with some of the supply's volume moved to the valve's inlet, the smallest volume, which alone asks for short steps. What
/// both hold together stays; what the inlet's pressure does within a millisecond is not seen in bins (a test holds the machine in the
/// fewest steps to 1e-4 of each signal's range, and the two pressures before the valve to 4e-4).
fn softer_at_the_inlet(machine: &MachineSpec) -> MachineSpec {
    let mut machine = machine.clone();
    let plant = &mut machine.plant;
    let moved = plant.inlet_volume_m3.min(LARGEST_MOVE * plant.supply_volume_m3);
    plant.inlet_volume_m3 += moved;
    plant.supply_volume_m3 -= moved;
    machine
}

/// Largest share of the supply's volume that is moved: with less of it left its relief valve chatters.
const LARGEST_MOVE: f64 = 0.2;

pub(crate) fn of(record: &SimulatedSignals<Lanes>, signal: Signal) -> Lanes {
    match signal {
        Signal::Command => record.command,
        Signal::Demand => record.demand,
        Signal::Position => record.position,
        Signal::PSupply => record.p_supply,
        Signal::PInlet => record.p_inlet,
        Signal::PCap => record.p_cap,
        Signal::PRod => record.p_rod,
        Signal::Load | Signal::CycleStart => record.load,
    }
}

/// The command opens the valve, and the piston moves.
fn inverted_command(signals: &[Signal], cycle: &RecordedCycle) -> Option<String> {
    let bins = |signal: Signal| bins_of(signals, signal, &cycle.bins);
    let (u, x) = (bins(Signal::Command)?, bins(Signal::Position)?);
    let speed: Vec<f64> = (0..BINS).map(|bin| x[(bin + 1) % BINS] - x[(bin + BINS - 1) % BINS]).collect();
    let together = correlation(u, &speed, 0, 1);
    if together < -0.5 {
        return Some(format!(
            "the command's sign is inverted (its correlation with the speed is {together:.2}); set scale = -1 in the mapping"
        ));
    }
    (together < 0.3).then(|| {
        format!("the position does not follow the command (correlation of command and speed {together:.2})")
    })
}

/// Piston forces balance the load but for friction; with the chambers swapped they do not.
fn swapped_chambers(spec: &MachineSpec, signals: &[Signal], cycle: &RecordedCycle) -> Option<String> {
    let bins = |signal: Signal| bins_of(signals, signal, &cycle.bins);
    let (p_cap, p_rod) = (bins(Signal::PCap)?, bins(Signal::PRod)?);
    let drive = &cycle.drive;
    let rest = |cap: &[f64], rod: &[f64]| -> f64 {
        (0..BINS)
            .map(|bin| {
                let load = drive[bin * drive.len() / BINS].load_n;
                (spec.plant.cap_area_m2 * cap[bin] - spec.plant.annulus_area_m2 * rod[bin] + load).powi(2)
            })
            .sum()
    };
    (rest(p_rod, p_cap) < 0.1 * rest(p_cap, p_rod))
        .then(|| "p_cap and p_rod are swapped: with them exchanged the piston's forces balance".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::MODEL_ERROR;
    use crate::record::binned;

    /// RMS over range of what `run` shows beside the machine in its own steps, by signal.
    fn differences(machine: &MachineSpec) -> Vec<(Signal, f64)> {
        let cycle = &machine.cycle;
        let ticks = (cycle.period_s / machine.controller.period_s) as usize;
        let drive: Vec<DriveSample> = (0..2 * ticks)
            .map(|tick| {
                let at_s = (tick % ticks) as f64 * machine.controller.period_s;
                let load_end_n = cycle.load_n(at_s + machine.controller.period_s);
                DriveSample {
                    load_end_n,
                    open_loop: cycle.open_loop_at(at_s),
                    ..DriveSample::new(at_s, cycle.demand_m(at_s), cycle.load_n(at_s))
                }
            })
            .collect();
        let signals = machine.signals();
        let compared =
            MachineSpec::run(std::slice::from_ref(machine), &drive, ticks, &signals).swap_remove(0);
        let mut own = vec![Vec::with_capacity(ticks); signals.len()];
        follow(std::slice::from_ref(machine), &drive, None, Steps::Own, |tick, record| {
            if tick >= ticks {
                signals.iter().zip(&mut own).for_each(|(signal, own)| own.push(of(record, *signal).0[0]));
            }
        });
        let of_signal = |((signal, own), compared): ((&Signal, &Vec<f64>), &Vec<f64>)| {
            let own = binned(own);
            let (low, high) = own.iter().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(*v), b.max(*v)));
            let square: f64 = own.iter().zip(compared).map(|(a, b)| (a - b).powi(2)).sum();
            (*signal, (square / BINS as f64).sqrt() / (high - low))
        };
        signals.iter().zip(&own).zip(&compared).map(of_signal).collect()
    }

    /// What the two pressures before the valve do within a millisecond is a fifth of the error that any model is allowed at most; the
    /// others hardly feel it.
    fn assert_alike(machine: &MachineSpec, what: &str) {
        for (signal, difference) in differences(machine) {
            let most = match signal {
                Signal::PSupply | Signal::PInlet => 4e-4,
                _ => 1e-4,
            };
            assert!(difference < most, "{what}, {signal:?}: {difference:.1e}");
        }
    }

    #[test]
    fn fewer_steps_with_a_softer_inlet_show_the_same() {
        let effects = [
            "",
            "coulomb_friction.force_n=1500",
            "coulomb_friction.force_n=5000",
            "stribeck_friction.static_force_n=5000",
            "pressure_friction.coefficient=0.1",
            "valve_rate_limit.rate_per_s=0.4",
            "valve_lag.natural_frequency_hz=40",
            "structure_compliance.mass_fraction=0.5",
            "accumulator.volume_m3=1e-3",
            "command_delay.delay_s=0.0051",
            "return_back_pressure.k_pa_s2_per_m6=1e12",
        ];
        for effect in effects {
            let mut machine = MachineSpec::default();
            machine.plant.leak_area_m2 = 3e-7;
            if !effect.is_empty() {
                machine.set_effect(effect).unwrap();
            }
            assert_alike(&machine, effect);
        }
        // A piston that sticks: which chamber holds it turns on little, which neither command nor position feels.
        let mut machine = MachineSpec::default();
        for set in
            ["static_force_n=3000", "force_n=2000", "stribeck_speed_m_per_s=0.03", "creep_speed_m_per_s=1e-4"]
        {
            machine.set_effect(&format!("stribeck_friction.{set}")).unwrap();
        }
        for (signal, difference) in differences(&machine.with_stable_steps()) {
            let most = if matches!(signal, Signal::Command | Signal::Position) { 1e-4 } else { MODEL_ERROR };
            assert!(difference < most, "sticking friction, {signal:?}: {difference:.1e}");
        }
        // A pump too small for the strokes: the supply's volume gives its oil.
        let mut machine = MachineSpec::default();
        machine.plant.pump_flow_m3_per_s = 4e-4;
        assert_alike(&machine, "a small pump");
    }
}
