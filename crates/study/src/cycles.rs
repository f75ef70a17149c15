//! Whole cycles of the press with leaks: demand and load (figure 2), command (figure 5), leak rate (figure 6).

use rayon::prelude::*;
use seepd_sim::cycle::CycleRun;
use seepd_sim::{Input, Machine, MachineSpec, Schedule, SimulatedSignals};
use serde::Serialize;

use crate::{AREAS_M2, geometric};

/// L/min in a m³/s.
pub(crate) const LPM_PER_M3_PER_S: f64 = 60_000.0;
/// Pressure difference at which a leak's area is given as a flow, Pa.
pub const REFERENCE_DP_PA: f64 = 7e6;
/// Leaks whose commands are drawn, m².
const DRAWN_M2: [f64; 6] = [0.0, 1e-7, 5e-7, 1e-6, 3e-6, 1e-5];
/// Every so many samples are drawn.
const DRAWN_EVERY: usize = 20;
/// Leaks of figure 6.
const RATES: usize = 25;
/// Warm-up cycles before the one that is looked at.
const WARM_UP: usize = 1;

/// The curves of one cycle.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CycleCurve {
    /// Leak area, m².
    pub leak_area_m2: f64,
    /// Time in the cycle, s.
    pub t_s: Vec<f64>,
    /// Demand, m.
    pub demand_m: Vec<f64>,
    /// Position, m.
    pub position_m: Vec<f64>,
    /// Load, N.
    pub load_n: Vec<f64>,
    /// Valve command, share of full command.
    pub command: Vec<f64>,
}

/// What a leak passes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LeakRate {
    /// Leak area, m².
    pub leak_area_m2: f64,
    /// Mean of |flow| over a cycle, L/min.
    pub mean_lpm: f64,
    /// Largest |flow| in a cycle, L/min.
    pub peak_lpm: f64,
    /// The orifice at the reference pressure difference, L/min.
    pub orifice_lpm: f64,
}

/// A settled cycle of the machine with a leak, tick by tick.
pub(crate) fn settled(spec: &MachineSpec, leak_area_m2: f64) -> Vec<SimulatedSignals<f64>> {
    let machine = Machine::<f64>::new(&[spec]);
    let mut state = machine.start();
    let schedule =
        Schedule::new(&spec.cycle, spec.controller.period_s, vec![CycleRun::with_leak(leak_area_m2)]);
    let mut records = Vec::new();
    for sample in schedule.take_while(|sample| sample.run <= WARM_UP) {
        let record = machine.tick(&mut state, &Input::gather(&[sample]));
        if sample.run == WARM_UP {
            records.push(record);
        }
    }
    records
}

/// Figures 2 and 5.
pub(crate) fn curves(spec: &MachineSpec) -> Vec<CycleCurve> {
    let of = |leak_area_m2: f64| {
        let records: Vec<SimulatedSignals<f64>> =
            settled(spec, leak_area_m2).into_iter().step_by(DRAWN_EVERY).collect();
        let signal = |pick: &dyn Fn(&SimulatedSignals<f64>) -> f64| records.iter().map(pick).collect();
        CycleCurve {
            leak_area_m2,
            t_s: (0..records.len()).map(|k| (k * DRAWN_EVERY) as f64 * spec.controller.period_s).collect(),
            demand_m: signal(&|record| record.demand),
            position_m: signal(&|record| record.position),
            load_n: signal(&|record| record.load),
            command: signal(&|record| record.command),
        }
    };
    DRAWN_M2.par_iter().map(|area| of(*area)).collect()
}

/// Figure 6.
pub(crate) fn leak_rates(spec: &MachineSpec) -> Vec<LeakRate> {
    let of = |leak_area_m2: f64| {
        let flows: Vec<f64> = settled(spec, leak_area_m2)
            .iter()
            .map(|record| record.leak_flow.abs() * LPM_PER_M3_PER_S)
            .collect();
        LeakRate {
            leak_area_m2,
            mean_lpm: flows.iter().sum::<f64>() / flows.len() as f64,
            peak_lpm: flows.iter().copied().fold(0.0, f64::max),
            orifice_lpm: orifice_lpm(spec, leak_area_m2),
        }
    };
    geometric(AREAS_M2.0, AREAS_M2.1, RATES).par_iter().map(|area| of(*area)).collect()
}

/// Flow of an area at the reference pressure difference, L/min: C_d A √(2 Δp / ρ).
pub(crate) fn orifice_lpm(spec: &MachineSpec, leak_area_m2: f64) -> f64 {
    spec.plant.orifice_flow_m3_per_s(leak_area_m2, REFERENCE_DP_PA) * LPM_PER_M3_PER_S
}
