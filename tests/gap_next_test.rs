//! The next test: proposed where a log leaves several explanations, run on the machine, and diagnosed together with the log.

use std::fs;
use std::path::Path;

use seepd_sim::MachineSpec;
use serde_json::Value;

use crate::support::{seepd, simulate, stderr, stdout};

/// Friction that this duty cycle hardly tells from one that sticks at rest.
const FRICTION: &str = "coulomb_friction.force_n=1200";

fn diagnosed(arguments: &[&str]) -> Value {
    let arguments = [&["gap", "--json", "-", "--force"][..], arguments].concat();
    serde_json::from_str(&stdout(&seepd(arguments))).unwrap()
}

/// Probability of an effect.
fn share(found: &Value, effect: &str) -> f64 {
    let effects = found["effects"].as_array().unwrap();
    effects.iter().find(|one| one["effect"] == effect).map_or(0.0, |one| one["probability"].as_f64().unwrap())
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_test_is_proposed_written_and_diagnosed_with_the_log() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    simulate(&log, &["--cycles", "12", "--leak-area", "2e-7", "--with", FRICTION]);
    let tests = folder.path().join("next");
    fs::create_dir(&tests).unwrap();
    let before = diagnosed(&[text(&log), "--emit-test", text(&tests)]);
    let next = &before["next_test"];
    assert!(next["explanations"].as_array().unwrap().len() >= 2, "{next}");
    let worth: Vec<f64> = next["proposals"]
        .as_array()
        .unwrap()
        .iter()
        .map(|proposal| proposal["information_bit"].as_f64().unwrap())
        .collect();
    assert!(worth.windows(2).all(|pair| pair[0] >= pair[1]) && worth[0] >= 0.0, "{worth:?}");

    // The test stays within the strokes of the log, ends where it begins, and comes three times.
    let plant = tests.join("next-test.toml");
    let cycle = MachineSpec::from_toml(&fs::read_to_string(&plant).unwrap()).unwrap().cycle;
    let (low, high) = cycle.reach_m();
    assert!(low >= 0.1 - 1e-9 && high <= 0.38 + 1e-9 && cycle.period_s <= 60.0, "{low} {high}");
    let demand = fs::read_to_string(tests.join("next-test.csv")).unwrap();
    assert_eq!(demand.lines().count(), 1 + 3 * (cycle.period_s / 1e-3).round() as usize);

    // The machine runs it.
    let mut truth = MachineSpec { cycle, ..MachineSpec::default() };
    truth.set_effect(FRICTION).unwrap();
    let machine = folder.path().join("machine.toml");
    fs::write(&machine, truth.to_toml().unwrap()).unwrap();
    let answer = folder.path().join("test.mcap");
    simulate(&answer, &["--plant", text(&machine), "--cycles", "5", "--leak-area", "2e-7", "--seed", "8"]);
    let after = diagnosed(&[text(&log), "--also", text(&answer), "--test-plant", text(&plant)]);
    let (was, is) = (share(&before, "coulomb_friction"), share(&after, "coulomb_friction"));
    println!("{was:.2} before, {is:.2} after: {}", next["proposals"][0]["what"]);
    assert_eq!(after["chosen"][0], "coulomb_friction", "{after}");
    assert!(is > was - 0.05, "{was:.2} before, {is:.2} after");
    assert!(after["notes"].to_string().contains("5 cycles of a test are fitted to as well"), "{after}");
}

#[test]
fn a_test_of_another_cycle_is_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    simulate(&log, &["--cycles", "4"]);
    let plant = folder.path().join("slow.toml");
    let mut spec = MachineSpec::default();
    spec.cycle.period_s = 17.0;
    spec.cycle.moves[0].to_s = 2.9;
    spec.cycle.moves[2].from_s = 14.0;
    spec.cycle.moves[2].to_s = 16.0;
    fs::write(&plant, spec.to_toml().unwrap()).unwrap();
    let output = seepd(["gap", text(&log), "--also", text(&log), "--test-plant", text(&plant)]);
    assert_eq!(output.status.code(), Some(65));
    assert!(stderr(&output).contains("do not match"), "{}", stderr(&output));
    let output = seepd(["gap", text(&log), "--also", text(&log)]);
    assert_eq!(output.status.code(), Some(64), "{}", stderr(&output));
}
