//! The repair log as people keep it, and what becomes of what was known before a repair.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::Duration;

use crate::daemon::{
    Daemon, Machine, Mosquitto, ask, ask_with, axis_status, cycle, free_port, has, machine_toml, until,
};
use crate::support::{seepd, simulate, stderr, stdout, summary};
use serde_json::{Value, json};

/// A machine of the series, as in the tests of causes.
const MACHINE: [&str; 8] =
    ["--parameter-spread", "0.05", "--machine", "3", "--load-variation", "0.02", "--noise", "0.003"];
/// Area of 0.7 L/min at 7 MPa, m².
const LEAK: &str = "1.33e-7";
/// Cycles before the repair, and after it: the CUSUM keeps a leak that has gone for 20 at most, and a verdict takes 12.
const CYCLES: &str = "16";
/// The second log follows the first one of 160 s.
const REPAIRED_AT: &str = "159.9 s";

struct Place {
    folder: PathBuf,
}

static PLACE: LazyLock<Place> = LazyLock::new(|| {
    let place = Place { folder: crate::support::shared_folder("repairs") };
    let log = place.log("healthy", &["--cycles", "60", "--seed", "2"]);
    let baseline = place.path("baseline.json");
    stdout(&seepd(["learn-baseline", "--out", text_of(&baseline), text_of(&log)]));
    place.log("sound", &["--cycles", CYCLES, "--seed", "5"]);
    place.log("sound on", &["--cycles", CYCLES, "--seed", "10"]);
    place.log("leak", &["--cycles", CYCLES, "--seed", "6", "--leak-area", LEAK]);
    place.log("leaks on", &["--cycles", CYCLES, "--seed", "7", "--leak-area", LEAK]);
    place.log("null", &["--cycles", CYCLES, "--seed", "8", "--with", "valve_bias.offset=0.008"]);
    place.log("null still", &["--cycles", CYCLES, "--seed", "9", "--with", "valve_bias.offset=0.008"]);
    place
});

fn text_of(path: &Path) -> &str {
    path.to_str().unwrap()
}

impl Place {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn log(&self, name: &str, more: &[&str]) -> PathBuf {
        let log = self.path(&format!("{name}.mcap"));
        simulate(&log, &[&MACHINE, more].concat());
        log
    }

    /// Two logs as one record, with a repair between them.
    fn arguments(&self, name: &str, what: &str, [before, after]: [&str; 2]) -> Vec<String> {
        let repairs = self.path(&format!("{name}.repairs.toml"));
        let who = ["--who", "M. Huber", "--note", "kit <7>"];
        let place = ["--at", REPAIRED_AT, "--file", text_of(&repairs)];
        stdout(&seepd([&["repair", "add", what], &who[..], &place].concat()));
        let logs = [before, after].map(|name| self.path(&format!("{name}.mcap")));
        ["replay", "--baseline", text_of(&self.path("baseline.json")), "--repairs", text_of(&repairs)]
            .into_iter()
            .chain(logs.iter().map(|log| text_of(log)))
            .map(str::to_owned)
            .collect()
    }

    fn lines(&self, name: &str, what: &str, logs: [&str; 2]) -> Vec<Value> {
        let arguments = self.arguments(name, what, logs);
        let output = stdout(&seepd(arguments.into_iter().chain(["--json".to_owned()])));
        output.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    fn told(&self, name: &str, what: &str, logs: [&str; 2]) -> String {
        stdout(&seepd(self.arguments(name, what, logs)))
    }
}

/// The cycles of the second log.
fn after(lines: &[Value]) -> Vec<&Value> {
    let cycles = lines.iter().filter(|line| line["schema"] == "seepd.cycle/1" && line["reason"].is_null());
    cycles.filter(|line| line["t_start_s"].as_f64().unwrap() > 160.0).collect()
}

#[test]
fn after_a_new_seal_the_leak_s_sums_and_flag_begin_anew_and_the_data_bear_it_out() {
    let place = &*PLACE;
    let lines = place.lines("good", "seal_replaced", ["leak", "sound"]);
    assert_eq!(summary(&lines)["highest_flag"], "leak");
    let after = after(&lines);
    assert!(after.len() >= 14, "{}", after.len());
    let finding = |line: &&Value| line["finding"] == "none" && line["flag"] == "healthy";
    assert_eq!(after.iter().find(|line| !finding(line)), None);
    let repair = &summary(&lines)["repairs"][0];
    assert_eq!(
        (&repair["what"], &repair["who"], &repair["note"], &repair["verdict"]),
        (&"seal_replaced".into(), &"M. Huber".into(), &"kit <7>".into(), &"borne_out".into())
    );
    assert!(repair["text"].as_str().unwrap().contains("and the leak is gone"), "{repair}");
    // The size is that of the new seal alone.
    assert!(summary(&lines)["leak_flow_lpm"].as_f64().unwrap() < 0.1, "{}", summary(&lines));
    // Without the entry the old seal's CUSUM is still above 0.
    let logs = ["leak", "sound"].map(|name| place.path(&format!("{name}.mcap")));
    let baseline = place.path("baseline.json");
    let without = crate::support::replay(&logs[0], &[text_of(&logs[1]), "--baseline", text_of(&baseline)]);
    assert_eq!(self::after(&without)[0]["finding"], "leak");
    assert!(summary(&without).get("repairs").is_none());
}

#[test]
fn a_new_seal_that_leaks_as_the_old_one_did_is_not_believed() {
    let place = &*PLACE;
    let lines = place.lines("bad", "seal_replaced", ["leak", "leaks on"]);
    let after = after(&lines);
    assert_eq!(after[after.len() - 1]["flag"], "leak");
    let flags: Vec<&str> = after.iter().map(|line| line["flag"].as_str().unwrap()).collect();
    assert!(!flags.contains(&"healthy") && flags[0] == "no_estimate", "{flags:?}");
    assert_eq!(summary(&lines)["repairs"][0]["verdict"], "contradicted");
    let text = place.told("bad in words", "seal_replaced", ["leak", "leaks on"]);
    assert!(text.contains("the seal was replaced (M. Huber: kit <7>): CUSUM, trend and flags"), "{text}");
    // Once as it is found, and in the summary.
    assert_eq!(text.matches("but the leak stands as before").count(), 2, "{text}");
}

#[test]
fn an_adjusted_null_is_told_as_such_and_one_that_was_not_contradicts() {
    let place = &*PLACE;
    let of = |name: &str, logs: [&str; 2]| {
        let lines = place.lines(name, "valve_adjusted", logs);
        let after = after(&lines).into_iter().cloned().collect::<Vec<_>>();
        assert!(after.iter().all(|line| line["flag"] == "healthy" && line["finding"] == "none"), "{name}");
        summary(&lines).clone()
    };
    let mended = of("mended", ["null", "sound"]);
    assert_eq!((&mended["repairs"][0]["verdict"], mended.get("condition")), (&"borne_out".into(), None));
    let stands = of("stands", ["null", "null still"]);
    assert_eq!(stands["repairs"][0]["verdict"], "contradicted", "{stands}");
    assert!(stands["condition"].as_str().unwrap().contains("Adjust the null"), "{stands}");
    let moved = of("moved", ["sound", "null"]);
    assert_eq!(moved["repairs"][0]["verdict"], "borne_out", "{moved}");
    let condition = moved["condition"].as_str().unwrap();
    assert!(condition.contains("since the valve was adjusted, as was to be expected"), "{condition}");
    let unseen = of("unseen", ["sound", "sound on"]);
    assert_eq!(unseen["repairs"][0]["verdict"], "not_seen", "{unseen}");
}

#[test]
fn a_report_shows_the_repairs_on_the_trend_and_in_a_table() {
    let place = &*PLACE;
    let page = place.path("report.html");
    let mut arguments = place.arguments("report", "seal_replaced", ["leak", "sound"]);
    arguments.extend(["--quiet", "--html", text_of(&page)].map(str::to_owned));
    stdout(&seepd(arguments));
    let page = fs::read_to_string(&page).unwrap();
    assert!(page.contains("<h2>The repairs</h2>") && page.contains("<td>borne out</td>"), "{page}");
    assert!(page.contains("kit &lt;7&gt;") && page.contains(">seal replaced</text>"), "{page}");
}

#[test]
fn the_log_is_kept_by_commands_and_what_is_wrong_is_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let config = path("seepd.toml");
    fs::write(&config, "axis = \"press-1\"\nrepairs = \"done.toml\"\n").unwrap();
    let of_config = ["--config", text_of(&config)];
    assert!(stdout(&seepd([&["repair", "list"], &of_config[..]].concat())).contains("no entries"));
    let add = |more: &[&str]| seepd([&["repair", "add"], more, &of_config].concat());
    stdout(&add(&["oil_changed", "--at", "2026-03-01T14:30:00+01:00", "--who", "Ä. Weiß"]));
    stdout(&add(&["seal_replaced", "--at", "2025-03-01", "--note", "line \\ \"quoted\""]));
    let listed = stdout(&seepd([&["repair", "list"], &of_config[..]].concat()));
    assert_eq!(
        listed,
        "2025-03-01T00:00:00Z  seal_replaced  line \\ \"quoted\"\n2026-03-01T13:30:00Z  oil_changed  Ä. Weiß\n"
    );
    let json = stdout(&seepd([&["repair", "list", "--json"], &of_config[..]].concat()));
    let first: Value = serde_json::from_str(json.lines().next().unwrap()).unwrap();
    assert_eq!(
        (&first["what"], first["t_ns"].as_i64()),
        (&"seal_replaced".into(), Some(1_740_787_200_000_000_000))
    );
    assert!(
        stdout(&seepd(["check", text_of(&config), text_of(&path("done.toml"))]))
            .contains("good repair log: 2")
    );
    for (more, code, told) in [
        (&["seal"][..], 64, "[possible values: seal_replaced,"),
        (&["other", "--at", "soon"], 64, "--at: `soon` is no time"),
        (&["other", "--note", "two\nlines"], 64, "--note has line breaks"),
    ] {
        let output = add(more);
        assert_eq!(output.status.code(), Some(code), "{more:?}");
        assert!(stderr(&output).contains(told), "{}", stderr(&output));
    }
    // A file that somebody has damaged is not added to, and named.
    fs::write(path("done.toml"), "[[repairs]]\nat = \"2026-03-01\"\nwhat = \"seal\"\n").unwrap();
    for output in [add(&["other"]), seepd(["check", text_of(&config)])] {
        let told = stderr(&output);
        assert_eq!((output.status.code(), told.lines().count()), (Some(78), 1), "{told}");
        assert!(told.contains("done.toml: line 3: unknown variant `seal`"), "{told}");
    }
    let missing = seepd(["replay", "--repairs", "/nowhere.toml", "x.mcap"]);
    assert_eq!(missing.status.code(), Some(66), "{}", stderr(&missing));
}

#[test]
fn entries_come_over_the_broker_and_wrong_ones_are_told() {
    if !has("mosquitto") || !has("mosquitto_pub") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let broker = Mosquitto::start(folder.path(), free_port(), "allow_anonymous true");
    let config = format!(
        "axis = \"press-1\"\nstate_dir = \"state\"\n{}[http]\nlisten = \"127.0.0.1:{port}\"\n[mqtt]\nhost = \"127.0.0.1\"\nport = {}\n",
        machine_toml(&folder.path().join("in.sock")),
        broker.port
    );
    let running = Daemon::start(folder.path(), &config);
    let say = |said: &str| {
        let to =
            ["-h", "127.0.0.1", "-p", &broker.port.to_string(), "-t", "seepd/press-1/repair", "-m", said];
        assert!(std::process::Command::new("mosquitto_pub").args(to).status().unwrap().success());
    };
    // Orders are asked for once the connection stands: said again until it is heard.
    until("the wrong entry told", Duration::from_secs(20), || {
        say("{\"what\":\"seal\"}");
        running.words().contains("seepd/press-1/repair: this is no entry: unknown variant `seal`")
    });
    say("{\"what\":\"oil_changed\",\"note\":\"ISO VG 46\"}");
    until("the entry", Duration::from_secs(10), || {
        axis_status(port).is_some_and(|status| status["repairs"][0]["note"] == "ISO VG 46")
    });
    let text = fs::read_to_string(folder.path().join("state/axes/press-1/repairs.toml")).unwrap();
    assert_eq!(text.matches("[[repairs]]").count(), 1, "{text}");
}

#[test]
fn the_daemon_takes_entries_as_it_takes_acknowledgements_and_remembers_them() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let socket = folder.path().join("in.sock");
    let config = format!(
        "axis = \"press-1\"\nstate_dir = \"state\"\n{}[alarm]\nraise_cycles = 1\n[http]\nlisten = \"127.0.0.1:{port}\"\n",
        machine_toml(&socket)
    );
    let running = Daemon::start(folder.path(), &config);
    let machine = Machine::start(&socket, cycle("nominal_leak_1e-6.csv"));
    until("a severe leak", Duration::from_secs(40), || {
        axis_status(port).is_some_and(|status| status["latched"] == "severe")
    });
    let post = |axis: &str, entry: &str, headers: &str| {
        ask_with(port, "POST", &format!("/api/v1/axes/{axis}/repairs"), headers, entry).unwrap()
    };
    let seal = json!({ "what": "seal_replaced", "who": "M. Huber", "note": "" }).to_string();
    for (answer, code, told) in [
        (post("press-1", "{}", ""), 400, "missing field `what`"),
        (post("press-1", "{\"what\":\"seal\"}", ""), 400, "unknown variant `seal`"),
        (post("press-1", "{\"what\":\"other\",\"at\":\"soon\"}", ""), 400, "is no time"),
        (post("other", &seal, ""), 404, "there is no axis other"),
        (post("press-1", &seal, "Origin: http://elsewhere.example\r\n"), 403, "other sites are refused"),
    ] {
        assert!(answer.code == code && answer.body.contains(told), "{}: {}", answer.code, answer.body);
    }
    assert_eq!(axis_status(port).unwrap()["repairs"], json!([]));
    machine.stop();
    assert_eq!(post("press-1", &seal, "").code, 202);
    let repaired = || axis_status(port).filter(|status| status["repairs"][0]["what"] == "seal_replaced");
    until("the entry", Duration::from_secs(5), || repaired().is_some());
    let status = repaired().unwrap();
    assert_eq!((&status["latched"], &status["flag"]), (&Value::Null, &"no_estimate".into()), "{status}");
    let history = ask(port, "GET", "/api/v1/history", "").unwrap().body;
    assert!(
        history.contains("\"repair_noted\"") && history.contains("the seal was replaced (M. Huber)"),
        "{history}"
    );
    let file = folder.path().join("state/axes/press-1/repairs.toml");
    let text = fs::read_to_string(&file).unwrap();
    assert!(
        text.contains("what = \"seal_replaced\"\nwho = \"M. Huber\"\n") && !text.contains("note ="),
        "{text}"
    );
    // An entry that the command adds counts while the daemon runs, and both outlive it.
    let config_file = folder.path().join("seepd.toml");
    let of_config = ["--config", text_of(&config_file)];
    stdout(&seepd([&["repair", "add", "oil_changed"], &of_config[..]].concat()));
    let machine = Machine::start(&socket, cycle("nominal_leak_1e-6.csv"));
    let count = || axis_status(port).map_or(0, |status| status["repairs"].as_array().unwrap().len());
    until("the command's entry", Duration::from_secs(15), || count() == 2);
    // The leak stands: it is told again, as the new seal's.
    until("the flag of the new seal", Duration::from_secs(40), || {
        axis_status(port).unwrap()["latched"] == "severe"
    });
    machine.stop();
    assert!(running.terminate().0.success());
    let again = Daemon::start(folder.path(), &config);
    until("an answer", Duration::from_secs(10), || axis_status(port).is_some());
    assert_eq!(count(), 2);
    let status = axis_status(port).unwrap();
    assert_eq!(status["latched"], "severe", "an entry that was heeded is not heeded again: {status}");
    drop(again);
}
