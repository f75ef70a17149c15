//! Cost of one RK4 step of the plant, scalar and per lane of the batched path.
//!
//! `items` are RK4 steps of one machine: the printed rate is comparable between the two.

use divan::counter::ItemsCount;
use seepd_sim::batch::{Job, run_lanes};
use seepd_sim::cycle::CycleRun;
use seepd_sim::real::LANES;
use seepd_sim::{Input, Machine, MachineSpec, Schedule};

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

#[divan::bench(sample_count = 10)]
fn batched_cycle(bencher: divan::Bencher<'_, '_>) {
    let jobs: Vec<Job> = (0..LANES)
        .map(|lane| Job {
            spec: MachineSpec::default(),
            runs: vec![CycleRun::with_leak(1e-6 * lane as f64)],
            start_tick: 0,
            skip_ticks: 0,
            record_ticks: TICKS,
        })
        .collect();
    bencher.counter(ItemsCount::new(TICKS * 10 * LANES as u64)).bench_local(|| {
        run_lanes(&jobs, |lane, record| {
            divan::black_box((lane, record.command));
        });
    });
}
