//! Causes beside the seal over many cycles: when they began, whether they came at once or grow, when they will matter, and that nothing is
//! found on a machine that weather and load alone change.
//!
//! A shift of the valve's null is the same in every sample, whatever the machine does: it is planted as an offset of the command.

use std::sync::{Arc, LazyLock};

use rayon::prelude::*;
use seepd_model::Model;
use seepd_model::causes::Cause;
use seepd_monitor::baseline::Baseline;
use seepd_monitor::cause::course::{Condition, CourseState, Manner, Severity};
use seepd_monitor::event::{Event, Flag, NoticeKind};
use seepd_monitor::pipeline::{MonitorConfig, Pipeline};
use seepd_signals::Sample;
use seepd_sim::batch::{Job, run_lanes};
use seepd_sim::cycle::CycleRun;
use seepd_sim::noise::Noise;
use seepd_sim::real::LANES;
use seepd_sim::series::{self, Tolerances};
use seepd_sim::{MachineSpec, Steps};

static MODEL: LazyLock<Arc<Model>> =
    LazyLock::new(|| Arc::new(Model::from_json(seepd::EMBEDDED_MODEL).unwrap()));

const NOISE: f64 = 0.003;
const LEARNED: usize = 50;
/// Samples of a cycle, and its length, ns.
const TICKS: u64 = 10_000;
const CYCLE_NS: i64 = 10_000_000_000;
/// Time of the first sample, ns: a date.
const BEGIN_NS: i64 = 1_750_000_000_000_000_000;

/// Some cycles of a machine on a day.
#[derive(Clone, Copy)]
struct Stretch {
    oil_c: f64,
    supply: f64,
    cycles: usize,
}

/// What was heard of a machine.
#[derive(Default)]
struct Heard {
    cycles: usize,
    /// Cycles whose line has conditions.
    with_conditions: usize,
    flags: usize,
    notices: Vec<(NoticeKind, u64, String)>,
    conditions: Vec<Condition>,
    courses: Vec<CourseState>,
    baseline: Option<Baseline>,
}

impl Heard {
    fn notices_of(&self, kind: NoticeKind) -> Vec<&str> {
        self.notices.iter().filter(|(of, ..)| *of == kind).map(|(.., text)| text.as_str()).collect()
    }
}

/// A machine of the series: its plant, and its load over plan.
fn machine(number: u64) -> (MachineSpec, f64) {
    let mut noise = Noise::new(17_000 + number, 0);
    let spec = series::vary(&MachineSpec::default(), &Tolerances::even(0.05), &mut noise);
    (spec, noise.factor(0.05))
}

/// Machines side by side over a stretch each; each is followed from its baseline, or learns one. `offset` is added to the command of a
/// cycle.
fn run(machines: &[(u64, Stretch, Option<Baseline>)], offset: impl Fn(f64) -> f64 + Sync) -> Vec<Heard> {
    let config = MonitorConfig::new("axis", Arc::clone(&MODEL));
    machines
        .par_chunks(LANES)
        .flat_map_iter(|machines| {
            let job = |number: u64, stretch: &Stretch| {
                let (spec, load) = machine(number);
                let spec = series::on_a_day(&spec, stretch.oil_c, stretch.supply);
                let mut noise = Noise::new(18_000 + number, stretch.oil_c.to_bits());
                let run = |_| CycleRun { load_factor: load * noise.factor(0.02), ..CycleRun::with_leak(0.0) };
                let runs = (0..stretch.cycles + 2).map(run).collect();
                let record_ticks = stretch.cycles as u64 * TICKS + 1_500;
                Job { spec, runs, start_tick: 0, skip_ticks: TICKS, record_ticks }
            };
            let mut jobs: Vec<Job> =
                machines.iter().map(|(number, stretch, _)| job(*number, stretch)).collect();
            let steps = jobs.iter().map(|job| job.spec.stable_steps()).max().unwrap_or(10);
            jobs.iter_mut().for_each(|job| job.spec.controller.steps_per_period = steps);
            let mut lanes: Vec<(Pipeline, Noise, u64, Heard)> = machines
                .iter()
                .map(|(number, stretch, baseline)| {
                    let mut pipeline = Pipeline::new(config.clone()).unwrap();
                    match baseline {
                        Some(baseline) => pipeline.monitors_mut()[0].follow(baseline.clone()),
                        None => pipeline.learn("test", LEARNED).unwrap(),
                    }
                    let noise = Noise::new(19_000 + number, stretch.oil_c.to_bits());
                    (pipeline, noise, 0, Heard::default())
                })
                .collect();
            run_lanes(&jobs, Steps::Own, |lane, record| {
                let (pipeline, noise, tick, heard) = &mut lanes[lane];
                let planted = offset(*tick as f64 / TICKS as f64);
                // A spool that is off by so much needs as much less of the command.
                let command = record.command.0[lane] - planted + noise.normal(NOISE);
                let sample = Sample::command(BEGIN_NS + *tick as i64 * 1_000_000, command.clamp(-1.0, 1.0));
                *tick += 1;
                pipeline.push(&sample, &mut |event| match event {
                    Event::Cycle(line) => {
                        heard.cycles += 1;
                        let found = line.cause.as_ref().map_or(0, |cause| cause.conditions.len());
                        heard.with_conditions += usize::from(found > 0);
                    }
                    Event::Flag(flag) => heard.flags += usize::from(flag.flag_to >= Flag::Watch),
                    Event::Notice(notice) => {
                        heard.notices.push((notice.notice, notice.cycle, notice.text.clone()));
                    }
                });
            });
            lanes.into_iter().map(|(pipeline, .., mut heard)| {
                heard.baseline = pipeline.monitors()[0].baseline().cloned();
                heard.conditions = pipeline.conditions().copied().collect();
                heard.courses = pipeline.monitors()[0].courses();
                heard
            })
        })
        .collect()
}

/// Baselines of the first eight machines, which most tests begin with.
static BASELINES: LazyLock<Vec<(u64, Baseline)>> = LazyLock::new(|| learned(LANES as u64));

fn baselines(machines: u64) -> Vec<(u64, Baseline)> {
    let known = BASELINES.get(..machines as usize);
    known.map_or_else(|| learned(machines), <[_]>::to_vec)
}

/// Healthy machines' baselines, oil at 45 °C.
fn learned(machines: u64) -> Vec<(u64, Baseline)> {
    let stretch = Stretch { oil_c: 45.0, supply: 1.0, cycles: LEARNED + 1 };
    let all: Vec<_> = (0..machines).map(|number| (number, stretch, None)).collect();
    let learned = run(&all, |_| 0.0);
    learned.into_iter().enumerate().map(|(number, heard)| (number as u64, heard.baseline.unwrap())).collect()
}

/// Machines with a planted offset of the null, oil at 45 °C.
fn with_offset(machines: u64, cycles: usize, offset: impl Fn(f64) -> f64 + Sync) -> Vec<Heard> {
    let stretch = Stretch { oil_c: 47.0, supply: 1.0, cycles };
    let all: Vec<_> =
        baselines(machines).into_iter().map(|(number, baseline)| (number, stretch, Some(baseline))).collect();
    run(&all, offset)
}

fn null_of(heard: &Heard) -> Condition {
    let is_null = |one: &&Condition| one.kind.cause == Cause::ValveNull;
    *heard.conditions.iter().find(is_null).unwrap_or_else(|| panic!("{:?}", heard.conditions))
}

#[test]
fn a_step_is_dated_and_not_taken_for_a_drift() {
    for (at_cycle, size) in [(12.0, 0.003), (30.0, -0.02), (25.0, 0.0008)] {
        for heard in with_offset(8, 90, |cycle| if cycle >= at_cycle { size } else { 0.0 }) {
            // Oil lost on the cap side looks like a null that shifts towards −: the class.
            if size < 0.0 && heard.conditions.iter().all(|one| one.kind.cause != Cause::ValveNull) {
                assert!(heard.conditions.iter().all(|one| one.kind.cause == Cause::ExternalLeak), "{size}");
                continue;
            }
            let null = null_of(&heard);
            let told = format!("{size} from cycle {at_cycle}: {null:?}");
            assert_eq!((null.manner, null.rate_per_day), (Manner::Step, None), "{told}");
            assert!((null.size / size - 1.0).abs() < 0.1, "{told}");
            let [from, to] = null.onset_cycles.unwrap();
            assert!(from as f64 <= at_cycle && at_cycle <= to as f64 && to - from <= 40, "{told}");
            let end_ns = BEGIN_NS + CYCLE_NS * (at_cycle as i64 + 1);
            assert!((null.onset_ns - end_ns).abs() < 6 * CYCLE_NS, "{told}");
            assert_eq!(null.severity == Severity::Matters, size.abs() > 0.01, "{told}");
            assert_eq!(heard.notices_of(NoticeKind::ConditionFound).len(), 1, "{:?}", heard.notices);
        }
    }
}

/// The daemon keeps what is found over a restart, which counts cycles anew: the date stays, the number goes.
#[test]
fn what_is_found_outlives_a_restart_with_its_date() {
    let heard = with_offset(1, 30, |cycle| if cycle >= 10.0 { 0.003 } else { 0.0 });
    let before = null_of(&heard[0]);
    let kept = serde_json::to_string(&heard[0].courses).unwrap();
    let courses: Vec<CourseState> = serde_json::from_str(&kept).unwrap();
    let mut pipeline = Pipeline::new(MonitorConfig::new("axis", Arc::clone(&MODEL))).unwrap();
    let monitor = &mut pipeline.monitors_mut()[0];
    monitor.follow(baselines(1).remove(0).1);
    monitor.restore_courses(&courses);
    let after: Vec<Condition> = pipeline.conditions().copied().collect();
    assert_eq!(after.len(), heard[0].conditions.len());
    let again = after.iter().find(|one| one.kind == before.kind).unwrap();
    assert_eq!((again.onset_cycle, again.onset_cycles, again.sum), (None, None, before.sum));
    assert!((again.onset_ns - before.onset_ns).abs() <= 2 * CYCLE_NS, "{before:?} {again:?}");
    assert_eq!(again.manner, Manner::Step);
}

#[test]
fn a_drift_has_a_rate_an_onset_and_a_date_from_which_it_matters() {
    // 3e-5 a cycle of 10 s from cycle 20 on: 0.26 a day, 1 % after 333 cycles.
    let (from_cycle, a_cycle) = (20.0, 3e-5);
    let rate_per_day = a_cycle * 8640.0;
    let heard = with_offset(8, 220, |cycle| a_cycle * (cycle - from_cycle).max(0.0));
    let (mut rates, mut onsets, mut dates) = (0, 0, 0);
    for heard in &heard {
        let null = null_of(heard);
        assert_eq!((null.manner, heard.flags), (Manner::Drift, 0), "{null:?}");
        assert!((null.rate_per_day.unwrap() / rate_per_day - 1.0).abs() < 0.1, "{null:?}");
        let [low, high] = null.rate90_per_day.unwrap();
        rates += usize::from((low..=high).contains(&rate_per_day));
        let [from, to] = null.onset_cycles.unwrap();
        onsets += usize::from(from as f64 <= from_cycle + 1.0 && from_cycle - 1.0 <= to as f64);
        assert!((null.onset_cycle.unwrap() as f64 - from_cycle).abs() < 15.0, "{null:?}");
        let until = null.time_to_matter.unwrap();
        let truth_s = (from_cycle + 0.01 / a_cycle - 220.0) * 10.0;
        assert!((until.expected_s / truth_s - 1.0).abs() < 0.2, "{truth_s}: {until:?}");
        dates += usize::from((until.earliest_s..=until.latest_s).contains(&truth_s));
        let grown = heard.notices_of(NoticeKind::ConditionGrown);
        assert!(
            grown.len() == 1 && grown[0].contains("a day, and matters, at +1.00 % of full command"),
            "{grown:?}"
        );
    }
    // Meant for nine in ten; of eight machines whose sizes share a model's error.
    println!("of 8 machines: rate within its interval on {rates}, onset on {onsets}, date on {dates}");
    assert!(rates >= 5 && onsets >= 5 && dates >= 5, "{rates} {onsets} {dates}");
}

/// A machine as it is, oil and supply as a day and its weather make them, load within 2 %.
fn healthy(machines: u64, stretches: usize, cycles: usize) -> Vec<Heard> {
    let mut weather = Noise::new(23, 0);
    let mut all = Vec::new();
    for (number, baseline) in baselines(machines) {
        for index in 0..stretches {
            // Over the day from 30 to 60 °C, and a supply of its own each time.
            let day = (index as f64 + 0.5) / stretches as f64;
            let oil_c = 45.0 - 15.0 * (std::f64::consts::TAU * day).cos();
            let stretch = Stretch { oil_c, supply: weather.factor(0.01), cycles };
            all.push((number, stretch, Some(baseline.clone())));
        }
    }
    run(&all, |_| 0.0)
}

#[expect(clippy::print_stdout, reason = "the figures that docs/causes.md has")]
fn assert_nothing_found(heard: &[Heard], least_cycles: usize) {
    let cycles: usize = heard.iter().map(|heard| heard.cycles).sum();
    let with_conditions: usize = heard.iter().map(|heard| heard.with_conditions).sum();
    let flags: usize = heard.iter().map(|heard| heard.flags).sum();
    let told: Vec<&str> =
        heard.iter().flat_map(|heard| heard.notices_of(NoticeKind::ConditionFound)).collect();
    println!(
        "{cycles} healthy cycles: {with_conditions} with a condition, {} conditions told, {flags} flags",
        told.len()
    );
    assert!(cycles >= least_cycles, "{cycles}");
    assert_eq!((with_conditions, flags, told.len()), (0, 0, 0), "{told:?}");
}

#[test]
fn load_and_weather_are_no_condition() {
    assert_nothing_found(&healthy(8, 4, 25), 700);
}

#[test]
#[ignore = "some minutes: cargo test --release -p seepd --test program conditions:: -- --ignored --nocapture"]
fn load_and_weather_are_no_condition_in_ten_thousand_cycles() {
    assert_nothing_found(&healthy(40, 10, 26), 10_000);
}
