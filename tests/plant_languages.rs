//! What the plant's other programs hear: Home Assistant over a real broker, InfluxDB's line protocol over UDP.

use std::collections::BTreeSet;
use std::net::UdpSocket;
use std::time::Duration;

use serde_json::Value;

use crate::daemon::{Daemon, Mosquitto, axis_status, free_port, has, until};
use crate::support::simulate;

const SOON: Duration = Duration::from_secs(20);

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
    let log = folder.path().join("worn.mcap");
    simulate(&log, &["--cycles", "8", "--leak-area", "2e-7"]);
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
    let log = folder.path().join("worn.mcap");
    simulate(&log, &["--cycles", "8", "--leak-area", "2e-7"]);
    let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
    receiver.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let (port, udp) = (free_port(), receiver.local_addr().unwrap());
    let config = format!(
        "state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{port}\"\n[influx]\nudp = \"{udp}\"\nperiod_s = 0.2\n\
         [[axes]]\naxis = \"Press 1\"\n[axes.source]\nlog = \"{}\"\npace = \"fast\"\n[[axes]]\naxis = \"silent\"\n{}",
        log.display(),
        crate::daemon::machine_toml(&folder.path().join("in.sock"))
            .replace("[source]", "[axes.source]")
            .replace("[signals", "[axes.signals")
    );
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
