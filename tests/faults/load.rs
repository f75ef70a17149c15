//! Five axes on two of the kernel's buses, steadily and in bursts, beside a disk that is full and a broker that takes connections and reads
//! nothing: each frame that was sent is used, or counted as missing.
//!
//! Needs root and a kernel with vcan, as in the virtual machine of `tests/vm/faults`.

use std::net::TcpListener;
use std::path::Path;
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;

use super::interface::Interface;
use super::sequences;
use crate::daemon::{Daemon, axis_status, axis_toml, can_frame, free_port, json, until};

const AXES: usize = 5;
const BUSES: [&str; 2] = ["load0", "load1"];
/// Frames of all axes together, 1/s.
const RATES_HZ: [u64; 3] = [1000, 4000, 9000];
/// Frames of so long come at once, ms, where they come in bursts.
const BURST_MS: u64 = 200;
/// Enough for no run to come round.
const COUNTER_BITS: u32 = 24;

fn identifier(axis: usize) -> u32 {
    0x120 + axis as u32
}

/// Sends frames of all axes in turn for so long, and tells how many for each.
fn send(buses: &mut [Interface; 2], rate_hz: u64, is_in_bursts: bool, time: Duration) -> [u64; AXES] {
    let mut sent = [0_u64; AXES];
    let begin = Instant::now();
    let all = rate_hz * time.as_millis() as u64 / 1000;
    let mut next = 0;
    while next < all {
        let mut due = begin.elapsed().as_millis() as u64 * rate_hz / 1000;
        if is_in_bursts {
            due -= due % (BURST_MS * rate_hz / 1000);
        }
        while next < due.min(all) {
            let axis = (next % AXES as u64) as usize;
            let [low, middle, high, _] = (sent[axis] as u32 % (1 << COUNTER_BITS)).to_le_bytes();
            let command = (1000.0 * (sent[axis] as f64 / 500.0).sin()) as i16;
            let [least, most] = command.to_le_bytes();
            let frame = can_frame(identifier(axis), &[least, most, low, middle, high]);
            buses[axis % BUSES.len()].send(&frame);
            sent[axis] += 1;
            next += 1;
        }
        thread::sleep(Duration::from_millis(1));
    }
    sent
}

fn axis_of_a_bus(axis: usize) -> String {
    axis_toml(&axis.to_string(), Path::new(""))
        .replace("unix:", BUSES[axis % BUSES.len()])
        .replace("0x123", &format!("{:#x}", identifier(axis)))
        .replace("start = 16, length = 8", &format!("start = 16, length = {COUNTER_BITS}"))
}

/// A folder that is full.
fn fill(folder: &Path) {
    let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", "size=64k", "full"]).arg(folder).status();
    assert!(mounted.unwrap().success());
    let _ = std::fs::write(folder.join("filler"), vec![0; 64 << 10]);
}

/// `tests/vm/faults 60 load` for 60 s at each rate, steadily and in bursts.
#[test]
#[ignore = "needs root and a kernel with CAN: tests/vm/faults"]
fn each_frame_is_used_or_counted() {
    let time = Duration::from_secs(u64::from(sequences(5)));
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state");
    std::fs::create_dir(&state).unwrap();
    fill(&state);
    // The system takes its connections; nobody ever reads of them.
    let broker = TcpListener::bind("127.0.0.1:0").unwrap();
    let http_port = free_port();
    let mut config = format!(
        "state_dir = \"{}\"\n[http]\nlisten = \"127.0.0.1:{http_port}\"\n[recording]\n[mqtt]\nhost = \"127.0.0.1\"\nport = {}\n",
        state.display(),
        broker.local_addr().unwrap().port()
    );
    (0..AXES).for_each(|axis| config += &axis_of_a_bus(axis));

    let mut buses = BUSES.map(Interface::make);
    for (rate_hz, is_in_bursts) in RATES_HZ.iter().flat_map(|rate_hz| [(*rate_hz, false), (*rate_hz, true)]) {
        let daemon = Daemon::start(folder.path(), &config);
        until("a page", Duration::from_secs(30), || axis_status(http_port).is_some());
        // Sockets are opened once the page is.
        thread::sleep(Duration::from_secs(1));
        let sent = send(&mut buses, rate_hz, is_in_bursts, time);
        thread::sleep(Duration::from_secs(2));

        let (mut used, mut missing) = (0, 0);
        for (axis, sent) in sent.iter().enumerate() {
            let status: Value = json(http_port, &format!("/api/v1/axes/{axis}"))["source"].clone();
            let count = |key: &str| status[key].as_u64().unwrap();
            assert_eq!(count("samples") + count("missing_by_counter"), *sent, "{axis}: {status}");
            assert!(count("dropped_in_socket") <= count("missing_by_counter"), "{axis}: {status}");
            used += count("samples");
            missing += count("missing_by_counter");
        }
        println!(
            "{rate_hz} Hz{}: {} sent, {used} used, {missing} counted as missing",
            if is_in_bursts { " in bursts" } else { "" },
            sent.iter().sum::<u64>()
        );
        let (status, _) = daemon.terminate();
        assert!(status.success(), "{status}");
    }
}
