//! Replay from zstd MCAP in memory to estimates: samples a second on one core.

use std::io::Cursor;

use divan::counter::ItemsCount;
use seepd_logs::{LogMapping, McapSource, Source};
use seepd_monitor::pipeline::{MonitorConfig, Pipeline};

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
    let model = seepd::config::embedded_model().expect("the embedded model");
    let config = MonitorConfig::new("axis", model);
    bencher.counter(ItemsCount::new(200_000usize)).bench_local(|| {
        let mut source =
            McapSource::new(Cursor::new(&bytes[..]), "log", LogMapping::default().places()).expect("a log");
        let mut pipeline = Pipeline::new(config.clone()).expect("the embedded model");
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
