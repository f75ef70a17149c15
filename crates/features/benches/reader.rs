//! Cost of a sample: intake checks, filter, segmentation and all features of the embedded model.

use divan::counter::ItemsCount;
use seepd_model::Model;
use seepd_signals::Sample;
use seepd_sim::cycle::CycleRun;
use seepd_sim::noise::Noise;
use seepd_sim::{Input, Machine, MachineSpec, Schedule};

fn main() {
    divan::main();
}

#[divan::bench(sample_count = 20)]
fn filter_and_all_features(bencher: divan::Bencher<'_, '_>) {
    let model =
        Model::from_json(include_bytes!("../../daemon/assets/model.json")).expect("the embedded model");
    let reader = model.reader().expect("the embedded model");
    let spec = MachineSpec::default();
    let machine = Machine::<f64>::new(&[&spec]);
    let mut plant = machine.start();
    let mut noise = Noise::new(1, 1);
    let samples: Vec<Sample> = Schedule::new(&spec.cycle, 1e-3, vec![CycleRun::with_leak(1e-6)])
        .take(50_000)
        .enumerate()
        .map(|(tick, drive)| {
            let command = machine.tick(&mut plant, &Input::gather(&[drive])).command + noise.normal(0.003);
            Sample::command(tick as i64 * 1_000_000, command)
        })
        .collect();
    bencher.counter(ItemsCount::new(samples.len())).bench_local(|| {
        let mut state =
            reader.start(vec![0.0f32; reader.definition().ring_samples()]).expect("memory for a cycle");
        let mut cycles = 0;
        for sample in &samples {
            reader.push(&mut state, sample, &mut |_| cycles += 1);
        }
        divan::black_box(cycles)
    });
}
