//! What the program says to somebody whose machine the model does not know.

use std::fs;
use std::path::Path;

use crate::support::{OTHER_PRESS, replay, seepd, simulate, stderr, stdout, summary};
use serde_json::Value;

/// The last line on the terminal, and the summary of the JSON lines.
fn told(log: &Path, more: &[&str]) -> (String, Value) {
    let mut arguments = vec!["replay", "--quiet", log.to_str().unwrap()];
    arguments.extend(more);
    let text = stdout(&seepd(arguments));
    (text.lines().last().unwrap().to_owned(), summary(&replay(log, more)).clone())
}

#[test]
fn a_press_with_another_cycle_is_told_its_period_and_the_next_command() {
    let folder = tempfile::tempdir().unwrap();
    let (plant, log) = (folder.path().join("other.toml"), folder.path().join("press.mcap"));
    fs::write(&plant, OTHER_PRESS).unwrap();
    simulate(&log, &["--cycles", "12", "--plant", plant.to_str().unwrap()]);
    let (line, summary) = told(&log, &[]);
    let expected = format!(
        "The command repeats every 7.02 s; the model knows cycles of 10.0 s. Describe this machine: `seepd adopt {} --out FOLDER`.",
        log.display()
    );
    assert!(line.contains(&expected), "{line}");
    assert_eq!(summary["advice"], line.as_str());
    let (out, log_text) = (folder.path().join("baseline.json"), log.to_str().unwrap());
    let learned = seepd(["learn-baseline", "--out", out.to_str().unwrap(), log_text]);
    assert_eq!(learned.status.code(), Some(65));
    assert!(
        stderr(&learned).contains(&expected) && stderr(&learned).lines().count() == 1,
        "{}",
        stderr(&learned)
    );
    assert!((summary["observed"]["period_s"].as_f64().unwrap() - 7.02).abs() < 0.02, "{summary}");
    assert_eq!(
        (summary["leak_area_m2"].is_null(), &summary["size_withheld"]),
        (true, &Value::from("too_few_estimates"))
    );
}

/// A press of another bore: a few of its cycles look like the series'. What they say is no size.
#[test]
fn a_summary_gives_no_size_where_most_cycles_had_none() {
    let folder = tempfile::tempdir().unwrap();
    let (plant, log) = (folder.path().join("other.toml"), folder.path().join("press.mcap"));
    fs::write(&plant, "[plant]\ncap_area_m2 = 0.0040\nannulus_area_m2 = 0.0027\n").unwrap();
    simulate(&log, &["--cycles", "12", "--load-variation", "0.05", "--plant", plant.to_str().unwrap()]);
    let (line, summary) = told(&log, &[]);
    assert!(summary["cycles"].as_u64().unwrap() < 6, "{summary}");
    assert!(summary["leak_flow_lpm"].is_null() && summary.get("leak_power_w").is_none(), "{summary}");
    assert!(line.contains("unlike training") && line.contains("as the model's cycle does"), "{line}");
    let page = folder.path().join("page.html");
    stdout(&seepd(["replay", "--quiet", "--html", page.to_str().unwrap(), log.to_str().unwrap()]));
    let page = fs::read_to_string(page).unwrap();
    assert!(page.contains("Describe it: ") && !page.contains("There is no leak that matters"), "{page}");
}

#[test]
fn commands_in_volts_and_per_cent_are_told_their_scale() {
    let folder = tempfile::tempdir().unwrap();
    let (config, log) = (folder.path().join("seepd.toml"), folder.path().join("press.mcap"));
    simulate(&log, &["--cycles", "4"]);
    for (scale, unit) in [("10.0", "volts of ±10 V"), ("100.0", "per cent")] {
        let mapping =
            format!("[signals.command]\ntopic = \"*/signals\"\nfield = \"command\"\nscale = {scale}\n");
        fs::write(&config, mapping).unwrap();
        let (line, summary) = told(&log, &["--config", config.to_str().unwrap()]);
        assert!(
            line.contains(&format!("if these are {unit}, set `scale = 1` for signals.command")),
            "{line}"
        );
        assert!(summary["observed"]["command_range"][1].as_f64().unwrap() > 2.0, "{summary}");
    }
}
