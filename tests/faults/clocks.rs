//! Clocks that step at random while cycles come: by decades forward and back, over leap seconds, over the ends of 32 bits, and the monotonic
//! clock over hours, as after a machine that was stopped. A daemon with such a clock and one beside it with the system's hear the same frames,
//! and estimate the same bytes.
//!
//! The clocks are those of a library that is preloaded (tests/clock/stepped.c); stepping this computer's own would disturb everybody on it.
//! The kernel's own clock is set by decades in tests/vm/systemd.

use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;

use super::{STOOD_STILL_MS, random, sequences};
use crate::daemon::{Daemon, axis_toml, command_frame, cycle, free_port, has, json, until};

const SOON: Duration = Duration::from_secs(20);
const SECOND_NS: i64 = 1_000_000_000;
/// Samples of a cycle, one a millisecond.
const CYCLE_MS: u64 = 10_000;
/// Places that a wall clock is set to, s since 1970: 1970, a leap second, the ends of 32 bits with and without a sign, 2038 less a second, 1901, 2262.
const PLACES_S: [i64; 9] = [
    0,
    1_483_228_799,
    2_147_483_646,
    2_147_483_648,
    4_294_967_294,
    4_294_967_296,
    946_684_800,
    7_258_118_400,
    9_223_372_030,
];
/// What it is set by, s: decades, leap seconds, an hour of summer.
const STEPS_S: [i64; 8] = [1_577_836_800, -1_577_836_800, 1, -1, 3600, -3600, 315_532_800, -315_532_800];

/// The library that steps clocks; `None` where none can be made.
pub(super) fn stepped_clock(folder: &Path) -> Option<PathBuf> {
    if !has("cc") {
        return None;
    }
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/clock/stepped.c");
    let library = folder.join("stepped.so");
    let made = Command::new("cc").args(["-shared", "-fPIC", "-O1", "-o"]).arg(&library).arg(source).status();
    assert!(made.unwrap().success());
    Some(library)
}

/// What is added to a daemon's clocks.
pub(super) struct Steps {
    file: File,
    wall_ns: i64,
    monotonic_ns: i64,
}

impl Steps {
    pub(super) fn begin(path: &Path) -> Self {
        fs::write(path, [0; 16]).unwrap();
        let file = fs::OpenOptions::new().write(true).open(path).unwrap();
        Steps { file, wall_ns: 0, monotonic_ns: 0 }
    }

    fn tell(&self) {
        self.file.write_all_at(&self.wall_ns.to_ne_bytes(), 0).unwrap();
        self.file.write_all_at(&self.monotonic_ns.to_ne_bytes(), 8).unwrap();
    }

    /// Sets the wall clock ahead of the system's.
    pub(super) fn set_ahead(&mut self, by: Duration) {
        self.wall_ns = by.as_nanos() as i64;
        self.tell();
    }

    fn step_wall(&mut self, seed: &mut u64) {
        let now_ns = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
        let now_ns = now_ns.as_nanos() as i64;
        let drawn = random(seed) as usize;
        let wall_ns = if random(seed).is_multiple_of(2) {
            let place_ns = PLACES_S[drawn % PLACES_S.len()].saturating_mul(SECOND_NS);
            place_ns.saturating_sub(now_ns)
        } else {
            self.wall_ns.saturating_add(STEPS_S[drawn % STEPS_S.len()] * SECOND_NS)
        };
        // No clock of Linux is before 1970 or behind 2262.
        let latest_ns = i64::MAX - 3600 * SECOND_NS;
        self.wall_ns = wall_ns.clamp(-now_ns, latest_ns - now_ns);
        self.tell();
    }

    /// As after a machine that was stopped for a second to ten hours.
    fn jump(&mut self, seed: &mut u64) {
        let by_ns = (1 + random(seed) % 36_000) as i64 * SECOND_NS;
        (self.monotonic_ns, self.wall_ns) = (self.monotonic_ns + by_ns, self.wall_ns.saturating_add(by_ns));
        self.tell();
    }
}

struct Watched {
    port: u16,
    socket: PathBuf,
    daemon: Daemon,
}

impl Watched {
    fn start(folder: &Path, environment: &[(&str, &str)]) -> Self {
        fs::create_dir(folder).unwrap();
        let (port, socket) = (free_port(), folder.join("in.sock"));
        let config = format!(
            "state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{port}\"\n{}",
            axis_toml("press-1", &socket)
        );
        let daemon = Daemon::start_with(folder, &config, environment);
        until("a page", SOON, || crate::daemon::axis_status(port).is_some());
        Watched { port, socket, daemon }
    }

    fn port(&self) -> UnixDatagram {
        let port = UnixDatagram::unbound().unwrap();
        until("the daemon's socket", SOON, || port.connect(&self.socket).is_ok());
        port
    }

    /// What is told of the estimate that is newest: its bytes; with its cycle.
    fn newest(&self) -> (Option<u64>, String) {
        let status = json(self.port, "/api/v1/axes/press-1");
        let of = |key: &str| status[key].to_string();
        let cycles = status["cycles"].as_u64();
        (cycles, [of("leak_area_m2"), of("interval90_m2"), of("leak_flow_lpm")].join(" "))
    }

    fn estimates(&self) -> Vec<String> {
        let trend = json(self.port, "/api/v1/axes/press-1/trend");
        let of = |point: &Value| format!("{} {}", point["leak_area_m2"], point["interval90_m2"]);
        trend.as_array().unwrap().iter().map(of).collect()
    }
}

/// `SEEPD_SEQUENCES=30 cargo test --workspace --test gateway faults::clocks -- --nocapture`: so many cycles, in real time.
#[test]
fn clocks_that_step_change_no_estimate() {
    let cycles = u64::from(sequences(1));
    let folder = tempfile::tempdir().unwrap();
    let Some(library) = stepped_clock(folder.path()) else { return };
    let place = folder.path().join("clock");
    let mut steps = Steps::begin(&place);
    let environment =
        [("LD_PRELOAD", library.to_str().unwrap()), ("SEEPD_TEST_CLOCK", place.to_str().unwrap())];
    let disturbed = Watched::start(&folder.path().join("disturbed"), &environment);
    let undisturbed = Watched::start(&folder.path().join("undisturbed"), &[]);
    let ports = [disturbed.port(), undisturbed.port()];
    let command = cycle("nominal_leak_1e-6.csv");
    let (mut seed, mut stepped, mut jumped, mut has_stood_still) = (5_u64, 0, 0, false);
    let begin = Instant::now();
    for ms in 0..cycles * CYCLE_MS + 700 {
        while (begin.elapsed().as_millis() as u64) < ms {
            thread::sleep(Duration::from_millis(1));
        }
        has_stood_still |= begin.elapsed() > Duration::from_millis(ms + STOOD_STILL_MS);
        for port in &ports {
            port.send(&command_frame(command[(ms % CYCLE_MS) as usize], ms as u8)).unwrap();
        }
        // Some ten steps in each cycle; a jump in each fourth one alone, which it may cost.
        if random(&mut seed).is_multiple_of(1000) {
            steps.step_wall(&mut seed);
            stepped += 1;
        }
        if ms % (4 * CYCLE_MS) == 3 * CYCLE_MS + 5000 {
            steps.jump(&mut seed);
            jumped += 1;
        }
    }
    thread::sleep(Duration::from_millis(500));
    let (told, expected) = (disturbed.estimates(), undisturbed.estimates());
    println!(
        "{cycles} cycles, {stepped} steps of the wall clock, {jumped} jumps of the monotonic one: {} estimates, {} without",
        told.len(),
        expected.len()
    );
    // Where this computer stood still, the bus was silent, and each of the two may have given another cycle up.
    assert!(has_stood_still || !expected.is_empty(), "{}", undisturbed.daemon.words());
    if jumped == 0 && !has_stood_still {
        assert_eq!(told, expected, "{}", disturbed.daemon.words());
        assert_eq!(disturbed.newest(), undisturbed.newest());
    }
    // A jump costs the cycle that it falls into, and the one that closes it; nothing else.
    assert!(has_stood_still || told.len() + 2 * jumped >= expected.len(), "{}", disturbed.daemon.words());
    assert!(
        has_stood_still || told.iter().all(|estimate| expected.contains(estimate)),
        "{told:?}\n{expected:?}"
    );
    assert!(!disturbed.daemon.words().contains("panic"), "{}", disturbed.daemon.words());
}
