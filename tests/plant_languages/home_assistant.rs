//! Home Assistant over a real broker: each axis found by itself, and templates that ask for what there is.

use std::collections::BTreeSet;

use serde_json::Value;

use super::{SOON, worn_log};
use crate::daemon::{Daemon, Mosquitto, axis_status, free_port, has, until};

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
