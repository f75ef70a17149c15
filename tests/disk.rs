//! Disks that are full, folders in the way, files of others: what the program writes, and what it leaves alone.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use serde_json::Value;

use crate::daemon::{Daemon, Machine, cycle, free_port, machine_toml, sink, until};
use crate::support::{fixture, seepd, simulate, stderr, stdout};

const SOON: Duration = Duration::from_secs(20);

/// A small disk of its own; unmounted with its test.
pub(crate) struct SmallDisk(PathBuf);

impl SmallDisk {
    /// Mounts it; says so where this user may not.
    pub(crate) fn mount(place: &Path, size: &str) -> Option<Self> {
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
    pub(crate) fn fill(&self) -> PathBuf {
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
    // A tenth of the disk is free, the state is written, and what was recorded last is there.
    assert!(disk.free_bytes() >= 600_000, "{}", disk.free_bytes());
    assert!(state.join("state.json").exists());
    let files = files(&state.join("recordings"));
    assert!(files.len() >= 2, "{files:?}");
    assert!(!files[0].ends_with("seepd-19700101T000000Z-000001.mcap"), "{files:?}");
    let names = files.iter().map(|file| file.to_str().unwrap());
    let text = stdout(&seepd(["replay", "--json", "--topic", "/press-1/signals"].into_iter().chain(names)));
    let summary: Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
    assert!((5..60).contains(&summary["cycles"].as_u64().unwrap()), "{summary}");
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
    until("a page", SOON, || crate::daemon::ask(port, "GET", "/healthz", "").is_some());
    until("what is dropped is counted", SOON, || {
        let recording = sink(port, "recording");
        recording["good"] == false && recording["dropped"].as_u64() > Some(1000)
    });
    until("the state's complaint", SOON, || sink(port, "state")["good"] == false);
    let metrics = crate::daemon::ask(port, "GET", "/metrics", "").unwrap().body;
    assert!(!metrics.contains("seepd_sink_dropped_total{sink=\"recording\"} 0\n"), "{metrics}");
    assert!(files(&state.join("recordings")).is_empty());
    fs::remove_file(ballast).unwrap();
    until("the state again", SOON, || sink(port, "state")["good"] == true);
    until("the recording again", SOON, || sink(port, "recording")["good"] == true);
    machine.stop();
    let words = daemon.words();
    let count = |what: &str| words.lines().filter(|line| line.contains(what)).count();
    assert_eq!((count("the disk has no room"), count("the recording in")), (1, 1), "{words}");
    assert_eq!((count("No space left on device"), count("is written again")), (1, 1), "{words}");
    assert!(files(&state.join("recordings")).iter().all(|file| fs::metadata(file).unwrap().len() > 0));
    assert!(state.join("state.json").exists());
    drop(daemon);
}

#[test]
fn one_state_folder_has_one_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let config = |socket: &str| {
        format!("axis = \"press-1\"\nstate_dir = \"state\"\n{}", machine_toml(&folder.path().join(socket)))
    };
    let first = Daemon::start(
        folder.path(),
        &format!("{}[http]\nlisten = \"127.0.0.1:{port}\"\n", config("one.sock")),
    );
    until("a page", SOON, || crate::daemon::ask(port, "GET", "/healthz", "").is_some());
    let path = folder.path().join("second.toml");
    fs::write(&path, config("two.sock")).unwrap();
    let output = seepd(["run", "--config", path.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(75));
    let held = format!("process {} keeps its state there", first.child.id());
    assert!(stderr(&output).contains(&held), "{}", stderr(&output));
    assert!(first.terminate().0.success());
}

#[test]
fn a_state_folder_that_cannot_be_used_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let (socket, port, state) = (folder.path().join("in.sock"), free_port(), folder.path().join("state"));
    fs::write(&state, "a file in the way").unwrap();
    let config = format!(
        "axis = \"press-1\"\nstate_dir = \"state\"\n{}[http]\nlisten = \"127.0.0.1:{port}\"\n\
         [mqtt]\nhost = \"127.0.0.1\"\nport = {}\n",
        machine_toml(&socket),
        free_port()
    );
    let daemon = Daemon::start(folder.path(), &config);
    let machine = Machine::start(&socket, cycle("nominal_leak_0.csv"));
    until("a page", SOON, || crate::daemon::ask(port, "GET", "/healthz", "").is_some());
    for name in ["state", "mqtt"] {
        until(name, SOON, || sink(port, name)["good"] == false);
    }
    fs::remove_file(&state).unwrap();
    // A folder in the place of the file is set aside by the next start; here it is what the first start has left.
    until("the state", SOON, || sink(port, "state")["good"] == true);
    until("the spool", SOON, || state.join("spool").exists());
    machine.stop();
    assert!(daemon.terminate().0.success());
    assert!(state.join("state.json").is_file());
}

/// Runs a command that ends by itself, or is killed after a while.
fn ended(arguments: &[&str]) -> std::process::ExitStatus {
    let mut child = Command::new(env!("CARGO_BIN_EXE_seepd"))
        .args(arguments)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let begin = std::time::Instant::now();
    while child.try_wait().unwrap().is_none() && begin.elapsed() < SOON {
        std::thread::sleep(Duration::from_millis(20));
    }
    let _ = child.kill();
    child.wait().unwrap()
}

#[test]
fn a_fifo_in_the_place_of_a_file_is_refused_and_not_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (fifo, log) = (path("fifo"), fixture("nominal_leak_0.csv").display().to_string());
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let daemon_with = |name: &str, table: &str| {
        let socket = folder.path().join(format!("{name}.sock"));
        fs::write(path(name), format!("state_dir = \"{name}-state\"\n{table}{}", machine_toml(&socket)))
            .unwrap();
        path(name)
    };
    let token = format!("[http]\nlisten = \"127.0.0.1:{}\"\ntoken_file = \"fifo\"\n", free_port());
    let password = "[mqtt]\nhost = \"localhost\"\nusername = \"seepd\"\npassword_file = \"fifo\"\n";
    let certificates = "[mqtt]\nhost = \"localhost\"\ntls = true\nca_file = \"fifo\"\n";
    let commands: [&[&str]; 11] = [
        &["run", "--config", &fifo],
        &["run", "--config", &daemon_with("model", "model = \"fifo\"\n")],
        &["run", "--config", &daemon_with("token", &token)],
        &["run", "--config", &daemon_with("password", password)],
        &["run", "--config", &daemon_with("certificates", certificates)],
        &["check", &fifo],
        &["replay", "--config", &fifo, &log],
        &["replay", "--model", &fifo, &log],
        &["replay", "--baseline", &fifo, &log],
        &["inspect", "--dbc", &fifo, &log],
        &["simulate", "--plant", &fifo, "--out", &path("new")],
    ];
    for command in commands {
        // Not killed, and no success.
        assert!(ended(command).code().is_some_and(|code| code >= 64), "{command:?}");
    }
}

/// Runs a command that must be refused; its exit code and its one line.
fn refusal(arguments: &[&str]) -> (i32, String) {
    let output = seepd(arguments);
    let text = stderr(&output);
    assert_eq!(text.lines().count(), 1, "{arguments:?}: {text}");
    (output.status.code().unwrap(), text)
}

#[test]
fn no_command_writes_over_a_file_unless_asked() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (log, old) = (path("log.mcap"), path("press.mcap"));
    simulate(Path::new(&log), &["--cycles", "6"]);
    fs::write(&old, "last week's result").unwrap();
    fs::write(path("seepd.1"), "last week's result").unwrap();
    let (new, here) = (path("new"), path(""));
    let commands: [&[&str]; 15] = [
        &["simulate", "--out", &old],
        &["train", "--out", &old],
        &["train", "--out", &new, "--data", &old],
        &["study", "--out", &old],
        &["demo", "--folder", &here],
        &["replay", &log, "--csv", &old],
        &["replay", &log, "--mcap", &old],
        &["replay", &log, "--html", &old],
        &["evaluate", &log, "--html", &old],
        &["learn-baseline", &log, "--out", &old],
        &["gap", &log, "--json", &old],
        &["gap", &log, "--html", &old],
        &["gap", &log, "--emit-plant", &old],
        &["init", &log, "--out", &old],
        &["man", "--folder", &here],
    ];
    for command in commands {
        let (code, text) = refusal(command);
        assert_eq!(code, 64, "{command:?}: {text}");
        assert!(text.contains("is there already; ") && text.contains("--force"), "{command:?}: {text}");
    }
    assert_eq!(fs::read_to_string(&old).unwrap(), "last week's result");
    assert_eq!(files(folder.path()).len(), 3);
    stdout(&seepd(["replay", "--quiet", "--force", "--csv", &old, &log]));
    assert!(fs::read_to_string(&old).unwrap().starts_with("axis,cycle,"));
}

#[test]
fn no_command_writes_over_what_it_reads() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (log, twin, plant) = (path("log.mcap"), path("twin.mcap"), path("plant.toml"));
    simulate(Path::new(&log), &["--cycles", "6"]);
    std::os::unix::fs::symlink(&log, &twin).unwrap();
    fs::copy(fixture("../../docs/plant.toml"), &plant).unwrap();
    let before = fs::read(&log).unwrap();
    let commands: [&[&str]; 9] = [
        &["replay", &log, "--csv", &log],
        &["replay", &log, "--mcap", &twin],
        &["replay", &twin, "--html", &log],
        &["evaluate", &log, "--html", &log],
        &["learn-baseline", &log, "--out", &twin],
        &["gap", &log, "--json", &log],
        &["gap", &log, "--plant", &plant, "--emit-plant", &plant],
        &["simulate", "--plant", &plant, "--out", &plant],
        &["init", &log, "--out", &log],
    ];
    for command in commands {
        let (code, text) = refusal(&[command, &["--force"]].concat());
        assert_eq!(code, 64, "{command:?}: {text}");
        assert!(text.contains("is read by this very command"), "{command:?}: {text}");
    }
    assert_eq!(fs::read(&log).unwrap(), before);
}

#[test]
fn a_command_that_fails_leaves_the_older_result() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (old, missing) = (path("cycles.csv"), path("missing.mcap"));
    fs::write(&old, "last week's result").unwrap();
    for option in ["--csv", "--mcap", "--parquet", "--html"] {
        assert_eq!(refusal(&["replay", &missing, "--force", option, &old]).0, 66);
        assert_eq!(fs::read_to_string(&old).unwrap(), "last week's result");
    }
    assert_eq!(files(folder.path()).len(), 1);
}

#[cfg(not(feature = "object-store"))]
#[test]
fn an_address_is_refused_with_what_to_do_and_without_what_may_be_secret() {
    let (code, text) = refusal(&["replay", "https://user:word@example.invalid/press.mcap?signature=secret"]);
    let expected = "https://example.invalid/press.mcap: this build reads no addresses; download the log first, or build with";
    assert!(code == 65 && text.contains(expected) && !text.contains("secret"), "{text}");
}

#[test]
fn pipes_and_devices_are_written_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    simulate(&log, &["--cycles", "6"]);
    let log = log.to_str().unwrap();
    let text = stdout(&seepd(["replay", "--quiet", "--csv", "/dev/stdout", log]));
    assert!(text.starts_with("axis,cycle,") && text.contains("cycles in"), "{text}");
    stdout(&seepd(["replay", "--quiet", "--mcap", "/dev/null", "--html", "/dev/null", log]));
    let (code, text) = refusal(&["replay", "--quiet", "--csv", "/dev/full", log]);
    assert!(code == 74 && text.contains("/dev/full: No space left"), "{text}");
    // A log that goes down a pipe is the same log.
    let through = seepd(["simulate", "--cycles", "6", "--out", "/dev/stdout"]);
    assert!(through.status.success(), "{}", stderr(&through));
    assert_eq!(through.stdout, fs::read(log).unwrap());
}
