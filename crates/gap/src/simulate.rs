//! Machines simulated along a recorded drive, closed loop, and what they show in bins.

use rayon::prelude::*;
use seepd_signals::Signal;
use seepd_sim::MachineSpec;
use seepd_sim::Record as Tick;
use seepd_sim::batch::follow;
use seepd_sim::cycle::Instant;
use seepd_sim::real::{LANES, Lanes};

use crate::record::{BINS, bin_of};

/// What a machine shows: mean of each signal in each bin.
pub type View = Vec<Vec<f64>>;

/// Simulates each machine over the drive, after a warm-up with the end of the same drive, and bins its signals. A simulation that goes out of
/// bounds shows NaN.
pub fn views(machines: &[MachineSpec], drive: &[Instant], signals: &[Signal]) -> Vec<View> {
    let ticks = drive.len();
    let warm_up = &drive[last_stroke(drive)..];
    let driven: Vec<Instant> = warm_up.iter().chain(drive).copied().collect();
    machines
        .par_chunks(LANES)
        .flat_map_iter(|machines| {
            let mut sums = vec![vec![[0.0; LANES]; BINS]; signals.len()];
            let mut counts = vec![0u32; BINS];
            follow(machines, &driven, |tick, record| {
                let Some(tick) = tick.checked_sub(warm_up.len()) else { return };
                let bin = bin_of(tick, ticks);
                counts[bin] += 1;
                for (signal, sums) in signals.iter().zip(&mut sums) {
                    for (sum, value) in sums[bin].iter_mut().zip(of(record, *signal).0) {
                        *sum += value;
                    }
                }
            });
            let view = |lane: usize| -> View {
                let mean = |bins: &Vec<[f64; LANES]>| {
                    bins.iter()
                        .zip(&counts)
                        .map(|(sum, count)| sum[lane] / f64::from((*count).max(1)))
                        .collect()
                };
                sums.iter().map(mean).collect()
            };
            (0..machines.len()).map(view).collect::<Vec<View>>()
        })
        .collect()
}

/// Where a warm-up begins: before the last stroke, which wipes out how a machine was started. From there the command is within 5e-5 of
/// its range of what it is after a whole cycle, on the default duty cycle.
fn last_stroke(drive: &[Instant]) -> usize {
    let demands = || drive.iter().map(|instant| instant.demand_m);
    let (low, high) = demands().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
    let end = demands().next_back().unwrap_or(0.0);
    let (mut least, mut most) = (end, end);
    for (tick, demand) in demands().enumerate().rev() {
        (least, most) = (least.min(demand), most.max(demand));
        if most - least > STROKE * (high - low) {
            return tick.saturating_sub(drive.len() / REST_BEFORE);
        }
    }
    0
}

/// Share of the demand's range that makes a stroke.
const STROKE: f64 = 0.95;
/// A warm-up begins this part of a cycle before the stroke.
const REST_BEFORE: usize = 20;

fn of(record: &Tick<Lanes>, signal: Signal) -> Lanes {
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
