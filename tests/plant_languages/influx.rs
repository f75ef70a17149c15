//! InfluxDB's line protocol over UDP.

use std::net::UdpSocket;
use std::time::Duration;

use super::{SOON, two_axes, worn_log};
use crate::daemon::{Daemon, axis_status, free_port, until};

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
    until("the page", SOON, || axis_status(port).is_some());
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
