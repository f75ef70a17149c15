//! The live daemon and those who talk to it over a network: brokers that refuse, orders that nobody gave, clients that stall.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]
#![expect(clippy::disallowed_methods, reason = "tests of a live daemon wait")]

#[expect(dead_code, reason = "other tests use the rest")]
#[path = "support/daemon.rs"]
mod daemon;
#[expect(dead_code, reason = "other tests use the rest")]
mod support;

use std::time::Duration;

use daemon::{Daemon, ask, axis_status, free_port, machine_toml, until};

const SOON: Duration = Duration::from_secs(15);

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
