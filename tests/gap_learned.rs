//! Causes without a name, made by another simulator: a law is learned in their place, where it acts and how, and the machine with it is a
//! plant file that the other commands know.

use std::fs;
use std::path::{Path, PathBuf};

use seepd_blind::Press;
use seepd_blind::foreign::Foreign;
use seepd_blind::press::Variation;
use seepd_sim::noise::Noise;
use seepd_sim::{Controller, DutyCycle, PlantParameters};
use serde_json::Value;

use crate::support::{seepd, simulate, stderr, stdout};

/// A log of 15 cycles of the press with that cause, load varying by 1.4 %, as a CSV.
fn planted(folder: &Path, foreign: Foreign) -> PathBuf {
    let press = Press {
        plant: PlantParameters { leak_area_m2: 2e-7, ..PlantParameters::default() },
        controller: Controller::default(),
        cycle: DutyCycle::default(),
        planted: seepd_blind::press::EffectValues::new(),
        other_law: false,
        foreign: Some(foreign),
    };
    let mut noise = Noise::new(11, 5);
    let mut text = String::from("t_s;command;demand;position;p_supply;p_inlet;p_cap;p_rod;load\n");
    let mut tick = 0u32;
    let finite = press.run(15, Variation { load: 0.014, jitter_s: 0.0, seed: 4 }, |sample| {
        let [p_s, p_3, p_1, p_2] = sample.pressures_pa.map(|pressure| pressure + noise.normal(2e4));
        text += &format!(
            "{:.3};{:.6};{:.6};{:.7};{p_s:.0};{p_3:.0};{p_1:.0};{p_2:.0};{:.1}\n",
            f64::from(tick) * 1e-3,
            sample.command + noise.normal(1e-3),
            sample.demand_m,
            sample.position_m + noise.normal(1e-5),
            sample.load_n,
        );
        tick += 1;
    });
    assert!(finite);
    let log = folder.join("planted.csv");
    fs::write(&log, text).unwrap();
    log
}

/// The diagnosis of a log, and the plant file that it emits.
fn diagnosed(folder: &Path, log: &Path) -> (Value, PathBuf) {
    let emitted = folder.join("as-it-is.toml");
    let output = seepd([
        "gap",
        log.to_str().unwrap(),
        "--json",
        "-",
        "--force",
        "--emit-plant",
        emitted.to_str().unwrap(),
    ]);
    (serde_json::from_str(&stdout(&output)).unwrap(), emitted)
}

/// Largest difference of the learned curve from the true one where the log has been, over the true one's largest value; both without the
/// straight line that calibration may take or give.
fn missed(law: &Value, truth: impl Fn(f64) -> f64) -> f64 {
    let list = |key: &str| -> Vec<f64> {
        law[key].as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
    };
    let (at, values) = (list("at"), list("values"));
    let visited = |knot: &usize| law["visited"][*knot].as_bool().unwrap();
    let points: Vec<(f64, f64, f64)> =
        (0..at.len()).filter(visited).map(|knot| (at[knot], values[knot], truth(at[knot]))).collect();
    let n = points.len() as f64;
    let x_mean = points.iter().map(|point| point.0).sum::<f64>() / n;
    let d_mean = points.iter().map(|point| point.1 - point.2).sum::<f64>() / n;
    let xx: f64 = points.iter().map(|point| (point.0 - x_mean).powi(2)).sum();
    let slope: f64 =
        points.iter().map(|point| (point.0 - x_mean) * (point.1 - point.2 - d_mean)).sum::<f64>() / xx;
    let rest = points.iter().map(|point| (point.1 - point.2 - d_mean - slope * (point.0 - x_mean)).abs());
    let low = points.iter().map(|point| point.2).fold(f64::INFINITY, f64::min);
    let high = points.iter().map(|point| point.2).fold(f64::NEG_INFINITY, f64::max);
    rest.fold(0.0, f64::max) / (high - low)
}

#[test]
fn a_drag_is_learned_as_a_force_over_speed_and_simulated_elsewhere() {
    let folder = tempfile::tempdir().unwrap();
    let log = planted(folder.path(), Foreign::Drag { coefficient: 6e4 });
    let (found, emitted) = diagnosed(folder.path(), &log);
    assert_eq!(found["verdict"], "unknown", "{found}");
    let law = &found["learned"][0];
    assert_eq!((&law["place"], &law["argument"]), (&"force on the piston".into(), &"speed".into()), "{law}");
    assert!(law["probability"].as_f64().unwrap() > 0.5, "{law}");
    assert!(law["shrink"].as_f64().unwrap() > 0.8, "{law}");
    let off = missed(law, |v| -6e4 * v * v.abs());
    assert!(off < 0.15, "{off:.3} of its range: {law}");
    // The plant file has it, and the others know it.
    assert!(fs::read_to_string(&emitted).unwrap().contains("[effects.learned_force_over_speed]"));
    stdout(&seepd(["check", emitted.to_str().unwrap()]));
    let again = folder.path().join("again.mcap");
    simulate(&again, &["--plant", emitted.to_str().unwrap(), "--cycles", "6"]);
    let output = seepd(["gap", again.to_str().unwrap(), "--plant", emitted.to_str().unwrap(), "--json", "-"]);
    let closed: Value = serde_json::from_str(&stdout(&output)).unwrap();
    assert_eq!(closed["verdict"], "no_gap", "{closed}");
}

#[test]
#[ignore = "some minutes: cargo test --release -p seepd --test program gap_learned:: -- --ignored --nocapture"]
fn every_cause_without_a_name() {
    let folder = tempfile::tempdir().unwrap();
    for strength in [0.3, 0.8] {
        for foreign in Foreign::all(strength) {
            let log = planted(folder.path(), foreign);
            let (found, _) = diagnosed(folder.path(), &log);
            let told: Vec<String> = found["learned"]
                .as_array()
                .unwrap()
                .iter()
                .map(|law| {
                    format!(
                        "{:.2} {} over {} ({:.2}{}): {}",
                        law["probability"].as_f64().unwrap(),
                        law["place"].as_str().unwrap(),
                        law["argument"].as_str().unwrap(),
                        law["shrink"].as_f64().unwrap(),
                        if law["adopted"] == true { ", adopted" } else { "" },
                        law["resembles"].as_str().unwrap()
                    )
                })
                .collect();
            println!(
                "{} {strength}: {} {} unknown {:.2}, {} s\n    {}",
                foreign.name(),
                found["verdict"],
                found["chosen"],
                found["unknown_probability"].as_f64().unwrap(),
                found["seconds"],
                told.join("\n    ")
            );
        }
    }
}

#[test]
fn a_law_that_runs_backwards_is_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let plant = folder.path().join("plant.toml");
    fs::write(&plant, "[effects.learned_force_over_speed]\nfrom = 0.2\nto = 0.1\nat_00 = 10.0\n").unwrap();
    let output = seepd(["check", plant.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(78));
    assert!(stderr(&output).contains("must be above `from`"), "{}", stderr(&output));
}
