//! An axis with several duty cycles: each cycle is known by its shape, has its own model and baseline, and one that no model knows has no
//! estimate.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use seepd_logs::LogMapping;
use seepd_signals::Signal;
use serde_json::Value;

use crate::support::{seepd, simulate, stderr, stdout};

/// A shorter stroke in a shorter time.
const SHORT: &str = r#"[cycle]
period_s = 8.0
moves = [
  { name = "extend", from_s = 0.5, to_s = 2.0, to_m = 0.28 },
  { name = "press", from_s = 2.5, to_s = 3.2, to_m = 0.30 },
  { name = "retract", from_s = 4.8, to_s = 6.8, to_m = 0.10 },
]
load = [
  { at_s = 2.70, force_n = -2e3 }, { at_s = 2.75, force_n = -12e3 },
  { at_s = 4.40, force_n = -12e3 }, { at_s = 4.45, force_n = -2e3 },
]
"#;
/// The nominal press's strokes at the same times, less far and against another load: their shapes are alike.
const LIGHT: &str = r#"[cycle]
period_s = 10.0
moves = [
  { name = "extend", from_s = 0.5, to_s = 2.5, to_m = 0.30 },
  { name = "press", from_s = 3.0, to_s = 4.0, to_m = 0.33 },
  { name = "retract", from_s = 6.0, to_s = 8.5, to_m = 0.10 },
]
load = [
  { at_s = 3.20, force_n = -2e3 }, { at_s = 3.25, force_n = -9e3 },
  { at_s = 5.60, force_n = -9e3 }, { at_s = 5.65, force_n = -2e3 },
]
"#;
/// Set-up: one slow stroke out and back.
const SETUP: &str = r#"[cycle]
period_s = 14.0
moves = [
  { name = "out", from_s = 1.0, to_s = 6.0, to_m = 0.30 },
  { name = "back", from_s = 7.0, to_s = 12.0, to_m = 0.10 },
]
load = []
"#;
/// Large enough to be told apart, small enough to train in seconds.
const SMALL_TRAINING: [&str; 12] = [
    "--observations",
    "480",
    "--held-out",
    "100",
    "--trials",
    "1",
    "--compared",
    "96",
    "--calibration",
    "128",
    "--causes",
    "0",
];

/// Plants, models and a configuration with three duty cycles.
struct Place {
    folder: PathBuf,
}

static PLACE: LazyLock<Place> = LazyLock::new(|| {
    let place = Place { folder: crate::support::shared_folder("duty_cycles") };
    fs::write(place.path("normal.json"), seepd::EMBEDDED_MODEL).unwrap();
    for (name, plant) in [("normal", ""), ("short", SHORT), ("light", LIGHT), ("setup", SETUP)] {
        fs::write(place.path(&format!("{name}.toml")), plant).unwrap();
    }
    for name in ["short", "light"] {
        let (plant, model) = (place.path(&format!("{name}.toml")), place.path(&format!("{name}.json")));
        let files = ["train", "--plant", plant.to_str().unwrap(), "--out", model.to_str().unwrap()];
        stdout(&seepd([&files[..], &SMALL_TRAINING].concat()));
    }
    place.configure("seepd.toml", &["normal", "short", "light"], false);
    place
});

/// Cycles of one duty cycle in a row.
struct Part {
    plant: &'static str,
    cycles: usize,
    leak_area_m2: f64,
    seed: u32,
}

fn part(plant: &'static str, cycles: usize, leak_area_m2: f64, seed: u32) -> Part {
    Part { plant, cycles, leak_area_m2, seed }
}

impl Place {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn configure(&self, file: &str, duty_cycles: &[&str], with_baselines: bool) {
        let mut text = String::new();
        for name in duty_cycles {
            write!(text, "[[duty_cycles]]\nname = \"{name}\"\nmodel = \"{name}.json\"\n").unwrap();
            if with_baselines {
                writeln!(text, "baseline = \"{name}.baseline.json\"").unwrap();
            }
        }
        fs::write(self.path(file), text).unwrap();
    }

    /// One log of the machine that goes from one duty cycle to the next.
    fn log(&self, name: &str, parts: &[Part]) -> PathBuf {
        let mut rows = String::from("t_s,command\n");
        let mut number = 0u32;
        for (index, part) in parts.iter().enumerate() {
            let log = self.path(&format!("{name}-{index}.mcap"));
            let plant = self.path(&format!("{}.toml", part.plant));
            let numbers = [part.cycles.to_string(), part.leak_area_m2.to_string(), part.seed.to_string()];
            simulate(
                &log,
                &[
                    ["--plant", plant.to_str().unwrap(), "--noise", "0.003"],
                    ["--cycles", &numbers[0], "--leak-area", &numbers[1]],
                    ["--seed", &numbers[2], "--load-variation", "0.05"],
                ]
                .concat(),
            );
            let mut source = seepd_logs::open(&log, &LogMapping::default()).unwrap();
            while let Some(sample) = source.next_sample().unwrap() {
                if let Some(command) = sample.get(Signal::Command) {
                    writeln!(rows, "{},{command:.5}", f64::from(number) / 1e3).unwrap();
                    number += 1;
                }
            }
        }
        let path = self.path(&format!("{name}.csv"));
        fs::write(&path, rows).unwrap();
        path
    }

    fn replay(&self, configuration: &str, log: &Path, more: &[&str]) -> Vec<Value> {
        let configuration = self.path(configuration);
        crate::support::replay(log, &[&["--config", configuration.to_str().unwrap()], more].concat())
    }
}

/// Cycle lines, without the summary.
fn cycles(lines: &[Value]) -> &[Value] {
    assert_eq!(lines.last().unwrap()["schema"], "seepd.summary/1");
    &lines[..lines.len() - 1]
}

/// Median of a field over the lines of a duty cycle.
fn median(lines: &[Value], duty_cycle: &str, field: &str) -> f64 {
    let of_duty_cycle = cycles(lines).iter().filter(|line| line["duty_cycle"] == duty_cycle);
    let mut values: Vec<f64> = of_duty_cycle.filter_map(|line| line[field].as_f64()).collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Each cycle counts once, under the name of its duty cycle, and the leak is the same whichever it is read from; a cycle at a change-over
/// may be lost.
#[test]
fn each_cycle_is_known_by_its_shape() {
    let place = &*PLACE;
    let order = ["normal", "short", "light", "normal", "light", "short"];
    let parts: Vec<Part> = order.iter().zip(1..).map(|(plant, seed)| part(plant, 6, 1e-6, seed)).collect();
    let lines = place.replay("seepd.toml", &place.log("mixed", &parts), &[]);
    let names: Vec<&str> = cycles(&lines).iter().filter_map(|line| line["duty_cycle"].as_str()).collect();
    let mut changes = names.clone();
    changes.dedup();
    assert_eq!(changes, order, "{names:?}");
    assert!((30..=36).contains(&names.len()), "{} cycles of 36: {names:?}", names.len());
    assert!(cycles(&lines).len() <= 36, "{} lines", lines.len());
    for name in ["normal", "short", "light"] {
        let leak_area_m2 = median(&lines, name, "leak_area_m2");
        assert!((leak_area_m2 / 1e-6 - 1.0).abs() < 0.1, "{name}: {leak_area_m2}");
    }
    let summary = lines.last().unwrap();
    let counted: u64 = summary["duty_cycles"].as_object().unwrap().values().filter_map(Value::as_u64).sum();
    assert_eq!(counted, summary["cycles"].as_u64().unwrap());
    assert_eq!(summary["flag"], "severe", "{summary}");
}

/// A duty cycle that no model was trained on: no estimate, and the flag says so.
#[test]
fn an_unknown_duty_cycle_has_no_estimate() {
    let place = &*PLACE;
    let log = place.log("setup", &[part("normal", 5, 0.0, 1), part("setup", 8, 0.0, 2)]);
    let lines = place.replay("seepd.toml", &log, &[]);
    let estimates = cycles(&lines).iter().filter(|line| line["leak_area_m2"].is_number());
    let late = estimates.filter(|line| line["t_start_s"].as_f64().unwrap() > 50.0).count();
    assert_eq!(late, 0, "{lines:?}");
    let summary = lines.last().unwrap();
    assert_eq!(
        (&summary["flag"], summary["cycles"].as_u64() >= Some(4)),
        (&"no_estimate".into(), true),
        "{summary}"
    );
}

/// Each duty cycle has its own baseline; the leak that comes after it is found in each.
#[test]
fn each_duty_cycle_has_its_own_baseline() {
    let place = &*PLACE;
    let both = ["normal", "light"];
    place.configure("two.toml", &both, false);
    place.configure("baselines.toml", &both, true);
    let healthy = |seed| [part("normal", 12, 0.0, seed), part("light", 12, 0.0, seed + 1)];
    let log = place.log("healthy", &healthy(1).into_iter().chain(healthy(3)).collect::<Vec<_>>());
    for name in both {
        let (configuration, out) = (place.path("two.toml"), place.path(&format!("{name}.baseline.json")));
        let output = seepd([
            "learn-baseline",
            "--config",
            configuration.to_str().unwrap(),
            "--duty-cycle",
            name,
            "--out",
            out.to_str().unwrap(),
            log.to_str().unwrap(),
        ]);
        let told = stdout(&output);
        assert!(told.contains("baseline of 2"), "{told}");
    }
    let log = place.log("leak", &[part("normal", 8, 1e-7, 9), part("light", 8, 1e-7, 10)]);
    let lines = place.replay("baselines.toml", &log, &[]);
    for name in both {
        let leak_area_m2 = median(&lines, name, "leak_area_m2");
        assert!((leak_area_m2 / 1e-7 - 1.0).abs() < 0.25, "{name}: {leak_area_m2}");
        let last = cycles(&lines).iter().rfind(|line| line["duty_cycle"] == name).unwrap();
        assert_eq!(last["finding"], "leak", "{last}");
    }
    // Learned on the way, the same comes out.
    let parts = healthy(1)
        .into_iter()
        .chain(healthy(3))
        .chain([part("normal", 8, 1e-7, 9), part("light", 8, 1e-7, 10)]);
    let lines =
        place.replay("two.toml", &place.log("all", &parts.collect::<Vec<_>>()), &["--learn-cycles", "20"]);
    for name in both {
        let last = cycles(&lines).iter().rfind(|line| line["duty_cycle"] == name).unwrap();
        assert_eq!(last["finding"], "leak", "{last}");
    }
}

/// What is wrong with several duty cycles in a configuration or on the command line is told in one line.
#[test]
fn wrong_duty_cycles_are_one_line_each() {
    let place = &*PLACE;
    let one = "[[duty_cycles]]\nname = \"normal\"\nmodel = \"normal.json\"\n";
    let cases = [
        (format!("{one}{one}"), "two duty cycles are called `normal`"),
        (format!("model = \"short.json\"\n{one}"), "each has a model and a baseline of its own"),
        (one.replace("name = \"normal\"", "name = \"a/b\""), "name is `a/b`"),
        (one.replace("normal.json", "missing.json"), "missing.json"),
        (format!("{one}baseline = \"short.json\"\n"), "is not a baseline"),
        (one.replace("model", "modell"), "modell"),
    ];
    for (text, wanted) in cases {
        let path = place.path("wrong.toml");
        fs::write(&path, &text).unwrap();
        let output = seepd(["check", path.to_str().unwrap()]);
        let told = stderr(&output) + &String::from_utf8_lossy(&output.stdout);
        assert_eq!(output.status.code(), Some(78), "{text}\n{told}");
        assert!(told.contains(wanted), "{told}");
    }
    let (configuration, model) = (place.path("seepd.toml"), place.path("short.json"));
    let (configuration, model) = (configuration.to_str().unwrap(), model.to_str().unwrap());
    let log = place.log("any", &[part("normal", 3, 0.0, 1)]);
    let (log, out) = (log.to_str().unwrap(), place.path("never.json"));
    let out = out.to_str().unwrap();
    let cases: [(&[&str], &str); 4] = [
        (&["replay", "--model", model], "several duty cycles"),
        (&["replay", "--baseline", model], "name their baselines there"),
        (&["learn-baseline", "--out", out], "--duty-cycle is missing"),
        (&["learn-baseline", "--out", out, "--duty-cycle", "long"], "normal, short, light"),
    ];
    for (arguments, wanted) in cases {
        let output = seepd([arguments, &["--config", configuration, log]].concat());
        assert_eq!(output.status.code(), Some(64), "{}", stderr(&output));
        assert!(stderr(&output).contains(wanted), "{}", stderr(&output));
    }
}

/// The daemon learns a baseline of each duty cycle, keeps it in a file of its own, and compares with it after a restart.
#[test]
#[cfg(feature = "live")]
fn the_daemon_keeps_a_baseline_for_each() {
    use crate::daemon::{Daemon, axis_status, free_port, until};

    let place = &*PLACE;
    let both = ["normal", "light"];
    let turns = (0u32..4).map(|turn| part(both[turn as usize % 2], 12, 0.0, 20 + turn));
    let healthy = place.log("live-healthy", &turns.collect::<Vec<_>>());
    let leaking = place.log("live-leak", &[part("normal", 8, 1e-7, 30), part("light", 8, 1e-7, 31)]);
    let duty_cycles: String = both
        .map(|name| {
            format!(
                "[[duty_cycles]]\nname = \"{name}\"\nmodel = \"{}\"\n",
                place.path(&format!("{name}.json")).display()
            )
        })
        .concat();
    let folder = tempfile::tempdir().unwrap();
    let configuration = |source: &str| {
        format!(
            "axis = \"press-1\"\nstate_dir = \"state\"\n{duty_cycles}[baseline]\nlearn_cycles = 20\n{source}"
        )
    };
    let of_log =
        |log: &Path| configuration(&format!("[source]\nlog = \"{}\"\npace = \"fast\"\n", log.display()));
    assert!(Daemon::start(folder.path(), &of_log(&healthy)).wait().success());
    for name in both {
        let record = folder.path().join(format!("state/axes/press-1/baseline-{name}.json"));
        let record: Value = serde_json::from_str(&fs::read_to_string(record).unwrap()).unwrap();
        assert_eq!(record["baselines"].as_array().unwrap().len(), 1, "{name}");
    }
    assert!(Daemon::start(folder.path(), &of_log(&leaking)).wait().success());
    // Both sums are there again; the page names both.
    let port = free_port();
    let socket = folder.path().join("in.sock");
    let page = format!("{}[http]\nlisten = \"127.0.0.1:{port}\"\n", crate::daemon::machine_toml(&socket));
    let _daemon = Daemon::start(folder.path(), &configuration(&page));
    until("an answer", std::time::Duration::from_secs(10), || axis_status(port).is_some());
    let status = axis_status(port).unwrap();
    assert_eq!((&status["finding"], &status["level"]), (&"leak".into(), &"watch".into()), "{status}");
    let listed = status["duty_cycles"].as_array().unwrap();
    let names: Vec<&str> = listed.iter().filter_map(|one| one["name"].as_str()).collect();
    assert_eq!(names, both);
    assert!(listed.iter().all(|one| one["baseline"]["learned_cycles"] == 20), "{status}");
}
