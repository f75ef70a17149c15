//! Diagnoses of the gap between simulator and machine, as a user runs them.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

#[expect(dead_code, reason = "other tests use the rest")]
mod support;

use std::fs;
use std::path::{Path, PathBuf};

use seepd::config::Config;
use seepd_signals::Signal;
use serde_json::Value;
use support::{seepd, simulate, stderr, stdout};

fn text_of(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// The diagnosis of a log.
fn diagnose(log: &Path, more: &[&str]) -> Value {
    let output = seepd([&["gap", text_of(log), "--json", "-"], more].concat());
    serde_json::from_str(&stdout(&output)).unwrap()
}

/// Probabilities sum to 1 and shares too, whatever the answer.
fn assert_consistent(diagnosis: &Value) {
    assert_eq!(diagnosis["schema"], "seepd.gap/1");
    let effects = diagnosis["effects"].as_array().unwrap();
    let of = |value: &Value| value.as_f64().unwrap();
    let named: f64 = effects.iter().map(|effect| of(&effect["probability"])).sum();
    let sum = named + of(&diagnosis["unknown_probability"]) + of(&diagnosis["no_effect_probability"]);
    assert!((sum - 1.0).abs() < 1e-9, "{sum}");
    let places = diagnosis["where"].as_array().unwrap();
    if !places.is_empty() {
        let shares: f64 = places.iter().map(|place| of(&place["share"])).sum();
        assert!((shares - 1.0).abs() < 1e-9, "{shares}");
    }
}

/// A log whose signals are written anew as CSV: each row's time, command, position, demand, load, cap and rod pressure.
fn rewritten(folder: &Path, log: &Path, change: impl Fn(usize, &mut [f64; 7]) -> bool) -> PathBuf {
    let mut source = seepd::source::open(log, &Config::default()).unwrap();
    let mut text = String::from("t_s,command,position,demand,load,p_cap,p_rod\n");
    let mut number = 0;
    while let Some(sample) = source.next_sample().unwrap() {
        let of = |signal| sample.get(signal).unwrap();
        let mut row = [
            sample.time_ns as f64 / 1e9,
            of(Signal::Command),
            of(Signal::Position),
            of(Signal::Demand),
            of(Signal::Load),
            of(Signal::PCap),
            of(Signal::PRod),
        ];
        if change(number, &mut row) {
            text += &row.map(|value| value.to_string()).join(",");
            text.push('\n');
        }
        number += 1;
    }
    let csv = folder.join("rewritten.csv");
    fs::write(&csv, text).unwrap();
    csv
}

#[test]
fn a_planted_friction_is_named_sized_and_removed() {
    let folder = tempfile::tempdir().unwrap();
    let (log, page, plant) =
        (folder.path().join("a.mcap"), folder.path().join("gap.html"), folder.path().join("plant.toml"));
    simulate(&log, &["--cycles", "12", "--leak-area", "2e-7", "--with", "coulomb_friction.force_n=1200"]);
    let found = diagnose(&log, &["--html", text_of(&page), "--emit-plant", text_of(&plant)]);
    assert_consistent(&found);
    assert_eq!((&found["verdict"], &found["chosen"][0]), (&"effect".into(), &"coulomb_friction".into()));
    let force_n = found["effects"][0]["parameters"]["force_n"].as_f64().unwrap();
    assert!((force_n - 1200.0).abs() < 24.0, "{force_n}");
    assert_eq!(found["where"][0]["equation"], "force");
    assert!(found["shrink"]["of_removable"].as_f64().unwrap() > 0.95);
    let leak_m2 = found["leak"]["chosen_m2"].as_f64().unwrap();
    assert!((leak_m2 - 2e-7).abs() < 4e-9, "{leak_m2}");
    let page = fs::read_to_string(&page).unwrap();
    assert!(page.contains("an effect: coulomb_friction") && !page.contains("http"));
    // The emitted plant is the machine: its own gap is none.
    stdout(&seepd(["check", text_of(&plant)]));
    let again = diagnose(&log, &["--plant", text_of(&plant)]);
    assert_eq!(again["verdict"], "no_gap", "{again}");
}

#[test]
fn command_and_position_alone_do_for_a_dead_band() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("a.mcap");
    simulate(&log, &["--cycles", "12", "--with", "valve_deadband.half_width=0.03"]);
    let config = folder.path().join("seepd.toml");
    fs::write(&config, "[signals.command]\n[signals.position]\n[signals.demand]\n").unwrap();
    let found = diagnose(&log, &["--config", text_of(&config)]);
    assert_consistent(&found);
    assert_eq!(found["signals"].as_array().unwrap().len(), 2);
    assert_eq!((&found["verdict"], &found["chosen"][0]), (&"effect".into(), &"valve_deadband".into()));
    let half_width = found["effects"][0]["parameters"]["half_width"].as_f64().unwrap();
    assert!((half_width - 0.03).abs() < 1e-3, "{half_width}");
}

#[test]
fn other_parameters_are_no_effect() {
    let folder = tempfile::tempdir().unwrap();
    let (log, plant) = (folder.path().join("a.mcap"), folder.path().join("plant.toml"));
    let text =
        "[plant]\nk_v = 9.5e-7\nb_v = 8000.0\nM = 200.0\nbeta = 1.1e9\np_prv = 15.2e6\nload_scale = 1.05\n";
    fs::write(&plant, text).unwrap();
    simulate(&log, &["--cycles", "12", "--plant", text_of(&plant), "--leak-area", "1e-7"]);
    let found = diagnose(&log, &[]);
    assert_consistent(&found);
    assert_eq!(found["verdict"], "parameters", "{found}");
    let k_v = found["retuned"]["k_v"]["fitted"].as_f64().unwrap();
    assert!((k_v / 9.5e-7 - 1.0).abs() < 0.02, "{k_v}");
}

/// The reason of a log that must not be diagnosed.
fn reason(log: &Path) -> String {
    let found = diagnose(log, &[]);
    assert_consistent(&found);
    assert_eq!(found["verdict"], "cannot_tell", "{found}");
    found["reason"].as_str().unwrap().to_owned()
}

#[test]
fn what_is_wrong_with_the_signals_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("a.mcap");
    simulate(&log, &["--cycles", "4"]);
    type Damage = fn(usize, &mut [f64; 7]) -> bool;
    let cases: [(&str, Damage); 7] = [
        ("that looks like millimetres", |_, row| {
            row[2] *= 1000.0;
            true
        }),
        ("that looks like bar", |_, row| {
            row[5] /= 1e5;
            true
        }),
        ("that looks like percent", |_, row| {
            row[1] *= 100.0;
            true
        }),
        ("the command's sign is inverted", |_, row| {
            row[1] = -row[1];
            true
        }),
        ("p_cap and p_rod are swapped", |_, row| {
            row.swap(5, 6);
            true
        }),
        ("the position does not follow the command", |number, row| {
            row[2] = 0.2 + 0.1 * (number as f64 / 777.0).sin();
            true
        }),
        ("do not match", |number, row| {
            row[3] = 0.2 + 0.1 * (number as f64 / 300.0).sin();
            true
        }),
    ];
    for (told, damage) in cases {
        let reason = reason(&rewritten(folder.path(), &log, damage));
        assert!(reason.contains(told), "{told}: {reason}");
    }
}

#[test]
fn cycles_of_another_kind_are_left_out_or_the_answer_is_withheld() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("a.mcap");
    simulate(&log, &["--cycles", "4"]);
    // The operator drives by hand in two of four cycles.
    let half = rewritten(folder.path(), &log, |number, row| {
        if number > 20_000 {
            row[1] *= 0.3;
            row[2] = 0.1 + 0.3 * (row[2] - 0.1);
        }
        true
    });
    assert!(reason(&half).contains("the cycles differ in kind"));
}

#[test]
fn logs_that_are_too_short_or_lack_a_signal_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("a.mcap");
    simulate(&log, &["--cycles", "2"]);
    let refusal = |log: &Path| {
        let output = seepd(["gap", text_of(log)]);
        assert_eq!((output.status.code(), stderr(&output).lines().count()), (Some(65), 1));
        stderr(&output)
    };
    assert!(refusal(&log).contains("at least 3 are needed"));
    let brief = rewritten(folder.path(), &log, |number, _| number < 5_000);
    assert!(refusal(&brief).contains("the log is shorter than a cycle"));
    let csv = folder.path().join("command.csv");
    fs::write(&csv, "t_s,command\n0.000,0.1\n0.001,0.2\n").unwrap();
    assert!(refusal(&csv).contains("the log has no position"));
    simulate(&log, &["--cycles", "4"]);
    let constant = rewritten(folder.path(), &log, |_, row| {
        row[1] = 0.1;
        true
    });
    assert!(refusal(&constant).contains("the command never changes"));
}

#[test]
fn dropped_samples_and_few_cycles_are_told_and_the_rest_is_used() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("a.mcap");
    simulate(&log, &["--cycles", "5"]);
    // A tenth of the second cycle is lost, and every fiftieth sample elsewhere is one that bridges.
    let gappy =
        rewritten(folder.path(), &log, |number, _| !(12_000..13_000).contains(&number) && number % 500 != 0);
    let found = diagnose(&gappy, &[]);
    assert_consistent(&found);
    assert_eq!(found["cycles"]["used"], 4);
    assert_eq!(found["verdict"], "no_gap", "{found}");
    let notes = found["notes"].to_string();
    assert!(notes.contains("1 cycles left out") && notes.contains("only 4 cycles"), "{notes}");
    assert!(found["reason"].as_str().unwrap().contains("only 4 cycles"));
}
