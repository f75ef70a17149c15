//! The catalogue of effects: complete, documented, neutral at neutral, and recoverable. Each test walks it.

use std::collections::BTreeSet;
use std::path::Path;

use seepd_sim::batch::{Job, run_lanes};
use seepd_sim::cycle::CycleRun;
use seepd_sim::effects::{self, Effect};
use seepd_sim::real::LANES;
use seepd_sim::{Input, Machine, MachineSpec, Schedule, Steps};

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
    let ticks = (spec.cycle.period_s / spec.controller.period_s) as usize;
    Schedule::new(&spec.cycle, spec.controller.period_s, vec![CycleRun::with_leak(1e-6)])
        .take(2 * ticks)
        .map(|sample| machine.tick(&mut state, &Input::gather(&[sample])))
        .map(|record| [record.command, record.position])
        .skip(ticks)
        .collect()
}

/// The catalogue's laws and those of data sheets.
fn laws() -> impl Iterator<Item = &'static dyn Effect> {
    effects::ALL.iter().chain(effects::OF_DATA_SHEETS).copied()
}

#[test]
fn property_catalogue_is_complete_and_documented() {
    let keys: BTreeSet<&str> = laws().map(|effect| effect.key()).collect();
    assert_eq!(keys.len(), laws().count(), "keys are unique");
    for effect in laws() {
        assert!(effect.key().chars().all(|c| c.is_ascii_lowercase() || c == '_'));
        assert!(effect.info().law.len() > 10 && effect.info().signature.len() > 20, "{}", effect.key());
        for parameter in effect.parameters() {
            let (low, high) = parameter.range;
            assert!(low < high && parameter.source.len() > 5, "{}.{}", effect.key(), parameter.name);
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
    for effect in laws() {
        let neutral: Vec<f64> = effect.parameters().iter().map(|parameter| parameter.neutral).collect();
        let same = cycle(&with(effect, &neutral));
        let bits =
            |cycle: &[[f64; 2]]| cycle.iter().flatten().map(|value| value.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&nominal), bits(&same), "{}", effect.key());
    }
}

/// A neutral lane beside one with the effect keeps the nominal bits: its law is there and must do nothing.
#[test]
fn neutral_lane_beside_an_acting_one_leaves_every_bit() {
    let nominal = cycle(&MachineSpec::default());
    for effect in laws() {
        let strong: Vec<f64> =
            effect.parameters().iter().map(|p| p.range.0 + 0.5 * (p.range.1 - p.range.0)).collect();
        let jobs = [with(effect, &strong), MachineSpec::default()].map(|spec| Job {
            spec,
            runs: vec![CycleRun::with_leak(1e-6)],
            start_tick: 0,
            skip_ticks: 10_000,
            record_ticks: 10_000,
        });
        let mut neutral = Vec::new();
        run_lanes(&jobs, Steps::Own, |lane, record| {
            if lane == 1 {
                neutral.push(record.command.0[1].to_bits());
            }
        });
        let expected: Vec<u64> = nominal.iter().map(|sample| sample[0].to_bits()).collect();
        assert_eq!(expected, neutral, "{}", effect.key());
    }
}

/// Where an effect acts on the default press: its values, a third into the ranges if nothing else is said, and the machine.
fn acting(effect: &dyn Effect) -> (MachineSpec, Vec<f64>) {
    let mut machine = MachineSpec::default();
    let third = |range: (f64, f64)| range.0 + (range.1 - range.0) / 3.0;
    let mut values: Vec<f64> = effect.parameters().iter().map(|parameter| third(parameter.range)).collect();
    match effect.key() {
        // The command of the default duty cycle moves at 0.46 1/s at most.
        "valve_rate_limit" => values = vec![0.36],
        "shared_supply" => values = vec![5e-4, 3.1, 0.7],
        "controller_gains" => {
            values = vec![1.3, 0.7, 1.5];
            // A factor on a derivative gain of 0 would be none.
            machine.controller.kd = 0.05;
        }
        // The default duty cycle stays 100 mm away from the stops.
        "cushioning" => {
            values = vec![0.02, 0.3];
            for (stroke, to_m) in machine.cycle.moves.iter_mut().zip([0.45, 0.495, 0.005]) {
                stroke.to_m = to_m;
            }
        }
        _ => {}
    }
    (machine, values)
}

fn planted(machine: &MachineSpec, effect: &dyn Effect, values: &[f64]) -> MachineSpec {
    MachineSpec { effects: with(effect, values).effects, ..machine.clone() }
}

/// Squared distance of command and position.
fn distance(a: &[[f64; 2]], b: &[[f64; 2]]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sum()
}

/// Each parameter comes back from command and position by minimising the distance over it alone, the effect's others being known: the
/// law acts, is continuous, and is not flat.
#[test]
fn recover_each_parameter() {
    use rayon::prelude::*;
    // Steps of a grid: the distance is no smooth function of the step.
    let jagged = ["command_quantisation", "position_quantisation"];
    let failures: Vec<String> = effects::ALL
        .par_iter()
        .filter(|effect| !jagged.contains(&effect.key()))
        .flat_map_iter(|effect| {
            let (machine, truth) = acting(*effect);
            let log = cycle(&planted(&machine, *effect, &truth));
            effect.parameters().iter().enumerate().filter_map(move |(index, parameter)| {
                // Around the truth; strange minima far away are the diagnosis's business.
                let (low, high) = (parameter.range.0, parameter.range.1.min(10.0));
                // The error of an eccentric wheel repeats, and so does its distance over the pitch.
                let share = if parameter.name == "pitch_m" { 0.02 } else { 0.25 };
                let reach = share * (high - low);
                let (low, high) = ((truth[index] - reach).max(low), (truth[index] + reach).min(high));
                let planted_at = |value: f64| {
                    let mut values = truth.clone();
                    values[index] = value;
                    planted(&machine, *effect, &values)
                };
                let found = nearest(low, high, &planted_at, &log);
                let off = (found - truth[index]).abs() / (high - low);
                (off > 0.02)
                    .then(|| format!("{}.{}: {found}, not {}", effect.key(), parameter.name, truth[index]))
            })
        })
        .collect();
    assert!(failures.is_empty(), "{failures:#?}");
}

/// On the press as it is the effect shows, by more than rounding, unless it is known not to.
#[test]
fn effects_show_on_the_default_press_unless_they_cannot() {
    let nominal = cycle(&MachineSpec::default());
    for effect in effects::ALL {
        let (_, values) = acting(*effect);
        let shown =
            (distance(&cycle(&planted(&MachineSpec::default(), *effect, &values)), &nominal) / 1e4).sqrt();
        // The stops are never near, and a factor on no derivative gain is none; kp and ki alone do show.
        let unseen = effect.key() == "cushioning";
        assert_eq!(shown < 1e-12, unseen, "{}: RMS {shown:e}", effect.key());
    }
}

/// The value whose machine is nearest to the log, within a 400th of the interval: of as many machines as there are lanes, that between the
/// neighbours of the nearest, and so on.
fn nearest(mut low: f64, mut high: f64, planted_at: &dyn Fn(f64) -> MachineSpec, log: &[[f64; 2]]) -> f64 {
    let ticks = log.len() as u64;
    for _ in 0..4 {
        let step = (high - low) / (LANES + 1) as f64;
        let values: [f64; LANES] = std::array::from_fn(|lane| low + (lane + 1) as f64 * step);
        let jobs = values.map(|value| Job {
            spec: planted_at(value),
            runs: vec![CycleRun::with_leak(1e-6)],
            start_tick: 0,
            skip_ticks: ticks,
            record_ticks: ticks,
        });
        let mut cycles = [const { Vec::new() }; LANES];
        run_lanes(&jobs, Steps::Own, |lane, signals| {
            cycles[lane].push([signals.command.0[lane], signals.position.0[lane]]);
        });
        let distances = cycles.map(|cycle| distance(&cycle, log));
        let least =
            (1..LANES).fold(0, |least, lane| if distances[lane] < distances[least] { lane } else { least });
        (low, high) = (values[least] - step, values[least] + step);
    }
    0.5 * (low + high)
}
