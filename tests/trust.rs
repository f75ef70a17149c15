//! Estimates relative to a machine's own baseline: what they find, what they leave alone, and what they refuse.
//!
//! Machines are of the series that training draws from (parameters and load ± 10 %), with other seeds. Oil, load and supply differ between
//! the baseline and what follows.

use rayon::prelude::*;
use seepd_model::Model;
use seepd_monitor::baseline::{Baseline, CusumFinding};
use seepd_monitor::event::Event;
use seepd_monitor::pipeline::{MonitorConfig, Pipeline};
use seepd_signals::{Sample, Signal};
use seepd_sim::batch::{Job, run_lanes};
use seepd_sim::cycle::CycleRun;
use seepd_sim::noise::Noise;
use seepd_sim::real::LANES;
use seepd_sim::series::{self, Tolerances};
use seepd_sim::{MachineSpec, Steps};

const NOISE: f64 = 0.003;
const BASELINE_CYCLES: usize = 50;

/// A machine on a day: its oil, and its supply over its own.
#[derive(Clone, Copy)]
struct Day {
    oil_c: f64,
    supply: f64,
    load_variation: f64,
    leak_area_m2: f64,
    cycles: usize,
    /// Half width of the valve's dead band.
    deadband: f64,
}

/// A machine of the series: its plant, and its load over plan.
fn machine(number: u64) -> (MachineSpec, f64) {
    let mut noise = Noise::new(7_000 + number, 0);
    let spec = series::vary(&MachineSpec::default(), &Tolerances::even(0.10), &mut noise);
    (spec, noise.factor(0.10))
}

fn job(number: u64, day: &Day) -> Job {
    let (spec, load) = machine(number);
    let mut spec = series::on_a_day(&spec, day.oil_c, day.supply);
    if day.deadband > 0.0 {
        spec = series::with_more_deadband(&spec, day.deadband);
    }
    spec.controller.steps_per_period = spec.stable_steps();
    let mut noise = Noise::new(8_000 + number, day.cycles as u64);
    // One cycle more at either end: the first settles, the last is cut.
    let runs = (0..day.cycles + 2)
        .map(|_| CycleRun {
            load_factor: load * noise.factor(day.load_variation),
            ..CycleRun::with_leak(day.leak_area_m2)
        })
        .collect();
    let record_ticks = (day.cycles as u64 * 10_000) + 1_500;
    Job { spec, runs, start_tick: 0, skip_ticks: 10_000, record_ticks }
}

/// What came of a machine's cycles.
#[derive(Default)]
struct Course {
    /// Cycles until a leak was found, from 1.
    found_after: Option<usize>,
    cycles: usize,
    /// Cycles that were taken for those of another machine.
    rejected: usize,
    estimates_m2: Vec<f64>,
    /// Cycles whose interval holds the truth.
    covered: usize,
    baseline: Option<Baseline>,
}

/// Runs machines in lanes over their days; each is followed from its baseline, or learns one.
fn run(model: &Model, machines: &[(u64, Day, Option<Baseline>)], with_load: bool) -> Vec<Course> {
    let config = MonitorConfig::new("axis", model.clone());
    machines
        .par_chunks(LANES)
        .flat_map_iter(|machines| {
            let mut jobs: Vec<Job> = machines.iter().map(|(number, day, _)| job(*number, day)).collect();
            let steps = jobs.iter().map(|job| job.spec.controller.steps_per_period).max().unwrap_or(10);
            jobs.iter_mut().for_each(|job| job.spec.controller.steps_per_period = steps);
            let truths: Vec<f64> = machines.iter().map(|(_, day, _)| day.leak_area_m2).collect();
            let mut lanes: Vec<(Pipeline, Noise, i64, Course)> = machines
                .iter()
                .map(|(number, day, baseline)| {
                    let mut pipeline = Pipeline::new(config.clone()).unwrap();
                    match baseline {
                        Some(baseline) => pipeline.monitors_mut()[0].follow(baseline.clone()),
                        None => pipeline.learn("test", BASELINE_CYCLES).unwrap(),
                    }
                    (pipeline, Noise::new(9_000 + number, day.cycles as u64), 0, Course::default())
                })
                .collect();
            run_lanes(&jobs, Steps::Own, |lane, record| {
                let (pipeline, noise, time_ns, course) = &mut lanes[lane];
                let command = (record.command.0[lane] + noise.normal(NOISE)).clamp(-1.0, 1.0);
                let mut sample = Sample::command(*time_ns, command);
                if with_load {
                    sample.set(Signal::Load, record.load.0[lane]);
                }
                *time_ns += 1_000_000;
                pipeline.push(&sample, &mut |event| {
                    let Event::Cycle(line) = event else { return };
                    course.cycles += 1;
                    course.rejected += usize::from(line.reason == Some("unlike_baseline"));
                    course.estimates_m2.extend(line.leak_area_m2);
                    let holds = |[low, high]: [f64; 2]| (low..=high).contains(&truths[lane]);
                    course.covered += usize::from(line.interval90_m2.is_some_and(holds));
                    if line
                        .comparison
                        .as_ref()
                        .is_some_and(|comparison| comparison.finding == CusumFinding::Leak)
                    {
                        course.found_after.get_or_insert(course.cycles);
                    }
                });
            });
            lanes.into_iter().map(|(pipeline, _, _, mut course)| {
                course.baseline = pipeline.monitors()[0].baseline().cloned();
                course
            })
        })
        .collect()
}

fn model() -> Model {
    Model::from_json(seepd::EMBEDDED_MODEL).unwrap()
}

/// What is common to the machines of a test, and what changes from cycle to cycle and from day to day.
#[derive(Clone, Copy)]
struct Setting {
    load_variation: f64,
    supply_drift: f64,
    with_load: bool,
    deadband: f64,
}

const SETTING: Setting =
    Setting { load_variation: 0.05, supply_drift: 0.01, with_load: false, deadband: 0.0 };

/// Machines at their baseline: oil at some temperature.
fn baselines(model: &Model, machines: u64, setting: Setting) -> Vec<Baseline> {
    let day = |number| Day {
        oil_c: Noise::new(6_000, number).uniform(30.0, 60.0),
        supply: 1.0,
        load_variation: setting.load_variation,
        leak_area_m2: 0.0,
        cycles: BASELINE_CYCLES + 1,
        deadband: setting.deadband,
    };
    let wanted: Vec<_> = (0..machines).map(|number| (number, day(number), None)).collect();
    let courses = run(model, &wanted, setting.with_load);
    courses.into_iter().map(|course| course.baseline.expect("a baseline")).collect()
}

/// The same machines later, one after the other, with other oil and supply.
fn later(
    model: &Model,
    baselines: &[Baseline],
    leak_area_m2: f64,
    cycles: usize,
    setting: Setting,
) -> Vec<Course> {
    let Setting { load_variation, supply_drift, with_load, deadband } = setting;
    let days: Vec<_> = baselines
        .iter()
        .enumerate()
        .map(|(number, baseline)| {
            let mut noise = Noise::new(5_000 + cycles as u64, number as u64);
            let (oil_c, supply) = (noise.uniform(30.0, 60.0), noise.factor(supply_drift));
            let day = Day { oil_c, supply, load_variation, leak_area_m2, cycles, deadband };
            (number as u64, day, Some(baseline.clone()))
        })
        .collect();
    run(model, &days, with_load)
}

fn area_m2(model: &Model, flow_lpm: f64) -> f64 {
    flow_lpm / 60_000.0 / model.leak_flow_m3_per_s(1.0, 7e6)
}

/// Share of machines whose leak is found within 30 cycles.
fn share_found(courses: &[Course]) -> f64 {
    courses.iter().filter(|course| course.found_after.is_some_and(|after| after <= 30)).count() as f64
        / courses.len() as f64
}

/// The requirement, on few machines: 0.10 L/min on each within 30 cycles (12 are simulated), and no false alarm.
#[test]
fn a_leak_of_a_tenth_of_a_litre_is_found_and_a_healthy_machine_is_left_alone() {
    found_and_left_alone(0.0);
}

/// The same where the valves' lands overlap, and did at the baseline. Training draws such valves, and 1 % is well within what it draws.
#[test]
fn a_dead_band_that_the_baseline_has_hides_no_leak() {
    found_and_left_alone(0.01);
}

fn found_and_left_alone(deadband: f64) {
    let (model, setting) = (model(), Setting { deadband, ..SETTING });
    let baselines = baselines(&model, 16, setting);
    let leaking = later(&model, &baselines, area_m2(&model, 0.10), 12, setting);
    assert_eq!(share_found(&leaking), 1.0);
    let healthy = later(&model, &baselines, 0.0, 40, Setting { load_variation: 0.10, ..setting });
    for (number, course) in healthy.iter().enumerate() {
        assert_eq!((course.found_after, course.rejected), (None, 0), "machine {number}");
        assert!(course.cycles >= 39);
    }
}

/// Leaks above 1 L/min: the median error over machines. 3 % are required; 32 machines' median is good to about 0.3 %.
#[test]
fn areas_are_right_within_three_percent() {
    let (model, load_variation) = (model(), 0.10);
    let baselines = baselines(&model, 32, Setting { with_load: true, ..SETTING });
    for (flow_lpm, with_load) in [(2.0, false), (8.0, true)] {
        let setting = Setting { load_variation, with_load, ..SETTING };
        assert!(median_error(&model, &baselines, area_m2(&model, flow_lpm), setting) < 0.03);
    }
}

/// Sizes under dead bands, from below the article's range to half of its largest: all cycles but a few are estimated, sizes ascend with the
/// leak's, errors stay within a few per cent, and intervals hold the truth. 90 % of all widths are meant; of 64 machines a width they held
/// 96, 92 and 86 %. The cycles of one machine err alike, so that these are 16 independent ones a size, 80 a width, and a share of them is
/// good to 8 % (2 σ).
#[test]
fn sizes_are_right_whatever_dead_band_the_baseline_has() {
    let model = model();
    for deadband in [0.003, 0.01, 0.015] {
        let setting = Setting { deadband, ..SETTING };
        let baselines = baselines(&model, 16, setting);
        for baseline in &baselines {
            // Seven times the standard deviation with which a baseline shows the width.
            let shown = model.relative().unwrap().deadband(&baseline.mean).unwrap();
            assert!((shown - deadband).abs() < 0.002, "{deadband}: {shown}");
        }
        let (mut covered, mut rejected, mut cycles) = (0, 0, 0);
        let mut before_m2 = vec![0.0; baselines.len()];
        for truth_m2 in [2e-8, 1e-7, 3e-7, 1e-6, 5e-6] {
            let mut errors = Vec::new();
            for (course, before_m2) in
                later(&model, &baselines, truth_m2, 2, setting).iter().zip(&mut before_m2)
            {
                (covered, rejected) = (covered + course.covered, rejected + course.rejected);
                cycles += course.estimates_m2.len() + course.rejected;
                for estimate_m2 in &course.estimates_m2 {
                    assert!(
                        estimate_m2 > before_m2,
                        "{deadband} {truth_m2}: {estimate_m2} after {before_m2}"
                    );
                    errors.push((estimate_m2 / truth_m2 - 1.0).abs());
                }
                *before_m2 = course.estimates_m2.iter().copied().fold(*before_m2, f64::max);
            }
            errors.sort_by(f64::total_cmp);
            let error = errors[errors.len() / 2];
            println!("{deadband} {truth_m2:.0e}: median error {:.1} %", 100.0 * error);
            assert!(error < if truth_m2 < 1e-7 { 0.15 } else { 0.06 }, "{deadband} {truth_m2}: {error}");
        }
        let share = |of: usize| of as f64 / cycles as f64;
        println!("{deadband}: {:.3} of {cycles} covered, {:.3} refused", share(covered), share(rejected));
        assert!(share(covered) > 0.78 && share(rejected) < 0.03, "{deadband}: {covered} {rejected} {cycles}");
    }
}

/// Median relative error of the areas over the machines.
fn median_error(model: &Model, baselines: &[Baseline], truth_m2: f64, setting: Setting) -> f64 {
    let mut errors: Vec<f64> = later(model, baselines, truth_m2, 2, setting)
        .iter()
        .flat_map(|course| course.estimates_m2.iter().map(|estimate| (estimate / truth_m2 - 1.0).abs()))
        .collect();
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

/// The whole requirement, and the smallest leak that is found: prints the table of docs/ACCURACY.md. Some minutes.
#[test]
#[ignore = "some minutes: cargo test --release -p seepd --test program trust::detection -- --ignored --nocapture"]
fn detection_limit_and_false_alarms() {
    let model = model();
    for (with_load, deadband) in [(false, 0.0), (true, 0.0), (false, 0.01)] {
        let setting = Setting { with_load, deadband, ..SETTING };
        let baselines = baselines(&model, 200, setting);
        println!(
            "load {}, dead band {deadband}: of 200 machines, baseline of 50 cycles, load ± 5 %, noise {NOISE}",
            if with_load { "measured" } else { "unknown" }
        );
        println!("{:>8} {:>9} {:>14} {:>15}", "L/min", "m²", "found in 30", "median cycles");
        let mut smallest = f64::INFINITY;
        for flow_lpm in [0.10, 0.07, 0.05, 0.045, 0.04, 0.035, 0.03, 0.02] {
            let setting = Setting { supply_drift: 0.0, ..setting };
            let courses = later(&model, &baselines, area_m2(&model, flow_lpm), 31, setting);
            let mut delays: Vec<usize> = courses.iter().filter_map(|course| course.found_after).collect();
            delays.sort_unstable();
            let share = share_found(&courses);
            println!(
                "{flow_lpm:>8} {:>9.2e} {:>12.1} % {:>15}",
                area_m2(&model, flow_lpm),
                100.0 * share,
                delays.get(delays.len() / 2).copied().unwrap_or(0)
            );
            if share >= 0.95 {
                smallest = smallest.min(flow_lpm);
            }
        }
        println!("smallest leak found by 95 %: {smallest} L/min");
        let healthy = later(&model, &baselines, 0.0, 51, Setting { load_variation: 0.10, ..setting });
        let cycles: usize = healthy.iter().map(|course| course.cycles).sum();
        let alarms = healthy.iter().filter(|course| course.found_after.is_some()).count();
        let rejected: usize = healthy.iter().map(|course| course.rejected).sum();
        println!(
            "{cycles} healthy cycles, load ± 10 %, oil 30 … 60 °C, supply ± 1 %: {alarms} false alarms, {rejected} not estimated\n"
        );
        assert!(smallest <= 0.10);
        assert_eq!(alarms, 0);
        assert!(cycles >= 10_000);
    }
}
