//! Foxglove's WebSocket, heard by another implementation's client.

use std::collections::BTreeSet;
use std::time::Duration;

use serde_json::Value;

use super::{SOON, two_axes, worn_log};
use crate::daemon::{Companion, Daemon, Machine, axis_status, cycle, free_port, json, sink, until};
use crate::support::python;

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
    // A cycle may end between the two: then the next status says what is so now.
    until("the state of the axis", SOON, || {
        let (told, status) = (data("/Press 1/status"), axis_status(port).unwrap());
        let told = &told[told.len() - 1]["content"];
        ["flag", "leak_area_m2", "leak_flow_lpm", "interval90_m2", "verdict"]
            .iter()
            .all(|key| told[key] == status[key])
    });
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
