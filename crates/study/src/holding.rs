//! The largest leak at which the controller still holds position, by a sweep.

use rayon::prelude::*;
use seepd_sim::{MachineSpec, SimulatedSignals};
use serde::Serialize;

use crate::cycles::{LPM_PER_M3_PER_S, orifice_lpm, settled};
use crate::geometric;

/// Leaks of the sweep, m².
const SWEPT_M2: (f64, f64) = (1e-7, 1e-4);
const SWEPT: usize = 31;
/// Halvings of the last interval, in equal ratios.
const HALVINGS: usize = 12;
/// A hold is looked at over its last part, s.
const HOLD_END_S: f64 = 0.3;
/// Position counts as held to accuracy while no hold ends this much farther from its demand than without a leak, m.
pub const ACCURATE_WITHIN_M: f64 = 1e-3;
/// The article's largest leak, L/min.
pub const ARTICLE_LPM: f64 = 0.6;

/// The sweep.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Holding {
    /// The leaks.
    pub sweep: Vec<Hold>,
    /// The largest leak at which every hold ends within [`ACCURATE_WITHIN_M`] of where it ends without a leak.
    pub accurate: Hold,
    /// The largest leak at which the command stays within its range, so that the controller still has a say.
    pub in_control: Hold,
    /// The holds at the area that passes the article's 0.6 L/min at the reference pressure difference.
    pub article: Hold,
}

/// How a leak is held.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Hold {
    /// Leak area, m².
    pub leak_area_m2: f64,
    /// The orifice at the reference pressure difference, L/min.
    pub orifice_lpm: f64,
    /// Largest |flow| past the piston at the holds' ends, L/min.
    pub flow_lpm: f64,
    /// How much farther from its demand than without a leak a hold ends, m: the worst of the holds.
    pub added_error_m: f64,
    /// Largest |command|.
    pub largest_command: f64,
}

/// Sweeps the leak and finds the largest ones that are held.
pub(crate) fn sweep(spec: &MachineSpec) -> Holding {
    let healthy = hold_errors_m(spec, &settled(spec, 0.0));
    let at = |leak_area_m2: f64| hold(spec, leak_area_m2, &healthy);
    let areas = geometric(SWEPT_M2.0, SWEPT_M2.1, SWEPT);
    let sweep: Vec<Hold> = areas.par_iter().map(|area| at(*area)).collect();
    Holding {
        accurate: largest(&sweep, &at, &|hold| hold.added_error_m <= ACCURATE_WITHIN_M),
        in_control: largest(&sweep, &at, &|hold| hold.largest_command < 1.0),
        article: at(ARTICLE_LPM / orifice_lpm(spec, 1.0)),
        sweep,
    }
}

/// The largest leak for which all smaller ones of the sweep are held, by halving the last interval.
fn largest(sweep: &[Hold], at: &dyn Fn(f64) -> Hold, held: &dyn Fn(&Hold) -> bool) -> Hold {
    let lost = sweep.iter().position(|hold| !held(hold)).unwrap_or(sweep.len());
    let mut best = sweep[lost.saturating_sub(1)].clone();
    if let Some(first_lost) = sweep.get(lost) {
        let mut above_m2 = first_lost.leak_area_m2;
        for _ in 0..HALVINGS {
            let middle = at((best.leak_area_m2 * above_m2).sqrt());
            if held(&middle) {
                best = middle;
            } else {
                above_m2 = middle.leak_area_m2;
            }
        }
    }
    best
}

/// Ticks of the holds' ends: each ends where the next move begins, the last one with the cycle.
fn hold_ends(spec: &MachineSpec, ticks: usize) -> Vec<std::ops::Range<usize>> {
    let period_s = spec.controller.period_s;
    let ends = spec.cycle.moves.iter().map(|stroke| stroke.from_s).chain([spec.cycle.period_s]);
    ends.map(|end_s| {
        let end = ((end_s / period_s).round() as usize).min(ticks);
        end.saturating_sub((HOLD_END_S / period_s) as usize)..end
    })
    .collect()
}

/// Largest |demand − position| at the end of each hold, m.
fn hold_errors_m(spec: &MachineSpec, records: &[SimulatedSignals<f64>]) -> Vec<f64> {
    let error = |record: &SimulatedSignals<f64>| (record.demand - record.position).abs();
    let ends = hold_ends(spec, records.len());
    ends.into_iter().map(|range| records[range].iter().map(error).fold(0.0, f64::max)).collect()
}

fn hold(spec: &MachineSpec, leak_area_m2: f64, healthy_m: &[f64]) -> Hold {
    let records = settled(spec, leak_area_m2);
    let errors = hold_errors_m(spec, &records);
    let flow = |record: &SimulatedSignals<f64>| record.leak_flow.abs() * LPM_PER_M3_PER_S;
    let holding = hold_ends(spec, records.len()).into_iter().flat_map(|range| &records[range]);
    Hold {
        leak_area_m2,
        orifice_lpm: orifice_lpm(spec, leak_area_m2),
        flow_lpm: holding.map(flow).fold(0.0, f64::max),
        added_error_m: errors.iter().zip(healthy_m).map(|(now, healthy)| now - healthy).fold(0.0, f64::max),
        largest_command: records.iter().map(|record| record.command.abs()).fold(0.0, f64::max),
    }
}
