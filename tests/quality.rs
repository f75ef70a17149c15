//! What the shipped model is worth, on machines that it has not seen. The program's own training measures it; the same
//! training rebuilds the embedded model.

use std::sync::LazyLock;

use rayon::prelude::*;
use seepd_model::Model;
use seepd_monitor::event::{Event, Flag};
use seepd_monitor::pipeline::{MonitorConfig, Pipeline};
use seepd_signals::Sample;
use seepd_sim::batch::{Job, run_lanes};
use seepd_sim::cycle::CycleRun;
use seepd_sim::noise::Noise;
use seepd_sim::real::LANES;
use seepd_sim::{MachineSpec, Steps};
use seepd_train::{TrainError, Trained, TrainingSettings, train};

/// Trained as the embedded model was, but for fewer machines that calibrate and are compared with their baselines, and without causes.
static TRAINED: LazyLock<Trained> = LazyLock::new(|| {
    let settings = TrainingSettings {
        relative_machines: 48,
        calibrated_on: 512,
        cause_machines: 0,
        tested_on: 64,
        noise_table: true,
        ..TrainingSettings::default()
    };
    train(&MachineSpec::default(), &settings, &mut |_, _, _| ()).unwrap()
});

/// What the asset's own command gives, but for what the fewer machines decide. Elsewhere than on x86-64 Linux the mathematical
/// library may round otherwise.
#[test]
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
fn embedded_trees_are_what_training_gives_to_the_bit() {
    let [mut trained, mut embedded] = [&TRAINED.json[..], seepd::EMBEDDED_MODEL]
        .map(|json| serde_json::from_slice::<serde_json::Value>(json).unwrap());
    for model in [&mut trained, &mut embedded] {
        for key in ["calibration", "novelty", "golden", "relative"] {
            assert!(model.as_object_mut().unwrap().remove(key).is_some(), "{key}");
        }
        model.as_object_mut().unwrap().remove("causes");
    }
    assert!(trained == embedded, "run: seepd train --out crates/daemon/assets/model.json");
}

#[test]
#[ignore = "three minutes: cargo test -p seepd --test program quality:: -- --ignored"]
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
fn embedded_model_is_what_training_gives_to_the_byte() {
    let trained = train(&MachineSpec::default(), &TrainingSettings::default(), &mut |_, _, _| ()).unwrap();
    assert!(trained.json == seepd::EMBEDDED_MODEL, "run: seepd train --out crates/daemon/assets/model.json");
}

#[test]
fn a_model_that_cannot_compare_is_not_written() {
    let settings = TrainingSettings {
        observations: 100,
        held_out: 100,
        trials: 1,
        relative_machines: 0,
        calibrated_on: 50,
        cause_machines: 0,
        tested_on: 50,
        ..TrainingSettings::default()
    };
    let error = train(&MachineSpec::default(), &settings, &mut |_, _, _| ()).unwrap_err();
    assert!(matches!(error, TrainError::Comparison { simulated: 0 }), "{error}");
    assert!(error.to_string().contains("cannot be learned from 0 simulated machines"), "{error}");
}

#[test]
fn accuracy_on_unseen_machines() {
    let accuracy = &TRAINED.report.accuracy;
    assert!(accuracy.r2_area >= 0.999 && accuracy.r2_transformed >= 0.999, "{accuracy:?}");
    let errors: Vec<f64> = accuracy.decades.iter().map(|decade| decade.median_relative_error).collect();
    assert!(errors[0] <= 0.08 && errors[1] <= 0.03 && errors[2] <= 0.02, "{errors:?}");
    assert!(accuracy.largest_healthy_m2 < 3e-8, "{accuracy:?}");
    assert!(TRAINED.json.len() <= 1_000_000);
    // 90 % is aimed at, calibrated on 512 machines here; these and about 780 measured give ± 4 % (2 σ).
    assert!((0.86..=0.94).contains(&accuracy.coverage), "{accuracy:?}");
    // Limits lie a quarter above the largest distance of 512 machines at three levels of noise.
    assert!(
        TRAINED.report.by_noise.iter().all(|level| level.out_of_distribution < 0.002),
        "{:?}",
        TRAINED.report.by_noise
    );
}

#[test]
fn noise_of_the_command_hardly_matters_behind_the_filter() {
    let table = TRAINED.report.noise_table.as_ref().unwrap();
    assert_eq!(table.iter().map(|line| line.noise).collect::<Vec<_>>(), [0.001, 0.003, 0.005, 0.007, 0.01]);
    let (first, last) = (&table[0], &table[4]);
    assert!(last.mean_absolute_error_m2[0] <= 1.5 * first.mean_absolute_error_m2[0], "{table:?}");
    assert!(table.iter().all(|line| line.largest_feature_change[0] <= 0.05), "{table:?}");
    // Without the filter at least one feature is lost in the noise: the filter is not decoration.
    assert!(last.largest_feature_change[1] > 0.2, "{table:?}");
}

/// Cycles of a healthy machine under ± 2 % of load raise no flag. Sixteen stretches run in lanes; each has an alarm of its own, which can
/// only see more starts.
#[test]
fn healthy_machine_raises_no_flag_in_2_000_cycles() {
    no_flag_in(125);
}

#[test]
#[ignore = "most of a minute: cargo test -p seepd --test program quality:: -- --ignored"]
fn healthy_machine_raises_no_flag_in_10_000_cycles() {
    no_flag_in(625);
}

/// In sixteen stretches of so many cycles.
fn no_flag_in(stretch_cycles: usize) {
    let model = Model::from_json(seepd::EMBEDDED_MODEL).unwrap();
    let estimates: Vec<u64> = (0..2u64)
        .into_par_iter()
        .flat_map_iter(|batch| {
            let jobs: Vec<Job> = (0..LANES as u64)
                .map(|lane| {
                    let mut noise = Noise::new(77, batch * 8 + lane);
                    let run = |noise: &mut Noise| CycleRun {
                        load_factor: noise.factor(0.02),
                        ..CycleRun::with_leak(0.0)
                    };
                    let runs = (0..=stretch_cycles).map(|_| run(&mut noise)).collect();
                    Job {
                        spec: MachineSpec::default(),
                        runs,
                        start_tick: 0,
                        skip_ticks: 10_000,
                        record_ticks: stretch_cycles as u64 * 10_000,
                    }
                })
                .collect();
            watch(&model, &jobs, batch)
        })
        .collect();
    assert!(estimates.iter().sum::<u64>() >= 16 * stretch_cycles as u64 - 16, "{estimates:?}");
}

/// Cycles with an estimate of each lane; panics where a flag rises.
fn watch(model: &Model, jobs: &[Job], batch: u64) -> Vec<u64> {
    let config = MonitorConfig::new("axis", model.clone());
    let mut lanes: Vec<(Pipeline, Noise, i64, u64)> = (0..LANES as u64)
        .map(|lane| (Pipeline::new(config.clone()).unwrap(), Noise::new(78, batch * 8 + lane), 0, 0))
        .collect();
    run_lanes(jobs, Steps::Own, |lane, record| {
        let (pipeline, noise, time_ns, cycles) = &mut lanes[lane];
        let sample = Sample::command(*time_ns, record.command.0[lane] + noise.normal(0.001));
        *time_ns += 1_000_000;
        pipeline.push(&sample, &mut |event| match event {
            Event::Cycle(line) => {
                *cycles += u64::from(line.leak_area_m2.is_some());
                assert!(line.flag <= Flag::Healthy, "{line:?}");
            }
            Event::Flag(change) => assert_eq!(change.flag_to, Flag::Healthy),
            Event::Notice(notice) => panic!("{}", notice.text),
        });
    });
    lanes.iter().map(|lane| lane.3).collect()
}
