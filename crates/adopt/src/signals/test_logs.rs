//! Logs of the simulated press, as others would have written them.

use std::sync::OnceLock;

use seepd_logs::columns::{Column, Columns};
use seepd_signals::Signal;
use seepd_sim::cycle::CycleRun;
use seepd_sim::noise::Noise;
use seepd_sim::{Input, Machine, MachineSpec, Schedule, SimulatedSignals};

/// Cycles of a log.
const CYCLES: usize = 4;
/// Noise of transducers, share of what is full for each.
const NOISE: f64 = 5e-4;

/// The default press at 1 kHz, without its warm-up.
pub(super) fn press() -> &'static [SimulatedSignals<f64>] {
    static PRESS: OnceLock<Vec<SimulatedSignals<f64>>> = OnceLock::new();
    PRESS.get_or_init(|| simulated(&MachineSpec::default()))
}

/// A machine's log.
pub(super) fn simulated(spec: &MachineSpec) -> Vec<SimulatedSignals<f64>> {
    let machine = Machine::<f64>::new(&[spec]);
    let mut state = machine.start();
    let runs = vec![CycleRun::with_leak(2e-8)];
    let schedule = Schedule::new(&spec.cycle, spec.controller.period_s, runs);
    let cycle = (spec.cycle.period_s / spec.controller.period_s) as usize;
    let samples = schedule.map(|sample| machine.tick(&mut state, &Input::gather(&[sample])));
    samples.skip(cycle).take(CYCLES * cycle).collect()
}

/// A simulated signal with what a transducer adds.
pub(super) fn measured(log: &[SimulatedSignals<f64>], signal: Signal) -> Vec<f64> {
    let mut noise = Noise::new(7, signal as u64);
    let (value, full): (fn(&SimulatedSignals<f64>) -> f64, f64) = match signal {
        Signal::Command => (|at| at.command, 1.0),
        Signal::Demand => (|at| at.demand, 0.0),
        Signal::Position => (|at| at.position, 0.5),
        Signal::PSupply => (|at| at.p_supply, 250e5),
        Signal::PInlet => (|at| at.p_inlet, 250e5),
        Signal::PCap => (|at| at.p_cap, 250e5),
        Signal::PRod => (|at| at.p_rod, 250e5),
        Signal::Load => (|at| at.load, 20e3),
        Signal::CycleStart => (|_| 0.0, 0.0),
    };
    log.iter().map(|at| value(at) + noise.normal(NOISE * full)).collect()
}

/// A column of that name, with the unit that a log's reader finds in it.
pub(super) fn column(field: &str, unit: Option<&str>, values: impl Iterator<Item = f64>) -> Column {
    let values = values.map(|value| value as f32).collect();
    Column { topic: String::new(), field: field.into(), unit: unit.map(str::to_owned), values }
}

/// A log of these columns at 1 kHz.
pub(super) fn log(columns: Vec<Column>) -> Columns {
    Columns { start_ns: 0, rate_hz: 1000.0, columns, time: None, notes: Vec::new() }
}
