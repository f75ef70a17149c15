//! The catalogue of effects: complete, documented, neutral at neutral, and recoverable. Each test walks it.

use std::collections::BTreeSet;
use std::path::Path;

use seepd_sim::batch::{Job, run_lanes};
use seepd_sim::cycle::Turn;
use seepd_sim::effects::{self, Effect};
use seepd_sim::{Input, Machine, MachineSpec, Schedule};

fn with(effect: &dyn Effect, values: &[f64]) -> MachineSpec {
    let mut spec = MachineSpec::default();
    let table = spec.effects.entry(effect.key().into()).or_default();
    for (parameter, value) in effect.parameters().iter().zip(values) {
        table.insert(parameter.name.into(), *value);
    }
    spec
}

/// Command and position of a whole cycle after a warm-up of the same length.
fn cycle(spec: &MachineSpec) -> Vec<[f64; 2]> {
    let machine = Machine::<f64>::new(&[spec]);
    let mut state = machine.start();
    Schedule::new(&spec.cycle, spec.controller.period_s, vec![Turn::with_leak(1e-6)])
        .take(20_000)
        .map(|instant| machine.tick(&mut state, &Input::gather(&[instant])))
        .map(|record| [record.command, record.position])
        .skip(10_000)
        .collect()
}

#[test]
fn property_catalogue_is_complete_and_documented() {
    let keys: BTreeSet<&str> = effects::ALL.iter().map(|effect| effect.key()).collect();
    assert_eq!(keys.len(), effects::ALL.len(), "keys are unique");
    for effect in effects::ALL {
        assert!(effect.key().chars().all(|c| c.is_ascii_lowercase() || c == '_'));
        assert!(effect.law_text().len() > 10 && effect.signature().len() > 20, "{}", effect.key());
        for parameter in effect.parameters() {
            let (low, high) = parameter.range;
            assert!(low < high && parameter.source.len() > 10, "{}.{}", effect.key(), parameter.name);
        }
    }
    // The direction in which one forgets: a file that is not in the catalogue.
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/effects");
    for file in std::fs::read_dir(folder).unwrap() {
        let name = file.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned();
        assert!(name == "mod" || keys.contains(name.as_str()), "{name} is not in the catalogue");
    }
}

#[test]
fn neutral_values_leave_every_bit() {
    let nominal = cycle(&MachineSpec::default());
    for effect in effects::ALL {
        let neutral: Vec<f64> = effect.parameters().iter().map(|parameter| parameter.neutral).collect();
        let same = cycle(&with(*effect, &neutral));
        let bits =
            |cycle: &[[f64; 2]]| cycle.iter().flatten().map(|value| value.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&nominal), bits(&same), "{}", effect.key());
    }
}

/// A neutral lane beside one with the effect keeps the nominal bits: its law is there and must do nothing.
#[test]
fn neutral_lane_beside_an_acting_one_leaves_every_bit() {
    let nominal = cycle(&MachineSpec::default());
    for effect in effects::ALL {
        let strong: Vec<f64> =
            effect.parameters().iter().map(|p| p.range.0 + 0.5 * (p.range.1 - p.range.0)).collect();
        let jobs = [with(*effect, &strong), MachineSpec::default()].map(|spec| Job {
            spec,
            turns: vec![Turn::with_leak(1e-6)],
            skip_ticks: 10_000,
            record_ticks: 10_000,
        });
        let mut neutral = Vec::new();
        run_lanes(&jobs, |lane, record| {
            if lane == 1 {
                neutral.push(record.command.0[1].to_bits());
            }
        });
        let expected: Vec<u64> = nominal.iter().map(|sample| sample[0].to_bits()).collect();
        assert_eq!(expected, neutral, "{}", effect.key());
    }
}

/// Each parameter, planted alone at a third of its range, comes back from command and position to 1 % by
/// minimising the distance over that parameter: the law acts, is continuous, and is not flat.
#[test]
fn recover_each_parameter_alone() {
    for effect in effects::ALL {
        for (index, parameter) in effect.parameters().iter().enumerate() {
            let (low, high) = parameter.range;
            let values = |value: f64| {
                let mut values: Vec<f64> = effect.parameters().iter().map(|p| p.neutral).collect();
                values[index] = value;
                values
            };
            let truth = low + (high - low) / 3.0;
            let log = cycle(&with(*effect, &values(truth)));
            let distance = |value: f64| {
                let pairs = cycle(&with(*effect, &values(value)));
                pairs
                    .iter()
                    .zip(&log)
                    .map(|(a, b)| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2))
                    .sum::<f64>()
            };
            let found = golden_section(low, high, &distance);
            assert!(
                (found - truth).abs() < 0.01 * (high - low),
                "{}.{}: {found} {truth}",
                effect.key(),
                parameter.name
            );
        }
    }
}

fn golden_section(mut low: f64, mut high: f64, f: &dyn Fn(f64) -> f64) -> f64 {
    let share = 0.5 * (5f64.sqrt() - 1.0);
    let (mut a, mut b) = (high - share * (high - low), low + share * (high - low));
    let (mut f_a, mut f_b) = (f(a), f(b));
    for _ in 0..12 {
        if f_a < f_b {
            (high, b, f_b) = (b, a, f_a);
            a = high - share * (high - low);
            f_a = f(a);
        } else {
            (low, a, f_a) = (a, b, f_b);
            b = low + share * (high - low);
            f_b = f(b);
        }
    }
    0.5 * (low + high)
}
