//! Clients of the page that mean harm, drawn at random: heads and bodies that trickle, streams that nobody reads, floods, requests too large, too
//! many or no requests at all, other names for this host, orders from other sites, paths that climb, markup wherever something can be said.
//!
//! Meanwhile the machine's samples are taken as before, an honest client is answered, memory is bounded, and nobody's markup or order gets
//! through. What the samples wait is compared within one run, without the clients and with them.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use super::patient::PatientMachine;
use super::{random, sequences};
use crate::daemon::{Daemon, ask, axis_status, axis_toml, cycle, free_port, json, until};

const SOON: Duration = Duration::from_secs(20);
/// Axes under load, each a thousand samples a second.
const AXES: usize = 4;
/// An honest client gives up after so long.
const PATIENCE: Duration = Duration::from_secs(5);
/// Samples may wait so much longer under all of them, ms.
const MORE_WAIT_MS: f64 = 10.0;
/// What the process may grow by under all of them, kB: connections' buffers, and what an allocator keeps.
const GROWTH_KB: u64 = 40 << 10;
/// Whoever sees this outside of a quoted text has been injected to.
const MARKUP: &str = "<script>alert('seepd')</script><img src=x onerror=alert(1)>";

/// What a client does. Each is one attempt, after which the next is drawn.
#[derive(Debug, Clone, Copy)]
enum Harm {
    SlowHead,
    SlowBody,
    /// An event stream that is asked for and never read.
    Stream,
    Flood,
    LongHead,
    ManyHeads,
    LongAddress,
    LongBody,
    EndlessChunks,
    Garbage,
    PipelinedGarbage,
    Smuggled,
    OtherHost,
    OtherOrigin,
    OtherSite,
    Climbing,
    Markup,
    /// Asks for much and takes nothing.
    Unread,
}

const HARMS: [Harm; 18] = [
    Harm::SlowHead,
    Harm::SlowBody,
    Harm::Stream,
    Harm::Flood,
    Harm::LongHead,
    Harm::ManyHeads,
    Harm::LongAddress,
    Harm::LongBody,
    Harm::EndlessChunks,
    Harm::Garbage,
    Harm::PipelinedGarbage,
    Harm::Smuggled,
    Harm::OtherHost,
    Harm::OtherOrigin,
    Harm::OtherSite,
    Harm::Climbing,
    Harm::Markup,
    Harm::Unread,
];

const PATHS: [&str; 10] = [
    "/",
    "/dashboard.js",
    "/metrics",
    "/api/v1/status",
    "/api/v1/reasons",
    "/api/v1/axes/0/cycles",
    "/api/v1/axes/0/healthy",
    "/api/v1/history",
    "/api/v1/openapi.json",
    "/healthz",
];

const CLIMBS: [&str; 8] = [
    "/../../../../etc/passwd",
    "/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
    "/api/v1/axes/..%2f..%2f..%2fetc%2fpasswd/trend",
    "/api/v1/axes/%00/cycles",
    "//etc/passwd",
    "/..\\..\\etc\\passwd",
    "/dashboard.css/../../state/state.json",
    "/api/v1/axes/%2fetc%2fpasswd",
];

/// What all clients did and saw.
#[derive(Default)]
struct Tally {
    requests: AtomicU64,
    streams: AtomicU64,
    /// What must be refused and was not, with its answer.
    let_through: Mutex<Vec<String>>,
    injections: AtomicU64,
}

struct Client<'t> {
    port: u16,
    seed: u64,
    stop: &'t AtomicBool,
    tally: &'t Tally,
}

impl Client<'_> {
    fn is_over(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn draw(&mut self, most: usize) -> usize {
        (random(&mut self.seed) % most as u64) as usize
    }

    fn connect(&self) -> Option<TcpStream> {
        let stream = TcpStream::connect(("127.0.0.1", self.port)).ok()?;
        stream.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
        stream.set_write_timeout(Some(Duration::from_millis(500))).unwrap();
        Some(stream)
    }

    fn head(&self, method: &str, path: &str, more: &str) -> String {
        format!("{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\n{more}", self.port)
    }

    /// Sends a request and reads the answer, however it ends.
    fn exchange(&self, request: &[u8]) -> Option<String> {
        self.tally.requests.fetch_add(1, Ordering::Relaxed);
        let mut stream = self.connect()?;
        let _ = stream.write_all(request);
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let text = String::from_utf8_lossy(&hear(&mut stream)).into_owned();
        if is_injected(&text) {
            self.tally.injections.fetch_add(1, Ordering::Relaxed);
        }
        Some(text)
    }

    /// A request that must not be let through; one that nobody answers in time is not.
    fn refused(&self, request: &str) {
        let answer = self.exchange(request.as_bytes()).unwrap_or_default();
        let code = answer.split(' ').nth(1).unwrap_or("000");
        if code.starts_with('2') || code.starts_with('3') || answer.contains("root:") {
            self.tally.let_through.lock().unwrap().push(format!("{request:?}: {answer}"));
        }
    }

    /// Says something a byte at a time, until it is cut off or told to stop.
    fn trickle(&self, beginning: &str, endless: &str) {
        let Some(mut stream) = self.connect() else { return };
        self.tally.requests.fetch_add(1, Ordering::Relaxed);
        for byte in beginning.bytes().chain(endless.bytes().cycle()) {
            if self.is_over() || stream.write_all(&[byte]).is_err() {
                return;
            }
            if beginning.len() < 4000 {
                thread::sleep(Duration::from_millis(50));
            }
        }
    }

    fn trickle_body(&self, path: &str) {
        let Some(mut stream) = self.connect() else { return };
        self.tally.requests.fetch_add(1, Ordering::Relaxed);
        let _ = stream.write_all(self.head("POST", path, "Content-Length: 4000\r\n\r\n").as_bytes());
        while !self.is_over() && stream.write_all(b" ").is_ok() {
            thread::sleep(Duration::from_millis(50));
        }
    }

    fn do_harm(&mut self, harm: Harm) {
        match harm {
            Harm::SlowHead => self.trickle(&self.head("GET", "/", "X-Slow: "), "a"),
            Harm::SlowBody => {
                let path = ["/login", "/api/v1/axes/0/acknowledge"][self.draw(2)];
                self.trickle_body(path);
            }
            Harm::Stream => self.stall_stream(),
            Harm::Flood => self.flood(),
            Harm::LongHead => {
                let long = "a".repeat(1 << 20);
                self.refused(&self.head("GET", "/api/v1/status", &format!("X-Long: {long}\r\n\r\n")));
            }
            Harm::ManyHeads => {
                let many: String = (0..20_000).map(|number| format!("X-{number}: a\r\n")).collect();
                self.refused(&self.head("GET", "/api/v1/status", &format!("{many}\r\n")));
            }
            Harm::LongAddress => {
                let path = format!("/api/v1/axes/{}", "a".repeat(100_000));
                self.refused(&self.head("GET", &path, "\r\n"));
            }
            Harm::LongBody => {
                let body = " ".repeat(3 << 20);
                let head = format!("Content-Length: {}\r\n\r\n{body}", 1_u64 << 40);
                self.refused(&self.head("POST", "/api/v1/axes/0/repairs", &head));
            }
            Harm::EndlessChunks => {
                let chunk = format!("10000\r\n{}\r\n", "a".repeat(0x10000));
                let head = format!("Transfer-Encoding: chunked\r\n\r\n{}", chunk.repeat(50));
                self.refused(&self.head("POST", "/api/v1/axes/0/acknowledge", &head));
            }
            Harm::Garbage => {
                let length = 1 + self.draw(4000);
                let garbage: Vec<u8> = (0..length).map(|_| random(&mut self.seed) as u8).collect();
                self.exchange(&garbage);
                self.exchange(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03");
                self.exchange(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n");
            }
            Harm::PipelinedGarbage => {
                let good = self.head("GET", "/healthz", "\r\n").repeat(1 + self.draw(100));
                let garbage: String =
                    (0..2000).map(|_| char::from(random(&mut self.seed) as u8 & 0x7f)).collect();
                self.exchange(format!("{good}{garbage}").as_bytes());
            }
            Harm::Smuggled => {
                let inner =
                    self.head("POST", "/api/v1/axes/0/new-baseline", "Origin: http://evil.example\r\n\r\n");
                let both = format!("Content-Length: 3\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n{inner}");
                self.exchange(self.head("POST", "/api/v1/axes/0/none", &both).as_bytes());
            }
            Harm::OtherHost => {
                let host = ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example:80", "", "0"]
                    [self.draw(5)];
                self.refused(&format!("GET /api/v1/status HTTP/1.1\r\nHost: {host}\r\n\r\n"));
                self.refused("GET /api/v1/status HTTP/1.0\r\n\r\n");
            }
            Harm::OtherOrigin => {
                let origin =
                    ["http://evil.example", "null", "https://127.0.0.1", "file://", "x"][self.draw(5)];
                let more = format!("Origin: {origin}\r\nContent-Length: 0\r\n\r\n");
                self.refused(&self.head("POST", "/api/v1/axes/0/new-baseline", &more));
            }
            Harm::OtherSite => {
                let site = ["cross-site", "same-site"][self.draw(2)];
                let more = format!("Sec-Fetch-Site: {site}\r\nContent-Length: 0\r\n\r\n");
                self.refused(&self.head("POST", "/api/v1/axes/0/new-baseline", &more));
            }
            Harm::Climbing => {
                let path = CLIMBS[self.draw(CLIMBS.len())];
                self.refused(&self.head("GET", path, "\r\n"));
            }
            Harm::Markup => self.say_markup(),
            Harm::Unread => {
                let Some(mut stream) = self.connect() else { return };
                self.tally.requests.fetch_add(100, Ordering::Relaxed);
                let path = PATHS[self.draw(PATHS.len())];
                let _ = stream.write_all(self.head("GET", path, "\r\n").repeat(100).as_bytes());
                thread::sleep(Duration::from_millis(500));
            }
        }
    }

    fn stall_stream(&self) {
        let Some(mut stream) = self.connect() else { return };
        self.tally.streams.fetch_add(1, Ordering::Relaxed);
        let _ = stream.write_all(self.head("GET", "/api/v1/events?axis=0", "\r\n").as_bytes());
        let begin = Instant::now();
        while !self.is_over() && begin.elapsed() < Duration::from_secs(2) {
            thread::sleep(Duration::from_millis(50));
        }
    }

    fn flood(&mut self) {
        let Some(mut stream) = self.connect() else { return };
        for _ in 0..200 {
            let path = PATHS[self.draw(PATHS.len())];
            self.tally.requests.fetch_add(1, Ordering::Relaxed);
            if self.is_over() || stream.write_all(self.head("GET", path, "\r\n").as_bytes()).is_err() {
                return;
            }
            let mut some = [0; 4096];
            let _ = stream.read(&mut some);
        }
    }

    /// Says markup wherever a name, a note or an address is taken.
    fn say_markup(&mut self) {
        let encoded: String = MARKUP.bytes().map(|byte| format!("%{byte:02x}")).collect();
        let quoted = serde_json::to_string(MARKUP).unwrap();
        let acknowledgement = format!("{{\"who\":{quoted},\"note\":{quoted}}}");
        let repair = format!("{{\"what\":\"other\",\"who\":{quoted},\"note\":{quoted}}}");
        let post = |path: &str, body: &str| {
            self.head("POST", path, &format!("Content-Length: {}\r\n\r\n{body}", body.len()))
        };
        let requests = [
            self.head("GET", &format!("/api/v1/axes/{encoded}"), "\r\n"),
            self.head("GET", &format!("/{encoded}"), "\r\n"),
            self.head("GET", &format!("/?token={encoded}"), "\r\n"),
            post("/api/v1/axes/0/acknowledge", &acknowledgement),
            post("/api/v1/axes/0/repairs", &repair),
            post("/login", &format!("token={encoded}")),
            post(&format!("/api/v1/axes/{encoded}/acknowledge"), &acknowledgement),
            post("/api/v1/axes/0/acknowledge", MARKUP),
            post("/api/v1/axes/0/acknowledge", "{\"who\":\"a\\r\\nSet-Cookie: b=c\"}"),
            self.head("GET", "/api/v1/status", &format!("X: {MARKUP}\r\n\r\n")),
            self.head("GET", "/api/v1/axes/a%0d%0aSet-Cookie:%20b=c", "\r\n"),
        ];
        let which = self.draw(requests.len());
        self.exchange(requests[which].as_bytes());
    }
}

/// What comes until the other side ends, nothing comes, or it is enough.
fn hear(stream: &mut TcpStream) -> Vec<u8> {
    let (mut heard, mut some) = (Vec::new(), [0; 16 << 10]);
    while heard.len() < 1 << 20 {
        match stream.read(&mut some) {
            Ok(0) => break,
            Ok(size) => heard.extend_from_slice(&some[..size]),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(_) => break,
        }
    }
    heard
}

/// Whether an answer has markup or lines of others where a browser would heed them: in its head, in HTML, or in a type that it may guess.
fn is_injected(answer: &str) -> bool {
    let Some((head, body)) = answer.split_once("\r\n\r\n") else { return false };
    let head = head.to_ascii_lowercase();
    let has_markup = body.contains("<script>alert") || body.contains("onerror=alert");
    let is_data = head.contains("content-type: application/json")
        || head.contains("content-type: text/plain")
        || head.contains("content-type: application/openmetrics-text")
        || head.contains("content-type: text/event-stream");
    let is_guarded = head.contains("x-content-type-options: nosniff")
        && head.contains("content-security-policy: default-src 'none'");
    head.contains("set-cookie: b=c") || head.contains("alert(") || has_markup && !(is_data && is_guarded)
}

/// What the samples of all machines have waited since this was last asked, µs, in order of length.
fn waits_us(machines: &[PatientMachine]) -> Vec<u32> {
    let mut waits: Vec<u32> = machines.iter().flat_map(PatientMachine::waits_us).collect();
    waits.sort_unstable();
    waits
}

fn at_share(sorted: &[u32], share: f64) -> f64 {
    f64::from(sorted[((sorted.len() - 1) as f64 * share) as usize]) / 1000.0
}

/// Delays of publication of the cycles that ended while it looked, s.
fn delays_until(port: u16, end: Instant, mut meanwhile: impl FnMut()) -> Vec<f64> {
    let (mut seen, mut delays) = (vec![None; AXES], Vec::new());
    while Instant::now() < end {
        for (axis, seen) in seen.iter_mut().enumerate() {
            let Some(status) = ask(port, "GET", &format!("/api/v1/axes/{axis}"), "") else { continue };
            let status = status.json();
            let cycle = status["cycle"].as_u64();
            if *seen != cycle && seen.is_some() {
                delays.extend(status["publication_delay_s"].as_f64());
            }
            *seen = cycle.or(*seen);
        }
        meanwhile();
        thread::sleep(Duration::from_millis(100));
    }
    delays.sort_by(f64::total_cmp);
    delays
}

/// `SEEPD_SEQUENCES=500 cargo test --workspace --test gateway faults::web -- --nocapture`: so many clients, and two minutes of each phase.
#[test]
fn hostile_clients_of_the_page_disturb_neither_the_machine_nor_an_honest_client() {
    let clients = sequences(60) as usize;
    let phase = if clients > 100 { Duration::from_secs(120) } else { Duration::from_secs(4) };
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let mut config = format!("state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{port}\"\n");
    for axis in 0..AXES {
        config += &axis_toml(&axis.to_string(), &folder.path().join(format!("{axis}.sock")));
    }
    let daemon = Daemon::start(folder.path(), &config);
    until("a page", SOON, || axis_status(port).is_some());

    let command = cycle("nominal_leak_1e-6.csv");
    // Each axis begins elsewhere in the cycle, so that their cycles end at different times.
    let machine = |axis: usize| {
        let socket = folder.path().join(format!("{axis}.sock"));
        PatientMachine::start(&socket, command.clone(), axis * command.len() / AXES)
    };
    let machines: Vec<PatientMachine> = (0..AXES).map(machine).collect();
    thread::sleep(Duration::from_secs(1));
    waits_us(&machines);
    let quiet_delays = delays_until(port, Instant::now() + phase, || {});
    let quiet = waits_us(&machines);
    let before_kb = daemon.memory_kb("RssAnon");

    let (stop, tally) = (AtomicBool::new(false), Tally::default());
    let (mut answers, mut longest, mut most_kb) = (0, Duration::ZERO, 0);
    let hostile_delays = thread::scope(|scope| {
        for number in 0..clients {
            let mut client = Client { port, seed: number as u64, stop: &stop, tally: &tally };
            scope.spawn(move || {
                // At first all of them want a stream, and read none.
                client.do_harm(Harm::Stream);
                while !client.is_over() {
                    let harm = HARMS[client.draw(HARMS.len())];
                    client.do_harm(harm);
                }
            });
        }
        let delays = delays_until(port, Instant::now() + phase, || {
            let begin = Instant::now();
            let is_well = ask(port, "GET", "/api/v1/status", "").is_some_and(|answer| answer.code == 200);
            longest = longest.max(begin.elapsed());
            answers += usize::from(is_well && begin.elapsed() < PATIENCE);
            most_kb = most_kb.max(daemon.memory_kb("RssAnon"));
            if !is_well {
                println!("an honest client was not answered, after {:?}", begin.elapsed());
                longest = longest.max(PATIENCE);
            }
        });
        stop.store(true, Ordering::Relaxed);
        delays
    });
    let hostile = waits_us(&machines);

    let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
    println!(
        "{clients} clients, {} requests, {} streams; {answers} honest answers, the last after {longest:?} at most; {before_kb} kB before, {most_kb} kB at most",
        count(&tally.requests),
        count(&tally.streams)
    );
    for (name, waits, delays) in [("quiet", &quiet, &quiet_delays), ("hostile", &hostile, &hostile_delays)] {
        println!(
            "{name}: samples waited {:.2} ms at most in 99 of 100, {:.2} ms at most; publication of {} cycles after {:?} s in the middle, {:?} s at most",
            at_share(waits, 0.99),
            at_share(waits, 1.0),
            delays.len(),
            delays.get(delays.len() / 2),
            delays.last()
        );
    }
    // Of a hundred samples ninety-nine wait no longer than without the clients, but for what a computer that all of them share costs.
    let (without, with) = (at_share(&quiet, 0.99), at_share(&hostile, 0.99));
    assert!(with < without + MORE_WAIT_MS, "{with} ms, {without} ms without the clients");
    assert_eq!((count(&tally.injections), &*tally.let_through.lock().unwrap()), (0, &Vec::new()));
    assert!(longest < PATIENCE && answers > 0, "{longest:?}\n{}", daemon.words());
    assert!(most_kb < before_kb + GROWTH_KB, "{most_kb} kB, {before_kb} kB before");
    for (axis, machine) in machines.into_iter().enumerate() {
        let sent = machine.stop();
        let source = || json(port, &format!("/api/v1/axes/{axis}"))["source"].clone();
        until("all samples", SOON, || source()["samples"].as_u64() >= Some(sent));
        assert_eq!(source()["samples"].as_u64(), Some(sent));
    }
}
