//! `learn-baseline` and what is told relative to it, on whole logs: what a baseline cancels, and what it refuses to estimate.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use serde_json::Value;

use crate::support::{estimates, reasons, seepd, simulate, stderr, stdout, summary};

/// A folder with the baselines of two machines: the nominal one, and one with dry friction and a valve that is off its null.
struct Place {
    folder: PathBuf,
}

const FAULTY_VALVE: [&str; 4] =
    ["--with", "valve_bias.offset=0.01", "--with", "coulomb_friction.force_n=500"];
const NOISY: [&str; 4] = ["--noise", "0.003", "--load-variation", "0.05"];

static PLACE: LazyLock<Place> = LazyLock::new(|| {
    let place = Place { folder: crate::support::shared_folder("baseline") };
    for (name, more) in [("nominal", &[][..]), ("faulty", &FAULTY_VALVE[..])] {
        let log = place.log(name, &[&["--cycles", "30"], more].concat());
        stdout(&learn(&place.baseline(name), &[&log], &[]));
    }
    place
});

impl Place {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn baseline(&self, name: &str) -> PathBuf {
        self.path(&format!("{name}.json"))
    }

    /// The log of a machine with noise and varying loads.
    fn log(&self, name: &str, more: &[&str]) -> PathBuf {
        let log = self.path(&format!("{name}.mcap"));
        simulate(&log, &[&NOISY, more].concat());
        log
    }

    fn follow(&self, baseline: &str, log: &Path) -> Vec<Value> {
        crate::support::replay(log, &["--baseline", self.baseline(baseline).to_str().unwrap()])
    }
}

fn learn(out: &Path, logs: &[&Path], more: &[&str]) -> std::process::Output {
    let mut arguments = vec!["learn-baseline", "--out", out.to_str().unwrap()];
    arguments.extend(logs.iter().map(|log| log.to_str().unwrap()));
    arguments.extend(more);
    seepd(arguments)
}

fn told(place: &Place, baseline: &str, log: &Path) -> String {
    let (baseline, log) = (place.baseline(baseline), log.to_str().unwrap().to_owned());
    stdout(&seepd(["replay", "--baseline", baseline.to_str().unwrap(), &log]))
}

/// A valve off its null and dry friction: the model alone sees something else, the comparison the leak.
#[test]
fn what_stays_as_it_was_is_cancelled() {
    let place = &*PLACE;
    let later = [&FAULTY_VALVE[..], &["--cycles", "8", "--leak-area", "5e-7", "--seed", "5"]].concat();
    let lines = place.follow("faulty", &place.log("faulty-leak", &later));
    let (mut relative, mut absolute) = (estimates(&lines), Vec::new());
    absolute.extend(lines.iter().filter_map(|line| line["absolute_leak_area_m2"].as_f64()));
    relative.sort_by(f64::total_cmp);
    absolute.sort_by(f64::total_cmp);
    let error = |values: &[f64]| (values[values.len() / 2] / 5e-7 - 1.0).abs();
    assert!(error(&relative) < 0.10, "{relative:?}");
    assert!(error(&absolute) > 2.0 * error(&relative), "{absolute:?}");
}

#[test]
fn a_small_leak_is_found_is_explained_and_its_interval_begins_above_nothing_for_a_healthy_machine_only() {
    let place = &*PLACE;
    let log = place.log("small", &["--cycles", "20", "--leak-step", "2e-8@10", "--seed", "6"]);
    let lines = place.follow("nominal", &log);
    let cycles = &lines[..lines.len() - 1];
    for line in &cycles[..9] {
        assert_eq!((&line["flag"], &line["finding"]), (&"healthy".into(), &"none".into()), "{line}");
        assert_eq!(line["interval90_m2"][0], 0.0, "{line}");
    }
    let last = &cycles[cycles.len() - 1];
    assert_eq!((&last["flag"], &last["finding"]), (&"watch".into(), &"leak".into()), "{last}");
    // What the phases and the load contribute is the response.
    let sum: f64 = last["why"].as_object().unwrap().values().map(|part| part.as_f64().unwrap()).sum();
    assert!((sum - last["response_m2"].as_f64().unwrap()).abs() < 1e-20, "{last}");
    assert_eq!(last["load"], "measured");
    assert!(told(place, "nominal", &log).contains("more leakage than at the baseline"));
}

#[test]
fn a_baseline_of_a_leaking_machine_is_remarked_on_and_its_new_seal_shows_as_improvement() {
    let place = &*PLACE;
    let worn = place.log("worn", &["--cycles", "30", "--leak-area", "3e-7"]);
    let output = learn(&place.baseline("worn"), &[&worn], &[]);
    let told_mm2 =
        stderr(&output).split_once("a leak of ").and_then(|(_, rest)| rest.split(' ').next()?.parse().ok());
    assert!(told_mm2.is_some_and(|told: f64| (told / 0.3 - 1.0).abs() < 0.05), "{}", stderr(&output));
    let mended = place.log("mended", &["--cycles", "10", "--seed", "7"]);
    assert!(told(place, "worn", &mended).contains("less leakage than at the baseline"));
    // The record keeps the old one.
    let new = place.log("new-seal", &["--cycles", "30", "--seed", "8"]);
    assert_eq!(learn(&place.baseline("worn"), &[&new], &[]).status.code(), Some(64));
    stdout(&learn(&place.baseline("worn"), &[&new], &["--seal-replaced"]));
    let record: Value = serde_json::from_str(&fs::read_to_string(place.baseline("worn")).unwrap()).unwrap();
    assert_eq!(record["baselines"].as_array().unwrap().len(), 2);
    assert_eq!(summary(&place.follow("worn", &mended))["flag"], "healthy");
}

/// Without a baseline: what training does not know has no estimate, and the phase that differs most is named once.
#[test]
fn a_machine_unlike_training_has_no_estimate() {
    let place = &*PLACE;
    let log = place.log("strange", &["--cycles", "8", "--with", "valve_deadband.half_width=0.01"]);
    let lines = crate::support::replay(&log, &[]);
    assert!(estimates(&lines).is_empty(), "{lines:?}");
    assert!(reasons(&lines).iter().all(|reason| reason == "unlike_training"), "{:?}", reasons(&lines));
    let cycles = &lines[..lines.len() - 1];
    assert!(cycles.iter().all(|line| line["absolute_novelty"].as_f64().unwrap() > 1.0));
    assert!(cycles.iter().all(|line| line["absolute_leak_area_m2"].is_number()), "it is still shown");
    assert_eq!(summary(&lines)["flag"], "no_estimate");
    let text = stdout(&seepd(["replay", log.to_str().unwrap()]));
    assert_eq!(text.matches("like no machine that the model was trained on").count(), 1, "{text}");
}

/// A leak larger than any that sizes were learned from is no other fault: it is severe, with a baseline and without.
#[test]
fn a_leak_beyond_training_is_severe() {
    let place = &*PLACE;
    let log = place.log("burst", &["--cycles", "8", "--leak-area", "2e-5"]);
    for lines in [crate::support::replay(&log, &[]), place.follow("nominal", &log)] {
        assert_eq!(summary(&lines)["flag"], "severe", "{}", summary(&lines));
        assert!(reasons(&lines).iter().all(|reason| reason == "incomplete"), "{:?}", reasons(&lines));
    }
}

/// What the features contribute to an estimate explains all of its difference from another.
#[test]
fn contributions_of_the_features_add_up_to_the_estimate() {
    let place = &*PLACE;
    let log = place.log("explained", &["--cycles", "12", "--leak-area", "2e-8", "--leak-growth", "4e-6"]);
    let lines = crate::support::replay(&log, &[]);
    let explained: Vec<(f64, f64)> = lines[..lines.len() - 1]
        .iter()
        .filter_map(|line| {
            let parts = line["absolute_why"].as_object()?.values();
            Some(((line["leak_area_m2"].as_f64()? + 2e-8).ln(), parts.filter_map(Value::as_f64).sum()))
        })
        .collect();
    assert!(explained.len() >= 11 && explained[10].0 - explained[0].0 > 3.0, "{explained:?}");
    // The base is the same for all; contributions are kept in single precision.
    let base = explained[0].0 - explained[0].1;
    assert!(explained.iter().all(|(ln, parts)| (ln - parts - base).abs() < 1e-4), "{explained:?}");
}

#[test]
fn a_replaced_valve_and_another_duty_cycle_get_no_estimate_and_ask_for_a_new_baseline() {
    let place = &*PLACE;
    for (name, more) in [
        ("gain", &["--with", "valve_flow_shape.exponent=1.3"][..]),
        ("more gain", &["--with", "valve_flow_shape.exponent=1.32"]),
    ] {
        let log = place.log(name, &[&["--cycles", "8", "--seed", "9"], more].concat());
        let lines = place.follow("nominal", &log);
        assert!(
            reasons(&lines).iter().all(|reason| reason == "unlike_baseline"),
            "{name}: {:?}",
            reasons(&lines)
        );
        assert!(estimates(&lines).is_empty(), "{name}");
        assert_eq!(summary(&lines)["reason"], "unlike_baseline");
        let text = told(place, "nominal", &log);
        assert!(text.contains("has a valve, a sensor or the duty cycle been changed"), "{text}");
    }
    // The operator has the stroke shortened by a tenth: the shape is the same, the size is not.
    let plant = place.path("short.toml");
    let text = "[[cycle.moves]]\nname = \"extend\"\nfrom_s = 0.5\nto_s = 2.5\nto_m = 0.325\n\
                [[cycle.moves]]\nname = \"press\"\nfrom_s = 3.0\nto_s = 4.0\nto_m = 0.355\n\
                [[cycle.moves]]\nname = \"retract\"\nfrom_s = 6.0\nto_s = 8.5\nto_m = 0.1\n";
    fs::write(&plant, text).unwrap();
    let log = place.log("short", &["--cycles", "6", "--plant", plant.to_str().unwrap()]);
    let lines = place.follow("nominal", &log);
    // One cycle or two may pass for a known cause; more of them do not, and no flag rises.
    assert!(estimates(&lines).len() <= 2, "{:?}", estimates(&lines));
    let highest = &summary(&lines)["highest_flag"];
    assert!(highest == "no_estimate" || highest == "healthy", "{}", summary(&lines));
}

#[test]
fn a_load_signal_that_freezes_is_told_and_not_used() {
    let place = &*PLACE;
    let log = place.log("frozen-load", &["--cycles", "6", "--seed", "10"]);
    // The same log as CSV, with a load that stands still.
    let json = stdout(&seepd(["replay", "--json", log.to_str().unwrap()]));
    assert!(!json.is_empty());
    let csv = place.path("frozen.csv");
    let mut text = String::from("t_s,command,load\n");
    let file = fs::read(&log).unwrap();
    for message in mcap::MessageStream::new(&file).unwrap() {
        let message = message.unwrap();
        if message.channel.topic.ends_with("/signals") {
            let value: Value = serde_json::from_slice(&message.data).unwrap();
            text.push_str(&format!("{:.3},{},-5000\n", message.log_time as f64 / 1e9, value["command"]));
        }
    }
    fs::write(&csv, text).unwrap();
    let lines = place.follow("nominal", &csv);
    assert!(estimates(&lines).len() >= 5);
    assert!(
        lines[..lines.len() - 1]
            .iter()
            .filter(|line| line.get("load").is_some())
            .all(|line| line["load"] == "frozen")
    );
    assert!(told(place, "nominal", &csv).contains("the load signal stands still"));
}

#[test]
fn baselines_that_cannot_be_are_refused_with_the_reason() {
    let place = &*PLACE;
    let short = place.log("few", &["--cycles", "8"]);
    let output = learn(&place.baseline("few"), &[&short], &[]);
    assert_eq!(output.status.code(), Some(65));
    assert!(stderr(&output).contains("a baseline needs 20"), "{}", stderr(&output));
    assert!(!place.baseline("few").exists());
    let log = short.to_str().unwrap();
    for (content, words) in [
        ("{", "is not a baseline"),
        (
            "{\"schema\":\"seepd.baseline/9\",\"axis\":\"a\",\"created_by\":\"\",\"plant_sha256\":\"\",\"phases\":[],\"baselines\":[]}",
            "seepd.baseline/9",
        ),
        (
            "{\"schema\":\"seepd.baseline/1\",\"axis\":\"a\",\"created_by\":\"\",\"plant_sha256\":\"\",\"phases\":[],\"baselines\":[]}",
            "another model",
        ),
    ] {
        let path = place.path("damaged.json");
        fs::write(&path, content).unwrap();
        let output = seepd(["replay", "--baseline", path.to_str().unwrap(), log]);
        assert_eq!(output.status.code(), Some(78), "{}", stderr(&output));
        assert!(stderr(&output).contains(words), "{}", stderr(&output));
    }
    assert_eq!(seepd(["replay", "--learn-cycles", "5", log]).status.code(), Some(64));
    // A configuration that names such a file is found out before the start.
    let configuration = place.path("seepd.toml");
    fs::write(&configuration, "[baseline]\nfile = \"damaged.json\"\n").unwrap();
    assert_eq!(seepd(["check", configuration.to_str().unwrap()]).status.code(), Some(78));
    fs::write(&configuration, "[baseline]\nfile = \"nominal.json\"\n").unwrap();
    stdout(&seepd(["check", configuration.to_str().unwrap()]));
    fs::write(&configuration, "[baseline]\nlearn_cycles = 7\n").unwrap();
    assert_eq!(seepd(["check", configuration.to_str().unwrap()]).status.code(), Some(78));
    // A baseline whose numbers were damaged.
    let good = fs::read_to_string(place.baseline("nominal")).unwrap();
    for (key, value) in [("noise", "-1.0"), ("load_n", "0.0"), ("response_deviation_m2", "1e999")] {
        let line = good.lines().find(|line| line.contains(&format!("\"{key}\":"))).unwrap();
        let path = place.path("numbers.json");
        fs::write(&path, good.replacen(line, &format!("\"{key}\": {value},"), 1)).unwrap();
        let output = seepd(["replay", "--baseline", path.to_str().unwrap(), log]);
        assert_eq!(output.status.code(), Some(78), "{key}: {}", stderr(&output));
    }
}

/// A growing leak gets a date: doubling each twenty cycles, it is 0.6 L/min some time after the log's end.
#[test]
fn a_growing_leak_has_a_date() {
    let place = &*PLACE;
    let log = place
        .log("growing", &["--cycles", "60", "--leak-area", "5e-9", "--leak-growth", "8e-8", "--seed", "11"]);
    let lines = place.follow("nominal", &log);
    let last = lines.iter().rev().find(|line| line.get("time_to_leak").is_some()).unwrap();
    let time = &last["time_to_leak"];
    // 16-fold in 590 s; from 8e-8 to the 1.13e-7 m² of 0.6 L/min: 73 s.
    let (expected, earliest, latest) = (
        time["expected_s"].as_f64().unwrap(),
        time["earliest_s"].as_f64().unwrap(),
        time["latest_s"].as_f64().unwrap(),
    );
    assert!((30.0..200.0).contains(&expected), "{time}");
    assert!(earliest <= expected && expected <= latest && latest < 1000.0, "{time}");
}
