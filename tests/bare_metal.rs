//! The same cycle on a Cortex-M4F, in an emulator: the same bits as here.
//!
//! Needs the target `thumbv7em-none-eabihf` and `qemu-system-arm`, which `.ci/run` installs; without them the test
//! says so and is counted as ignored by name: run it with `cargo test -p seepd --test program bare_metal:: -- --ignored`.

use std::fmt::Write;
use std::path::Path;
use std::process::Command;

use seepd_features::Outcome;
use seepd_model::Model;
use seepd_signals::Sample;
use seepd_sim::cycle::CycleRun;
use seepd_sim::noise::Noise;
use seepd_sim::{Input, Machine, MachineSpec, Schedule};

/// A cycle with a leak of 5e-7 m² and noise, with half a second around it, as single precision.
fn cycle() -> Vec<f32> {
    let spec = MachineSpec::default();
    let machine = Machine::<f64>::new(&[&spec]);
    let mut state = machine.start();
    let mut noise = Noise::new(11, 0);
    Schedule::new(&spec.cycle, 1e-3, vec![CycleRun::with_leak(5e-7)])
        .take(20_500)
        .map(|sample| machine.tick(&mut state, &Input::gather(&[sample])).command)
        .skip(9_500)
        .map(|command| (command + noise.normal(0.003)) as f32)
        .collect()
}

/// What the guest prints, computed here.
fn expected(cycle: &[f32]) -> String {
    let model = Model::from_json(seepd::EMBEDDED_MODEL).unwrap();
    let reader = model.reader().unwrap();
    let mut state = reader.start(vec![0.0f32; reader.definition().ring_samples()]).unwrap();
    let mut text = String::new();
    let mut tell = |outcome: Outcome<'_>| match outcome {
        Outcome::Valid(cycle) => {
            for value in cycle.features {
                writeln!(text, "feature {:016x}", value.to_bits()).unwrap();
            }
            let estimate = model.estimate(cycle.features);
            assert!((estimate.value / 5e-7 - 1.0).abs() < 0.1);
            writeln!(text, "estimate {:016x}", estimate.value.to_bits()).unwrap();
            let [low, high] = estimate.interval.map(f64::to_bits);
            writeln!(text, "interval {low:016x} {high:016x}").unwrap();
        }
        Outcome::Rejected(rejected) => writeln!(text, "rejected {}", rejected.reason.name()).unwrap(),
    };
    for (number, command) in cycle.iter().enumerate() {
        let sample = Sample::command(number as i64 * 1_000_000, f64::from(*command));
        reader.push(&mut state, &sample, &mut tell);
    }
    reader.finish(&mut state, &mut tell);
    text
}

#[test]
#[ignore = "needs the thumbv7em-none-eabihf target and qemu-system-arm; .ci/run installs them and runs this"]
fn reference_cortex_m4f_gives_the_hosts_bits() {
    let cycle = cycle();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../bare-metal");
    let bytes: Vec<u8> = cycle.iter().flat_map(|command| command.to_le_bytes()).collect();
    std::fs::write(folder.join("cycle.bin"), bytes).unwrap();
    let output = Command::new("cargo")
        .args(["run", "--release", "--quiet", "--locked"])
        .current_dir(&folder)
        // The flags of the guest's own configuration, not those of this test's run.
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_TARGET_DIR")
        .output()
        .expect("cargo starts");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    let expected = expected(&cycle);
    assert_eq!(expected.lines().count(), 33);
    assert_eq!(text.replace('\r', ""), expected);
}
