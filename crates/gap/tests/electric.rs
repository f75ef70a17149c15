//! The diagnosis on a simulated electric axis: the method does not know the press.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use seepd_gap::report::{Diagnosis, Verdict};
use seepd_gap::{DiagnosisSettings, Log, Mismatch, Record, RecordError, diagnose};
use seepd_signals::Signal;
use seepd_sim::cycle::{DriveSample, Schedule};
use seepd_sim::electric::ElectricAxis;
use seepd_sim::noise::Noise;

fn plan() -> ElectricAxis {
    ElectricAxis::from_toml(include_str!("../../../docs/electric-axis.toml")).unwrap()
}

/// What such an axis logs: noise of 1e-3 of full command, 5e-8 m of position.
fn log_of(axis: &ElectricAxis, cycles: usize) -> Log {
    let ticks = (axis.cycle.period_s / axis.controller.period_s).round() as usize;
    let schedule = Schedule::new(&axis.cycle, axis.controller.period_s, Vec::new());
    let drive: Vec<DriveSample> = schedule.take(ticks * (cycles + 1)).collect();
    let mut noise = Noise::new(1, 5);
    let mut log = Log::default();
    axis.follow(&drive, |tick, record| {
        if tick >= ticks {
            log.values[Signal::Command as usize].push(record.command + noise.normal(1e-3));
            log.values[Signal::Position as usize].push(record.position_m + noise.normal(5e-8));
            log.values[Signal::Demand as usize].push(drive[tick].demand_m);
        }
    });
    log
}

fn diagnosed(machine: &ElectricAxis, cycles: usize) -> (Diagnosis, ElectricAxis) {
    let record = Record::new(&log_of(machine, cycles), &plan()).unwrap();
    diagnose(&record, &plan(), &DiagnosisSettings::default(), &mut |_| ())
}

/// The plan's axis with effects given as `effect.parameter=value`.
fn with(effects: &[(&str, &str, f64)]) -> ElectricAxis {
    let mut axis = plan();
    for (effect, parameter, value) in effects {
        axis.effects.entry((*effect).into()).or_default().insert((*parameter).into(), *value);
    }
    axis
}

#[test]
fn coulomb_friction_then_the_offset_are_named_and_sized() {
    let machine = with(&[("coulomb_friction", "force_n", 20.4), ("force_offset", "force_n", 3.16)]);
    let (found, as_it_is) = diagnosed(&machine, 12);
    assert_eq!((found.verdict, &found.chosen), (Verdict::Effect, &vec!["coulomb_friction", "force_offset"]));
    for (effect, planted) in [("coulomb_friction", 20.4), ("force_offset", 3.16)] {
        let value = as_it_is.effects[effect]["force_n"];
        assert!((value / planted - 1.0).abs() < 0.03, "{effect}: {value}");
        let finding = found.effects.iter().find(|finding| finding.effect == effect).unwrap();
        let [low, high] = finding.interval95["force_n"];
        assert!(low <= planted && planted <= high, "{effect}: {low} … {high}");
    }
    assert!(found.shrink.of_removable > 0.95, "{:?}", found.shrink);
    // Shapley's parts and calibration add up to the whole.
    let parts: f64 = found.shrink.by_effect.values().sum();
    assert!((parts + found.shrink.calibration_only - found.shrink.of_removable).abs() < 1e-9);
    assert!(found.shrink.by_effect["coulomb_friction"] > found.shrink.by_effect["force_offset"]);
}

#[test]
fn each_effect_is_named_within_its_class() {
    type Planted<'a> = &'a [(&'a str, &'a str, f64)];
    let cases: [(Planted<'_>, &[&str]); 4] = [
        (&[("coulomb_friction", "force_n", 15.0)], &["coulomb_friction"]),
        (&[("force_offset", "force_n", -8.0)], &["force_offset"]),
        (&[("asymmetric_friction", "difference_n", 12.0)], &["asymmetric_friction"]),
        (
            &[("position_friction", "force_n", 20.0), ("position_friction", "slope_n_per_m", 100.0)],
            &["position_friction"],
        ),
    ];
    for (planted, named) in cases {
        let (found, _) = diagnosed(&with(planted), 12);
        assert_eq!(found.verdict, Verdict::Effect, "{planted:?}: {:?}", found.reason);
        assert_eq!(found.chosen, named, "{planted:?}");
    }
}

#[test]
fn other_parameters_are_no_effect_and_the_plan_has_no_gap() {
    let mut machine = plan();
    machine.plant.mass_kg *= 1.2;
    machine.plant.viscous_friction_n_s_per_m *= 0.7;
    let (found, as_it_is) = diagnosed(&machine, 12);
    assert_eq!(found.verdict, Verdict::Parameters, "{:?}", found.reason);
    assert!((as_it_is.plant.mass_kg / machine.plant.mass_kg - 1.0).abs() < 0.01);
    assert_eq!(diagnosed(&plan(), 12).0.verdict, Verdict::NoGap);
}

#[test]
fn an_inverted_command_is_told() {
    let mut log = log_of(&plan(), 4);
    log.values[Signal::Command as usize].iter_mut().for_each(|value| *value = -*value);
    let error = Record::new(&log, &plan()).unwrap_err();
    assert!(
        matches!(&error, RecordError::Mismatch(Mismatch::Contradiction(what)) if what.contains("sign is inverted")),
        "{error}"
    );
}
