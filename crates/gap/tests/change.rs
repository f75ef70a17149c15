//! A machine that changes within its log is diagnosed as it is in the end, and what it was before is told.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use seepd_gap::course::ChangeKind;
use seepd_gap::report::Diagnosis;
use seepd_gap::{DiagnosisSettings, Log, Record, diagnose};
use seepd_signals::Signal;
use seepd_sim::MachineSpec;
use seepd_sim::cycle::{CycleRun, Schedule};
use seepd_sim::machine::{Input, Machine};
use seepd_sim::noise::Noise;

/// A log of cycles, each of a machine with that effect at that value.
fn log(effect: &str, values: impl Iterator<Item = f64>) -> Log {
    let mut log = Log::default();
    let mut noise = Noise::new(3, 1);
    let mut last: Option<(f64, Vec<[f64; 5]>)> = None;
    for value in values {
        if last.as_ref().is_none_or(|(of, _)| *of != value) {
            last = Some((value, cycle(effect, value)));
        }
        for [command, demand, position, p_cap, p_rod] in &last.as_ref().unwrap().1 {
            let signals = [
                (Signal::Command, command + noise.normal(1e-3)),
                (Signal::Demand, *demand),
                (Signal::Position, position + noise.normal(1e-5)),
                (Signal::PCap, p_cap + noise.normal(2e4)),
                (Signal::PRod, p_rod + noise.normal(2e4)),
            ];
            signals.into_iter().for_each(|(signal, value)| log.values[signal as usize].push(value));
        }
    }
    log
}

/// One cycle of a machine that has run one before.
fn cycle(effect: &str, value: f64) -> Vec<[f64; 5]> {
    let mut spec = MachineSpec::default();
    spec.plant.leak_area_m2 = 3e-7;
    if value > 0.0 {
        spec.set_effect(&format!("{effect}={value}")).unwrap();
    }
    let machine = Machine::<f64>::new(&[&spec]);
    let mut state = machine.start();
    let runs = vec![CycleRun::with_leak(spec.plant.leak_area_m2)];
    let schedule = Schedule::new(&spec.cycle, spec.controller.period_s, runs);
    let ticks = schedule.take(20_000).map(|sample| {
        let shown = machine.tick(&mut state, &Input::gather(&[sample]));
        [shown.command, shown.demand, shown.position, shown.p_cap, shown.p_rod]
    });
    ticks.skip(10_000).collect()
}

fn diagnosed(log: &Log) -> Diagnosis {
    let spec = MachineSpec::default();
    let record = Record::new(log, &spec).unwrap();
    diagnose(&record, &spec, &DiagnosisSettings::default(), &mut |_| ()).0
}

#[test]
fn friction_from_the_13th_of_24_cycles_is_sized_from_there_on() {
    let force = |cycle: u32| if cycle < 12 { 0.0 } else { 1500.0 };
    let found = diagnosed(&log("coulomb_friction.force_n", (0..24).map(force)));
    let change = found.change.as_ref().unwrap();
    assert_eq!((change.kind, change.from_cycle), (ChangeKind::Step, 13));
    assert_eq!(found.chosen, ["coulomb_friction"]);
    let force_n = found.effects[0].parameters["force_n"];
    assert!((force_n - 1500.0).abs() < 60.0, "{force_n}");
    let before_n = change.before["coulomb_friction"]["force_n"];
    assert!(before_n < 60.0, "{before_n}");
    assert!(found.shrink.of_removable > 0.9, "{:?}", found.shrink);
}

#[test]
fn a_dead_band_that_grows_is_a_drift() {
    let width = |cycle: u32| 0.005 + 0.05 * f64::from(cycle) / 35.0;
    let found = diagnosed(&log("valve_deadband.half_width", (0..36).map(width)));
    let change = found.change.as_ref().unwrap();
    assert_eq!((change.kind, change.from_cycle), (ChangeKind::Drift, 25));
    assert_eq!(found.chosen, ["valve_deadband"]);
    let (end, beginning) =
        (found.effects[0].parameters["half_width"], change.before["valve_deadband"]["half_width"]);
    // The means of the last and of the first twelve.
    assert!((end - 0.0472).abs() < 0.004 && (beginning - 0.0129).abs() < 0.004, "{beginning} {end}");
}

#[test]
fn a_machine_that_stays_as_it_is_has_no_change() {
    let record = |log: &Log| Record::new(log, &MachineSpec::default()).unwrap();
    let log = log("coulomb_friction.force_n", std::iter::repeat_n(800.0, 24));
    let settings = DiagnosisSettings { fitted: 1, iterations: 1, ..DiagnosisSettings::default() };
    let (found, _) = diagnose(&record(&log), &MachineSpec::default(), &settings, &mut |_| ());
    assert_eq!(found.change, None);
}
