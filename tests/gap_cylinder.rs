//! `seepd gap` on a cylinder that a valve drives open loop, recorded in several files with one pressure each: the machine is a simulation of its
//! own, with a supply of constant pressure and explicit steps of 10 µs.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::{seepd, stderr, stdout};

/// What stands in the plant file and the machine has as well.
const CAP_M2: f64 = 2e-4;
const ANNULUS_M2: f64 = 1.2e-4;
const STROKE_M: f64 = 0.2;
const SUPPLY_PA: f64 = 4.4e6;
const RETURN_PA: f64 = 1e5;
const MASS_KG: f64 = 1.0;
/// What the plant file does not know: it says 5e-8, 50 N s/m and no friction.
const VALVE: f64 = 6e-8;
const VISCOUS_N_S_PER_M: f64 = 40.0;
const COULOMB_N: f64 = 60.0;

const PLANT: &str = "
[plant]
cap_area_m2 = 2e-4
annulus_area_m2 = 1.2e-4
stroke_m = 0.2
relief_pressure_pa = 4.4e6
relief_resistance_pa_s_per_m3 = 1e9
pump_flow_m3_per_s = 1e-4
return_pressure_pa = 1e5
valve_m3_per_s_sqrt_pa = 5e-8
line_m3_per_s_sqrt_pa = 1e-6
supply_volume_m3 = 1e-3
inlet_volume_m3 = 1e-4
cap_dead_volume_m3 = 3e-5
rod_dead_volume_m3 = 3e-5
bulk_modulus_pa = 3e8
mass_kg = 1.0
viscous_friction_n_s_per_m = 50.0
transition_pressure_pa = 5e4

[controller]
kind = \"none\"
steps_per_period = 10
";

const MAPPING: &str = "
[signals.command]
field = \"volts\"
scale = 0.1
[signals.position]
field = \"x_m\"
[signals.p_cap]
field = \"pa\"
[signals.p_rod]
field = \"pb\"
";

/// The machine's states: pressures, position, speed.
struct Cylinder {
    p_a: f64,
    p_b: f64,
    x: f64,
    v: f64,
}

impl Cylinder {
    /// A step of `dt` s under a command.
    fn step(&mut self, u: f64, valve: f64, dt: f64) {
        let orifice = |opening: f64, dp: f64| opening * dp.signum() * dp.abs().sqrt();
        let k = valve * u.abs();
        let (at_a, at_b) = if u > 0.0 { (SUPPLY_PA, RETURN_PA) } else { (RETURN_PA, SUPPLY_PA) };
        let (q_a, q_b) = (orifice(k, at_a - self.p_a), orifice(k, at_b - self.p_b));
        let beta = 3e8;
        let friction = VISCOUS_N_S_PER_M * self.v + COULOMB_N * (self.v / 5e-3).tanh();
        let force = CAP_M2 * self.p_a - ANNULUS_M2 * self.p_b - friction;
        self.p_a = (self.p_a + dt * beta * (q_a - CAP_M2 * self.v) / (3e-5 + CAP_M2 * self.x)).max(0.0);
        self.p_b = (self.p_b
            + dt * beta * (q_b + ANNULUS_M2 * self.v) / (3e-5 + ANNULUS_M2 * (STROKE_M - self.x)))
            .max(0.0);
        self.v += dt * force / MASS_KG;
        self.x += dt * self.v;
        if self.x <= 0.0 {
            (self.x, self.v) = (0.0, self.v.max(0.0));
        } else if self.x >= STROKE_M {
            (self.x, self.v) = (STROKE_M, self.v.min(0.0));
        }
    }
}

/// A deterministic disturbance of some sensor, −1 … 1.
fn noise(state: &mut u64) -> f64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Writes a run: up at that many volts, a rest at the end, and down again. One pressure is recorded.
fn record(folder: &Path, volts: f64, pressure: &str, repetition: u64) -> PathBuf {
    let path = folder.join(format!("{volts}v-{pressure}-{repetition}.csv"));
    let mut machine = Cylinder { p_a: RETURN_PA, p_b: SUPPLY_PA, x: 0.0, v: 0.0 };
    let mut seed = repetition * 977 + volts as u64 * 31 + pressure.len() as u64;
    // Warm oil: repetitions differ a little.
    let valve = VALVE * (1.0 + 0.002 * (repetition as f64 - 1.0));
    let mut text = format!("t_s,volts,x_m,{pressure}\n");
    for tick in 0..7000u32 {
        let at_s = f64::from(tick) * 1e-3;
        let command = match at_s {
            s if s < 0.1 => 0.0,
            s if s < 3.5 => volts,
            s if s < 3.6 => 0.0,
            _ => -volts,
        };
        let shown = if pressure == "pa" { machine.p_a } else { machine.p_b };
        let (x, p) = (machine.x + 1e-4 * noise(&mut seed), shown + 1e4 * noise(&mut seed));
        let _ = writeln!(text, "{at_s:.3},{command},{x:.6},{p:.0}");
        for _ in 0..100 {
            machine.step(0.1 * command, valve, 1e-5);
        }
    }
    std::fs::write(&path, text).expect("a run");
    path
}

struct Rig {
    folder: tempfile::TempDir,
    plant: PathBuf,
    mapping: PathBuf,
}

fn rig() -> Rig {
    let folder = tempfile::tempdir().expect("a folder");
    let (plant, mapping) = (folder.path().join("servo.toml"), folder.path().join("mapping.toml"));
    std::fs::write(&plant, PLANT).expect("a plant file");
    std::fs::write(&mapping, MAPPING).expect("a mapping");
    Rig { folder, plant, mapping }
}

impl Rig {
    fn run(&self, volts: f64, pressure: &str, repetition: u64) -> PathBuf {
        record(self.folder.path(), volts, pressure, repetition)
    }

    fn seepd(&self, command: &[&str], runs: &[PathBuf], more: &[&str]) -> std::process::Output {
        let paths = runs.iter().map(|run| run.to_str().expect("UTF-8"));
        let files = [
            "--plant",
            self.plant.to_str().expect("UTF-8"),
            "--config",
            self.mapping.to_str().expect("UTF-8"),
        ];
        seepd(command.iter().copied().chain(paths).chain(files).chain(more.iter().copied()))
    }
}

/// The rows of a prediction: run, signal, error, mean.
fn rows(text: &str) -> Vec<(String, String, f64)> {
    let row = |line: &str| {
        let words: Vec<&str> = line.split_whitespace().collect();
        Some((words.first()?.to_string(), words.get(1)?.to_string(), words.get(2)?.parse().ok()?))
    };
    text.lines().skip(1).filter_map(row).collect()
}

/// Friction is found from runs at two voltages in files with one pressure each, and a run at a third is foretold.
#[test]
fn runs_in_several_files_are_diagnosed_as_one_machine_and_foretell_another_command() {
    let rig = rig();
    let mut runs = Vec::new();
    for volts in [2.0, 4.0] {
        for pressure in ["pa", "pb"] {
            runs.extend([0, 2].map(|repetition| rig.run(volts, pressure, repetition)));
        }
    }
    let [json, fitted] = ["gap.json", "fitted.toml"].map(|name| rig.folder.path().join(name));
    let outputs = ["--json", json.to_str().expect("UTF-8"), "--emit-plant", fitted.to_str().expect("UTF-8")];
    let told = stdout(&rig.seepd(&["gap"], &runs, &outputs));
    assert!(told.starts_with("an effect: "), "{told}");
    let diagnosis: Value = serde_json::from_slice(&std::fs::read(&json).expect("JSON")).expect("JSON");
    // One whose static part is none is the same.
    let first = diagnosis["effects"][0]["effect"].as_str().expect("an effect");
    assert!(["coulomb_friction", "stribeck_friction"].contains(&first), "{told}");
    let friction = diagnosis["effects"][0]["parameters"]["force_n"].as_f64().expect("a force");
    assert!((friction - COULOMB_N).abs() < 0.1 * COULOMB_N, "{friction} N");
    assert_eq!(diagnosis["signals"], serde_json::json!(["command", "position", "p_cap", "p_rod"]));
    assert!(diagnosis["cycles"]["held_out"].as_u64() > Some(0), "{told}");
    assert!(diagnosis["shrink"]["of_removable"].as_f64() > Some(0.9), "{told}");

    // A command that nothing was fitted to.
    let unseen = [rig.run(3.0, "pa", 1), rig.run(3.0, "pb", 1)];
    let folder = rig.folder.path().join("predicted");
    let fitted = Rig { plant: fitted, ..rig };
    let told =
        stdout(&fitted.seepd(&["gap", "predict"], &unseen, &["--out", folder.to_str().expect("UTF-8")]));
    for (run, signal, error) in rows(&told) {
        // mm, mm/s, bar; the piston goes 150 mm a second, and the chambers are at 10 to 40 bar.
        let most = match signal.as_str() {
            "position" => 1.5,
            "speed" => 3.0,
            _ => 1.0,
        };
        assert!(error < most, "{run} {signal} {error}\n{told}");
    }
    let table = std::fs::read_to_string(folder.join("3v-pa-1.csv")).expect("a prediction");
    assert!(table.starts_with("t_s,command,position_m,speed_m_per_s,"), "{}", &table[..80]);
    assert_eq!(table.lines().count(), 7001);
}

/// What is wrong with runs is said in a line.
#[test]
fn runs_that_cannot_be_diagnosed_say_why() {
    let rig = rig();
    let good = rig.run(3.0, "pa", 0);
    let text = std::fs::read_to_string(&good).expect("a run");
    let changed = |name: &str, change: &dyn Fn(&str) -> String| {
        let path = rig.folder.path().join(name);
        let head = text.lines().next().expect("a head");
        let rows: Vec<String> = text.lines().skip(1).map(change).filter(|row| !row.is_empty()).collect();
        std::fs::write(&path, format!("{head}\n{}\n", rows.join("\n"))).expect("a run");
        path
    };
    let position = |row: &str, of: &dyn Fn(f64, f64) -> f64| {
        let words: Vec<&str> = row.split(',').collect();
        let number = |at: usize| words[at].parse::<f64>().expect("a number");
        format!("{},{},{:.6},{}", words[0], words[1], of(number(0), number(2)), words[3])
    };
    let standing = changed("standing.csv", &|row| position(row, &|t, _| 0.1 + 1e-4 * (900.0 * t).sin()));
    let beyond = changed("beyond.csv", &|row| position(row, &|_, x| 1.4 * x));
    let other = changed("other.csv", &|row| position(row, &|_, x| 0.2 * (x / 0.2).powi(3)));
    let turned = changed("turned.csv", &|row| position(row, &|_, x| 0.2 - x));
    let short = changed("short.csv", &|row| if row < "0.15" { row.to_owned() } else { String::new() });
    let told = |runs: &[PathBuf]| {
        let output = rig.seepd(&["gap"], runs, &[]);
        let told = format!("{}{}", String::from_utf8_lossy(&output.stdout), stderr(&output));
        told
    };
    for (runs, wanted) in [
        (vec![standing], "standing.csv: the piston stands in all of it"),
        (vec![beyond], "beyond.csv: the position reaches 0.28"),
        (vec![good.clone(), other], "move differently under the same command"),
        (vec![turned], "the command's sign is inverted"),
        (vec![short], "short.csv: it has"),
    ] {
        let told = told(&runs);
        assert!(told.contains(wanted), "{wanted}: {told}");
        assert_eq!(told.lines().filter(|line| !line.trim().is_empty()).count(), 1, "{told}");
    }
    // What asks for a controller or a demand.
    let plant = rig.plant.to_str().expect("UTF-8");
    let out = rig.folder.path().join("out.mcap");
    let output = seepd(["simulate", "--plant", plant, "--out", out.to_str().expect("UTF-8")]);
    assert_eq!(output.status.code(), Some(78), "{}", stderr(&output));
    assert!(stderr(&output).contains("no controller"), "{}", stderr(&output));
    let output = rig.seepd(&["gap"], std::slice::from_ref(&good), &["--next-test"]);
    assert!(stderr(&output).contains("no controller"), "{}", stderr(&output));
    let several = seepd(["gap", good.to_str().expect("UTF-8"), good.to_str().expect("UTF-8")]);
    assert!(stderr(&several).contains("kind = \"none\""), "{}", stderr(&several));
    assert!(stdout(&seepd(["check", plant])).contains("without a controller"));
}
