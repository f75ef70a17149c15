//! `export-fmu`: what is written is valid for an independent tool (FMPy), which simulates it to our simulator's numbers, and serves `gap` as its
//! simulator as the native machine does.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{fixture, python, seepd, simulate, stderr, stdout};
use seepd_sim::MachineSpec;
use seepd_sim::cycle::{DriveSample, Schedule};
use seepd_sim::electric::ElectricAxis;
use seepd_sim::machine::{Input, Machine};
use serde_json::Value;

fn text_of(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn export(folder: &Path, name: &str, arguments: &[&str]) -> PathBuf {
    let fmu = folder.join(name);
    let mut all = vec!["export-fmu", "--out", text_of(&fmu)];
    all.extend(arguments);
    stdout(&seepd(&all));
    fmu
}

/// FMPy's run of an FMU that it has validated: rows of the named outputs.
fn simulated(
    mut fmpy: Command,
    fmu: &Path,
    inputs: &str,
    (step_s, start): (f64, &str),
    names: &[&str],
) -> Vec<Vec<f64>> {
    let (given, shown) = (fmu.with_extension("in.csv"), fmu.with_extension("out.csv"));
    fs::write(&given, inputs).unwrap();
    let ran = fmpy
        .args([fixture("fmu/fmpy_run.py"), fmu.into(), given, shown.clone()])
        .args([&step_s.to_string(), start])
        .args(names)
        .output()
        .unwrap();
    assert!(ran.status.success(), "{}: {}", fmu.display(), stderr(&ran));
    let text = fs::read_to_string(shown).unwrap();
    let rows = text.lines().skip(1).map(|line| line.split(',').map(|value| value.parse().unwrap()).collect());
    rows.collect()
}

/// Largest difference of two series over the range of the first.
fn apart(ours: &[f64], theirs: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = ours.iter().fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(*v), high.max(*v)));
    ours.iter().zip(theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / (high - low)
}

const TICKS: usize = 3000;

#[test]
fn reference_fmpy_simulates_the_press_to_our_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let mut spec = MachineSpec::default();
    let start = r#"{"effects.valve_deadband.half_width": 0.03, "effects.valve_lag.natural_frequency_hz": 30.0,
        "effects.coulomb_friction.force_n": 900.0, "plant.leak_area_m2": 3e-7, "plant.mass_kg": 300.0}"#;
    for effect in [
        "valve_deadband.half_width=0.03",
        "valve_lag.natural_frequency_hz=30",
        "coulomb_friction.force_n=900",
    ] {
        spec.set_effect(effect).unwrap();
    }
    (spec.plant.leak_area_m2, spec.plant.mass_kg) = (3e-7, 300.0);
    let spec = spec.with_stable_steps();
    let machine = Machine::<f64>::new(&[&spec]);
    let input = |tick: usize| {
        let at_s = tick as f64 * 1e-3;
        let sample = DriveSample::new(at_s, spec.cycle.demand_m(at_s), -1500.0);
        Input::from(DriveSample { leak_area_m2: 3e-7, ..sample })
    };
    let mut state = machine.start_at(&input(0));
    let ours: Vec<_> = (0..=TICKS).map(|tick| machine.tick(&mut state, &input(tick))).collect();
    let of =
        |signal: fn(&seepd_sim::SimulatedSignals<f64>) -> f64| ours.iter().map(signal).collect::<Vec<_>>();
    let (command, position, p_cap) = (of(|s| s.command), of(|s| s.position), of(|s| s.p_cap));
    for version in ["2", "3"] {
        let Some(fmpy) = python("fmpy") else { return };
        let fmu =
            export(folder.path(), &format!("loop{version}.fmu"), &["--with-controller", "--fmi", version]);
        let mut inputs = String::from("time,demand,load\n");
        (0..=TICKS)
            .for_each(|tick| inputs += &format!("{},{},-1500\n", tick as f64 * 1e-3, input(tick).demand));
        let rows = simulated(fmpy, &fmu, &inputs, (1e-3, start), &["command", "position", "p_cap"]);
        assert_eq!(rows.len(), TICKS + 1);
        // A command is seen after the step that it acted in.
        assert!(apart(&command, rows.iter().skip(1).map(|row| row[0])) < 1e-9, "command, FMI {version}");
        assert!(apart(&position, rows.iter().map(|row| row[1])) < 1e-9, "position, FMI {version}");
        assert!(apart(&p_cap, rows.iter().map(|row| row[2])) < 1e-9, "pressure, FMI {version}");

        let Some(fmpy) = python("fmpy") else { return };
        let fmu = export(folder.path(), &format!("plant{version}.fmu"), &["--fmi", version]);
        let mut inputs = String::from("time,command,load\n");
        let each = command.iter().enumerate();
        each.for_each(|(tick, command)| inputs += &format!("{},{command},-1500\n", tick as f64 * 1e-3));
        let rows = simulated(fmpy, &fmu, &inputs, (1e-3, start), &["position", "p_cap"]);
        assert!(apart(&position, rows.iter().map(|row| row[0])) < 1e-9, "position alone, FMI {version}");
        assert!(apart(&p_cap, rows.iter().map(|row| row[1])) < 1e-9, "pressure alone, FMI {version}");
    }
}

const AXIS: &str = "kind = \"electric_axis\"
[plant]
mass_kg = 95.0
viscous_friction_n_s_per_m = 200.0
full_force_n = 350.0
stroke_m = 0.3
[controller]
position_gain_per_s = 20.0
velocity_gain_s_per_m = 3.0
period_s = 0.001
steps_per_period = 4
[cycle]
period_s = 4.0
load = []
moves = [{ name = \"out\", from_s = 0.2, to_s = 1.4, to_m = 0.25 }, { name = \"back\", from_s = 2.2, to_s = 3.4, to_m = 0.05 }]
";

#[test]
fn reference_fmpy_simulates_the_electric_axis_to_our_numbers() {
    let Some(fmpy) = python("fmpy") else { return };
    let folder = tempfile::tempdir().unwrap();
    let plant = folder.path().join("axis.toml");
    fs::write(&plant, AXIS).unwrap();
    let emitted = folder.path().join("simulator.toml");
    let arguments =
        ["--with-controller", "--fmi", "3", "--plant", text_of(&plant), "--emit-plant", text_of(&emitted)];
    let fmu = export(folder.path(), "axis.fmu", &arguments);
    let mut axis = ElectricAxis::from_toml(AXIS).unwrap();
    axis.effects = [("coulomb_friction".into(), [("force_n".into(), 20.5)].into())].into();
    let schedule = Schedule::new(&axis.cycle, axis.controller.period_s, Vec::new());
    let drive: Vec<DriveSample> = schedule.take(TICKS + 1).collect();
    let mut ours = Vec::new();
    axis.follow(&drive, |_, signals| ours.push(signals.position_m));
    let mut inputs = String::from("time,demand,load\n");
    drive.iter().for_each(|sample| inputs += &format!("{},{},0\n", sample.at_s, sample.demand_m));
    let start = r#"{"effects.coulomb_friction.force_n": 20.5}"#;
    let rows = simulated(fmpy, &fmu, &inputs, (1e-3, start), &["position"]);
    assert!(apart(&ours, rows.iter().map(|row| row[0])) < 1e-9);
    assert!(stdout(&seepd(["check", text_of(&emitted)])).contains("simulator of your own"));
}

/// The monitor beside a model says what `replay` says of the same command.
#[test]
fn reference_the_monitor_in_fmpy_says_what_replay_says() {
    let Some(fmpy) = python("fmpy") else { return };
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    simulate(&log, &["--cycles", "2", "--leak-area", "1e-6"]);
    let lines = stdout(&seepd(["replay", "--json", text_of(&log)]));
    let last = lines.lines().rfind(|line| line.contains("seepd.cycle/1")).unwrap();
    let last: Value = serde_json::from_str(last).unwrap();
    let survey = fs::read(&log).unwrap();
    let mut commands = Vec::new();
    for message in mcap::MessageStream::new(&survey).unwrap() {
        let message = message.unwrap();
        if message.channel.topic == "/axis/signals" {
            let signals: Value = serde_json::from_slice(&message.data).unwrap();
            commands.push(signals["command"].as_f64().unwrap());
        }
    }
    let mut inputs = String::from("time,command\n");
    let each = commands.iter().chain(commands.last()).enumerate();
    each.for_each(|(tick, command)| inputs += &format!("{},{command}\n", tick as f64 * 1e-3));
    let fmu = export(folder.path(), "monitor.fmu", &["--monitor"]);
    let names =
        ["leak_area", "leak_area_low", "leak_area_high", "leak_flow", "cycles", "no_estimate", "severe"];
    let rows = simulated(fmpy, &fmu, &inputs, (1e-3, "{}"), &names);
    let (first, end) = (&rows[0], &rows[rows.len() - 1]);
    assert_eq!((first[0], first[4], first[5]), (0.0, 0.0, 1.0));
    assert_eq!(end[4], 2.0);
    let close = |ours: &Value, theirs: f64| {
        let ours = ours.as_f64().unwrap();
        assert!((theirs / ours - 1.0).abs() < 1e-6, "{theirs} {ours}");
    };
    close(&last["leak_area_m2"], end[0]);
    close(&last["interval90_m2"][0], end[1]);
    close(&last["interval90_m2"][1], end[2]);
    close(&last["leak_flow_lpm"], end[3] * 60_000.0);
}

/// A short cycle, so that a diagnosis is cheap.
const SHORT: &str = "[cycle]
period_s = 1.6
load = []
[[cycle.moves]]
name = \"extend\"
from_s = 0.1
to_s = 0.55
to_m = 0.2
[[cycle.moves]]
name = \"retract\"
from_s = 0.85
to_s = 1.3
to_m = 0.1
";

/// Verdict, chosen effects and probabilities by effect.
fn verdict(log: &Path, plant: &Path, most: &[&str]) -> (String, Value, Vec<(String, f64)>) {
    let found =
        stdout(&seepd([&["gap", text_of(log), "--plant", text_of(plant), "--json", "-"], most].concat()));
    let found: Value = serde_json::from_str(&found).unwrap();
    let effects = found["effects"].as_array().unwrap().iter();
    let mut probabilities: Vec<(String, f64)> =
        effects.map(|e| (e["effect"].as_str().unwrap().into(), e["probability"].as_f64().unwrap())).collect();
    for other in ["unknown_probability", "no_effect_probability"] {
        probabilities.push((other.into(), found[other].as_f64().unwrap()));
    }
    (found["verdict"].as_str().unwrap().into(), found["chosen"].clone(), probabilities)
}

/// A handful of what `docs/SIMULATOR_VALIDATION.md` tells: the exported press is diagnosed as the native one.
#[test]
fn the_exported_press_gives_the_native_verdicts() {
    let folder = tempfile::tempdir().unwrap();
    let (plant, emitted) = (folder.path().join("press.toml"), folder.path().join("simulator.toml"));
    fs::write(&plant, SHORT).unwrap();
    export(folder.path(), "press.fmu", &["--plant", text_of(&plant), "--emit-plant", text_of(&emitted)]);
    for effect in ["valve_deadband.half_width=0.04", "external_leak.cap_m3_per_s_pa=5e-12"] {
        let log = folder.path().join(format!("{effect}.mcap"));
        simulate(
            &log,
            &["--plant", text_of(&plant), "--cycles", "8", "--leak-area", "2e-7", "--with", effect],
        );
        // Its answer comes to the same with the thousands that are usual.
        let (native, exported) =
            (verdict(&log, &plant, &[]), verdict(&log, &emitted, &["--simulations", "1200"]));
        assert_eq!((&native.0, &native.1), (&exported.0, &exported.1), "{effect}");
        for (name, probability) in &exported.2 {
            let of_native = native.2.iter().find(|(other, _)| other == name).map_or(0.0, |(_, p)| *p);
            assert!((probability - of_native).abs() < 0.05, "{effect}: {name} {of_native} {probability}");
        }
    }
}

/// A program without the library beside it says what to do, and a library for another machine is refused.
#[test]
fn a_missing_library_is_told_in_a_line() {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("seepd");
    // A process of its own writes the copy. Had this one open it for writing, a program that another
    // test starts at that moment would inherit it open, and Linux starts no file that somebody writes.
    let copied = Command::new("cp").arg(env!("CARGO_BIN_EXE_seepd")).arg(&program).status().unwrap();
    assert!(copied.success());
    let out = folder.path().join("press.fmu");
    let run = |arguments: &[&str]| {
        Command::new(&program)
            .arg("export-fmu")
            .args(["--out", text_of(&out)])
            .args(arguments)
            .output()
            .unwrap()
    };
    let missing = run(&[]);
    assert_eq!(missing.status.code(), Some(66), "{}", stderr(&missing));
    assert!(stderr(&missing).contains("cargo build --release -p seepd-fmu-library") && !out.exists());
    assert_eq!(stderr(&missing).lines().count(), 1);
    let library =
        Path::new(env!("CARGO_BIN_EXE_seepd")).with_file_name("deps").join("libseepd_fmu_library.so");
    // Beside the program, where an archive of both has it.
    fs::copy(&library, folder.path().join("libseepd_fmu_library.so")).unwrap();
    assert!(stdout(&run(&[])).contains("FMI 2.0"));
    let wrong = run(&["--force", "--library", &format!("x86_64-windows={}", text_of(&library))]);
    assert_eq!(wrong.status.code(), Some(65), "{}", stderr(&wrong));
    assert!(stderr(&wrong).contains("it is not a library for x86_64-windows"));
    for (arguments, code) in [
        (["--library", "amiga=x.so"], 64),
        (["--library", "x86_64-linux=missing.so"], 66),
        (["--plant", "missing.toml"], 66),
        (["--monitor", "missing.json"], 66),
        (["--fmi", "1"], 64),
    ] {
        let refused = run(&["--force", arguments[0], arguments[1]]);
        assert_eq!(refused.status.code(), Some(code), "{arguments:?}: {}", stderr(&refused));
    }
}
