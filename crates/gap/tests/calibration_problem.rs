//! The gap as a least-squares problem: what a solver of others sees is what the diagnosis sees.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use seepd_gap::{
    CalibrationProblem, Log, NoSuchParameter, ParameterValues, Record, SimulatedAxis, nominal_gap,
};
use seepd_signals::Signal;
use seepd_sim::cycle::{DriveSample, Schedule};
use seepd_sim::electric::ElectricAxis;
use seepd_sim::noise::Noise;

fn plan() -> ElectricAxis {
    ElectricAxis::from_toml(include_str!("../../../docs/electric-axis.toml")).unwrap()
}

/// The problem that the log of a machine is, against the plan; the catalogue lacks what `without` names.
fn problem(machine: &ElectricAxis, without: &[&str]) -> CalibrationProblem<ElectricAxis> {
    let plan = plan();
    let ticks = (plan.cycle.period_s / plan.controller.period_s).round() as usize;
    let schedule = Schedule::new(&plan.cycle, plan.controller.period_s, Vec::new());
    let drive: Vec<DriveSample> = schedule.take(ticks * 13).collect();
    let (mut log, mut noise) = (Log::default(), Noise::new(1, 5));
    machine.follow(&drive, |tick, signals| {
        if tick >= ticks {
            log.values[Signal::Command as usize].push(signals.command + noise.normal(1e-3));
            log.values[Signal::Position as usize].push(signals.position_m + noise.normal(5e-8));
            log.values[Signal::Demand as usize].push(drive[tick].demand_m);
        }
    });
    let without: Vec<String> = without.iter().map(|effect| (*effect).to_owned()).collect();
    CalibrationProblem::new(Record::new(&log, &plan).unwrap(), plan, &without)
}

fn values(of: &[(&str, f64)]) -> ParameterValues {
    of.iter().map(|(key, value)| ((*key).to_owned(), *value)).collect()
}

/// Sum of squares over the 60 independent values that each of the two signals counts for.
fn misfit(row: &[f64]) -> f64 {
    row.iter().map(|value| value * value).sum::<f64>() / 120.0
}

const FRICTION: &str = "coulomb_friction.force_n";

/// A machine with the planted friction leaves less than a perfect model may; without it, and with twice as much, tens of times as much.
#[test]
fn squares_are_least_at_what_was_planted() {
    let mut machine = plan();
    machine.effects.entry("coulomb_friction".into()).or_default().insert("force_n".into(), 20.0);
    let problem = problem(&machine, &[]);
    let machines: Vec<ElectricAxis> = [0.0, 19.0, 20.0, 21.0, 40.0]
        .map(|force_n| problem.with(&values(&[(FRICTION, force_n)])).unwrap())
        .into();
    let left: Vec<f64> = problem.residuals(&machines).iter().map(|row| misfit(row)).collect();
    assert!(left[2] < 1.0, "{left:?}");
    assert!(left[1] > left[2] && left[3] > left[2], "{left:?}");
    assert!(left[0] > 30.0 * left[2] && left[4] > 30.0 * left[2], "{left:?}");
    // A row has a place for each drive, signal and bin, as has what was recorded and what is simulated.
    let (recorded, simulated) = (problem.recorded(), problem.simulated(&machines[2..3]));
    assert_eq!((recorded.len(), problem.drives().len()), (simulated.len(), simulated.len()));
    assert_eq!(recorded[0].len(), 2);
    let bins = recorded[0][0].len();
    assert_eq!(problem.residuals(&machines[..1])[0].len(), recorded.len() * 2 * bins);
    let position = problem.machine().signals().iter().position(|signal| *signal == Signal::Position).unwrap();
    let off = recorded[0][1].iter().zip(&simulated[0][0][position]).map(|(a, b)| (a - b).abs());
    assert!(off.fold(0.0, f64::max) < 1e-6, "the planted machine is where the log says");
}

#[test]
fn held_out_gaps_are_those_of_the_diagnosis() {
    let problem = problem(&plan(), &[]);
    let gaps = problem.held_out_gaps(std::slice::from_ref(problem.machine())).swap_remove(0);
    // Nothing wears in this axis: its gap with wear fitted is its gap.
    let of_diagnosis = nominal_gap(problem.record(), problem.machine());
    assert_eq!(gaps, of_diagnosis);
}

#[test]
fn parameters_have_bounds_and_priors_and_effects_that_are_left_out_have_none() {
    let problem = problem(&plan(), &["coulomb_friction"]);
    let parameters = problem.parameters();
    assert!(parameters.iter().all(|parameter| parameter.bounds.0 < parameter.bounds.1));
    let mass = parameters.iter().find(|parameter| parameter.key == "mass_kg").unwrap();
    assert!(
        mass.effect.is_none()
            && mass.sigma.is_some()
            && mass.bounds.0 < mass.value
            && mass.value < mass.bounds.1
    );
    let of_effect = parameters.iter().find(|parameter| parameter.key == "force_offset.force_n").unwrap();
    assert_eq!((of_effect.effect, of_effect.sigma, of_effect.value), (Some("force_offset"), None, 0.0));
    assert!(!parameters.iter().any(|parameter| parameter.key == FRICTION));
    let refused = problem.with(&values(&[(FRICTION, 1.0)])).unwrap_err();
    assert_eq!(refused, NoSuchParameter(FRICTION.into()));
}

#[test]
fn values_are_held_within_their_bounds() {
    let problem = problem(&plan(), &[]);
    for beyond in [1e9, -1e9, f64::NAN] {
        let machine = problem.with(&values(&[("mass_kg", beyond), (FRICTION, beyond)])).unwrap();
        for parameter in
            problem.parameters().iter().filter(|p| ["mass_kg", FRICTION].contains(&p.key.as_str()))
        {
            let value = match parameter.effect {
                Some(effect) => machine.effects[effect]["force_n"],
                None => machine.parameter(&parameter.key),
            };
            let (low, high) = parameter.bounds;
            assert!(low <= value && value <= high, "{}: {beyond} became {value}", parameter.key);
        }
    }
}
