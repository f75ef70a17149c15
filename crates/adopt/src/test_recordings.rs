//! Recordings of the simulated press with command, demand and position, for tests.

use seepd_gap::Log;
use seepd_signals::Signal;
use seepd_sim::noise::Noise;
use seepd_sim::{Input, Machine, MachineSpec, Schedule};

use crate::adoption::{Adoption, adopt};
use crate::duty_cycle::find_duty_cycle;
use crate::machine_data::MachineData;
use crate::recording::Recording;

pub(crate) const TICK_S: f64 = 1e-3;
pub(crate) const TICKS_OF_CYCLE: usize = 10_000;
const CYCLES: usize = 8;

/// The nominal press without a load, in steps as short as it needs.
pub(crate) fn press() -> MachineSpec {
    let mut spec = MachineSpec::default();
    spec.plant.inlet_volume_m3 *= 4.0;
    spec.controller.steps_per_period = 4;
    spec.cycle.load.clear();
    spec
}

/// Eight cycles of a machine after its first, at 1 kHz, as transducers have them.
pub(crate) fn recorded(spec: &MachineSpec) -> Recording {
    let machine = Machine::<f64>::new(&[spec]);
    let mut state = machine.start();
    let mut noise = Noise::new(5, 1);
    let mut log = Log::default();
    let drive = Schedule::new(&spec.cycle, TICK_S, Vec::new());
    for sample in drive.take((CYCLES + 1) * TICKS_OF_CYCLE) {
        let signals = machine.tick(&mut state, &Input::gather(&[sample]));
        log.values[Signal::Command as usize].push(signals.command + noise.normal(1e-3));
        log.values[Signal::Demand as usize].push(signals.demand);
        log.values[Signal::Position as usize].push(signals.position + noise.normal(1e-5));
    }
    for values in &mut log.values {
        values.drain(..TICKS_OF_CYCLE.min(values.len()));
    }
    Recording { rate_hz: 1000.0, log, beyond: 0 }
}

/// The nominal press's data sheet; what follows it is of the valve.
const DATA_SHEET: &str = "[cylinder]\nbore_mm = 63\nrod_mm = 36\nstroke_mm = 500\nmoved_mass_kg = 250\n\
                          [supply]\npump_flow_lpm = 90\nrelief_bar = 160\nreturn_bar = 1\n\
                          [valve]\nrated_flow_lpm = 96\nrated_at_bar = 70\n";

/// A machine adopted from its recording and the nominal press's data sheet with more of its valve.
pub(crate) fn adopted(truth: &MachineSpec, of_valve: &str) -> Adoption {
    let recording = recorded(truth);
    let found = find_duty_cycle(&recording, 0.0).unwrap();
    let data = MachineData::from_toml(&format!("{DATA_SHEET}{of_valve}")).unwrap();
    adopt(&recording, &found, &data).unwrap()
}
