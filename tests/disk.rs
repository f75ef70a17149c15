//! Disks that are full, folders in the way, files of others: what the program writes, and what it leaves alone.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

#[path = "support/daemon.rs"]
#[expect(dead_code, reason = "other tests use the rest")]
mod daemon;
#[path = "support/mod.rs"]
#[expect(dead_code, reason = "other tests use the rest")]
mod support;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use serde_json::Value;

use daemon::{Daemon, Machine, cycle, free_port, json, machine_toml, until};
use support::{seepd, simulate, stdout};

const SOON: Duration = Duration::from_secs(20);

/// A small disk of its own; unmounted with its test.
struct SmallDisk(PathBuf);

impl SmallDisk {
    /// Mounts it; says so where this user may not.
    fn mount(place: &Path, size: &str) -> Option<Self> {
        fs::create_dir_all(place).unwrap();
        let options = format!("size={size}");
        let mounted =
            Command::new("mount").args(["-t", "tmpfs", "-o", &options, "tmpfs"]).arg(place).output();
        if mounted.is_ok_and(|output| output.status.success()) {
            return Some(SmallDisk(place.to_owned()));
        }
        let _ = writeln!(std::io::stderr(), "skipped: no disk can be mounted here");
        None
    }

    /// Fills it to the last byte.
    fn fill(&self) -> PathBuf {
        let ballast = self.0.join("ballast");
        let mut file = fs::File::create(&ballast).unwrap();
        while file.write_all(&[1; 4096]).is_ok() {}
        ballast
    }

    fn free_bytes(&self) -> u64 {
        let facts = nix::sys::statvfs::statvfs(&self.0).unwrap();
        facts.blocks_available() * facts.fragment_size()
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

fn sink(port: u16, name: &str) -> Option<Value> {
    let status = json(port, "/api/v1/status");
    status["sinks"].as_array().unwrap().iter().find(|sink| sink["name"] == name).cloned()
}

#[test]
fn a_recording_leaves_room_for_the_state_and_keeps_the_newest() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state");
    let Some(disk) = SmallDisk::mount(&state, "6m") else { return };
    let log = folder.path().join("long.mcap");
    simulate(&log, &["--cycles", "60", "--command-only", "--no-truth"]);
    let config = format!(
        "axis = \"press-1\"\nstate_dir = \"state\"\n[source]\nlog = \"{}\"\npace = \"fast\"\n[recording]\n",
        log.display()
    );
    let daemon = Daemon::start(folder.path(), &config);
    let log = daemon.log.clone();
    assert!(daemon.wait().success());
    let words = fs::read_to_string(log).unwrap();
    assert!(!words.contains("ERROR"), "{words}");
    // A tenth of the disk is free, the state is written, and the newest files hold the last cycles.
    assert!(disk.free_bytes() >= 600_000, "{}", disk.free_bytes());
    assert!(state.join("state.json").exists());
    let files = files(&state.join("recordings"));
    assert!(files.len() >= 2, "{files:?}");
    assert!(!files[0].ends_with("seepd-19700101T000000Z-000001.mcap"), "{files:?}");
    let newest = files.last().unwrap().to_str().unwrap();
    let text = stdout(&seepd(["replay", "--json", "--topic", "/press-1/signals", newest]));
    let summary: Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
    assert!(summary["cycles"].as_u64() >= Some(1), "{summary}");
}

#[test]
fn a_full_disk_is_told_once_and_counted_and_recovery_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state");
    let Some(disk) = SmallDisk::mount(&state, "6m") else { return };
    let ballast = disk.fill();
    let (socket, port) = (folder.path().join("in.sock"), free_port());
    let config = format!(
        "axis = \"press-1\"\nstate_dir = \"state\"\n{}[recording]\n[http]\nlisten = \"127.0.0.1:{port}\"\n",
        machine_toml(&socket)
    );
    let daemon = Daemon::start(folder.path(), &config);
    let machine = Machine::start(&socket, cycle("nominal_leak_0.csv"));
    until("a page", SOON, || daemon::ask(port, "GET", "/healthz", "").is_some());
    until("what is dropped is counted", SOON, || {
        sink(port, "recording")
            .is_some_and(|sink| sink["good"] == false && sink["dropped"].as_u64() > Some(1000))
    });
    until("the state's complaint", SOON, || sink(port, "state").is_some_and(|sink| sink["good"] == false));
    let metrics = daemon::ask(port, "GET", "/metrics", "").unwrap().body;
    assert!(!metrics.contains("seepd_sink_dropped_total{sink=\"recording\"} 0\n"), "{metrics}");
    assert!(files(&state.join("recordings")).is_empty());
    fs::remove_file(ballast).unwrap();
    until("the state again", SOON, || sink(port, "state").is_some_and(|sink| sink["good"] == true));
    until("the recording again", SOON, || sink(port, "recording").is_some_and(|sink| sink["good"] == true));
    machine.stop();
    let words = daemon.words();
    let count = |what: &str| words.lines().filter(|line| line.contains(what)).count();
    assert_eq!((count("the disk has no room"), count("the recording in")), (1, 1), "{words}");
    assert_eq!((count("No space left on device"), count("is written again")), (1, 1), "{words}");
    assert!(files(&state.join("recordings")).iter().all(|file| fs::metadata(file).unwrap().len() > 0));
    assert!(state.join("state.json").exists());
    drop(daemon);
}
