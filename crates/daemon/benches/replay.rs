//! Replay from zstd MCAP in memory to estimates: samples a second on one core.

use std::io::Cursor;

use divan::counter::ItemsCount;
use seepd::alarm::AlarmConfig;
use seepd::config::Config;
use seepd::pipeline::{DutyCycle, Pipeline, PipelineConfig};
use seepd::source::Source;
use seepd::source::mcap::McapSource;

fn main() {
    divan::main();
}

const CYCLES: &str = "20";

/// A simulated log by the program itself.
fn log(command_only: bool) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("log.mcap");
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_seepd"));
    command.args(["simulate", "--cycles", CYCLES, "--no-truth", "--out"]).arg(&path);
    if command_only {
        command.arg("--command-only");
    }
    assert!(command.status().expect("seepd starts").success());
    std::fs::read(path).expect("the log")
}

fn replay(bencher: divan::Bencher<'_, '_>, command_only: bool) {
    let bytes = log(command_only);
    let config = Config::default();
    let model = seepd::config::embedded_model().expect("the embedded model");
    let (duty_cycles, alarm) = ([DutyCycle::only(&model)], AlarmConfig::default());
    let config = PipelineConfig {
        axis: "axis",
        duty_cycles: &duty_cycles,
        alarm: &alarm,
        reference_dp_pa: config.reference_dp_pa,
        operating_hours_per_year: config.operating_hours_per_year,
    };
    bencher.counter(ItemsCount::new(200_000usize)).bench_local(|| {
        let mut source =
            McapSource::new(Cursor::new(&bytes[..]), "log", Config::default().mapping()).expect("a log");
        let mut pipeline = Pipeline::new(config).expect("the embedded model");
        let mut cycles = 0;
        while let Some(sample) = source.next_sample().expect("samples") {
            pipeline.push(&sample, &mut |_| cycles += 1);
        }
        divan::black_box(cycles)
    });
}

#[divan::bench(sample_count = 20)]
fn command_only(bencher: divan::Bencher<'_, '_>) {
    replay(bencher, true);
}

#[divan::bench(sample_count = 20)]
fn all_eight_signals(bencher: divan::Bencher<'_, '_>) {
    replay(bencher, false);
}
