//! Cost of one RK4 step of the plant, scalar and per lane of the batched path, there also with each effect of the catalogue.
//!
//! `items` are RK4 steps of one machine: the printed rate is comparable among them.

use divan::counter::ItemsCount;
use seepd_sim::batch::{Job, run_lanes};
use seepd_sim::cycle::CycleRun;
use seepd_sim::real::LANES;
use seepd_sim::{Input, Machine, MachineSpec, Schedule, Steps, effects};

const TICKS: u64 = 10_000;

fn main() {
    divan::main();
}

#[divan::bench(sample_count = 10)]
fn scalar_cycle(bencher: divan::Bencher<'_, '_>) {
    let spec = MachineSpec::default();
    let machine = Machine::<f64>::new(&[&spec]);
    bencher.counter(ItemsCount::new(TICKS * 10)).bench_local(|| {
        let schedule = Schedule::new(&spec.cycle, 1e-3, vec![CycleRun::with_leak(1e-6)]);
        let mut state = machine.start();
        for sample in schedule.take(TICKS as usize) {
            divan::black_box(machine.tick(&mut state, &Input::gather(&[sample])));
        }
    });
}

#[divan::bench(sample_count = 10, args = [Steps::Own, Steps::Fewest])]
fn batched_cycle(bencher: divan::Bencher<'_, '_>, steps: Steps) {
    batched(bencher, MachineSpec::default(), steps);
}

#[divan::bench(sample_count = 4, args = effects::ALL.iter().map(|effect| effect.key()))]
fn batched_cycle_with(bencher: divan::Bencher<'_, '_>, effect: &str) {
    let mut spec = MachineSpec::default();
    let parameters = effects::find(effect).map_or(&[][..], |effect| effect.parameters());
    let values = parameters.iter().map(|parameter| {
        let (low, high) = parameter.range;
        (parameter.name.to_owned(), low + 0.1 * (high - low))
    });
    spec.effects.insert(effect.to_owned(), values.collect());
    batched(bencher, spec, Steps::Own);
}

fn batched(bencher: divan::Bencher<'_, '_>, spec: MachineSpec, steps: Steps) {
    let jobs: Vec<Job> = (0..LANES)
        .map(|lane| Job {
            spec: spec.clone(),
            runs: vec![CycleRun::with_leak(1e-6 * lane as f64)],
            start_tick: 0,
            skip_ticks: 0,
            record_ticks: TICKS,
        })
        .collect();
    bencher.counter(ItemsCount::new(TICKS * 10 * LANES as u64)).bench_local(|| {
        run_lanes(&jobs, steps, |lane, record| {
            divan::black_box((lane, record.command));
        });
    });
}
