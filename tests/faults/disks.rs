//! Disks that fill, are read-only, vanish and come back, files that may not grow, a disk that is slow, and a log that nobody takes, drawn at
//! random for state, spool, recording and log: the monitor goes on, says once what is wrong, and recovers by itself.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use serde_json::Value;

use super::sequences;
use crate::daemon::{Daemon, axis_status, cycle, free_port, has, sink, until};
use crate::disk::SmallDisk;

/// What waits longest is tried again every ten seconds.
const SOON: Duration = Duration::from_secs(40);
/// Samples of a cycle, and those that a source may keep back before they make a batch.
const CYCLE: u64 = 10_000;
const BATCH: u64 = 256;
/// Names of what is written, each on a disk of its own, and how each says that it cannot be.
const PLACES: [(&str, &str); 3] = [
    ("state", "the state in"),
    ("state/spool", "mqtt: events wait in memory"),
    ("recordings", "recording into"),
];

/// What happens to a disk.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Disk {
    Good,
    Full,
    ReadOnly,
    /// It is gone, and what was under it as well; it comes back as it was.
    Gone,
}

/// What happens to the process.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Process {
    Good,
    /// No file may be longer than so many bytes, as with a quota.
    ShortFiles(u32),
    /// What is made durable takes so long, ms.
    SlowDisk(u32),
}

#[derive(Debug, Clone)]
struct Fault {
    disks: [Disk; PLACES.len()],
    process: Process,
    /// Nobody takes what is logged.
    log_stands: bool,
    cycles: u64,
}

fn faults() -> impl Strategy<Value = Vec<Fault>> {
    let disk = prop::sample::select(&[Disk::Good, Disk::Full, Disk::ReadOnly, Disk::Gone][..]);
    let process = prop_oneof![
        3 => Just(Process::Good),
        1 => (0..9000_u32).prop_map(Process::ShortFiles),
        1 => prop_oneof![20..600_u32, Just(10_000)].prop_map(Process::SlowDisk),
    ];
    let fault = (prop::array::uniform3(disk), process, any::<bool>(), 1..4_u64);
    let fault =
        fault.prop_map(|(disks, process, log_stands, cycles)| Fault { disks, process, log_stands, cycles });
    prop::collection::vec(fault, 1..4)
}

/// Reads what a daemon logs, while it is told to.
struct LogReader {
    stands: Arc<AtomicBool>,
}

impl LogReader {
    fn start(pipe: File, into: PathBuf) -> Self {
        let stands = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&stands);
        thread::spawn(move || {
            let (mut pipe, mut some) = (pipe, [0; 4096]);
            let mut out = File::create(into).unwrap();
            loop {
                while told.load(Ordering::Relaxed) {
                    thread::sleep(Duration::from_millis(5));
                }
                match pipe.read(&mut some) {
                    Ok(0) | Err(_) => return,
                    Ok(size) => out.write_all(&some[..size]).unwrap(),
                }
            }
        });
        LogReader { stands }
    }
}

/// A disk at its place, or taken away from it.
struct Mounted {
    place: PathBuf,
    /// Where it is as well, so that it can come back as it was.
    elsewhere: PathBuf,
    disk: Option<SmallDisk>,
    ballast: Option<PathBuf>,
    fault: Disk,
}

fn succeeds(program: &str, arguments: &[&str], path: &Path) -> bool {
    Command::new(program).args(arguments).arg(path).output().is_ok_and(|output| output.status.success())
}

impl Mounted {
    fn mount(folder: &Path, name: &str) -> Option<Self> {
        let (place, elsewhere) = (folder.join(name), folder.join(name.replace('/', "-") + "-elsewhere"));
        let disk = SmallDisk::mount(&elsewhere, "8m")?;
        let mounted = Mounted { place, elsewhere, disk: Some(disk), ballast: None, fault: Disk::Good };
        mounted.bind();
        Some(mounted)
    }

    fn bind(&self) {
        fs::create_dir_all(&self.place).unwrap();
        let elsewhere = self.elsewhere.to_str().unwrap();
        assert!(succeeds("mount", &["--bind", elsewhere], &self.place));
    }

    fn unbind(&self) {
        let _ = succeeds("umount", &["-l"], &self.place);
    }

    fn meet(&mut self, fault: Disk) {
        self.fault = fault;
        match fault {
            Disk::Good => {}
            Disk::Full => self.ballast = self.disk.as_ref().map(SmallDisk::fill),
            // A file that is open keeps a disk from being made read-only by hand; its folder then takes no other one.
            Disk::ReadOnly => {
                assert!(
                    succeeds("mount", &["-o", "remount,ro"], &self.elsewhere)
                        || succeeds("chattr", &["+i"], &self.elsewhere)
                );
            }
            Disk::Gone => {
                self.unbind();
                // One that is within another one may be gone, or cannot be removed.
                let _ = fs::remove_dir_all(&self.place);
            }
        }
    }

    fn heal(&mut self) {
        match self.fault {
            Disk::Good => {}
            Disk::Full => fs::remove_file(self.ballast.take().unwrap()).unwrap(),
            Disk::ReadOnly => {
                let _ = succeeds("mount", &["-o", "remount,rw"], &self.elsewhere);
                let _ = succeeds("chattr", &["-i"], &self.elsewhere);
            }
            Disk::Gone => {}
        }
        // One that was within another one went with it.
        if !succeeds("mountpoint", &["-q"], &self.place) {
            self.bind();
        }
        self.fault = Disk::Good;
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        self.heal();
        self.unbind();
    }
}

struct Bench {
    daemon: Daemon,
    pipe: File,
    log: LogReader,
    sent: u64,
    cycles: u64,
    command: Vec<f64>,
    port: u16,
    /// Keeps the disk slow while it lives.
    strace: Option<Child>,
    // In the order in which they go: those within others first.
    disks: Vec<Mounted>,
    folder: tempfile::TempDir,
}

impl Bench {
    fn start() -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let mut disks = Vec::new();
        for (name, _) in PLACES {
            disks.insert(0, Mounted::mount(folder.path(), name)?);
        }
        for fifo in ["commands.csv", "log"] {
            nix::unistd::mkfifo(&path(fifo), nix::sys::stat::Mode::S_IRWXU).unwrap();
        }
        let port = free_port();
        let config = format!(
            "axis = \"press-1\"\nstate_dir = \"state\"\n[source]\nlog = \"commands.csv\"\npace = \"fast\"\nstale_after_s = 3600.0\n\
             [recording]\nfolder = \"recordings\"\n[http]\nlisten = \"127.0.0.1:{port}\"\n\
             [mqtt]\nhost = \"127.0.0.1\"\nport = {}\n",
            free_port()
        );
        // Opened for both, neither waits for the other.
        let both = fs::OpenOptions::new().read(true).write(true).open(path("log")).unwrap();
        // A pipe has room for 64 KiB, which is many cycles of lines: one page is soon full.
        let room = nix::fcntl::FcntlArg::F_SETPIPE_SZ(4096);
        nix::fcntl::fcntl(&both, room).unwrap();
        let mut daemon =
            Daemon::start_logging_to(folder.path(), &config, Stdio::from(both.try_clone().unwrap()));
        daemon.log = path("read.log");
        let log = LogReader::start(both, daemon.log.clone());
        let mut pipe = fs::OpenOptions::new().write(true).open(path("commands.csv")).unwrap();
        pipe.write_all(b"t_s,command\n").unwrap();
        until("a page", SOON, || axis_status(port).is_some_and(|status| status["axis"].is_string()));
        let command = cycle("nominal_leak_1e-6.csv");
        Some(Bench { daemon, pipe, log, sent: 0, cycles: 0, command, port, strace: None, disks, folder })
    }

    /// Sends cycles, which the daemon must work through whatever its disks do.
    fn send(&mut self, cycles: u64) {
        for _ in 0..cycles {
            let mut text = String::new();
            for number in self.sent..self.sent + CYCLE {
                let command = self.command[(number % CYCLE) as usize];
                text += &format!("{}.{:03},{command}\n", number / 1000, number % 1000);
            }
            self.sent += CYCLE;
            self.pipe.write_all(text.as_bytes()).unwrap();
        }
        self.cycles += cycles;
        let (port, sent, cycles) = (self.port, self.sent, self.cycles);
        let mut status = Value::Null;
        until("every sample and cycle", SOON, || {
            status = axis_status(port).unwrap_or_default();
            // The last cycle is closed by the next.
            status["source"]["samples"].as_u64().is_some_and(|samples| samples + BATCH >= sent)
                && status["cycles"].as_u64().is_some_and(|told| told + 1 >= cycles)
        });
        let area_m2 = status["leak_area_m2"].as_f64();
        assert!(cycles < 2 || area_m2.is_some_and(|area_m2| (area_m2 / 1e-6 - 1.0).abs() < 0.1), "{status}");
    }

    fn meet(&mut self, fault: &Fault) {
        for (disk, fault) in self.disks.iter_mut().rev().zip(fault.disks) {
            disk.meet(fault);
        }
        let process = self.daemon.child.id().to_string();
        match fault.process {
            Process::Good => {}
            Process::ShortFiles(bytes) => {
                assert!(limit(&process, &bytes.to_string()));
            }
            Process::SlowDisk(ms) => {
                let delay = format!("inject=fsync,fdatasync:delay_enter={}", u64::from(ms) * 1000);
                let strace = Command::new("strace")
                    .args(["-q", "-f", "-p", &process, "-e", "trace=fsync,fdatasync", "-e", &delay])
                    .args(["-o", "/dev/null"])
                    .stderr(Stdio::null())
                    .spawn();
                self.strace = strace.ok();
            }
        }
        self.log.stands.store(fault.log_stands, Ordering::Relaxed);
    }

    fn heal(&mut self) {
        if let Some(mut strace) = self.strace.take() {
            // Asked to end it lets go of the daemon; killed it might leave it stopped.
            let _ = Command::new("kill").arg(strace.id().to_string()).status();
            strace.wait().unwrap();
        }
        assert!(limit(&self.daemon.child.id().to_string(), "unlimited"));
        self.disks.iter_mut().rev().for_each(Mounted::heal);
        self.log.stands.store(false, Ordering::Relaxed);
    }

    /// Everything is written again, without anybody's help.
    fn recover(&mut self) {
        self.send(1);
        let port = self.port;
        let are_good = |sinks: &[Value]| {
            sinks[0]["good"] == true
                && sinks[1]["good"] == true
                && !sinks[2]["detail"].as_str().unwrap_or("in memory").contains("in memory")
        };
        let begin = Instant::now();
        loop {
            let sinks = ["state", "recording", "mqtt"].map(|name| sink(port, name));
            if are_good(&sinks) {
                break;
            }
            assert!(begin.elapsed() < SOON, "{sinks:?}\n{}", self.daemon.words());
            // A machine goes on, and what comes is what is tried with.
            self.send(1);
            thread::sleep(Duration::from_millis(200));
        }
        let state = self.folder.path().join("state/state.json");
        until("the state's file", SOON, || {
            fs::read_to_string(&state).is_ok_and(|text| seepd::live::state::parse(&text).is_ok())
        });
    }

    /// So often each place was said to be at fault.
    fn complaints(&self) -> Vec<usize> {
        let words = self.daemon.words();
        let said = |complaint: &str| {
            words.lines().filter(|line| line.contains("ERROR") && line.contains(complaint)).count()
        };
        PLACES.iter().map(|(_, complaint)| said(complaint)).collect()
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.heal();
    }
}

fn limit(process: &str, bytes: &str) -> bool {
    let option = format!("--fsize={bytes}:");
    Command::new("prlimit")
        .args(["--pid", process, &option])
        .output()
        .is_ok_and(|output| output.status.success())
}

/// `SEEPD_SEQUENCES=40 cargo test --workspace --test gateway faults::disks -- --nocapture` for a long run.
#[test]
fn disks_that_fail_in_any_way_stop_no_monitoring_and_are_told_of_once() {
    if !["strace", "prlimit", "chattr"].into_iter().all(has) {
        return;
    }
    let cases = sequences(3);
    let config = Config { cases, max_shrink_iters: 0, failure_persistence: None, ..Config::default() };
    let rng = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    let met = std::cell::Cell::new(0);
    let outcome = TestRunner::new_with_rng(config, rng).run(&faults(), |faults| {
        let Some(mut bench) = Bench::start() else { return Ok(()) };
        // One after the other in a long run; the short one has time for the first.
        let count = if cases > 1 { faults.len() } else { 1 };
        for fault in &faults[..count] {
            bench.send(1);
            let before = bench.complaints();
            bench.meet(fault);
            bench.send(fault.cycles);
            thread::sleep(Duration::from_millis(if fault.log_stands { 0 } else { 1000 }));
            let complaints = bench.complaints();
            bench.heal();
            bench.recover();
            let told = before.iter().zip(&complaints).all(|(before, now)| *now <= before + 1);
            prop_assert!(
                told,
                "{:?}: {:?} before, {:?} then\n{}",
                fault,
                before,
                complaints,
                bench.daemon.words()
            );
            met.set(met.get() + 1);
        }
        Ok(())
    });
    println!("{cases} sequences, {} times of faults", met.get());
    outcome.unwrap_or_else(|error| panic!("{error}"));
}
