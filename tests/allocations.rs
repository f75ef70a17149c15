//! What the pipeline allocates, counted: nothing for a sample; at a cycle's end only what is given back, so that memory stays flat.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use std::sync::{Arc, LazyLock};

use allocation_counter::{AllocationInfo, measure};
use seepd_model::Model;
use seepd_monitor::baseline::CusumFinding;
use seepd_monitor::event::Event;
use seepd_monitor::pipeline::{DutyCycle, MonitorConfig, Pipeline};
use seepd_signals::{Sample, Signal};
use seepd_sim::cycle::CycleRun;
use seepd_sim::noise::Noise;
use seepd_sim::{Input, Machine, MachineSpec, Schedule};

static MODEL: LazyLock<Arc<Model>> =
    LazyLock::new(|| Arc::new(Model::from_json(seepd::EMBEDDED_MODEL).unwrap()));

/// Cycles from which the baseline is learned.
const LEARNED: usize = 20;

/// A machine whose seal begins to wear after its baseline, with a knock and a gap now and then; every signal is there.
static SAMPLES: LazyLock<Vec<Sample>> = LazyLock::new(|| {
    let spec = MachineSpec::default();
    let machine = Machine::<f64>::new(&[&spec]);
    let (mut state, mut noise) = (machine.start(), Noise::new(1, 1));
    let leak = |cycle: usize| 3e-8 * cycle.saturating_sub(LEARNED + 2) as f64;
    let runs: Vec<CycleRun> = (0..LEARNED + 40).map(|cycle| CycleRun::with_leak(leak(cycle))).collect();
    let ticks = 10_000 * runs.len();
    let samples = Schedule::new(&spec.cycle, 1e-3, runs).take(ticks).enumerate().map(|(tick, drive)| {
        let record = machine.tick(&mut state, &Input::gather(&[drive]));
        let mut sample = Sample::command(tick as i64 * 1_000_000, record.command + noise.normal(0.003));
        sample.set(Signal::Demand, record.demand);
        sample.set(Signal::Load, drive.load_n);
        sample
    });
    // A gap in one of the last cycles.
    samples.filter(|sample| !(500_000_000_000..500_300_000_000).contains(&sample.time_ns)).collect()
});

/// What pushing samples allocated: for those at which the pipeline said nothing, and for the others.
#[derive(Default)]
struct Allocated {
    silent: u64,
    /// The most that a cycle's end allocated, bytes.
    most_at_an_event: u64,
    /// Kept when all is done, bytes.
    kept: i64,
    events: usize,
}

fn push(pipeline: &mut Pipeline, samples: &[Sample]) -> Allocated {
    let mut allocated = Allocated::default();
    for sample in samples {
        let mut events = 0;
        let told: AllocationInfo = measure(|| {
            pipeline.push(sample, &mut |event| events += usize::from(!matches!(event, Event::Notice(_))));
        });
        if events == 0 {
            allocated.silent += told.count_total;
        } else {
            allocated.most_at_an_event = allocated.most_at_an_event.max(told.bytes_total);
        }
        allocated.kept += told.bytes_current;
        allocated.events += events;
    }
    allocated
}

fn check(names: &[Option<&str>]) {
    let duty_cycle =
        |name: &Option<&str>| DutyCycle { name: name.map(str::to_owned), model: Arc::clone(&MODEL) };
    let duty_cycles = names.iter().map(duty_cycle).collect();
    let config = MonitorConfig { duty_cycles, ..MonitorConfig::new("axis", Arc::clone(&MODEL)) };
    let mut pipeline = Pipeline::new(config).unwrap();
    // Without a baseline.
    let plain = push(&mut pipeline, &SAMPLES[..60_000]);
    assert!(plain.events >= 5, "{}", plain.events);
    assert_eq!((plain.silent, plain.kept), (0, 0));
    // While one is learned, and compared with from then on.
    pipeline.learn("test", LEARNED).unwrap();
    let (learning, following) = SAMPLES[60_000..].split_at(10_000 * (LEARNED + 1));
    assert_eq!(push(&mut pipeline, learning).silent, 0);
    let following = push(&mut pipeline, following);
    assert_eq!(pipeline.finding(), CusumFinding::Leak);
    assert!(following.events >= 25, "{}", following.events);
    assert_eq!((following.silent, following.kept), (0, 0));
    // The fit of the growth, twice, with at most 48 points: up to 1,128 slopes between them. (More than 0: the counter counts.)
    assert!((1_000..64_000).contains(&following.most_at_an_event), "{}", following.most_at_an_event);
}

#[test]
fn no_sample_allocates() {
    check(&[None]);
}

#[test]
fn no_sample_allocates_where_several_duty_cycles_are_told_apart() {
    check(&[Some("short"), Some("long")]);
}
