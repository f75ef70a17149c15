//! The batched path gives the scalar path's numbers.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use seepd_sim::batch::{Job, commands};
use seepd_sim::cycle::{CycleRun, OpenLoop};
use seepd_sim::effects;
use seepd_sim::noise::Noise;
use seepd_sim::real::LANES;
use seepd_sim::{Input, Machine, MachineSpec, PlantParameters, Schedule, Steps};

const TICKS: u64 = 11_000;

fn jobs(count: usize) -> Vec<Job> {
    (0..count)
        .map(|index| {
            let mut noise = Noise::new(9, index as u64);
            let mut spec = MachineSpec::default();
            for info in PlantParameters::ALL.iter().filter(|info| info.key != "leak_area_m2") {
                if let Some(value) = spec.plant.get_mut(info.key) {
                    *value *= noise.factor(0.05);
                }
            }
            for effect in effects::ALL.iter().chain(effects::OF_DATA_SHEETS) {
                // Lanes with and without each effect stand side by side.
                if noise.uniform(0.0, 1.0) < 0.3 {
                    for parameter in effect.parameters() {
                        let (low, high) = parameter.range;
                        // Times within the test; else anywhere in the range.
                        let high = if parameter.unit == "s" { high.min(5.0) } else { high };
                        let value = noise.uniform(low, high);
                        let assignment = format!("{}.{}={value}", effect.key(), parameter.name);
                        spec.set_effect(&assignment).unwrap();
                    }
                }
            }
            let runs = vec![
                CycleRun {
                    load_factor: noise.factor(0.2),
                    stretch: noise.factor(0.05),
                    ..CycleRun::with_leak(1e-5 * noise.uniform(0.0, 1.0))
                },
                CycleRun { pause_s: 0.1, ..CycleRun::with_leak(1e-6) },
            ];
            // Some moves begin open loop, beside lanes whose moves do not.
            if index % 3 == 1 {
                let to_s = noise.uniform(0.6, 2.0);
                let command = (0..4).map(|_| noise.uniform(-0.2, 0.6)).collect();
                spec.cycle.moves[0].open_loop = Some(OpenLoop { to_s, command });
            }
            // Some begin in the middle of their cycle.
            let start_tick = 500 * (index as u64 % 3);
            Job { spec, runs, start_tick, skip_ticks: 0, record_ticks: TICKS }
        })
        .collect()
}

fn scalar(job: &Job) -> Vec<f64> {
    let machine = Machine::<f64>::new(&[&job.spec]);
    let mut drive = Schedule::new(&job.spec.cycle, job.spec.controller.period_s, job.runs.clone())
        .starting_at(job.start_tick)
        .peekable();
    let mut state = machine.start_at(&Input::gather(&[*drive.peek().unwrap()]));
    drive
        .take(TICKS as usize)
        .map(|sample| machine.tick(&mut state, &Input::gather(&[sample])).command)
        .collect()
}

/// Asked for: 1e-9 relative. Given: the same bits, as no operation is contracted or reordered.
#[test]
fn property_lanes_equal_the_scalar_machine_bit_for_bit() {
    let jobs = jobs(2 * LANES + 3);
    let batched = commands(&jobs, Steps::Own, |_, commands| commands.to_vec());
    assert_eq!(batched.len(), jobs.len());
    for (job, batched) in jobs.iter().zip(&batched) {
        for (tick, (a, b)) in scalar(job).iter().zip(batched).enumerate() {
            assert_eq!(a.to_bits(), b.to_bits(), "tick {tick}: {a} {b}");
        }
    }
}

#[test]
fn property_a_lane_alone_equals_itself_in_a_full_batch() {
    let jobs = jobs(LANES);
    let full = commands(&jobs, Steps::Own, |_, commands| commands.to_vec());
    for (index, job) in jobs.iter().enumerate() {
        let alone = commands(std::slice::from_ref(job), Steps::Own, |_, commands| commands.to_vec());
        assert_eq!(alone[0], full[index]);
    }
}
