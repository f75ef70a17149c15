//! Reports as pages: what they say, and that they need nothing from outside.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::{replay, seepd, simulate, stderr, stdout, summary};

fn text_of(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn log(folder: &tempfile::TempDir, name: &str, more: &[&str]) -> PathBuf {
    let log = folder.path().join(name);
    simulate(&log, &[&["--command-only"], more].concat());
    log
}

/// A page must be one file: nothing is fetched, and every `<` that a name brings is escaped.
fn assert_self_contained(page: &str) {
    assert!(page.starts_with("<!DOCTYPE html>") && page.trim_end().ends_with("</html>"));
    for outside in ["http://", "https://", "src=", "href=", "url(", "@import", "<script"] {
        assert!(!page.contains(outside), "{outside}");
    }
    assert!(page.contains("prefers-color-scheme:dark") && page.contains("@media print"));
    assert!(!page.contains("NaN") && !page.contains(">inf"), "no number that is none");
}

#[test]
fn a_report_of_several_logs_tells_leak_power_flags_and_rejections() {
    let folder = tempfile::tempdir().unwrap();
    let healthy = log(&folder, "monday.mcap", &["--cycles", "6"]);
    let worn = log(
        &folder,
        "tues<day>.mcap",
        &["--cycles", "6", "--leak-area", "2e-7", "--seed", "2", "--start-at", "4"],
    );
    let page = folder.path().join("report.html");
    let config = folder.path().join("seepd.toml");
    fs::write(&config, "axis = \"press 3\"\noperating_hours_per_year = 2000\n").unwrap();
    let more = [text_of(&worn), "--config", text_of(&config), "--html", text_of(&page)];
    let lines = replay(&healthy, &more);
    let page = fs::read_to_string(&page).unwrap();
    assert_self_contained(&page);
    let flow_lpm = summary(&lines)["leak_flow_lpm"].as_f64().unwrap();
    let power_w = flow_lpm / 60_000.0 * 7e6;
    for told in [
        "Piston seal of press 3".to_owned(),
        format!("{flow_lpm:.2} L/min"),
        format!("{power_w:.0} W"),
        format!("{:.0} kWh a year", power_w * 2.0),
        "first cycles below 0.24 L/min (mean of 5)".into(),
        "now (mean of the last 5)".into(),
        "monday.mcap".into(),
        "tues&lt;day&gt;.mcap".into(),
        "its clock starts again".into(),
        "samples are missing".into(),
        "threshold 0.6 L/min".into(),
        "relative.hold_1".into(),
    ] {
        assert!(page.contains(&told), "{told}");
    }
    // The wear is one step in the record: half of the cycles before it, and the leak at the end.
    assert_eq!(summary(&lines)["flag"], "leak");
    assert_eq!(summary(&lines)["cycles"].as_u64().unwrap() + 1, 12);
}

#[test]
fn a_report_of_a_log_without_cycles_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let csv = folder.path().join("still.csv");
    let rows: String = (0..40_000).map(|index| format!("{},0.1\n", f64::from(index) * 1e-3)).collect();
    fs::write(&csv, format!("t_s,command\n{rows}")).unwrap();
    let page = folder.path().join("report.html");
    stdout(&seepd(["replay", text_of(&csv), "--quiet", "--html", text_of(&page)]));
    let page = fs::read_to_string(&page).unwrap();
    assert_self_contained(&page);
    assert!(
        page.contains("There is no estimate: the command stood still while the machine had to move."),
        "{page}"
    );
}

#[test]
fn a_report_that_begins_with_a_leak_does_not_call_it_healthy() {
    let folder = tempfile::tempdir().unwrap();
    let worn = log(&folder, "worn.mcap", &["--cycles", "5", "--leak-area", "5e-7"]);
    let page = folder.path().join("report.html");
    let output = seepd(["replay", text_of(&worn), "--quiet", "--html", text_of(&page)]);
    stdout(&output);
    let page = fs::read_to_string(&page).unwrap();
    assert!(page.contains("first cycles (mean of"), "{}", stderr(&output));
    assert!(page.contains("No cycle of this record has an estimate below 0.24 L/min"));
    assert!(!page.contains("healthy (mean"));
}

#[test]
fn a_page_that_cannot_be_written_is_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let worn = log(&folder, "worn.mcap", &["--cycles", "2"]);
    let output = seepd(["replay", text_of(&worn), "--quiet", "--html", "/nowhere/report.html"]);
    assert_eq!(output.status.code(), Some(74));
    assert_eq!(stderr(&output).lines().count(), 1, "{}", stderr(&output));
}

#[test]
#[expect(clippy::disallowed_methods, reason = "the limit is one of wall time")]
fn the_study_finds_the_plant_s_figures_and_says_what_agrees() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("study.html");
    let begin = std::time::Instant::now();
    let study: Value =
        serde_json::from_str(&stdout(&seepd(["study", "--json", "--out", text_of(&page)]))).unwrap();
    // Two minutes is the limit, on two cores.
    assert!(begin.elapsed().as_secs() < 120, "{:?}", begin.elapsed());
    assert_self_contained(&fs::read_to_string(&page).unwrap());
    let verdicts = study["verdicts"].as_array().unwrap();
    let agreement = |figure: &str| {
        verdicts.iter().find(|verdict| verdict["figure"] == figure).unwrap()["agreement"].as_str().unwrap()
    };
    assert_eq!(verdicts.len(), 7);
    assert_eq!(agreement("figure 5"), "agrees");
    assert_eq!(agreement("figure 6"), "partly");
    assert_eq!(agreement("largest leak held"), "differs");
    // What an independent implementation of the plant found: 37 L/min at the peak of the largest leak, and the mean command there.
    let near = |value: &Value, expected: f64, within: f64| {
        let value = value.as_f64().unwrap();
        assert!((value - expected).abs() <= within, "{value}, not {expected}");
    };
    let largest = study["leak_rates"].as_array().unwrap().last().unwrap();
    near(&largest["peak_lpm"], 37.0, 0.5);
    let command = study["cycles"].as_array().unwrap().last().unwrap()["command"].as_array().unwrap();
    let mean = command.iter().map(|value| value.as_f64().unwrap()).sum::<f64>() / command.len() as f64;
    near(&mean.into(), -0.1024, 2e-4);
    // 0.6 L/min through C_d A √(2 Δp / ρ) at 7 MPa.
    let area = 0.6 / 60_000.0 / (0.7 * (2.0f64 * 7e6 / 870.0).sqrt());
    near(&study["holding"]["article"]["leak_area_m2"], area, 1e-12);
    // On its own press the article's five features do, on others of the series they do not.
    let error = |ensemble: &str, machines: &str| {
        let lines = study["ensembles"]["accuracy"].as_array().unwrap();
        let of = |line: &&Value| {
            line["ensemble"] == ensemble && line["machines"] == machines && line["noise"] == 0.001
        };
        lines.iter().find(of).unwrap()["median_relative_error"][1].as_f64().unwrap()
    };
    assert!(error("article", "press") < 0.03 && error("article", "series") > 0.1);
    assert!(error("seepd", "series") < 0.03);
    let curves = study["features"]["curves"].as_array().unwrap();
    assert_eq!(curves.len(), 5 + 2);
    assert!(curves[2]["name"] == "skewness" && curves[2]["net_share"].as_f64().unwrap() < 0.5);
}

/// A report against a baseline shows the record of baselines, both estimates, and what the last one comes from.
#[test]
fn a_report_against_a_baseline_shows_its_record_and_what_the_estimate_comes_from() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (
        log(&folder, "first.mcap", &["--cycles", "24", "--leak-area", "2e-7"]),
        log(&folder, "second.mcap", &["--cycles", "24", "--seed", "2"]),
    );
    let worn = log(&folder, "worn.mcap", &["--cycles", "8", "--leak-area", "1e-7", "--seed", "3"]);
    let (baseline, page) = (folder.path().join("baseline.json"), folder.path().join("report.html"));
    for (log, more) in [(&first, &["--occasion", "commissioning <1>"][..]), (&second, &["--seal-replaced"])] {
        stdout(&seepd([&["learn-baseline", "--out", text_of(&baseline), text_of(log)][..], more].concat()));
    }
    replay(&worn, &["--baseline", text_of(&baseline), "--html", text_of(&page)]);
    let text = fs::read_to_string(&page).unwrap();
    assert_self_contained(&text);
    for told in [
        "commissioning &lt;1&gt;",
        "seal replaced <b>(in force)</b>",
        "sees a leak of 0.20",
        "estimate, relative to the baseline",
        "the model alone",
        "contribution, mm²",
        "retract",
    ] {
        assert!(text.contains(told), "{told}");
    }
    // Without one, the features' contributions to the model's estimate.
    replay(&worn, &["--force", "--html", text_of(&page)]);
    let text = fs::read_to_string(&page).unwrap();
    assert_self_contained(&text);
    assert!(text.contains("multiplies the estimate by") && !text.contains("The baselines"), "{text}");
}
