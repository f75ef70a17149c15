//! `adopt` on whole logs of machines that the embedded model does not know: what comes of it, and what it refuses.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::{estimates, replay, seepd, simulate, stderr, stdout};
use serde_json::Value;

/// A press of another bore, valve, pump and controller with a 7 s cycle.
const PLANT: &str = r#"
[plant]
cap_area_m2 = 7.854e-3
annulus_area_m2 = 5.391e-3
stroke_m = 0.4
mass_kg = 600
valve_m3_per_s_sqrt_pa = 1.7e-6
pump_flow_m3_per_s = 3e-3
supply_volume_m3 = 4e-3
inlet_volume_m3 = 8e-4
relief_resistance_pa_s_per_m3 = 2.5e8
line_m3_per_s_sqrt_pa = 5.75e-6
cap_dead_volume_m3 = 4e-4
rod_dead_volume_m3 = 4e-4
viscous_friction_n_s_per_m = 15000
[controller]
kp = 16
ki = 18
[cycle]
period_s = 7.0
load = []
[[cycle.moves]]
name = "down"
from_s = 0.5
to_s = 2.2
to_m = 0.33
[[cycle.moves]]
name = "up"
from_s = 3.8
to_s = 5.6
to_m = 0.06
"#;

const MACHINE: &str = "[cylinder]\nbore_mm = 100\nrod_mm = 56\nstroke_mm = 400\nmoved_mass_kg = 550\n\
                       [valve]\nrated_flow_lpm = 180\nrated_at_bar = 70\n[supply]\npump_flow_lpm = 190\nrelief_bar = 160\n";

/// Its healthy log and its data sheet in a folder.
fn machine(folder: &Path) -> (PathBuf, PathBuf, PathBuf) {
    let (plant, log, data) =
        (folder.join("plant.toml"), folder.join("healthy.mcap"), folder.join("machine.toml"));
    fs::write(&plant, PLANT).unwrap();
    fs::write(&data, MACHINE).unwrap();
    simulate(&log, &["--plant", text_of(&plant), "--cycles", "40", "--seed", "3"]);
    (plant, log, data)
}

fn text_of(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn another_press_is_adopted_and_its_leak_sized() {
    let folder = tempfile::tempdir().unwrap();
    let (plant, log, data) = machine(folder.path());
    let out = folder.path().join("press-3");
    let adopt =
        ["adopt", text_of(&log), "--machine", text_of(&data), "--out", text_of(&out), "--quick", "--json"];
    let output = seepd(adopt);
    let told: Value = serde_json::from_str(&stdout(&output)).unwrap();
    assert_eq!(told["schema"], "seepd.adopt/1");
    assert!((told["cycle"]["period_s"].as_f64().unwrap() - 7.0).abs() < 0.02, "{}", told["cycle"]);
    assert_eq!((&told["cycle"]["strokes"], &told["axis"]), (&Value::from(2), &Value::from("press-3")));
    // The valve was 6 % smaller on the data sheet; the log has its position.
    let valve = &told["machine"]["values"]["valve_m3_per_s_sqrt_pa"];
    assert!((valve["value"].as_f64().unwrap() / 1.7e-6 - 1.0).abs() < 0.03, "{valve}");
    let smallest_lpm = told["smallest_leak_lpm"].as_f64().unwrap();
    assert!((0.02..1.5).contains(&smallest_lpm), "{smallest_lpm}");
    for name in [
        "seepd.toml",
        "plant.toml",
        "training.toml",
        "model.json",
        "baseline.json",
        "machine.toml",
        "adopt.html",
    ] {
        assert!(out.join(name).exists(), "{name}");
    }
    let config = out.join("seepd.toml");
    stdout(&seepd([
        "check",
        text_of(&config),
        text_of(&out.join("plant.toml")),
        text_of(&out.join("model.json")),
    ]));
    let page = fs::read_to_string(out.join("adopt.html")).unwrap();
    assert!(page.contains("Adopted: press-3") && page.contains("extend") && !page.contains("http"));
    // The data sheet's valve, as it writes it.
    assert!(page.contains("L/min at 70 bar over the loop") && page.contains("valve_m3_per_s_sqrt_pa = "));

    // 3 L/min at 70 bar are 0.56 mm², 1.6 % of what the valve passes.
    let leaking = folder.path().join("leaking.mcap");
    let leak = ["--plant", text_of(&plant), "--cycles", "12", "--leak-area", "5.63e-7", "--seed", "4"];
    simulate(&leaking, &leak);
    let mut sizes = estimates(&replay(&leaking, &["--config", text_of(&config)]));
    sizes.sort_by(f64::total_cmp);
    let median = sizes[sizes.len() / 2];
    assert!(sizes.len() >= 10 && (median / 5.63e-7 - 1.0).abs() < 0.10, "{sizes:?}");
    // A null that shifts is none.
    let shifted = folder.path().join("shifted.mcap");
    let shift =
        ["--plant", text_of(&plant), "--cycles", "12", "--with", "valve_bias.offset=0.008", "--seed", "5"];
    simulate(&shifted, &shift);
    let cycles = replay(&shifted, &["--config", text_of(&config)]);
    let told = |key: &str, value: &str| cycles.iter().filter(|cycle| cycle[key] == value).count();
    assert!(told("flag", "healthy") >= 10 && told("cause", "valve_null") >= 10, "{cycles:?}");

    // What was adopted stays unless asked.
    let again = seepd(["adopt", text_of(&log), "--out", text_of(&out)]);
    assert_eq!(again.status.code(), Some(64));
    assert!(stderr(&again).contains("--from STEP goes on with it"), "{}", stderr(&again));
    // From the baseline on nothing is trained: the model stays the same file.
    let model = fs::read(out.join("model.json")).unwrap();
    stdout(&seepd(["adopt", text_of(&log), "--out", text_of(&out), "--from", "baseline"]));
    assert_eq!(fs::read(out.join("model.json")).unwrap(), model);
}

#[test]
fn data_that_cannot_be_of_this_machine_are_refused_in_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let (_, log, data) = machine(folder.path());
    let refused = |text: &str, code: i32| {
        fs::write(&data, text).unwrap();
        let out = folder.path().join("refused");
        let output = seepd(["adopt", text_of(&log), "--machine", text_of(&data), "--out", text_of(&out)]);
        assert_eq!(output.status.code(), Some(code), "{}", stderr(&output));
        // What was found so far stays.
        assert!(out.join("machine.toml").exists());
        stderr(&output).lines().last().unwrap().to_owned()
    };
    let rod = refused("[cylinder]\nbore_mm = 56\nrod_mm = 100\n", 78);
    assert!(rod.contains("are cylinder.rod_mm and cylinder.bore_mm exchanged?"), "{rod}");
    let valve = refused("[cylinder]\nbore_mm = 100\n[valve]\nrated_flow_lpm = 4\nrated_at_bar = 70\n", 78);
    assert!(valve.contains("check valve.rated_flow_lpm"), "{valve}");
    let key = refused("[cylinder]\nbore = 100\n", 78);
    assert!(key.contains("bore_mm"), "{key}");
}

#[test]
fn a_log_without_cycles_is_refused_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let (plant, ..) = machine(folder.path());
    let short = folder.path().join("short.mcap");
    simulate(&short, &["--plant", text_of(&plant), "--cycles", "2"]);
    let out = folder.path().join("short");
    let output = seepd(["adopt", text_of(&short), "--out", text_of(&out)]);
    assert_eq!(output.status.code(), Some(65));
    let told = stderr(&output);
    assert!(told.contains("some 50 cycles"), "{told}");
}
