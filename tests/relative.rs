//! A machine without a plant file, watched relative to its own healthy cycles.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use crate::daemon::Daemon;
use crate::support::{OTHER_PRESS, replay, seepd, simulate, stderr, stdout, summary};
use serde_json::Value;

/// A folder with the logs of a healthy machine, of the same one later, and of the same one with a leak that began at its 20th cycle.
struct Shop {
    folder: PathBuf,
}

impl Shop {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }
}

static SHOP: LazyLock<Shop> = LazyLock::new(|| {
    let shop = Shop { folder: crate::support::shared_folder("relative") };
    fs::write(shop.path("plant.toml"), OTHER_PRESS).unwrap();
    fs::write(shop.path("seepd.toml"), "axis = \"press\"\n[monitor]\nkind = \"relative\"\n").unwrap();
    let simulated = |name: &str, cycles: &str, more: &[&str]| {
        let plant = shop.text("plant.toml");
        let usual = [
            "--plant",
            &plant,
            "--cycles",
            cycles,
            "--load-variation",
            "0.02",
            "--noise",
            "0.003",
            "--command-only",
        ];
        simulate(&shop.path(name), &[&usual[..], more].concat());
    };
    simulated("healthy.mcap", "60", &["--seed", "1"]);
    simulated("later.mcap", "60", &["--seed", "2"]);
    simulated("worn.mcap", "40", &["--seed", "3", "--leak-step", "1e-7@20"]);
    let learned = stdout(&seepd([
        "learn-baseline",
        "--config",
        &shop.text("seepd.toml"),
        "--out",
        &shop.text("press.baseline.json"),
        &shop.text("healthy.mcap"),
    ]));
    assert!(learned.contains("the command repeats every 7.02 s, at 1000 Hz"), "{learned}");
    shop
});

fn replayed(log: &str) -> Vec<Value> {
    let (config, baseline) = (SHOP.text("seepd.toml"), SHOP.text("press.baseline.json"));
    replay(&SHOP.path(log), &["--config", &config, "--baseline", &baseline])
}

#[test]
fn the_healthy_machine_stays_healthy_and_has_no_size() {
    let lines = replayed("later.mcap");
    let summary = summary(&lines);
    assert_eq!(
        (&summary["flag"], &summary["highest_flag"]),
        (&"healthy".into(), &"healthy".into()),
        "{summary}"
    );
    assert!(summary["cycles"].as_u64().unwrap() >= 58, "{summary}");
    assert_eq!(
        (&summary["leak_flow_lpm"], &summary["size_withheld"]),
        (&Value::Null, &"no_plant_model".into())
    );
    let file: Value =
        serde_json::from_str(&fs::read_to_string(SHOP.path("press.baseline.json")).unwrap()).unwrap();
    assert_eq!(file["schema"], "seepd.relative-baseline/1");
    let phases = file["cycle"]["phases"].as_array().unwrap();
    assert_eq!(phases.iter().filter(|phase| phase["kind"] == "stroke").count(), 2, "{phases:?}");
}

#[test]
fn a_leak_is_a_change_with_phases_and_an_onset() {
    let lines = replayed("worn.mcap");
    assert_eq!((&summary(&lines)["flag"], &summary(&lines)["leak_area_m2"]), (&"watch".into(), &Value::Null));
    let changed: Vec<&Value> = lines.iter().filter(|line| line["changed"] == true).collect();
    let (first, last) = (changed[0], changed[changed.len() - 1]);
    assert!((140.0..200.0).contains(&first["t_end_s"].as_f64().unwrap()), "{first}");
    assert!((126.0..162.0).contains(&last["changed_since_s"].as_f64().unwrap()), "{last}");
    let page = SHOP.path("page.html");
    let (config, baseline) = (SHOP.text("seepd.toml"), SHOP.text("press.baseline.json"));
    let text = stdout(&seepd([
        "replay",
        "--config",
        &config,
        "--baseline",
        &baseline,
        "--html",
        page.to_str().unwrap(),
        &SHOP.text("worn.mcap"),
    ]));
    let last = text.lines().last().unwrap();
    let gain = format!(
        "Without a plant model there is no L/min: `seepd adopt {} --out FOLDER` gives sizes.",
        SHOP.text("worn.mcap")
    );
    assert_eq!(last, gain, "{text}");
    assert!(text.contains("the command has changed since the baseline, most in "), "{text}");
    assert!(fs::read_to_string(page).unwrap().contains("The machine is not as it was at its baseline."));
}

#[test]
fn a_configuration_without_a_model_is_checked() {
    let good = stdout(&seepd(["check", &SHOP.text("seepd.toml")]));
    assert!(good.contains("watched relative to its own healthy cycles"), "{good}");
    let wrong = SHOP.path("wrong.toml");
    fs::write(&wrong, "model = \"m.json\"\n[monitor]\nkind = \"relative\"\n").unwrap();
    let refused = seepd([Path::new("check"), &wrong]);
    assert_eq!(refused.status.code(), Some(78));
    assert!(stderr(&refused).contains("`relative`, which takes no model"), "{}", stderr(&refused));
    fs::write(
        &wrong,
        format!(
            "axis = \"press\"\n[monitor]\nkind = \"relative\"\n[baseline]\nfile = \"{}\"\n",
            SHOP.text("plant.toml")
        ),
    )
    .unwrap();
    let refused = seepd([Path::new("check"), &wrong]);
    assert!(
        stderr(&refused).contains("this is not a baseline of an axis without a model"),
        "{}",
        stderr(&refused)
    );
}

/// The daemon learns on its own, keeps what it has learned and found, and takes it up again.
#[test]
fn the_daemon_learns_watches_and_remembers() {
    let folder = tempfile::tempdir().unwrap();
    let run = |log: &str| {
        let config = format!(
            "axis = \"press\"\nstate_dir = \"state\"\n[monitor]\nkind = \"relative\"\n[baseline]\nlearn_cycles = 30\n\
             [source]\nlog = \"{}\"\npace = \"fast\"\n",
            SHOP.text(log)
        );
        let daemon = Daemon::start(folder.path(), &config);
        let words = daemon.log.clone();
        assert!(daemon.wait().success());
        fs::read_to_string(words).unwrap()
    };
    let state = || -> Value {
        serde_json::from_str(&fs::read_to_string(folder.path().join("state/state.json")).unwrap()).unwrap()
    };
    run("healthy.mcap");
    let record = folder.path().join("state/axes/press/relative-baseline.json");
    let learned: Value = serde_json::from_str(&fs::read_to_string(&record).unwrap()).unwrap();
    assert_eq!((&learned["cycles"], &learned["occasion"]), (&30.into(), &"commissioning".into()));
    assert_eq!(state()["axes"]["press"]["alarm"]["level"], "healthy");
    let words = run("worn.mcap");
    assert!(words.contains("the command has changed since the baseline"), "{words}");
    let axis = &state()["axes"]["press"];
    assert_eq!((&axis["alarm"]["level"], &axis["latch"]["latched"]), (&"watch".into(), &"watch".into()));
    assert_eq!(axis["relative"]["sums"]["changed"], true, "{axis}");
    fs::write(&record, "{").unwrap();
    assert!(run("healthy.mcap").contains("the file is kept as"));
}
