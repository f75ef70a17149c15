//! Time of a diagnosis by stage, on three logs of the blind planter whose loads and strokes vary from cycle to cycle: a machine with other
//! parameters alone, one effect, two effects.

#![expect(clippy::disallowed_methods, clippy::print_stdout, reason = "time is what is measured, and told")]

use std::time::{Duration, Instant};

use seepd_blind::{Case, Set};
use seepd_gap::{DiagnosisSettings, Log, Record, diagnose};
use seepd_signals::Signal;
use seepd_sim::MachineSpec;
use seepd_sim::noise::Noise;

/// Duty cycles of a log.
const CYCLES: usize = 24;
/// Stages between which [`diagnose`] tells that it goes on.
const STAGES: [&str; 4] = ["leak alone", "calibration, screening", "search", "held-out gaps, report"];

fn main() {
    // As `cargo test` runs it: what takes seconds is asked for by `cargo bench`.
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    let cases = seepd_blind::draw(71, 4, 1);
    for set in [Set::Parameters, Set::Single, Set::Pair] {
        let Some(case) = cases.iter().find(|case| case.truth.set == set) else { continue };
        let mut case = case.clone();
        (case.truth.load_variation, case.truth.jitter_s) = (0.014, 0.003);
        time(&case);
    }
}

fn time(case: &Case) {
    let spec = MachineSpec::default();
    let log = log_of(case);
    let begin = Instant::now();
    let Ok(record) = Record::new(&log, &spec) else { return };
    let mut last = Instant::now();
    let mut stages: Vec<Duration> = Vec::new();
    let settings = DiagnosisSettings { without: vec![case.without.clone()], ..DiagnosisSettings::default() };
    let (diagnosis, _) = diagnose(&record, &spec, &settings, &mut |_| {
        stages.push(last.elapsed());
        last = Instant::now();
    });
    let planted: Vec<&str> = case.truth.effects.keys().map(String::as_str).collect();
    println!("{:?} {planted:?}: {:?} {:?}", case.truth.set, diagnosis.verdict, diagnosis.chosen);
    for (stage, took) in STAGES.iter().zip(&stages) {
        println!("  {:>6.2} s  {stage}", took.as_secs_f64());
    }
    println!("  {:>6.2} s  in all", begin.elapsed().as_secs_f64());
}

/// What the planted machine logs, with the noise of its sensors.
fn log_of(case: &Case) -> Log {
    let mut noise = Noise::new(case.truth.seed, 11);
    let mut log = Log::default();
    case.truth.press().run(CYCLES, case.truth.variation(), |sample| {
        let pressures = [Signal::PSupply, Signal::PInlet, Signal::PCap, Signal::PRod];
        for ((signal, pressure_pa), transducer) in
            pressures.into_iter().zip(sample.pressures_pa).zip(case.truth.transducers)
        {
            log.values[signal as usize].push(transducer.shown_pa(pressure_pa) + noise.normal(2e4));
        }
        log.values[Signal::Command as usize].push(sample.command + noise.normal(1e-3));
        log.values[Signal::Demand as usize].push(sample.demand_m);
        log.values[Signal::Position as usize].push(sample.position_m + noise.normal(1e-5));
        log.values[Signal::Load as usize].push(sample.load_n + noise.normal(20.0));
    });
    log
}
