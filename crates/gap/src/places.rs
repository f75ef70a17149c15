//! Where the gap is: which equation does not balance, in which phase of the duty cycle, and which signal shows it.
//!
//! Each balance is evaluated on the recorded signals and on the simulated ones with the same coefficients and the same differences over
//! bins; what differs is imbalance that the machine has and the simulation has not.

use seepd_signals::Signal;
use seepd_sim::MachineSpec;

use crate::record::{BINS, Record};
use crate::report::Place;
use crate::simulate::View;

/// Phases in reports.
const PHASES: [&str; 7] = ["extend", "press", "hold", "retract", "reversal", "near_zero", "near_end"];
/// Speed below which a hold is a hold, share of the largest.
const STANDING: f64 = 0.01;
/// Share of the stroke within which an end stop is near.
const NEAR_END: f64 = 0.06;
/// Places that are told.
const TOLD: usize = 12;

/// The phase of each bin.
fn phases(spec: &MachineSpec) -> Vec<usize> {
    let cycle = &spec.cycle;
    let at = |bin: f64| (bin + 0.5) / BINS as f64 * cycle.period_s;
    let speed = |bin: usize| {
        let (before, after) = (at(bin as f64 - 0.5).max(0.0), at(bin as f64 + 0.5));
        (cycle.demand_m(after) - cycle.demand_m(before)) / (after - before)
    };
    let fastest = (0..BINS).map(|bin| speed(bin).abs()).fold(1e-9, f64::max);
    let mean_load = (0..BINS).map(|bin| cycle.load_n(at(bin as f64)).abs()).sum::<f64>() / BINS as f64;
    // A move is a press stroke as a whole, though the load may come in the middle of it.
    let presses = |at_s: f64| {
        cycle.moves.iter().any(|stroke| {
            (stroke.from_s..stroke.to_s).contains(&at_s) && cycle.load_n(stroke.to_s).abs() > 1.2 * mean_load
        })
    };
    (0..BINS)
        .map(|bin| {
            let position = cycle.demand_m(at(bin as f64));
            let (before, after) = (speed(bin.saturating_sub(8)), speed((bin + 8).min(BINS - 1)));
            if position < NEAR_END * spec.plant.stroke_m || position > (1.0 - NEAR_END) * spec.plant.stroke_m
            {
                6
            } else if before * after < -(STANDING * fastest).powi(2) {
                4
            } else if speed(bin).abs() < STANDING * fastest {
                2
            } else if speed(bin) < 0.0 {
                3
            } else if presses(at(bin as f64)) {
                1
            } else {
                0
            }
        })
        .collect()
}

/// The phases of the cycle in time order: name, start and end, s.
pub(crate) fn phase_spans(spec: &MachineSpec) -> Vec<(&'static str, f64, f64)> {
    let at = |bin: usize| bin as f64 / BINS as f64 * spec.cycle.period_s;
    let mut spans: Vec<(&'static str, f64, f64)> = Vec::new();
    for (bin, phase) in phases(spec).into_iter().enumerate() {
        match spans.last_mut() {
            Some((name, _, end)) if *name == PHASES[phase] => *end = at(bin + 1),
            _ => spans.push((PHASES[phase], at(bin), at(bin + 1))),
        }
    }
    spans
}

/// The balances that the record's signals allow, as equation and imbalance in each bin, over the size of its largest term.
fn imbalances(record: &Record, spec: &MachineSpec, view: &View) -> Vec<(&'static str, Vec<f64>)> {
    let signal = |signal: Signal| record.index_of(signal).map(|index| &view[index]);
    let dt = spec.cycle.period_s / BINS as f64;
    let p = &spec.plant;
    let slope = |values: &[f64], bin: usize| {
        (values[(bin + 1) % BINS] - values[(bin + BINS - 1) % BINS]) / (2.0 * dt)
    };
    let sq = |k: f64, dp: f64| k * dp / (dp * dp + p.transition_pressure_pa.powi(2)).powf(0.25);
    let mut all = Vec::new();
    let (Some(u), Some(x)) = (signal(Signal::Command), signal(Signal::Position)) else { return all };
    let load = |bin: usize| spec.cycle.load_n((bin as f64 + 0.5) * dt) * p.load_scale;
    if let (Some(p_1), Some(p_2)) = (signal(Signal::PCap), signal(Signal::PRod)) {
        let force = (0..BINS).map(|bin| {
            let v = slope(x, bin);
            let acceleration = (x[(bin + 1) % BINS] - 2.0 * x[bin] + x[(bin + BINS - 1) % BINS]) / (dt * dt);
            (p.cap_area_m2 * p_1[bin] - p.annulus_area_m2 * p_2[bin] - p.viscous_friction_n_s_per_m * v
                + load(bin)
                - p.mass_kg * acceleration)
                / (p.cap_area_m2 * p.relief_pressure_pa)
        });
        all.push(("force", force.collect()));
        if let Some(p_3) = signal(Signal::PInlet) {
            let leak = |bin: usize| {
                let dp = p_1[bin] - p_2[bin];
                sq(p.discharge_coefficient * p.leak_area_m2 * (2.0 / p.density_kg_per_m3).sqrt(), dp)
                    + dp / p.seal_resistance_pa_s_per_m3
            };
            let opening = |bin: usize| p.valve_m3_per_s_sqrt_pa * u[bin].abs();
            let flow_1 = |bin: usize| {
                let source = if u[bin] > 0.0 { p_3[bin] } else { p.return_pressure_pa };
                sq(opening(bin), source - p_1[bin])
            };
            let flow_2 = |bin: usize| {
                let source = if u[bin] > 0.0 { p.return_pressure_pa } else { p_3[bin] };
                sq(opening(bin), source - p_2[bin])
            };
            let scale = p.pump_flow_m3_per_s;
            let cap = (0..BINS).map(|bin| {
                let volume = p.cap_dead_volume_m3 + p.cap_area_m2 * x[bin];
                (flow_1(bin)
                    - p.cap_area_m2 * slope(x, bin)
                    - leak(bin)
                    - volume / p.bulk_modulus_pa * slope(p_1, bin))
                    / scale
            });
            all.push(("cap", cap.collect()));
            let rod = (0..BINS).map(|bin| {
                let volume = p.rod_dead_volume_m3 + p.annulus_area_m2 * (p.stroke_m - x[bin]);
                (flow_2(bin) + p.annulus_area_m2 * slope(x, bin) + leak(bin)
                    - volume / p.bulk_modulus_pa * slope(p_2, bin))
                    / scale
            });
            all.push(("rod", rod.collect()));
            if let Some(p_s) = signal(Signal::PSupply) {
                let line = |bin: usize| sq(p.line_m3_per_s_sqrt_pa, p_s[bin] - p_3[bin]);
                let inlet = (0..BINS).map(|bin| {
                    let drawn = if u[bin] > 0.0 { flow_1(bin) } else { flow_2(bin) };
                    (line(bin) - drawn - p.inlet_volume_m3 / p.bulk_modulus_pa * slope(p_3, bin)) / scale
                });
                all.push(("inlet", inlet.collect()));
                let supply = (0..BINS).map(|bin| {
                    let relief =
                        ((p_s[bin] - p.relief_pressure_pa) / p.relief_resistance_pa_s_per_m3).max(0.0);
                    (p.pump_flow_m3_per_s
                        - line(bin)
                        - relief
                        - p.supply_volume_m3 / p.bulk_modulus_pa * slope(p_s, bin))
                        / scale
                });
                all.push(("supply", supply.collect()));
            }
        }
    }
    if !all.iter().any(|(equation, _)| *equation == "cap") {
        // Without all pressures: the speed that the command gives against the speed that there is.
        let flow = (0..BINS).map(|bin| {
            let fastest = p.valve_m3_per_s_sqrt_pa * (0.5 * p.relief_pressure_pa).sqrt();
            (u[bin] * fastest - p.cap_area_m2 * slope(x, bin)) / p.pump_flow_m3_per_s
        });
        all.push(("flow", flow.collect()));
    }
    all.push(("controller", controller(spec, u, x, dt)));
    all
}

/// The command's rate against what the controller makes of demand and position: the integrator's start does not count.
fn controller(spec: &MachineSpec, u: &[f64], x: &[f64], dt: f64) -> Vec<f64> {
    let c = &spec.controller;
    let error = |bin: usize| {
        let bin = bin % BINS;
        spec.cycle.demand_m((bin as f64 + 0.5) * dt) - x[bin]
    };
    (0..BINS)
        .map(|bin| {
            let (next, before) = (bin + 1, bin + BINS - 1);
            let rate = (u[next % BINS] - u[before % BINS]) / (2.0 * dt);
            rate - c.kp * (error(next) - error(before)) / (2.0 * dt) - c.ki * error(bin)
        })
        .collect()
}

/// Where the recorded machine's balances differ from the simulated one's.
pub fn places(record: &Record, retuned: &MachineSpec, recorded: &View, simulated: &View) -> Vec<Place> {
    let phase = phases(retuned);
    let difference =
        |signal: usize, bin: usize| (recorded[signal][bin] - simulated[signal][bin]) / record.range[signal];
    let mut found: Vec<Place> = Vec::new();
    let pairs = imbalances(record, retuned, recorded).into_iter().zip(imbalances(record, retuned, simulated));
    for ((equation, a), (_, b)) in pairs {
        for (number, name) in PHASES.iter().enumerate() {
            let bins = || (0..BINS).filter(|bin| phase[*bin] == number);
            let share: f64 = bins().map(|bin| (a[bin] - b[bin]).powi(2)).sum();
            let shown = |signal: usize| bins().map(|bin| difference(signal, bin).powi(2)).sum::<f64>();
            let most = (0..record.signals.len()).max_by(|a, b| shown(*a).total_cmp(&shown(*b)));
            let signal = most.map_or("command", |index| record.signals[index].name());
            if share > 0.0 {
                found.push(Place { equation, phase: name, signal, share });
            }
        }
    }
    let sum: f64 = found.iter().map(|place| place.share).sum();
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    found.truncate(TOLD);
    let told: f64 = found.iter().map(|place| place.share).sum();
    let scale = if sum > 0.0 { 1.0 / told } else { 0.0 };
    for place in &mut found {
        place.share *= scale;
    }
    found
}
