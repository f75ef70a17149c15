//! OpenTelemetry's metrics, taken by a collector of another implementation.

use std::time::Duration;

use serde_json::Value;

use super::{SOON, two_axes, worn_log};
use crate::daemon::{Companion, Daemon, axis_status, free_port, has, sink, until};
use crate::support::{python, seepd};

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
