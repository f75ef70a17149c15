//! `seepd demo --live`, as a visitor starts it and ends it.

use std::fs;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::Value;

use crate::daemon::{ask_with, json, until};

/// A life of a seal is 220 cycles of 10 s: eleven seconds at this speed, where the machine can simulate so fast.
const SPEED: &str = "200";
const LIFE: Duration = Duration::from_secs(60);

struct Demo {
    child: Child,
    port: u16,
}

impl Demo {
    fn start(folder: &std::path::Path, more: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_seepd"))
            .args(["demo", "--live", "--port", "0"])
            .args(more)
            .current_dir(folder)
            .env("TMPDIR", folder)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let port = line.split('/').nth(2).and_then(|place| place.rsplit(':').next()).unwrap();
        Demo { port: port.parse().unwrap_or_else(|_| panic!("{line}")), child }
    }

    fn status(&self) -> Value {
        json(self.port, "/api/v1/status")["axes"][0].clone()
    }

    fn told(&self) -> Vec<Value> {
        json(self.port, "/api/v1/history").as_array().unwrap().clone()
    }

    fn end(mut self, signal: &str) {
        assert!(
            Command::new("kill").args([signal, &self.child.id().to_string()]).status().unwrap().success()
        );
        assert_eq!(self.child.wait().unwrap().code(), Some(0), "{signal}");
    }
}

impl Drop for Demo {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn flags(told: &[Value]) -> Vec<&str> {
    told.iter().filter_map(|event| event["flag_to"].as_str()).collect()
}

#[test]
fn a_visitor_sees_a_seal_wear_and_a_new_one_and_nothing_is_left_behind() {
    let folder = tempfile::tempdir().unwrap();
    let demo = Demo::start(folder.path(), &["--speed", SPEED]);
    until("a baseline", LIFE, || demo.status()["baseline"]["learned_cycles"] == 20);
    until("a severe leak", LIFE, || demo.status()["flag"] == "severe");
    let told = demo.told();
    let of_wear = flags(&told);
    let of_wear = &of_wear[of_wear.iter().position(|flag| *flag == "healthy").unwrap()..];
    assert_eq!(of_wear, ["healthy", "watch", "leak", "severe"]);
    // The sums over cycles find the leak before it matters.
    let found = told.iter().position(|event| event["notice"] == "leak_found").unwrap();
    let leak = told.iter().position(|event| event["flag_to"] == "leak").unwrap();
    assert!(found < leak, "{found} {leak}");
    // Whoever notes a new seal gets one; otherwise the demo would fit one by itself.
    let noted = ask_with(
        demo.port,
        "POST",
        "/api/v1/axes/demo%20press/repairs",
        "Content-Type: application/json\r\n",
        r#"{"what":"seal_replaced","who":"a visitor"}"#,
    );
    assert_eq!(noted.unwrap().code, 202);
    until("the machine as new", LIFE, || {
        let status = demo.status();
        status["flag"] == "healthy" && status["latched"].is_null()
    });
    assert_eq!(demo.status()["repairs"][0]["who"], "a visitor");
    demo.end("-INT");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "something is left behind");
}

#[test]
fn a_terminal_that_hangs_up_ends_it_too() {
    let folder = tempfile::tempdir().unwrap();
    let demo = Demo::start(folder.path(), &[]);
    until("samples", LIFE, || demo.status()["source"]["samples"].as_u64() > Some(60_000));
    assert!(demo.status()["source"]["detail"].as_str().unwrap().starts_with("60 times faster"));
    demo.end("-HUP");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}
