//! `seepd evaluate`: figures that are the same when they are computed by hand from a replay, and truth that is missing.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::{replay, seepd, simulate, stderr, stdout};

const NOISY: [&str; 4] = ["--noise", "0.003", "--load-variation", "0.05"];

fn log(folder: &Path, name: &str, more: &[&str]) -> PathBuf {
    let log = folder.join(name);
    simulate(&log, &[&NOISY, more].concat());
    log
}

fn evaluate(logs: &[&Path], more: &[&str]) -> Value {
    let logs = logs.iter().map(|log| log.to_str().unwrap());
    let output = seepd(["evaluate", "--json"].into_iter().chain(more.iter().copied()).chain(logs));
    serde_json::from_str(&stdout(&output)).unwrap()
}

/// The entry of a list in which a key has that value.
fn of<'v>(list: &'v Value, key: &str, value: &str) -> &'v Value {
    list.as_array().unwrap().iter().find(|entry| entry[key] == value).unwrap_or(&Value::Null)
}

fn near(value: &Value, wanted: f64) -> bool {
    value.as_f64().is_some_and(|value| (value - wanted).abs() <= 1e-9 * wanted.abs())
}

/// Three machines: a healthy one, two that leak. What `evaluate` says of their sizes is what a replay's lines give.
#[test]
fn errors_and_coverage_are_those_of_a_replay_beside_the_known_truth() {
    let folder = tempfile::tempdir().unwrap();
    let truths = [0.0, 3e-7, 4e-6];
    let logs: Vec<PathBuf> = truths
        .iter()
        .enumerate()
        .map(|(number, truth)| {
            let (name, seed, truth) = (format!("{number}.mcap"), number.to_string(), truth.to_string());
            log(folder.path(), &name, &["--cycles", "5", "--leak-area", &truth, "--seed", &seed])
        })
        .collect();
    let all: Vec<&Path> = logs.iter().map(PathBuf::as_path).collect();
    let told = evaluate(&all, &[]);
    assert_eq!((&told["schema"], &told["machines"]), (&"seepd.evaluation/1".into(), &3.into()));

    let mut judged: Vec<(f64, f64, bool)> = Vec::new();
    for (truth, log) in truths.iter().zip(&logs) {
        for line in replay(log, &[]).iter().filter(|line| line["interval90_m2"].is_array()) {
            let area = line["leak_area_m2"].as_f64().unwrap();
            let end = |index: usize| line["interval90_m2"][index].as_f64().unwrap();
            judged.push((*truth, area, (end(0)..=end(1)).contains(truth)));
        }
    }
    let sizes = of(&told["sizes"], "method", "absolute");
    assert_eq!(sizes["cycles"], judged.len());
    assert_eq!(told["sizes"].as_array().unwrap().len(), 1, "there is no baseline");
    for (decade, truth) in [(1, 3e-7), (2, 4e-6)] {
        let of_truth: Vec<_> = judged.iter().filter(|case| case.0 == truth).collect();
        let mut errors: Vec<f64> = of_truth.iter().map(|case| (case.1 - truth).abs() / truth).collect();
        errors.sort_by(f64::total_cmp);
        let line = &sizes["decades"][decade];
        assert_eq!(line["count"], errors.len());
        // The truth is read back as a mean over the cycle.
        let error = line["median_relative_error"].as_f64().unwrap();
        assert!((error - errors[errors.len() / 2]).abs() < 1e-9, "{error} {errors:?}");
        let held = of_truth.iter().filter(|case| case.2).count() as f64;
        assert!(near(&line["coverage"], held / errors.len() as f64));
    }
    assert_eq!(sizes["decades"][0]["count"], 0);
    assert!(sizes["decades"][0]["median_relative_error"].is_null());
    let main: Vec<_> = judged.iter().filter(|case| case.0 > 0.0).collect();
    let mean = main.iter().map(|case| case.0).sum::<f64>() / main.len() as f64;
    let residual: f64 = main.iter().map(|case| (case.0 - case.1).powi(2)).sum();
    let total: f64 = main.iter().map(|case| (case.0 - mean).powi(2)).sum();
    assert!((sizes["r2_area"].as_f64().unwrap() - (1.0 - residual / total)).abs() < 1e-9);
    let largest = judged.iter().filter(|case| case.0 == 0.0).map(|case| case.1).fold(0.0, f64::max);
    assert!(near(&sizes["healthy"]["largest_m2"], largest));
    // Both leaks are a multiple of what a healthy machine is ever taken for.
    assert_eq!(of(&told["roc"], "score", "absolute_estimate")["area"], 1.0);
}

/// A machine's record over two logs: a baseline, then a leak far below the thresholds of the flags. The sums find it, and raise one.
#[test]
fn a_small_leak_after_a_baseline_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let healthy = log(folder.path(), "monday.mcap", &["--cycles", "34"]);
    let leaking =
        log(folder.path(), "tuesday.mcap", &["--cycles", "8", "--leak-area", "2e-8", "--seed", "2"]);
    let page = folder.path().join("page.html");
    let more = ["--one-machine", "--learn-cycles", "25", "--html", page.to_str().unwrap()];
    let told = evaluate(&[&healthy, &leaking], &more);
    let sums = of(&told["detection"], "detector", "sums");
    assert_eq!(sums["false_alarms"], 0);
    assert_eq!(sums["healthy_cycles"].as_u64(), Some(9), "after the baseline's 25");
    let onset = &sums["onsets"][0];
    // 2e-8 m² are 0.107 L/min at 7 MPa.
    assert!((onset["leak_lpm"].as_f64().unwrap() - 0.107).abs() < 0.001, "{onset}");
    assert!(onset["found_after_cycles"].as_u64().unwrap() <= 4, "{onset}");
    assert_eq!(sums["classes"][0]["from_lpm"], 0.1);
    assert!(sums["smallest_found_lpm"].is_f64());
    let flags = of(&told["detection"], "detector", "flags");
    assert_eq!(flags["false_alarms"], 0);
    assert!(flags["onsets"][0]["found_after_cycles"].as_u64() >= onset["found_after_cycles"].as_u64());
    let relative = of(&told["sizes"], "method", "relative");
    let absolute = of(&told["sizes"], "method", "absolute");
    assert!(relative["cycles"].as_u64().unwrap() < absolute["cycles"].as_u64().unwrap());
    for score in ["drift_sum", "response"] {
        assert!(of(&told["roc"], "score", score)["area"].as_f64().unwrap() > 0.95, "{score}");
    }
    let page = fs::read_to_string(page).unwrap();
    assert!(page.starts_with("<!DOCTYPE html>") && !page.contains("NaN") && !page.contains("http"));
    for told in [
        "CUSUM over cycles",
        "relative to the baseline",
        "Smallest leak found by 95 %",
        "Receiver operating curves",
    ] {
        assert!(page.contains(told), "{told}");
    }
    let logs = [healthy, leaking].map(|log| log.to_str().unwrap().to_owned());
    let text = stdout(&seepd(["evaluate", "--one-machine", "--learn-cycles", "25", &logs[0], &logs[1]]));
    for told in [
        "Sizes, relative to the baseline:",
        "Detection by CUSUM over cycles:",
        "0 false alarms in 9 cycles",
        "Receiver operating curve of CUSUM over cycles",
    ] {
        assert!(text.contains(told), "{told}:\n{text}");
    }
}

/// A CSV file with its own column of truth, as a flow.
#[test]
fn the_truth_may_be_a_flow_in_a_column_of_any_name() {
    let folder = tempfile::tempdir().unwrap();
    let mcap = log(folder.path(), "rig.mcap", &["--cycles", "4", "--leak-area", "1e-6"]);
    let lpm = evaluate(&[&mcap], &[])["detection"][0]["onsets"][0]["leak_lpm"].as_f64().unwrap();
    let mut text = String::from("t_s;command;flow meter\n");
    let commands = crate::support::fixture("nominal_leak_1e-6.csv");
    let rows = fs::read_to_string(commands).unwrap();
    let values: Vec<&str> = rows.lines().skip(1).map(|row| row.split(',').nth(1).unwrap()).collect();
    for number in 0..3 * values.len() {
        // The meter says nothing in some rows.
        let meter = if number % 100 == 0 { lpm.to_string() } else { String::new() };
        text += &format!("{:.3};{};{meter}\n", number as f64 / 1e3, values[number % values.len()]);
    }
    let csv = folder.path().join("rig.csv");
    fs::write(&csv, text).unwrap();
    let told = evaluate(&[&csv], &["--truth", "flow meter", "--truth-unit", "lpm"]);
    assert_eq!(told["without_truth"], 0);
    let onset = &of(&told["detection"], "detector", "flags")["onsets"][0];
    assert!((onset["leak_lpm"].as_f64().unwrap() / lpm - 1.0).abs() < 1e-9);
    assert!(of(&told["sizes"], "method", "absolute")["cycles"].as_u64() >= Some(1));
}

#[test]
fn missing_truth_and_wrong_limits_are_one_line_each() {
    let folder = tempfile::tempdir().unwrap();
    let blind = log(folder.path(), "blind.mcap", &["--cycles", "3", "--no-truth"]);
    let log = log(folder.path(), "log.mcap", &["--cycles", "3"]);
    let (blind, log) = (blind.to_str().unwrap(), log.to_str().unwrap());
    for (arguments, code, told) in [
        (&[blind][..], 65, "on a topic that ends in /truth"),
        (&[log, blind], 65, "name the truth with --truth and --truth-topic"),
        (&["--truth", "leakage", log], 65, "`leakage`"),
        (&["--truth-topic", "/elsewhere", log], 65, "on topic /elsewhere"),
        (&["-"], 64, "each log is read twice"),
        (&["--within-cycles", "0", log], 64, "--within-cycles is 0"),
        (&["--onset-lpm", "nan", log], 64, "--onset-lpm"),
        (&["--learn-cycles", "3", log], 64, "a baseline takes"),
        (&["--truth-unit", "gallons", log], 64, "gallons"),
        (&["absent.mcap"], 66, "absent.mcap"),
    ] {
        let output = seepd(["evaluate"].into_iter().chain(arguments.iter().copied()));
        let error = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {error}");
        assert!(error.contains(told), "{arguments:?}: {error}");
        assert!(output.stdout.is_empty());
        if code != 64 {
            assert_eq!(error.trim_end().lines().count(), 1, "{error}");
        }
    }
}

#[test]
fn a_baseline_that_was_learned_from_a_leak_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let worn = log(folder.path(), "worn.mcap", &["--cycles", "26", "--leak-area", "1e-7"]);
    let arguments = ["evaluate", "--json", "--learn-cycles", "20", worn.to_str().unwrap()];
    let output = seepd(arguments);
    let told: Value = serde_json::from_str(&stdout(&output)).unwrap();
    assert_eq!(told["learned_while_leaking"], 1);
    // 1e-7 m² at 7 MPa are 0.53 L/min.
    assert!(
        stderr(&output).contains("its baseline was learned while the truth was a leak of up to 0.53"),
        "{}",
        stderr(&output)
    );
    // A leak that begins after the baseline is what a baseline is for.
    let later = log(folder.path(), "later.mcap", &["--cycles", "26", "--leak-step", "1e-7@21"]);
    let told = evaluate(&[&later], &["--learn-cycles", "20"]);
    assert_eq!(told["learned_while_leaking"], 0);
}

/// One machine for each cause: the command works and judges; how good causes are is docs/ISOLATION_VALIDATION.md's, on machines of another
/// simulator.
#[test]
fn causes_are_judged_on_simulated_machines_in_a_matrix_and_by_their_delays() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("causes.html");
    let run = |more: &[&str]| seepd([&["evaluate", "--causes", "1", "--seed", "3"], more].concat());
    let told: Value =
        serde_json::from_str(&stdout(&run(&["--json", "--html", page.to_str().unwrap()]))).unwrap();
    assert_eq!((&told["schema"], &told["machines"]), (&"seepd.cause-evaluation/1".into(), &16.into()));
    let rows = told["planted"].as_array().unwrap();
    assert_eq!(rows.len(), 14);
    for row in rows {
        let named: u64 = row["named"].as_object().unwrap().values().filter_map(Value::as_u64).sum();
        assert_eq!(Some(named), row["machines"].as_u64(), "{row}");
        let watched = told["watched_cycles"].as_u64().unwrap();
        assert!(row["slowest_cycles"].as_u64().is_none_or(|cycles| (1..=watched).contains(&cycles)), "{row}");
    }
    // Half of the causes at the least: one machine each says no more.
    assert!(told["right_within_class"].as_f64().unwrap() > 0.5, "{told}");
    assert_eq!(told["conditions_without_change"], 0.0, "{told}");
    let page = fs::read_to_string(&page).unwrap();
    assert!(page.contains("Who is taken for whom") && page.contains("<td>valve null</td>"), "{page}");
    // The same seed gives the same bytes; a table says the same.
    let text = stdout(&run(&[]));
    assert!(text.starts_with("16 machines, 24 cycles after the change, seed 3\n"), "{text}");
    assert_eq!(text.lines().filter(|line| line.starts_with("valve_")).count(), 4, "{text}");
    for (more, code, what) in [
        (&["press.mcap"][..], 64, "cannot be used with"),
        (&["--plant", "/nowhere.toml"], 66, "/nowhere.toml"),
        (
            &["--plant", crate::support::fixture("other_press.toml").to_str().unwrap()],
            78,
            "name the model's plant file",
        ),
    ] {
        let output = run(more);
        assert_eq!(output.status.code(), Some(code), "{more:?}");
        assert!(crate::support::stderr(&output).contains(what), "{}", crate::support::stderr(&output));
    }
}
