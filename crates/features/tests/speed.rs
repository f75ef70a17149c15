//! Speeds as ratios within one run, which hold on slow and noisy machines; `docs/PERFORMANCE.md` has absolute figures.
//! `cargo test --release -p seepd-features --test speed -- --ignored --test-threads=1`: with debug assertions lanes are no vectors.

use std::hint::black_box;
use std::time::Instant;

use seepd_features::Outcome;
use seepd_model::Model;
use seepd_signals::Sample;
use seepd_sim::batch::{Job, run_lanes};
use seepd_sim::cycle::CycleRun;
use seepd_sim::real::LANES;
use seepd_sim::{Input, Machine, MachineSpec, Schedule, Steps};

/// One cycle at 1 kHz.
const TICKS: u64 = 10_000;
const ROUNDS: usize = 5;

/// Shortest of some rounds, s: other processes can only make a round longer.
#[expect(clippy::disallowed_methods, reason = "a measurement reads the clock")]
fn shortest_s(mut work: impl FnMut()) -> f64 {
    let round = |_| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    };
    (0..ROUNDS).map(round).fold(f64::INFINITY, f64::min)
}

fn commands(cycles: u64) -> Vec<f64> {
    let spec = MachineSpec::default();
    let machine = Machine::<f64>::new(&[&spec]);
    let mut state = machine.start();
    let runs = vec![CycleRun::with_leak(1e-6); cycles as usize];
    Schedule::new(&spec.cycle, 1e-3, runs)
        .take((cycles * TICKS) as usize)
        .map(|drive| machine.tick(&mut state, &Input::gather(&[drive])).command)
        .collect()
}

/// Eight lanes are 6.3 times faster with AVX-512 and 2.6 times on the platform's baseline; code that lost its vectors would be at 1.
#[test]
#[ignore = "measures the release profile, while nothing else runs: .ci/run"]
fn a_lane_step_is_at_most_half_a_scalar_step() {
    let scalar_s = shortest_s(|| {
        black_box(commands(1));
    });
    let job = Job {
        spec: MachineSpec::default(),
        runs: vec![CycleRun::with_leak(1e-6)],
        start_tick: 0,
        skip_ticks: 0,
        record_ticks: TICKS,
    };
    let jobs = vec![job; LANES];
    let lane_s = shortest_s(|| {
        run_lanes(&jobs, Steps::Own, |lane, record| {
            black_box((lane, record.command));
        });
    }) / LANES as f64;
    assert!(lane_s <= 0.5 * scalar_s, "a cycle takes {lane_s} s in a lane, {scalar_s} s alone");
}

/// A cycle's estimate is one walk through each tree, some µs; its ten thousand samples take some hundred µs. An estimate as dear as the
/// reading would be a fault in the evaluation.
#[test]
#[ignore = "measures the release profile, while nothing else runs: .ci/run"]
fn an_estimate_takes_at_most_half_of_what_reading_its_cycle_takes() {
    const CYCLES: u64 = 5;
    let model = Model::from_json(include_bytes!("../../daemon/assets/model.json")).unwrap();
    let reader = model.reader().unwrap();
    let samples: Vec<Sample> = (0..)
        .map(|tick| tick * 1_000_000)
        .zip(commands(CYCLES))
        .map(|(at, u)| Sample::command(at, u))
        .collect();
    let mut features = Vec::new();
    let reading_s = shortest_s(|| {
        features.clear();
        let mut state = reader.start(vec![0.0f32; reader.definition().ring_samples()]).unwrap();
        for sample in &samples {
            reader.push(&mut state, sample, &mut |outcome| {
                if let Outcome::Valid(cycle) = outcome {
                    features.push(cycle.features.to_vec());
                }
            });
        }
    });
    assert!(features.len() >= 3, "{} cycles", features.len());
    let estimates_s = shortest_s(|| {
        for features in &features {
            black_box(model.estimate(features));
        }
    });
    let (estimate_s, cycle_s) = (estimates_s / features.len() as f64, reading_s / CYCLES as f64);
    assert!(estimate_s <= 0.5 * cycle_s, "{estimate_s} s an estimate, {cycle_s} s a cycle's reading");
}
