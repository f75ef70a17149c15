//! The description of what the page's port serves (OpenAPI): another implementation finds it whole, it names every route that there is, and
//! every answer is as it says.

use std::collections::BTreeSet;
use std::fs;
use std::time::Duration;

use serde_json::{Value, json};

use crate::daemon::{Answer, Daemon, ask, ask_with, axis_toml, free_port, log_axis_toml, until};
use crate::support::{python, simulate};

const SOON: Duration = Duration::from_secs(20);

/// Routes as the program's text has them.
fn routes() -> BTreeSet<String> {
    let text = include_str!("../crates/daemon/src/sink/http/mod.rs");
    let mut routes: BTreeSet<String> =
        text.split(".route(\"").skip(1).map(|rest| rest.split('"').next().unwrap().to_owned()).collect();
    routes.insert("/login".into());
    routes
}

fn description(port: u16) -> Value {
    ask(port, "GET", "/api/v1/openapi.json", "").unwrap().json()
}

/// Holds an answer against what is described for its code.
fn hold(document: &Value, path: &str, method: &str, answer: &Answer) {
    let place = format!("{method} {path} {}", answer.code);
    let mut described = &document["paths"][path][method]["responses"][answer.code.to_string()];
    assert!(described.is_object(), "{place} is not described: {}", answer.body);
    if let Some(name) = described["$ref"].as_str() {
        described = document.pointer(name.trim_start_matches('#')).unwrap();
    }
    let Some(content) = described["content"].as_object() else { return };
    let (kind, content) = content.iter().next().unwrap();
    assert!(
        answer.head.to_lowercase().contains(&format!("content-type: {kind}")),
        "{place}: {}",
        answer.head
    );
    if kind == "application/json" {
        let schema = json!({ "$ref": "#/$defs/answer", "$defs": { "answer": content["schema"] }, "components": document["components"] });
        let validator = jsonschema::draft202012::new(&schema).unwrap();
        let errors: Vec<String> = validator
            .iter_errors(&answer.json())
            .map(|error| format!("{}: {error}", error.instance_path()))
            .collect();
        assert!(errors.is_empty(), "{place}: {errors:?}\n{}", answer.body);
    }
}

#[test]
fn every_route_is_described_and_every_answer_is_as_described() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("worn.mcap");
    simulate(&log, &["--cycles", "8", "--leak-area", "1e-7", "--leak-growth", "3e-6"]);
    let port = free_port();
    let config = format!(
        "state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{port}\"\n{}[axes.energy]\nprice_per_kwh = 0.3\n{}",
        log_axis_toml("worn", &log),
        axis_toml("silent", &folder.path().join("in.sock"))
    );
    let _daemon = Daemon::start(folder.path(), &config);
    until("the log's end", SOON, || {
        ask(port, "GET", "/api/v1/axes/worn", "")
            .is_some_and(|answer| answer.json()["source"]["state"] == "ended")
    });
    let document = description(port);
    let described: BTreeSet<String> = document["paths"].as_object().unwrap().keys().cloned().collect();
    assert_eq!(described, routes());

    for (path, methods) in document["paths"].as_object().unwrap() {
        if methods["get"].is_object() && path != "/api/v1/events" {
            for axis in ["worn", "silent", "none"] {
                let answer = ask(port, "GET", &path.replace("{axis}", axis), "").unwrap();
                hold(&document, path, "get", &answer);
            }
        }
    }
    let orders = [
        ("acknowledge", "silent", "{\"who\":\"M. Huber\"}", 202),
        ("acknowledge", "silent", "{\"who\":1}", 400),
        ("acknowledge", "worn", "", 409),
        ("new-baseline", "silent", "", 202),
        ("new-baseline", "none", "", 404),
        ("repairs", "silent", "{\"what\":\"seal_replaced\",\"note\":\"kit 7\"}", 202),
        ("repairs", "silent", "{\"what\":\"luck\"}", 400),
    ];
    for (order, axis, said, code) in orders {
        let answer = ask_with(port, "POST", &format!("/api/v1/axes/{axis}/{order}"), "", said).unwrap();
        assert_eq!(answer.code, code, "{order} {axis} {said}: {}", answer.body);
        hold(&document, &format!("/api/v1/axes/{{axis}}/{order}"), "post", &answer);
    }
    let foreign = ask(port, "GET", "/api/v1/status", "Origin: http://elsewhere\r\n").unwrap();
    assert_eq!(foreign.code, 403);
    hold(&document, "/api/v1/status", "get", &foreign);
    // What was noted is in the status, and in its description.
    until("the repair", SOON, || {
        let answer = ask(port, "GET", "/api/v1/axes/silent", "").unwrap();
        hold(&document, "/api/v1/axes/{axis}", "get", &answer);
        answer.json()["repairs"].as_array().is_some_and(|repairs| !repairs.is_empty())
    });
    let history = ask(port, "GET", "/api/v1/history", "").unwrap();
    hold(&document, "/api/v1/history", "get", &history);
    assert!(
        history.body.contains("seepd.event/1") && history.body.contains("seepd.notice/1"),
        "{}",
        history.body
    );
}

#[test]
fn reference_openapi_spec_validator_finds_the_description_whole() {
    let Some(mut python) = python("openapi_spec_validator") else { return };
    let script = "import json, sys, openapi_spec_validator as v; v.validate(json.load(open(sys.argv[1])))";
    let path = format!("{}/src/sink/http/openapi.json", env!("CARGO_MANIFEST_DIR"));
    assert!(fs::metadata(&path).is_ok());
    let output = python.args(["-c", script, &path]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
