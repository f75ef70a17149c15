//! The window: what the page says to who walks by, to who comes in the morning, and to who has to log in.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use serde_json::Value;

use crate::daemon::{Daemon, ask, ask_with, axis_status, cycle, free_port, has, json, machine_toml, until};
use crate::support::{seepd, simulate, stderr, stdout};

const SOON: Duration = Duration::from_secs(20);
const TOKEN: &str = "0123456789abcdef0123";

/// A machine in an alarm, one whose baseline is being learned, one whose command stands still, and one that is silent.
fn four_machines(folder: &Path, port: u16) -> String {
    // A log at its own pace: five minutes in which the machine is alive, whatever else the processor has to do.
    let alive = folder.join("alive.mcap");
    simulate(&alive, &["--cycles", "30", "--leak-area", "9e-7"]);
    let learning = folder.join("learning.mcap");
    simulate(&learning, &["--cycles", "12", "--load-variation", "0.05"]);
    let stuck = folder.join("stuck.csv");
    let rows: String = (0..60_000).map(|ms| format!("{:.3},0.1\n", f64::from(ms) / 1e3)).collect();
    fs::write(&stuck, format!("t_s,command\n{rows}")).unwrap();
    fs::write(folder.join("token"), TOKEN).unwrap();
    let of_log = |name: &str, log: &Path| {
        format!("[[axes]]\naxis = \"{name}\"\n[axes.source]\nlog = \"{}\"\npace = \"fast\"\n", log.display())
    };
    let silent = machine_toml(&folder.join("in.sock"));
    let silent = silent.replace("[source]", "[axes.source]").replace("[signals", "[axes.signals");
    format!(
        "state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{port}\"\ntoken_file = \"token\"\n\
         {}[axes.energy]\nprice_per_kwh = 0.25\n{}[axes.baseline]\nlearn_cycles = 50\n{}[[axes]]\naxis = \"silent\"\n{silent}",
        of_log("alarm", &alive).replace("pace = \"fast\"", "stale_after_s = 30.0"),
        of_log("learning", &learning),
        of_log("stuck", &stuck),
    )
}

/// What an earlier run has left of the machine in an alarm.
fn run_into_alarm(folder: &Path) {
    let log = folder.join("alarm.mcap");
    simulate(&log, &["--cycles", "14", "--leak-area", "1e-7", "--leak-growth", "9e-7"]);
    run_to_the_end(folder, "alarm", &log);
}

/// A daemon's run over a log, which leaves its state to the next one.
fn run_to_the_end(folder: &Path, axis: &str, log: &Path) {
    let of_log = format!(
        "axis = \"{axis}\"\nstate_dir = \"state\"\n[source]\nlog = \"{}\"\npace = \"fast\"\n",
        log.display()
    );
    assert!(Daemon::start(folder, &of_log).wait().success());
}

/// Runs a script in a browser, where there is one; pictures stay where SEEPD_SCREENSHOTS says.
fn in_browser(script: &str, folder: &Path, place: &str, more: &[&str]) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let modules = root.join("target/node/node_modules");
    if !has("chromium") || !has("node") || !modules.join("playwright-core").exists() {
        return;
    }
    let pictures = std::env::var_os("SEEPD_SCREENSHOTS").map_or_else(|| folder.to_owned(), PathBuf::from);
    let output = Command::new("node")
        .arg(root.join("tests/browser").join(script))
        .arg(place)
        .arg(pictures)
        .args(more)
        .env("NODE_PATH", modules)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
}

#[test]
fn a_report_reads_well_on_a_phone_and_on_paper() {
    let folder = tempfile::tempdir().unwrap();
    let [healthy, worn, baseline, report] =
        ["healthy.mcap", "worn.mcap", "b.json", "report.html"].map(|name| folder.path().join(name));
    simulate(&healthy, &["--cycles", "24", "--load-variation", "0.05"]);
    simulate(&worn, &["--cycles", "24", "--leak-area", "2e-8", "--leak-growth", "8e-7"]);
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    stdout(&seepd(["learn-baseline", "--out", &text(&baseline), &text(&healthy)]));
    stdout(&seepd(["replay", "--baseline", &text(&baseline), "--html", &text(&report), &text(&worn)]));
    let page = fs::read_to_string(&report).unwrap();
    assert!(page.contains("Stop the machine as soon as it can be stopped"), "what to do");
    in_browser("report.cjs", folder.path(), &text(&report), &[]);
}

#[test]
fn the_page_answers_in_every_state_on_desk_and_phone_in_light_and_dark() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    run_into_alarm(folder.path());
    let _daemon = Daemon::start(folder.path(), &four_machines(folder.path(), port));
    let bearer = format!("Authorization: Bearer {TOKEN}\r\n");
    // The first whole cycle takes up to 20 s.
    until("the logs' ends, silence and the alarm", 4 * SOON, || {
        let Some(answer) = ask(port, "GET", "/api/v1/status", &bearer) else { return false };
        let axes = answer.json()["axes"].as_array().unwrap().clone();
        let has_ended = |axis: &&Value| axis["source"]["state"] == "ended";
        let is_alarmed = axes.iter().any(|axis| axis["flag"] == "severe" && axis["cycle"].is_u64());
        is_alarmed
            && axes.iter().filter(has_ended).count() == 2
            && axes.iter().any(|axis| axis["reason"] == "stale")
    });
    in_browser("window.cjs", folder.path(), &format!("http://localhost:{port}/"), &[TOKEN]);
}

#[test]
fn the_whole_page_is_small_and_asks_for_nothing_elsewhere() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let config = format!(
        "state_dir = \"state\"\n{}[http]\nlisten = \"127.0.0.1:{port}\"\n",
        machine_toml(&folder.path().join("in.sock"))
    );
    let _daemon = Daemon::start(folder.path(), &config);
    until("an answer", SOON, || axis_status(port).is_some());
    let parts = ["/", "/dashboard.js", "/dashboard.css"].map(|path| ask(port, "GET", path, "").unwrap().body);
    let bytes: usize = parts.iter().map(String::len).sum();
    assert!((10_000..=150_000).contains(&bytes), "{bytes}");
    assert!(parts.iter().all(|part| !part.contains("http://") && !part.contains("https://")));
    // The words of reasons are the program's own.
    let reasons = json(port, "/api/v1/reasons");
    let stale = reasons.as_array().unwrap().iter().find(|reason| reason["name"] == "stale").unwrap();
    assert_eq!(stale["meaning"], "no command comes");
    assert!(stale["cure"].as_str().unwrap().contains("seepd init"));
}

#[test]
fn who_comes_in_the_morning_sees_the_night_and_who_has_taken_note() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("worn.mcap");
    simulate(&log, &["--cycles", "12", "--leak-area", "5e-8", "--leak-growth", "3e-7"]);
    run_to_the_end(folder.path(), "press-1", &log);
    let (socket, port) = (folder.path().join("in.sock"), free_port());
    let live = format!(
        "axis = \"press-1\"\nstate_dir = \"state\"\n[alarm]\nwatch_lpm = 0.2\n{}[http]\nlisten = \"127.0.0.1:{port}\"\n",
        machine_toml(&socket)
    );
    let told = |daemon: &Daemon| {
        until("an answer", SOON, || axis_status(port).is_some());
        let history = json(port, "/api/v1/history").as_array().unwrap().clone();
        assert!(!daemon.words().contains("kept as"), "{}", daemon.words());
        history
    };
    let daemon = Daemon::start(folder.path(), &live);
    let history = told(&daemon);
    let flags: Vec<&str> = history.iter().filter_map(|event| event["flag_to"].as_str()).collect();
    assert!(flags.starts_with(&["healthy", "watch", "leak"]), "{flags:?}");
    let status = axis_status(port).unwrap();
    assert_eq!(status["thresholds"]["watch_lpm"], 0.2);
    assert!(status["since_ns"].is_i64() && status["t_sample_ns"].is_null());
    // Notes that are none are refused.
    let say = |text: &str| ask_with(port, "POST", "/api/v1/axes/press-1/acknowledge", "", text).unwrap();
    for (wrong, word) in
        [("7", "no acknowledgement"), (r#"{"whom":"x"}"#, "whom"), (r#"{"who":"a\nb"}"#, "line breaks")]
    {
        let answer = say(wrong);
        assert_eq!(answer.code, 400, "{wrong}");
        assert!(answer.body.contains(word), "{}", answer.body);
    }
    assert_eq!(say(r#"{"who":"M. Huber <b>","note":"kit ordered"}"#).code, 202);
    until("the acknowledgement", SOON, || {
        axis_status(port).unwrap()["acknowledgement"]["who"] == "M. Huber <b>"
    });
    assert!(daemon.terminate().0.success());
    // The next shift's daemon knows it, and so does its page.
    let daemon = Daemon::start(folder.path(), &live);
    let history = told(&daemon);
    let last = history.iter().rev().find(|event| event["schema"] == "seepd.acknowledged/1").unwrap();
    assert_eq!((&last["who"], &last["note"]), (&"M. Huber <b>".into(), &"kit ordered".into()));
    assert_eq!(axis_status(port).unwrap()["acknowledgement"]["note"], "kit ordered");
    let ids: Vec<&str> = history.iter().filter_map(|event| event["id"].as_str()).collect();
    assert_eq!(ids.len(), history.len());
}

#[test]
fn the_healthy_cycle_is_the_mean_of_the_first_ones_and_outlives_the_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("healthy.mcap");
    simulate(&log, &["--cycles", "10"]);
    run_to_the_end(folder.path(), "press-1", &log);
    let (socket, port) = (folder.path().join("in.sock"), free_port());
    let live = format!(
        "axis = \"press-1\"\nstate_dir = \"state\"\n{}[http]\nlisten = \"127.0.0.1:{port}\"\n",
        machine_toml(&socket)
    );
    let _daemon = Daemon::start(folder.path(), &live);
    until("an answer", SOON, || axis_status(port).is_some());
    let course = json(port, "/api/v1/axes/press-1/healthy");
    let healthy = &course["healthy"];
    // Of ten cycles those at the ends may not be whole.
    let cycles = healthy["cycles"].as_u64().unwrap();
    assert!((4..=10).contains(&cycles), "{cycles}");
    let points = healthy["points"].as_array().unwrap();
    assert!((490..=500).contains(&points.len()), "{}", points.len());
    // It is the cycle of the fixture, to what filter and bins change.
    let fixture = cycle("nominal_leak_0.csv");
    let at = |s: f64| {
        points
            .iter()
            .min_by(|a, b| {
                let far = |point: &Value| (point[0].as_f64().unwrap() - s).abs();
                far(a).total_cmp(&far(b))
            })
            .unwrap()[1]
            .as_f64()
            .unwrap()
    };
    for s in [1.5, 3.5, 7.25] {
        let wanted = fixture[(s * 1e3) as usize];
        assert!((at(s) - wanted).abs() < 0.02, "{s}: {} {wanted}", at(s));
    }
    let phases: Vec<&str> =
        course["phases"].as_array().unwrap().iter().filter_map(|phase| phase["name"].as_str()).collect();
    assert!(phases.contains(&"extend") && phases.contains(&"hold_3"), "{phases:?}");
    assert_eq!(ask(port, "GET", "/api/v1/axes/none/healthy", "").unwrap().code, 404);
}

#[test]
fn who_has_no_token_gets_a_form_and_who_has_it_is_let_in() {
    let folder = tempfile::tempdir().unwrap();
    let (socket, port) = (folder.path().join("in.sock"), free_port());
    fs::write(folder.path().join("token"), TOKEN).unwrap();
    let config = format!(
        "state_dir = \"state\"\n{}[http]\nlisten = \"127.0.0.1:{port}\"\ntoken_file = \"token\"\n",
        machine_toml(&socket)
    );
    let _daemon = Daemon::start(folder.path(), &config);
    until("an answer", SOON, || ask(port, "GET", "/healthz", "").is_some());
    let form = ask(port, "GET", "/", "").unwrap();
    assert_eq!(form.code, 401);
    assert!(form.body.contains("<form method=\"post\" action=\"/login\">"), "{}", form.body);
    assert!(form.head.contains("form-action 'self'"));
    assert_eq!(ask(port, "GET", "/dashboard.css", "").unwrap().code, 200);
    assert_eq!(ask(port, "GET", "/api/v1/reasons", "").unwrap().code, 401);
    let send = |body: &str, more: &str| {
        let headers = format!("Content-Type: application/x-www-form-urlencoded\r\n{more}");
        ask_with(port, "POST", "/login", &headers, body).unwrap()
    };
    let long = "x".repeat(100_000);
    for wrong in ["token=wrong", "token=", "", "other=1", long.as_str()] {
        let answer = send(wrong, "");
        assert_eq!(answer.code, 401);
        assert!(answer.body.contains("That is not the token"), "{}", answer.body);
    }
    assert_eq!(send(&format!("token={TOKEN}"), "Origin: http://evil.example\r\n").code, 403);
    let own = format!("Origin: http://127.0.0.1:{port}\r\n");
    let entered = send(&format!("token={TOKEN}"), &own);
    assert_eq!(entered.code, 303);
    assert!(
        entered.head.to_lowercase().contains(&format!("set-cookie: seepd_token={TOKEN}; path=/; httponly"))
    );
    let cookie = format!("Cookie: seepd_token={TOKEN}\r\n");
    assert_eq!(ask(port, "GET", "/api/v1/reasons", &cookie).unwrap().code, 200);
}
