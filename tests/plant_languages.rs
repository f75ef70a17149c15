//! What the plant's other programs hear: Home Assistant over a real broker, InfluxDB's line protocol over UDP.

use std::collections::BTreeSet;
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::Value;

use crate::daemon::{
    Companion, Daemon, Machine, Mosquitto, axis_status, axis_toml, cycle, free_port, has, json,
    log_axis_toml, sink, until,
};
use crate::support::{python, seepd, simulate};

const SOON: Duration = Duration::from_secs(20);

/// A configuration with the page at a port, some sinks, an axis `Press 1` that reads a log, and one that hears nothing.
fn two_axes(folder: &Path, port: u16, log: &Path, sinks: &str) -> String {
    format!(
        "state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{port}\"\n{sinks}{}{}",
        log_axis_toml("Press 1", log),
        axis_toml("silent", &folder.join("in.sock"))
    )
}

/// A log of a machine that leaks.
fn worn_log(folder: &Path) -> PathBuf {
    let log = folder.join("worn.mcap");
    simulate(&log, &["--cycles", "8", "--leak-area", "2e-7"]);
    log
}

/// The keys of a status that templates ask for.
fn asked_for(template: &str) -> BTreeSet<String> {
    let names = template.split("value_json.").skip(1);
    names.map(|rest| rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()).collect()
}

#[test]
fn home_assistant_is_told_of_each_axis_and_asks_for_what_there_is() {
    if !has("mosquitto") || !has("mosquitto_sub") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let log = worn_log(folder.path());
    let mosquitto = Mosquitto::start(folder.path(), free_port(), "allow_anonymous true");
    let heard = mosquitto.listen(&folder.path().join("heard.txt"), &["-t", "homeassistant/#"]);
    let port = free_port();
    let silent = crate::daemon::machine_toml(&folder.path().join("in.sock"))
        .replace("[source]", "[axes.source]")
        .replace("[signals", "[axes.signals");
    let config = |first: &str| {
        format!(
            "state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{port}\"\n[mqtt]\nhost = \"localhost\"\nport = {}\nhome_assistant = \"homeassistant\"\n\
             {first}[[axes]]\naxis = \"second\"\n{silent}",
            mosquitto.port
        )
    };
    let first = format!(
        "[[axes]]\naxis = \"Press 1\"\n[axes.source]\nlog = \"{}\"\npace = \"fast\"\n",
        log.display()
    );
    let daemon = Daemon::start(folder.path(), &config(&first));
    // Topics with spaces cannot be told from their content in a line: the message begins with its brace.
    let configs = || -> Vec<(String, String)> {
        let text = std::fs::read_to_string(folder.path().join("heard.txt")).unwrap_or_default();
        let lines = text.lines().filter(|line| line.starts_with("homeassistant/"));
        lines
            .filter_map(|line| line.split_once(' '))
            .map(|(topic, text)| (topic.to_owned(), text.to_owned()))
            .collect()
    };
    until("the devices", SOON, || configs().len() >= 2);
    let (topic, message) = configs().into_iter().find(|(topic, _)| topic.contains("Press")).unwrap();
    assert_eq!(topic, "homeassistant/device/seepd-Press_20_1/config");
    let device: Value = serde_json::from_str(&message).unwrap();
    assert_eq!(
        (&device["dev"]["name"], &device["availability_topic"]),
        (&"Press 1".into(), &"seepd/status".into())
    );
    until("its estimate", SOON, || axis_status(port).is_some_and(|status| status["flag"] == "leak"));
    let status = axis_status(port).unwrap();
    let mut keys = BTreeSet::new();
    for (name, component) in device["cmps"].as_object().unwrap() {
        assert!(component["p"].is_string() && component["unique_id"].is_string(), "{name}");
        keys.extend(asked_for(component["value_template"].as_str().unwrap_or_default()));
    }
    assert!(keys.len() >= 8, "{keys:?}");
    assert!(keys.iter().all(|key| status.get(key).is_some()), "{keys:?}: {status}");
    assert!(!heard.messages("seepd/status").is_empty(), "the device's availability");
    // An axis that a reload takes away is told to have gone.
    std::fs::write(folder.path().join("seepd.toml"), config("")).unwrap();
    let before = daemon.words().len();
    daemon.signal("HUP");
    until("the reload", SOON, || daemon.words()[before..].contains("in force"));
    let is_cleared = || configs().iter().any(|(of, text)| *of == topic && !text.starts_with('{'));
    until("its end", SOON, is_cleared);
}

/// A line of the protocol: tags, fields and time.
fn read_line(text: &str) -> (String, Vec<(String, String)>, i64) {
    let line = text.strip_suffix('\n').unwrap();
    let marked = line.replace("\\ ", "\u{1}");
    let parts: Vec<&str> = marked.split(' ').collect();
    assert_eq!(parts.len(), 3, "{line}");
    let fields = parts[1].split(',').map(|field| field.split_once('=').unwrap());
    let fields = fields.map(|(name, value)| (name.to_owned(), value.to_owned())).collect();
    (parts[0].replace('\u{1}', " "), fields, parts[2].parse().unwrap())
}

#[test]
fn lines_for_influx_come_after_each_cycle_and_in_between_and_a_deaf_port_holds_nothing_up() {
    let folder = tempfile::tempdir().unwrap();
    let log = worn_log(folder.path());
    let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
    receiver.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let (port, udp) = (free_port(), receiver.local_addr().unwrap());
    let sinks = format!("[influx]\nudp = \"{udp}\"\nperiod_s = 0.2\n");
    let config = two_axes(folder.path(), port, &log, &sinks);
    let _daemon = Daemon::start(folder.path(), &config);
    let mut buffer = [0; 2048];
    let mut next = || {
        let length = receiver.recv(&mut buffer).unwrap();
        read_line(std::str::from_utf8(&buffer[..length]).unwrap())
    };
    let is_leak = |fields: &[(String, String)]| fields.contains(&("flag".into(), "\"leak\"".into()));
    let (mut of_leak, mut of_silent) = (None, None);
    for _ in 0..200 {
        let (series, fields, time_ns) = next();
        assert!(time_ns > 1_700_000_000_000_000_000, "{time_ns}");
        match series.as_str() {
            "seepd,axis=Press 1" if is_leak(&fields) => of_leak = Some(fields),
            "seepd,axis=Press 1" => {}
            "seepd,axis=silent" => of_silent = Some(fields),
            other => panic!("{other}"),
        }
        if of_leak.is_some() && of_silent.is_some() {
            break;
        }
    }
    let (leak, silent) = (of_leak.unwrap(), of_silent.unwrap());
    let value = |name: &str| leak.iter().find(|(known, _)| known == name).unwrap().1.clone();
    let status = axis_status(port).unwrap();
    assert_eq!(value("flag_code"), "3i");
    let flow: f64 = value("leak_flow_lpm").parse().unwrap();
    assert!((flow / status["leak_flow_lpm"].as_f64().unwrap() - 1.0).abs() < 0.05, "{flow} {status}");
    assert!(silent.iter().all(|(name, _)| !name.starts_with("leak")), "{silent:?}");
    // Nobody listens any more: counted or not, the rest goes on.
    drop(receiver);
    until("the sink's complaint", SOON, || {
        let sinks = crate::daemon::json(port, "/api/v1/status")["sinks"].clone();
        sinks
            .as_array()
            .unwrap()
            .iter()
            .any(|sink| sink["name"] == "influx" && sink["dropped"].as_u64() > Some(0))
    });
    assert_eq!(axis_status(port).unwrap()["flag"], "leak");
}

/// What a Sparkplug host has heard of a kind, of a device.
fn told<'t>(heard: &'t [Value], kind: &str, device: Option<&str>) -> Vec<&'t Value> {
    heard.iter().filter(|line| line["type"] == kind && line["device"].as_str() == device).collect()
}

#[test]
fn a_sparkplug_host_sees_births_data_rebirths_and_deaths_in_order() {
    let Some(host) = python("pysparkplug") else { return };
    if !has("mosquitto") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let log = worn_log(folder.path());
    let mosquitto = Mosquitto::start(folder.path(), free_port(), "allow_anonymous true");
    let broker = mosquitto.port.to_string();
    let host = Companion::start(host, "sparkplug_host.py", folder.path(), &[&broker, "plant", "gateway 1"]);
    std::thread::sleep(Duration::from_secs(1));
    let port = free_port();
    let sinks = format!(
        "[sparkplug]\ngroup = \"plant\"\nnode = \"gateway 1\"\nhost = \"127.0.0.1\"\nport = {broker}\n"
    );
    let config = two_axes(folder.path(), port, &log, &sinks);
    let daemon = Daemon::start(folder.path(), &config);
    let press = Some("Press 1");
    until("births", SOON, || {
        told(&host.heard(), "DBIRTH", press).len() == 1
            && told(&host.heard(), "DBIRTH", Some("silent")).len() == 1
    });
    let heard = host.heard();
    let birth = &heard[0];
    assert_eq!(
        (&birth["type"], &birth["seq"], &birth["retain"]),
        (&"NBIRTH".into(), &0.into(), &false.into())
    );
    assert_eq!(birth["topic"], "spBv1.0/plant/NBIRTH/gateway 1");
    assert_eq!(birth["metrics"]["bdSeq"]["value"], 0);
    assert_eq!(birth["metrics"]["Node Control/Rebirth"]["value"], false);
    // The axis without a command has every size, and none has a value.
    let silent = told(&heard, "DBIRTH", Some("silent"))[0]["metrics"].clone();
    assert_eq!(silent["flag"]["value"], "no_estimate");
    for size in [
        "leak_flow_lpm",
        "leak_area_m2",
        "leak_area_low_m2",
        "leak_area_high_m2",
        "leak_power_w",
        "time_to_leak_s",
    ] {
        let told = &silent[size];
        assert_eq!(
            (&told["value"], &told["null"], &told["type"]),
            (&Value::Null, &true.into(), &"DOUBLE".into()),
            "{size}"
        );
    }
    until("the estimate", SOON, || axis_status(port).is_some_and(|status| status["flag"] == "leak"));
    // A host puts what is new over what it had.
    let latest = |name: &str| {
        let heard = host.heard();
        let of_press = heard.iter().filter(|line| line["device"] == "Press 1");
        of_press
            .filter_map(|line| line["metrics"].get(name))
            .next_back()
            .map(|metric| metric["value"].clone())
    };
    let is_up_to_date = || {
        latest("flag") == Some("leak".into())
            && latest("cycles") == Some(axis_status(port).unwrap()["cycles"].clone())
    };
    until("the flag", SOON, is_up_to_date);
    let status = axis_status(port).unwrap();
    for size in ["leak_flow_lpm", "leak_area_m2", "leak_power_w"] {
        assert_eq!(latest(size), Some(status[size].clone()), "{size}");
    }
    assert_eq!(latest("leak_area_high_m2"), Some(status["interval90_m2"][1].clone()));
    assert_eq!(latest("verdict"), Some(status["verdict"].clone()));
    // A host that has lost the thread asks for all of it again.
    host.say("rebirth");
    until("the rebirth", SOON, || told(&host.heard(), "DBIRTH", Some("silent")).len() == 2);
    let heard = host.heard();
    let again = told(&heard, "NBIRTH", None)[1];
    assert_eq!((&again["seq"], &again["metrics"]["bdSeq"]["value"]), (&0.into(), &0.into()));
    assert_eq!(told(&heard, "DBIRTH", press)[1]["metrics"]["flag"]["value"], "leak");
    // An axis that a reload takes away dies.
    let without = config.split("[[axes]]\naxis = \"Press 1\"").next().unwrap().to_owned()
        + "[[axes]]\naxis = \"silent\""
        + config.split("axis = \"silent\"").nth(1).unwrap();
    std::fs::write(folder.path().join("seepd.toml"), without).unwrap();
    daemon.signal("HUP");
    until("the axis's death", SOON, || !told(&host.heard(), "DDEATH", press).is_empty());
    assert!(
        sink(port, "sparkplug")["good"].as_bool().unwrap()
            && sink(port, "sparkplug")["sent"].as_u64() > Some(5)
    );
    // Killed, it dies by the broker's hand: the will has the number of the birth.
    daemon.signal("KILL");
    until("the will", SOON, || !told(&host.heard(), "NDEATH", None).is_empty());
    let heard = host.heard();
    let death = told(&heard, "NDEATH", None)[0];
    assert_eq!((&death["seq"], &death["metrics"]["bdSeq"]["value"]), (&Value::Null, &0.into()));
    // Every message has the next number, and every metric a time.
    let mut expected = 0;
    for line in heard.iter().filter(|line| line["type"] != "NCMD" && line["type"] != "NDEATH") {
        if line["type"] == "NBIRTH" {
            expected = 0;
        }
        assert_eq!(line["seq"], expected, "{line}");
        assert!(
            line["stamped"].as_bool().unwrap() && line["timestamp"].as_u64() > Some(1_700_000_000_000),
            "{line}"
        );
        expected = (expected + 1) % 256;
    }
}

#[test]
fn a_sparkplug_node_comes_again_with_the_next_number_and_says_farewell() {
    let Some(host) = python("pysparkplug") else { return };
    if !has("mosquitto") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let log = worn_log(folder.path());
    let port = free_port();
    let first = Mosquitto::start(folder.path(), free_port(), "allow_anonymous true");
    let broker = first.port;
    let sinks = format!(
        "[sparkplug]\ngroup = \"plant\"\nnode = \"gateway 1\"\nhost = \"127.0.0.1\"\nport = {broker}\n"
    );
    let daemon = Daemon::start(folder.path(), &two_axes(folder.path(), port, &log, &sinks));
    until("the connection", SOON, || {
        axis_status(port).is_some() && sink(port, "sparkplug")["sent"].as_u64() >= Some(3)
    });
    // A broker that is away holds nothing up.
    drop(first);
    until("the complaint", SOON, || sink(port, "sparkplug")["good"] == false);
    until("the estimate", SOON, || axis_status(port).is_some_and(|status| status["flag"] == "leak"));
    let mosquitto = Mosquitto::start(folder.path(), broker, "allow_anonymous true");
    let host = Companion::start(
        host,
        "sparkplug_host.py",
        folder.path(),
        &[&broker.to_string(), "plant", "gateway 1"],
    );
    until("births", Duration::from_secs(60), || sink(port, "sparkplug")["good"] == true);
    // A host that has asked for these topics hears what comes: a farewell before that is heard by nobody.
    let is_there =
        |line: &Value| line["topic"].as_str().is_some_and(|topic| topic.starts_with("spBv1.0/plant/"));
    until("a host that listens", SOON, || host.heard().iter().any(is_there));
    let output = seepd(["test-sinks", "--config", folder.path().join("seepd.toml").to_str().unwrap()]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        text.contains("good  sparkplug: the broker confirmed spBv1.0/plant/NDEATH/gateway 1-test"),
        "{text}"
    );
    daemon.terminate();
    let dies = |line: &Value| line["topic"] == "spBv1.0/plant/NDEATH/gateway 1";
    until("the farewell", SOON, || host.heard().iter().any(dies));
    let heard = host.heard();
    let number = heard.iter().find(|line| dies(line)).unwrap()["metrics"]["bdSeq"]["value"].as_u64().unwrap();
    assert!(number >= 1, "a new connection has a new number");
    assert_eq!(heard.iter().filter(|line| dies(line)).count(), 1, "one farewell, and no will beside it");
    drop(mosquitto);
}

/// A metric of a request, of an axis; null where there is none.
fn measured(request: &Value, name: &str, axis: &str) -> Value {
    let points = request["metrics"][name]["points"].as_array().cloned().unwrap_or_default();
    points
        .into_iter()
        .find(|point| point["labels"]["axis"] == axis)
        .map_or(Value::Null, |point| point["value"].clone())
}

#[test]
fn a_collector_gets_the_metrics_and_one_that_refuses_or_stalls_holds_nothing_up() {
    let Some(python) = python("opentelemetry.proto") else { return };
    let folder = tempfile::tempdir().unwrap();
    let log = worn_log(folder.path());
    let (port, otlp) = (free_port(), free_port());
    let sinks = format!(
        "[opentelemetry]\nendpoint = \"http://localhost:{otlp}\"\nperiod_s = 1.0\nservice_name = \"hall 3\"\n"
    );
    let _daemon = Daemon::start(folder.path(), &two_axes(folder.path(), port, &log, &sinks));
    // Nobody is there yet: requests wait.
    until("the complaint", SOON, || {
        axis_status(port).is_some() && sink(port, "opentelemetry")["good"] == false
    });
    let collector = Companion::start(python, "otlp_collector.py", folder.path(), &[&otlp.to_string()]);
    let is_leak = |request: &Value| {
        let points = request["metrics"]["seepd_flag"]["points"].as_array().cloned().unwrap_or_default();
        let is_told = points.iter().any(|point| point["labels"]["flag"] == "leak" && point["value"] == 1.0);
        is_told && measured(request, "seepd_cycles", "Press 1") == axis_status(port).unwrap()["cycles"]
    };
    until("the leak", SOON, || collector.heard().iter().any(is_leak));
    let heard = collector.heard();
    let request = heard.iter().find(|request| is_leak(request)).unwrap();
    assert_eq!(
        (&request["path"], &request["type"]),
        (&"/v1/metrics".into(), &"application/x-protobuf".into())
    );
    assert_eq!((&request["host"], &request["token"]), (&format!("localhost:{otlp}").into(), &Value::Null));
    let resource = &request["resource"];
    assert_eq!((&resource["service.name"], &request["scope"]), (&"hall 3".into(), &"seepd".into()));
    assert!(resource["service.instance.id"].as_str().is_some_and(|host| !host.is_empty()), "{resource}");
    let status = axis_status(port).unwrap();
    for (name, key, unit) in [
        ("seepd_leak_area_m2", "leak_area_m2", "m2"),
        ("seepd_leak_flow_lpm", "leak_flow_lpm", "L/min"),
        ("seepd_leak_power_w", "leak_power_w", "W"),
    ] {
        assert_eq!(
            (&request["metrics"][name]["kind"], &request["metrics"][name]["unit"]),
            (&"gauge".into(), &unit.into())
        );
        assert_eq!(measured(request, name, "Press 1"), status[key], "{name}");
        // Without an estimate there is no point, and never a zero.
        assert_eq!(measured(request, name, "silent"), Value::Null, "{name}");
    }
    let cycles = &request["metrics"]["seepd_cycles"];
    assert_eq!(
        (&cycles["kind"], &cycles["cumulative"], &cycles["monotonic"]),
        (&"sum".into(), &true.into(), &true.into())
    );
    assert_eq!(measured(request, "seepd_cycles", "Press 1"), status["cycles"]);
    let point = &cycles["points"][0];
    assert!(
        point["start"].as_u64() > Some(1_700_000_000_000_000_000)
            && point["time"].as_u64() >= point["start"].as_u64(),
        "{point}"
    );
    // The same names as those that are fetched.
    let fetched = crate::daemon::ask(port, "GET", "/metrics", "").unwrap().body;
    for name in request["metrics"].as_object().unwrap().keys() {
        assert!(fetched.contains(&format!("# HELP {name} ")), "{name}");
    }
    // Busy: it is asked again and nothing is lost. Refused for good, or in part: counted.
    until("good", SOON, || sink(port, "opentelemetry")["good"] == true);
    collector.say("503");
    until("what waits", SOON, || sink(port, "opentelemetry")["waiting"].as_u64() >= Some(2));
    assert_eq!(sink(port, "opentelemetry")["dropped"], 0);
    collector.say("200");
    until("what waited", SOON, || sink(port, "opentelemetry")["waiting"] == 0);
    collector.say("400");
    until("the refusal", SOON, || sink(port, "opentelemetry")["dropped"] == 1);
    collector.say("partial");
    until("the partial refusal", SOON, || {
        sink(port, "opentelemetry")["detail"].as_str().unwrap_or_default().contains("two too many")
    });
    let config = folder.path().join("seepd.toml");
    collector.say("200");
    until("good again", SOON, || sink(port, "opentelemetry")["good"] == true);
    let output = seepd(["test-sinks", "--config", config.to_str().unwrap()]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        text.contains(&format!("good  opentelemetry: http://localhost:{otlp} accepted seepd_test")),
        "{text}"
    );
    // What a collector writes down follows its answer.
    let is_test = |request: &&Value| request["metrics"].get("seepd_test").is_some();
    until("the test's request", SOON, || collector.heard().iter().filter(is_test).count() == 1);
}

#[test]
fn a_collector_over_tls_gets_a_token_and_one_that_never_answers_holds_nothing_up() {
    let Some(python) = python("opentelemetry.proto") else { return };
    if !has("openssl") || !has("mosquitto_passwd") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let log = worn_log(folder.path());
    crate::live::secure_broker(folder.path());
    std::fs::write(folder.path().join("otlp-token"), "a-token\n").unwrap();
    let place = |name: &str| folder.path().join(name).display().to_string();
    let (port, otlp) = (free_port(), free_port());
    let arguments = [otlp.to_string(), place("server.pem"), place("server.key")];
    let arguments = arguments.each_ref().map(String::as_str);
    let collector = Companion::start(python, "otlp_collector.py", folder.path(), &arguments);
    let sinks = format!(
        "[opentelemetry]\nendpoint = \"https://localhost:{otlp}/otlp/v1/metrics\"\nperiod_s = 1.0\nca_file = \"ca.pem\"\ntoken_file = \"otlp-token\"\n"
    );
    let daemon = Daemon::start(folder.path(), &two_axes(folder.path(), port, &log, &sinks));
    until("a request", SOON, || !collector.heard().is_empty());
    let request = collector.heard()[0].clone();
    assert_eq!((&request["path"], &request["token"]), (&"/otlp/v1/metrics".into(), &"Bearer a-token".into()));
    // One that takes connections and says nothing, and does not stop the rest.
    let deaf = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let sinks =
        format!("[opentelemetry]\nendpoint = \"http://{}\"\nperiod_s = 1.0\n", deaf.local_addr().unwrap());
    std::fs::write(folder.path().join("seepd.toml"), two_axes(folder.path(), port, &log, &sinks)).unwrap();
    daemon.signal("HUP");
    until("the reload", SOON, || daemon.words().contains("in force"));
    until("the complaint", SOON, || {
        sink(port, "opentelemetry")["detail"].as_str().unwrap_or_default().contains("no answer within 10 s")
    });
    assert!(sink(port, "opentelemetry")["waiting"].as_u64() >= Some(5));
    assert_eq!(axis_status(port).unwrap()["flag"], "leak");
    let (status, took) = daemon.terminate();
    assert!(status.success() && took < Duration::from_secs(3), "{status} {took:?}");
}

#[test]
fn foxglove_hears_command_estimates_conditions_and_events_and_a_client_that_hangs_is_ended() {
    let Some(client) = python("foxglove_websocket, websockets.sync.client, jsonschema") else { return };
    let folder = tempfile::tempdir().unwrap();
    let log = worn_log(folder.path());
    let (port, live) = (free_port(), free_port());
    let sinks = format!("[foxglove]\nlisten = \"127.0.0.1:{live}\"\n");
    let daemon = Daemon::start(folder.path(), &two_axes(folder.path(), port, &log, &sinks));
    until("the flag", SOON, || axis_status(port).is_some_and(|status| status["flag"] == "leak"));
    let client =
        Companion::start(client, "foxglove_client.py", folder.path(), &[&format!("ws://127.0.0.1:{live}/")]);
    let data = |topic: &str| -> Vec<Value> {
        client.heard().into_iter().filter(|line| line["op"] == "data" && line["topic"] == topic).collect()
    };
    until("conditions", SOON, || data("/Press 1/status").len() >= 2 && data("/silent/status").len() >= 2);
    let heard = client.heard();
    assert_eq!(
        (&heard[0]["protocol"], &heard[1]["op"], &heard[2]["op"]),
        (&"foxglove.sdk.v1".into(), &"serverInfo".into(), &"advertise".into())
    );
    let topics: BTreeSet<&str> = heard[2]["channels"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|channel| channel["topic"].as_str())
        .collect();
    for topic in ["signals", "status", "leakage", "flags", "notices", "acknowledged"] {
        assert!(
            topics.contains(format!("/Press 1/{topic}").as_str())
                && topics.contains(format!("/silent/{topic}").as_str()),
            "{topic}"
        );
    }
    let (told, status) = (data("/Press 1/status")[0]["content"].clone(), axis_status(port).unwrap());
    for key in ["flag", "leak_area_m2", "leak_flow_lpm", "interval90_m2", "verdict"] {
        assert_eq!(told[key], status[key], "{key}");
    }
    let silent = data("/silent/status")[0]["content"].clone();
    assert_eq!((&silent["flag"], &silent["leak_area_m2"]), (&"no_estimate".into(), &Value::Null));
    let machine = Machine::start(&folder.path().join("in.sock"), cycle("nominal_leak_1e-6.csv"));
    // What happens comes as it happens.
    let entry = r#"{"what":"oil_changed","who":"M. \"Huber\""}"#;
    let answer = crate::daemon::ask_with(port, "POST", "/api/v1/axes/silent/repairs", "", entry).unwrap();
    assert_eq!(answer.code, 202, "{}", answer.body);
    until("the notice", SOON, || !data("/silent/notices").is_empty());
    until("the command", SOON, || data("/silent/signals").len() > 100);
    let signals = data("/silent/signals");
    let times: Vec<i64> = signals.iter().filter_map(|line| line["time"].as_i64()).collect();
    assert!(times.windows(2).all(|pair| pair[0] < pair[1]), "{times:?}");
    let span_s = (times[times.len() - 1] - times[0]) as f64 / 1e9;
    let rate_hz = (times.len() - 1) as f64 / span_s;
    assert!((30.0..60.0).contains(&rate_hz), "the command's 1000 Hz come as 50: {rate_hz}");
    assert!(signals.iter().any(|line| line["content"]["command"].as_f64().unwrap().abs() > 0.05));
    until("an estimate", Duration::from_secs(60), || !data("/silent/leakage").is_empty());
    assert_eq!(data("/silent/leakage")[0]["content"]["axis"], "silent");
    // Another page in the same browser gets nothing; nor does one with another protocol.
    let page = python("websockets").unwrap();
    let folder_of_page = tempfile::tempdir().unwrap();
    let page = Companion::start(
        page,
        "foxglove_client.py",
        folder_of_page.path(),
        &[&format!("ws://127.0.0.1:{live}/"), "https://evil.example"],
    );
    until("the refusal", SOON, || {
        page.heard().first().is_some_and(|line| line["why"].as_str().unwrap_or_default().contains("403"))
    });
    let upgrade = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    assert_eq!(crate::daemon::ask(live, "GET", "/", upgrade).unwrap().code, 400);
    // A client that hangs is ended, and nobody else notices.
    assert!(sink(port, "foxglove")["sent"].as_u64() > Some(100));
    client.signal("STOP");
    until("its end", Duration::from_secs(60), || sink(port, "foxglove")["dropped"] == 1);
    assert!(
        sink(port, "foxglove")["detail"].as_str().unwrap().ends_with(" 0 clients"),
        "{}",
        sink(port, "foxglove")
    );
    let status = &json(port, "/api/v1/status")["axes"][1];
    assert_eq!((&status["axis"], &status["stale"]), (&"silent".into(), &false.into()));
    // The machine gives a frame up after 0.3 s: a client that held the axis would cost dozens, a computer that stood still for a moment one.
    let missing = status["source"]["missing_by_counter"].as_u64().unwrap();
    assert!(missing <= 2, "{missing} frames were not taken");
    machine.stop();
    let (status, took) = daemon.terminate();
    assert!(status.success() && took < Duration::from_secs(3), "{status} {took:?}");
}

/// What a tester on J1939 has heard of a message's kind.
fn spoken(heard: &[Value], kind: &str) -> Vec<Value> {
    heard.iter().filter(|line| line["message"] == kind).cloned().collect()
}

#[test]
fn a_tester_reads_dm1_asks_for_dm2_and_takes_the_address_away() {
    let Some(tester) = python("j1939") else { return };
    let folder = tempfile::tempdir().unwrap();
    let log = worn_log(folder.path());
    let bus = folder.path().join("bus.sock");
    let tester = Companion::start(tester, "j1939_tester.py", folder.path(), &[bus.to_str().unwrap()]);
    until("the bus", SOON, || bus.exists());
    let port = free_port();
    let speaker = |axis: &str, address: u8| {
        format!(
            "[[j1939]]\ninterface = \"unix:{}\"\naxis = \"{axis}\"\naddress = {address}\nspn = 520000\n",
            bus.display()
        )
    };
    let config = two_axes(folder.path(), port, &log, &speaker("Press 1", 0x80));
    let daemon = Daemon::start(folder.path(), &config);
    let last = || spoken(&tester.heard(), "DM1").last().cloned().unwrap_or_default();
    until("the leak", SOON, || last()["codes"][0]["fmi"] == 16);
    let told = last();
    assert_eq!(
        (&told["address"], &told["codes"]),
        (&0x80.into(), &serde_json::json!([{ "spn": 520_000, "fmi": 16, "oc": 1 }]))
    );
    // Amber is on, the others are off, none flashes.
    assert_eq!(told["lamps"], serde_json::json!({ "pl": 0, "awl": 1, "rsl": 0, "mil": 0 }));
    let heard = tester.heard();
    assert_eq!(heard[0]["message"], "0EEFF", "the address is claimed before anything is said: {}", heard[0]);
    let so_far = spoken(&heard, "DM1").len();
    until("three more", SOON, || spoken(&tester.heard(), "DM1").len() >= so_far + 3);
    let times: Vec<f64> =
        spoken(&tester.heard(), "DM1")[so_far..].iter().filter_map(|line| line["time"].as_f64()).collect();
    assert!(times.windows(2).all(|pair| (0.9..1.3).contains(&(pair[1] - pair[0]))), "{times:?}");
    // Asked, it answers: nothing was active before, of this address or of all.
    tester.say("ask feca 80");
    tester.say("ask fecb 80");
    until("an answer", SOON, || {
        !spoken(&tester.heard(), "DM2").is_empty() || {
            tester.say("ask fecb ff");
            std::thread::sleep(Duration::from_millis(200));
            false
        }
    });
    assert_eq!(
        spoken(&tester.heard(), "DM2")[0]["codes"],
        serde_json::json!([{ "spn": 0, "fmi": 0, "times": 0, "cm": 0 }])
    );
    // What it does not know is refused, where it alone is asked.
    std::thread::sleep(Duration::from_millis(300));
    tester.say("ask fee5 80");
    until("the refusal", SOON, || {
        spoken(&tester.heard(), "0E8FF").iter().any(|line| line["data"] == "01fffffff9e5fe00")
    });
    // A name that comes later is answered by a claim, one that comes before takes the address.
    let claims = spoken(&tester.heard(), "0EEFF").len();
    std::thread::sleep(Duration::from_millis(300));
    tester.say("claim 80 7fffffffffffffff");
    until("the claim", SOON, || spoken(&tester.heard(), "0EEFF").len() > claims);
    assert!(sink(port, &format!("j1939 unix:{} 80", bus.display()))["good"].as_bool().unwrap());
    tester.say("claim 80 1");
    until("silence", SOON, || spoken(&tester.heard(), "0EEFF").iter().any(|line| line["address"] == 254));
    let status = sink(port, &format!("j1939 unix:{} 80", bus.display()));
    assert!(status["detail"].as_str().unwrap().contains("belongs to the name 0000000000000001"), "{status}");
    let count = spoken(&tester.heard(), "DM1").len();
    std::thread::sleep(Duration::from_millis(2500));
    assert_eq!(spoken(&tester.heard(), "DM1").len(), count, "one that has no address says nothing");
    assert_eq!(axis_status(port).unwrap()["flag"], "leak");
    drop(daemon);
}

#[test]
fn codes_that_are_over_go_into_dm2_and_are_counted() {
    let Some(tester) = python("j1939") else { return };
    let folder = tempfile::tempdir().unwrap();
    let bus = folder.path().join("bus.sock");
    let tester = Companion::start(tester, "j1939_tester.py", folder.path(), &[bus.to_str().unwrap()]);
    until("the bus", SOON, || bus.exists());
    let port = free_port();
    let socket = folder.path().join("in.sock");
    let config = format!(
        "state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{port}\"\n[[j1939]]\ninterface = \"unix:{}\"\naddress = 0x81\n{}[alarm]\nraise_cycles = 1\n",
        bus.display(),
        crate::daemon::machine_toml(&socket)
    );
    let _daemon = Daemon::start(folder.path(), &config.replace("[source]", "[source]\nstale_after_s = 3.0"));
    let dm1 = || spoken(&tester.heard(), "DM1");
    // No command: the code of it alone, with no lamp of the seal.
    until("no command", SOON, || {
        dm1().last().is_some_and(|told| told["codes"][0]["spn"] == 516_112 && told["codes"][0]["fmi"] == 9)
    });
    // Before that nothing was known: the lamps were not available, rather than off.
    let first = dm1()[0].clone();
    assert_eq!((&first["lamps"]["awl"], &first["codes"][0]["spn"]), (&4.into(), &0.into()), "{first}");
    let machine = Machine::start(&socket, cycle("nominal_leak_1e-6.csv"));
    until("the severe leak", Duration::from_secs(60), || {
        dm1().last().is_some_and(|told| told["codes"][0]["spn"] == 516_096)
    });
    let told = dm1().last().cloned().unwrap();
    assert_eq!((&told["codes"][0]["fmi"], &told["lamps"]["rsl"]), (&0.into(), &1.into()), "{told}");
    // The missing command is over, and in DM2.
    let dm2 = || spoken(&tester.heard(), "DM2");
    tester.say("ask fecb 81");
    until("DM2", SOON, || !dm2().is_empty());
    assert_eq!(dm2()[0]["codes"], serde_json::json!([{ "spn": 516_112, "fmi": 9, "times": 1, "cm": 0 }]));
    // It stops: the leak is no longer told as active, the command is missing again, the second time.
    machine.stop();
    until("no command again", SOON, || dm1().last().is_some_and(|told| told["codes"][0]["fmi"] == 9));
    let told = dm1().last().cloned().unwrap();
    assert_eq!(told["codes"], serde_json::json!([{ "spn": 516_112, "fmi": 9, "oc": 2 }]));
    std::thread::sleep(Duration::from_millis(300));
    tester.say("ask fecb 81");
    until("DM2 again", SOON, || dm2().len() >= 2);
    assert_eq!(
        dm2()[1]["codes"],
        serde_json::json!([{ "spn": 516_096, "fmi": 0, "times": 1, "cm": 0 }]),
        "the latch is not acknowledged"
    );
}

#[test]
fn a_leak_beside_a_shifted_null_is_two_codes_in_packets_that_a_tester_puts_together() {
    let Some(tester) = python("j1939") else { return };
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let machine =
        ["--parameter-spread", "0.05", "--machine", "3", "--load-variation", "0.02", "--noise", "0.003"];
    simulate(&place("healthy.mcap"), &[&machine[..], &["--cycles", "60", "--seed", "2"]].concat());
    let (baseline, healthy) = (place("baseline.json"), place("healthy.mcap"));
    let learned = seepd(["learn-baseline", "--out", baseline.to_str().unwrap(), healthy.to_str().unwrap()]);
    assert!(learned.status.success());
    let worn =
        ["--cycles", "10", "--seed", "5", "--leak-area", "1.9e-7", "--with", "valve_bias.offset=0.005"];
    simulate(&place("worn.mcap"), &[&machine[..], &worn[..]].concat());
    let (bus, port) = (place("bus.sock"), free_port());
    let tester = Companion::start(tester, "j1939_tester.py", folder.path(), &[bus.to_str().unwrap()]);
    until("the bus", SOON, || bus.exists());
    let sinks =
        format!("[[j1939]]\ninterface = \"unix:{}\"\naxis = \"Press 1\"\naddress = 0x82\n", bus.display());
    let fast = "pace = \"fast\"\n";
    let with_baseline = format!("{fast}[axes.baseline]\nfile = \"baseline.json\"\n");
    let config = two_axes(folder.path(), port, &place("worn.mcap"), &sinks).replace(fast, &with_baseline);
    let _daemon = Daemon::start(folder.path(), &config);
    until("two codes", SOON, || {
        spoken(&tester.heard(), "DM1").last().is_some_and(|told| told["codes"].as_array().unwrap().len() == 2)
    });
    let status = axis_status(port).unwrap();
    assert_eq!(
        (&status["flag"], &status["conditions"][0]["cause"]),
        (&"leak".into(), &"valve_null".into()),
        "{status}"
    );
    let told = spoken(&tester.heard(), "DM1").last().cloned().unwrap();
    let codes = told["codes"].as_array().unwrap();
    assert_eq!(codes[0], serde_json::json!({ "spn": 516_096, "fmi": 16, "oc": 1 }));
    assert_eq!((&codes[1]["spn"], &told["lamps"]["awl"]), (&516_097.into(), &1.into()));
    // Announced, and in packets with the standard's distance and priority.
    let heard = tester.heard();
    let announced = spoken(&heard, "0ECFF")[0].clone();
    assert_eq!((&announced["data"], &announced["priority"]), (&"200a0002ffcafe00".into(), &7.into()));
    let packets = spoken(&heard, "0EBFF");
    let between = packets[1]["time"].as_f64().unwrap() - packets[0]["time"].as_f64().unwrap();
    assert!((0.045..0.2).contains(&between), "{between}");
}
