//! Sparkplug B over a real broker, heard by another implementation's host.

use std::time::Duration;

use serde_json::Value;

use super::{SOON, two_axes, worn_log};
use crate::daemon::{Companion, Daemon, Mosquitto, axis_status, free_port, has, sink, until};
use crate::support::{python, seepd};

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
    // A host that has asked for these topics hears what comes: a farewell before that is heard by nobody. All may have been said before it
    // was there, so that it asks for births until it hears something.
    let is_there =
        |line: &Value| line["topic"].as_str().is_some_and(|topic| topic.starts_with("spBv1.0/plant/"));
    let mut looks = 0;
    until("a host that listens", SOON, || {
        if looks % 50 == 0 {
            host.say("rebirth");
        }
        looks += 1;
        host.heard().iter().any(is_there)
    });
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
