//! The live daemon and those who talk to it over a network: brokers that refuse, orders that nobody gave, clients that stall.

use std::fs;
use std::io::Write;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use serde_json::Value;

use crate::daemon::{
    Daemon, Mosquitto, ask, axis_status, axis_toml, free_port, has, json, machine_toml, sink, until,
};
use crate::support::{seepd, simulate, stderr, stdout};

const SOON: Duration = Duration::from_secs(15);

/// A machine that says nothing, with a page and a broker.
fn silent_press(folder: &Path, http_port: u16, broker_port: u16, version: &str) -> String {
    format!(
        "axis = \"press-1\"\nstate_dir = \"state\"\n{}[http]\nlisten = \"127.0.0.1:{http_port}\"\n\
         [mqtt]\nhost = \"127.0.0.1\"\nport = {broker_port}\nversion = \"{version}\"\n",
        machine_toml(&folder.join("in.sock"))
    )
}

/// A machine that says nothing, and one whose log is read as fast as can be, with a page.
fn silent_and_worn(folder: &Path, port: u16) -> String {
    let log = folder.join("worn.mcap");
    simulate(&log, &["--cycles", "8", "--leak-area", "1e-7", "--leak-growth", "3e-7"]);
    let silent = axis_toml("silent", &folder.join("in.sock"));
    format!(
        "state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{port}\"\n{silent}\
         [[axes]]\naxis = \"worn\"\n[axes.alarm]\nraise_cycles = 1\n[axes.source]\nlog = \"{}\"\npace = \"fast\"\n",
        log.display()
    )
}

/// Events of a leaking machine that wait for a broker: what a daemon has left that had none.
fn spooled(folder: &Path, broker_port: u16) -> Vec<PathBuf> {
    let log = folder.join("worn.mcap");
    simulate(&log, &["--cycles", "8", "--leak-area", "1e-7", "--leak-growth", "3e-7"]);
    let config = format!(
        "axis = \"press-1\"\nstate_dir = \"state\"\n[source]\nlog = \"{}\"\npace = \"fast\"\n[alarm]\nraise_cycles = 1\n\
         [mqtt]\nhost = \"127.0.0.1\"\nport = {broker_port}\n",
        log.display()
    );
    assert!(Daemon::start(folder, &config).wait().success());
    entries(&folder.join("state/spool"))
}

fn has_ended(port: u16, axis: &str) -> bool {
    let answer = ask(port, "GET", &format!("/api/v1/axes/{axis}"), "");
    answer.is_some_and(|answer| answer.json()["source"]["state"] == "ended")
}

/// Publishes a message.
fn publish(mosquitto: &Mosquitto, topic: &str, more: &[&str]) {
    let port = mosquitto.port.to_string();
    let output =
        Command::new("mosquitto_pub").args(["-h", "127.0.0.1", "-p", &port, "-t", topic]).args(more).output();
    assert!(output.unwrap().status.success());
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().map(|entry| entry.unwrap().path());
    entries.filter(|path| path.extension().is_some_and(|extension| extension == "json")).collect()
}

#[test]
fn retained_and_empty_messages_are_no_orders() {
    if !has("mosquitto") || !has("mosquitto_pub") {
        return;
    }
    for version in ["3.1.1", "5"] {
        let folder = tempfile::tempdir().unwrap();
        let mosquitto = Mosquitto::start(folder.path(), free_port(), "allow_anonymous true");
        let topic = "seepd/press-1/new_baseline";
        publish(&mosquitto, topic, &["-r", "-m", "replaced last year"]);
        let port = free_port();
        let config = silent_press(folder.path(), port, mosquitto.port, version);
        let daemon = Daemon::start(folder.path(), &config);
        let told = |what: &str| until(what, SOON, || daemon.words().contains(what));
        let learning = || axis_status(port).unwrap()["baseline"]["learning"].clone();
        told("seepd/press-1/new_baseline: a retained message is no order");
        assert_eq!(learning(), Value::Null);
        // Whoever clears it gives no order either.
        publish(&mosquitto, topic, &["-r", "-n"]);
        told("seepd/press-1/new_baseline: an empty message is no order");
        assert_eq!(learning(), Value::Null);
        publish(&mosquitto, topic, &["-m", "replaced just now"]);
        until("the order", SOON, || learning() == serde_json::json!([0, 50]));
    }
}

#[test]
fn a_topic_that_the_broker_refuses_holds_up_no_other() {
    if !has("mosquitto") || !has("mosquitto_sub") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (http_port, broker_port) = (free_port(), free_port());
    let spool = folder.path().join("state/spool");
    let waiting = spooled(folder.path(), broker_port);
    let of_topic =
        |topic: &str| waiting.iter().filter(|path| fs::read_to_string(path).unwrap().contains(topic)).count();
    let (cycles, flags) = (of_topic("\"press-1/cycle\""), of_topic("\"press-1/flag\""));
    assert!(cycles == 8 && flags >= 1 && cycles + flags == waiting.len(), "{cycles} cycles, {flags} flags");

    let acl = folder.path().join("acl");
    fs::write(&acl, "topic deny seepd/press-1/cycle\ntopic readwrite seepd/#\n").unwrap();
    let more = format!("allow_anonymous true\nacl_file {}", acl.display());
    let mosquitto = Mosquitto::start(folder.path(), broker_port, &more);
    let heard = mosquitto.listen(&folder.path().join("heard.txt"), &[]);
    let daemon = Daemon::start(folder.path(), &silent_press(folder.path(), http_port, broker_port, "5"));
    until("every flag", SOON, || heard.messages("seepd/press-1/flag").len() == flags);
    until("an empty spool", SOON, || entries(&spool).is_empty());
    assert_eq!(entries(&spool.join("refused")).len(), cycles);
    let mqtt = sink(http_port, "mqtt");
    assert_eq!(
        (&mqtt["sent"], &mqtt["waiting"], &mqtt["dropped"]),
        (&flags.into(), &0.into(), &cycles.into())
    );
    assert!(mqtt["detail"].as_str().unwrap().ends_with("the broker refuses press-1/cycle"), "{mqtt}");
    assert_eq!(daemon.words().matches("connected to the broker").count(), 1, "{}", daemon.words());
}

#[test]
fn an_order_too_large_to_be_read_keeps_no_event_back() {
    if !has("mosquitto") || !has("mosquitto_pub") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (http_port, broker_port) = (free_port(), free_port());
    let waiting = spooled(folder.path(), broker_port).len();
    let mosquitto = Mosquitto::start(folder.path(), broker_port, "allow_anonymous true");
    let large = folder.path().join("large");
    fs::write(&large, "x".repeat(100_000)).unwrap();
    publish(&mosquitto, "seepd/press-1/acknowledge", &["-r", "-f", large.to_str().unwrap()]);
    let daemon = Daemon::start(folder.path(), &silent_press(folder.path(), http_port, broker_port, "3.1.1"));
    until("the large message", SOON, || daemon.words().contains("payload size limit exceeded"));
    until("every event", SOON, || sink(http_port, "mqtt")["sent"] == waiting);
    assert_eq!(sink(http_port, "mqtt")["dropped"], 0);
}

#[test]
fn a_flood_of_orders_is_a_few_lines_in_the_log() {
    if !has("mosquitto") || !has("mosquitto_pub") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mosquitto =
        Mosquitto::start(folder.path(), free_port(), "allow_anonymous true\nmax_queued_messages 0");
    let port = free_port();
    let daemon = Daemon::start(folder.path(), &silent_press(folder.path(), port, mosquitto.port, "3.1.1"));
    // Orders are asked for once the connection stands, and what comes before is lost: one is given again until it is heard.
    until("a first order", SOON, || {
        publish(&mosquitto, "seepd/first/acknowledge", &["-m", "now"]);
        daemon.words().contains("there is no axis first")
    });
    let flood = |topic: &str| {
        let mut child = Command::new("mosquitto_pub")
            .args(["-h", "127.0.0.1", "-p", &mosquitto.port.to_string(), "-l", "-t", topic])
            .stdin(Stdio::piped())
            .spawn()
            .unwrap();
        child.stdin.take().unwrap().write_all(&b"now\n".repeat(3000)).unwrap();
        assert!(child.wait().unwrap().success());
    };
    flood("seepd/press-1/new_baseline");
    flood("seepd/nobody/acknowledge");
    let words = || daemon.words();
    until("what is true", SOON, || words().contains("there is no axis nobody; the axes are press-1"));
    until("the order", SOON, || {
        axis_status(port).unwrap()["baseline"]["learning"] == serde_json::json!([0, 50])
    });
    assert!(words().lines().count() < 40, "{}", words());
    assert!(!words().contains("there is no axis press-1"), "{}", words());
}

#[test]
fn an_order_to_an_axis_that_cannot_run_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let socket = folder.path().join("in.sock");
    let good =
        machine_toml(&socket).replace("[source]", "[axes.source]").replace("[signals", "[axes.signals");
    let config = format!(
        "state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{port}\"\n[[axes]]\naxis = \"good\"\n{good}\
         [[axes]]\naxis = \"press-1\"\nmodel = \"missing.json\"\n{good}"
    );
    let _daemon = Daemon::start(folder.path(), &config);
    until("an answer", SOON, || axis_status(port).is_some());
    for order in ["acknowledge", "new-baseline"] {
        let told = |axis: &str| {
            let answer = ask(port, "POST", &format!("/api/v1/axes/{axis}/{order}"), "").unwrap();
            (answer.code, answer.json()["error"].as_str().unwrap_or_default().to_owned())
        };
        let (code, error) = told("press-1");
        assert!(code == 409 && error.starts_with("the axis press-1 does not run: "), "{code}: {error}");
        assert!(error.contains("missing.json"), "{error}");
        assert_eq!(told("other"), (404, "there is no axis other; the axes are good, press-1".into()));
        assert_eq!(told("good"), (202, String::new()));
    }
}

#[test]
fn idle_connections_leave_descriptors_for_the_rest() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let config = format!(
        "axis = \"press-1\"\nstate_dir = \"state\"\n{}[http]\nlisten = \"127.0.0.1:{port}\"\n",
        machine_toml(&folder.path().join("in.sock"))
    );
    let daemon = Daemon::start(folder.path(), &config);
    until("an answer", SOON, || axis_status(port).is_some());
    let open = || fs::read_dir(format!("/proc/{}/fd", daemon.child.id())).unwrap().count();
    let before = open();
    let idle: Vec<TcpStream> = (0..220).map(|_| TcpStream::connect(("127.0.0.1", port)).unwrap()).collect();
    until("as many as are taken", SOON, || daemon.words().contains("128 connections are open"));
    assert!((1..=before + 128).contains(&open()), "{before} descriptors before, {} then", open());
    // Once they go, the others have their turn.
    drop(idle);
    until("an answer", SOON, || axis_status(port).is_some());
}

#[test]
fn what_was_told_of_a_log_is_remembered_and_has_no_delay() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let _daemon = Daemon::start(folder.path(), &silent_and_worn(folder.path(), port));
    until("the end of the log", SOON, || has_ended(port, "worn"));
    let history = json(port, "/api/v1/history");
    let flags = history.as_array().unwrap().iter().filter(|event| event["axis"] == "worn");
    let flags: Vec<&str> = flags.filter_map(|event| event["flag_to"].as_str()).collect();
    assert_eq!(flags, ["watch", "leak"]);
    // Its times are its own: what has passed since then is no delay.
    let worn = json(port, "/api/v1/axes/worn");
    assert_eq!((&worn["cycles"], &worn["publication_delay_s"]), (&8.into(), &Value::Null));
    let metrics = ask(port, "GET", "/metrics", "").unwrap().body;
    assert!(metrics.contains("seepd_cycles_total{axis=\"worn\"} 8"), "{metrics}");
    assert!(!metrics.contains("seepd_publication_delay_s{"), "{metrics}");
}

#[test]
fn a_reload_takes_up_a_changed_token_and_a_changed_password() {
    if !has("mosquitto") || !has("mosquitto_passwd") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let passwords = folder.path().join("passwords");
    let made = Command::new("mosquitto_passwd")
        .args(["-b", "-c"])
        .arg(&passwords)
        .args(["press", "the new one"])
        .status();
    assert!(made.unwrap().success());
    let more = format!("allow_anonymous false\npassword_file {}", passwords.display());
    let mosquitto = Mosquitto::start(folder.path(), free_port(), &more);
    let port = free_port();
    let (token, password) = (folder.path().join("token"), folder.path().join("password"));
    fs::write(&token, "the-old-token-of-20-").unwrap();
    fs::write(&password, "the old one").unwrap();
    let config = format!(
        "{}username = \"press\"\npassword_file = \"password\"\n",
        silent_press(folder.path(), port, mosquitto.port, "3.1.1")
    );
    let config = config.replace("[mqtt]", "token_file = \"token\"\n[mqtt]");
    let daemon = Daemon::start(folder.path(), &config);
    let code = |token: &str| {
        let header = format!("Authorization: Bearer {token}\r\n");
        ask(port, "GET", "/api/v1/status", &header).map(|answer| answer.code)
    };
    until("the refusal", SOON, || daemon.words().contains("the broker at 127.0.0.1"));
    until("an answer", SOON, || code("the-old-token-of-20-") == Some(200));
    fs::write(&token, "the-new-token-of-20-").unwrap();
    fs::write(&password, "the new one").unwrap();
    daemon.signal("HUP");
    until("the new token", SOON, || code("the-new-token-of-20-") == Some(200));
    assert_eq!(code("the-old-token-of-20-"), Some(401));
    until("the new password", SOON, || daemon.words().contains("connected to the broker"));
    // Where nothing has changed everything goes on.
    daemon.signal("HUP");
    until("the second reload", SOON, || {
        daemon.words().matches("the changed configuration is in force").count() == 2
    });
    assert_eq!(daemon.words().matches("connected to the broker").count(), 1, "{}", daemon.words());
}

#[test]
fn topics_have_no_control_characters() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("seepd.toml");
    fs::write(&path, "[mqtt]\nprefix = \"a\\u001bb\"\n").unwrap();
    let output = seepd(["check", path.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(78));
    assert!(stderr(&output).contains("mqtt.prefix is `a"), "{}", stderr(&output));
    assert!(!stderr(&output).contains('\u{1b}'), "{}", stderr(&output));
}

#[test]
fn a_password_that_others_can_read_and_an_open_page_are_remarked_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("seepd.toml");
    fs::write(folder.path().join("secret"), "0123456789abcdef").unwrap();
    let remarks = |http: &str, mqtt: &str| -> Vec<String> {
        let text = format!(
            "{}[http]\n{http}[mqtt]\nusername = \"press\"\npassword_file = \"secret\"\n{mqtt}",
            machine_toml(Path::new("in.sock"))
        );
        fs::write(&path, text).unwrap();
        let line = stdout(&seepd(["check", "--json", path.to_str().unwrap()]));
        let line: Value = serde_json::from_str(&line).unwrap();
        assert_eq!(line["good"], true);
        let remarks = line["remarks"].as_array().unwrap().iter();
        remarks.map(|remark| remark.as_str().unwrap().split_once(' ').unwrap().0.to_owned()).collect()
    };
    assert_eq!(remarks("", "host = \"broker.example\"\n"), ["http:", "mqtt:"]);
    let text = stdout(&seepd(["check", path.to_str().unwrap()]));
    assert_eq!(text.matches(": remark: ").count(), 2, "{text}");
    // What stays on this machine, or is encrypted, is nobody else's to read.
    for host in ["localhost\"", "127.0.0.2\"", "::1\"", "broker.example\"\ntls = true"] {
        let mqtt = format!("host = \"{host}\n");
        assert_eq!(remarks("token_file = \"secret\"\n", &mqtt), Vec::<String>::new(), "{host}");
    }
    // The daemon says it at its start.
    let config = silent_press(folder.path(), free_port(), free_port(), "5");
    let daemon = Daemon::start(folder.path(), &config);
    until("the remark", SOON, || daemon.words().contains("http: there is no token_file"));
}

#[test]
fn the_page_shows_the_chosen_axis_alone_and_what_was_told_before() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/browser/axes.cjs");
    let modules = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/node/node_modules");
    if !has("chromium") || !has("node") || !modules.join("playwright-core").exists() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let _daemon = Daemon::start(folder.path(), &silent_and_worn(folder.path(), port));
    until("the end of the log", SOON, || has_ended(port, "worn"));
    let pictures =
        std::env::var_os("SEEPD_SCREENSHOTS").map_or_else(|| folder.path().to_owned(), PathBuf::from);
    let output = Command::new("node")
        .arg(script)
        .arg(format!("http://localhost:{port}/"))
        .arg(&pictures)
        .env("NODE_PATH", modules)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
}
