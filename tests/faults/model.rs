//! A model of the daemon in fifty lines, and random sequences of cycles, kills, restarts, reloads, acknowledgements and brokers that come
//! and go: whatever the real program tells, by its events at a real broker and by its status, is what the model says.
//!
//! An event once numbered reaches the broker, or none behind it of the same run does: a kill may cost the last ones, and never one
//! in between. What the daemon knows after a kill is what it knew after some cycle that it has told of: no alarm is lost or invented.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Write;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::Duration;

use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use seepd_logs::LogMapping;
use seepd_monitor::event::Flag;
use seepd_signals::Signal;
use serde_json::Value;

use super::sequences;
use crate::daemon::{Daemon, Listener, Mosquitto, ask_with, axis_status, has, json, sink, until};
use crate::support::simulate;

const SOON: Duration = Duration::from_secs(30);
/// Leak areas that give each flag, m².
const LEAKS_M2: [&str; 4] = ["0", "8e-8", "3e-7", "1e-6"];
/// Thresholds of watch, leak and severe as they stand by default, L/min, and the share below which they clear.
const THRESHOLDS_LPM: [f64; 3] = [0.3, 0.6, 3.0];
const CLEAR_SHARE: f64 = 0.8;
const FLAGS: [Flag; 4] = [Flag::Healthy, Flag::Watch, Flag::Leak, Flag::Severe];
const RAISE_CYCLES: usize = 2;
const CLEAR_CYCLES: usize = 2;
const LOST_CYCLES: u32 = 3;
/// Samples of a cycle, and those that a source may keep back before they make a batch.
const CYCLE: u64 = 10_000;
const BATCH: u64 = 256;

/// What happens to the daemon.
#[derive(Debug, Clone)]
enum Fault {
    Cycles {
        count: u64,
        leak: usize,
    },
    KillAmidCycles {
        leak: usize,
        after_ms: u64,
    },
    Kill,
    Restart,
    Acknowledge,
    /// A recording begins or ends, or the broker is spoken to in the other version, while cycles come; the axis goes on.
    Reload {
        records: bool,
        version: usize,
        leak: usize,
    },
    BrokenReload(usize),
    BrokerGoes,
    BrokerComes,
}

fn faults() -> impl Strategy<Value = Vec<Fault>> {
    let fault = prop_oneof![
        5 => (1..5_u64, 0..LEAKS_M2.len()).prop_map(|(count, leak)| Fault::Cycles { count, leak }),
        3 => (0..LEAKS_M2.len(), 0..400_u64).prop_map(|(leak, after_ms)| Fault::KillAmidCycles { leak, after_ms }),
        1 => Just(Fault::Kill),
        1 => Just(Fault::Restart),
        2 => Just(Fault::Acknowledge),
        2 => (any::<bool>(), 0..VERSIONS.len(), 0..LEAKS_M2.len())
            .prop_map(|(records, version, leak)| Fault::Reload { records, version, leak }),
        1 => (0..BROKEN.len()).prop_map(Fault::BrokenReload),
        1 => Just(Fault::BrokerGoes),
        1 => Just(Fault::BrokerComes),
    ];
    prop::collection::vec(fault, 4..14)
}

const VERSIONS: [&str; 2] = ["3.1.1", "5"];

/// Configurations that must not come into force.
const BROKEN: [&str; 5] = [
    "spring = 3\n",
    "[[axes]]\n",
    "[recording]\nfile_mb = -1.0\n[",
    "[influx]\nudp = \"nowhere\"\n",
    // A pipe cannot be read from its beginning again.
    "[energy]\nprice_per_kwh = 0.3\n",
];

/// What the daemon must know after each of its events.
#[derive(Debug, Clone, Default, PartialEq)]
struct Expected {
    /// Index of the leak's level among the flags.
    level: usize,
    is_estimated: bool,
    flows_lpm: Vec<f64>,
    rejected: u32,
    latched: usize,
    acknowledged: bool,
}

impl Expected {
    fn flag(&self) -> Flag {
        if self.is_estimated { FLAGS[self.level] } else { Flag::NoEstimate }
    }

    /// Estimates in a row, counted from the last, of which something holds.
    fn row(&self, holds: impl Fn(f64) -> bool) -> usize {
        self.flows_lpm.iter().rev().take_while(|flow| holds(**flow)).count()
    }

    fn take_cycle(&mut self, flow_lpm: Option<f64>) {
        let Some(flow_lpm) = flow_lpm else {
            self.rejected += 1;
            self.is_estimated &= self.rejected < LOST_CYCLES;
            return;
        };
        self.rejected = 0;
        self.flows_lpm.push(flow_lpm);
        let is_above = |level: usize| self.row(|flow| flow >= THRESHOLDS_LPM[level - 1]) >= RAISE_CYCLES;
        let is_below =
            |level: usize| self.row(|flow| flow < CLEAR_SHARE * THRESHOLDS_LPM[level - 1]) >= CLEAR_CYCLES;
        self.level = match (self.level + 1..=3).rev().find(|level| is_above(*level)) {
            Some(raised) => raised,
            None => (1..=self.level).find(|level| is_below(*level)).map_or(self.level, |cleared| cleared - 1),
        };
        self.is_estimated |= self.level > 0 || flow_lpm < THRESHOLDS_LPM[0];
        self.latch();
    }

    fn latch(&mut self) {
        if self.level > self.latched {
            (self.latched, self.acknowledged) = (self.level, false);
        } else if self.acknowledged {
            self.latched = self.level;
            self.acknowledged = self.latched > 0;
        }
    }

    fn acknowledge(&mut self) {
        self.acknowledged = self.latched > 0;
        self.latch();
    }

    /// As the status tells it.
    fn status(&self) -> Known {
        Known {
            flag: self.flag(),
            level: FLAGS[self.level],
            latched: (self.latched > 0).then(|| FLAGS[self.latched]),
            acknowledged: self.acknowledged,
        }
    }
}

/// Cycles that a status knows of, usable and not.
fn cycles_told(status: &Value) -> u64 {
    let rejected = status["rejected"].as_object().unwrap().values().map(|count| count.as_u64().unwrap());
    status["cycles"].as_u64().unwrap() + rejected.sum::<u64>()
}

/// What the status tells of the alarm.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Known {
    flag: Flag,
    level: Flag,
    latched: Option<Flag>,
    acknowledged: bool,
}

impl Known {
    fn of(status: &Value) -> Self {
        let flag = |name: &str| serde_json::from_value(status[name].clone()).unwrap();
        Known {
            flag: flag("flag"),
            level: flag("level"),
            latched: serde_json::from_value(status["latched"].clone()).unwrap(),
            acknowledged: status["acknowledged"].as_bool().unwrap(),
        }
    }
}

/// A run of the daemon, from its start to its end.
struct Run {
    daemon: Option<Daemon>,
    pipe: File,
    /// Samples sent.
    sent: u64,
    /// What it knew at its start.
    at_start: Known,
    /// What it knew when everything was worked through, with the cycles told of by then.
    seen: Vec<(u64, Known)>,
    /// The beginning of its events' names.
    name: String,
    was_killed: bool,
}

/// The daemon, its machine, and its broker.
struct Plant {
    folder: tempfile::TempDir,
    commands: Vec<Vec<String>>,
    http_port: u16,
    broker_port: u16,
    broker: Option<(Mosquitto, Listener)>,
    records: bool,
    version: usize,
    runs: Vec<Run>,
    /// Samples sent by all runs.
    time_ms: u64,
}

impl Plant {
    fn new(commands: Vec<Vec<String>>, ports: &mut Ports) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut plant = Plant {
            folder,
            commands,
            http_port: ports.next(),
            broker_port: ports.next(),
            broker: None,
            records: false,
            version: 0,
            runs: Vec::new(),
            time_ms: 0,
        };
        plant.start();
        plant
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn config(&self) -> String {
        format!(
            "axis = \"press-1\"\nstate_dir = \"state\"\n[source]\nlog = \"commands.csv\"\npace = \"fast\"\nstale_after_s = 3600.0\n\
             [alarm]\nraise_cycles = {RAISE_CYCLES}\nclear_cycles = {CLEAR_CYCLES}\nlost_cycles = {LOST_CYCLES}\n\
             [http]\nlisten = \"127.0.0.1:{}\"\n[mqtt]\nhost = \"127.0.0.1\"\nport = {}\nversion = \"{}\"\n{}",
            self.http_port,
            self.broker_port,
            VERSIONS[self.version],
            if self.records { "[recording]\n" } else { "" }
        )
    }

    fn open_pipe(&self) -> File {
        let mut pipe = fs::OpenOptions::new().write(true).open(self.path("commands.csv")).unwrap();
        pipe.write_all(b"t_s,command\n").unwrap();
        pipe
    }

    fn start(&mut self) {
        // What a killed run has left unread in the pipe goes with it.
        let pipe = self.path("commands.csv");
        let _ = fs::remove_file(&pipe);
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let daemon = Daemon::start(self.folder.path(), &self.config());
        let pipe = self.open_pipe();
        until("the daemon's page", SOON, || {
            axis_status(self.http_port).is_some_and(|status| status["axis"].is_string())
        });
        let status = json(self.http_port, "/api/v1/status");
        self.runs.push(Run {
            daemon: Some(daemon),
            pipe,
            sent: 0,
            at_start: Known::of(&status["axes"][0]),
            seen: Vec::new(),
            name: status["run"].as_str().unwrap().to_owned(),
            was_killed: false,
        });
    }

    fn run(&mut self) -> &mut Run {
        self.runs.last_mut().unwrap()
    }

    /// Sends so many samples of a machine with a leak, which goes on where it was; whether the daemon took them.
    fn send(&mut self, samples: u64, leak: usize) -> bool {
        let mut text = String::with_capacity(samples as usize * 24);
        for _ in 0..samples {
            let command = &self.commands[leak][(self.time_ms % self.commands[leak].len() as u64) as usize];
            text += &format!("{}.{:03},{command}\n", self.time_ms / 1000, self.time_ms % 1000);
            self.time_ms += 1;
        }
        let run = self.run();
        run.sent += samples;
        run.pipe.write_all(text.as_bytes()).is_ok()
    }

    /// Waits until the daemon has worked through all that was sent, and notes what it knows.
    fn settle(&mut self) {
        let (port, sent) = (self.http_port, self.run().sent);
        let mut status = Value::Null;
        until("all samples", SOON, || {
            status = axis_status(port).unwrap();
            status["source"]["samples"].as_u64().unwrap() + BATCH >= sent
        });
        // The counts are told some times a second; the cycle that the last samples ended, at once.
        thread::sleep(Duration::from_millis(250));
        let status = axis_status(port).unwrap();
        // A disk that others keep busy takes its time; what a kill then costs is no fault of the daemon's.
        until("the state on disk", SOON, || self.is_on_disk(&status));
        let run = self.run();
        run.seen.push((cycles_told(&status), Known::of(&status)));
    }

    /// Whether the state's file says what a status does.
    fn is_on_disk(&self, status: &Value) -> bool {
        let text = fs::read_to_string(self.path("state/state.json")).unwrap_or_default();
        let state: Value = serde_json::from_str(&text).unwrap_or_default();
        let (kept, latch) = (&state["axes"]["press-1"], &state["axes"]["press-1"]["latch"]);
        cycles_told(status) == 0
            || kept["alarm"]["level"] == status["level"]
                && kept["alarm"]["estimated"] == (status["flag"] != "no_estimate")
                && latch["latched"] == status["latched"]
                && latch["acknowledged"] == status["acknowledged"]
                && kept["estimate"]["leak_area_m2"] == status["leak_area_m2"]
    }

    fn kill(&mut self) {
        let run = self.run();
        run.was_killed = true;
        run.daemon.take().unwrap().child.kill().unwrap();
    }

    fn meet(&mut self, fault: &Fault) {
        match *fault {
            Fault::Cycles { count, leak } => {
                assert!(self.send(count * CYCLE, leak));
                self.settle();
            }
            Fault::KillAmidCycles { leak, after_ms } => {
                let daemon = self.run().daemon.take().unwrap();
                let assassin = thread::spawn(move || {
                    thread::sleep(Duration::from_millis(after_ms));
                    drop(daemon);
                });
                // Whether it takes all of them or dies before is its own affair.
                let _ = self.send(4 * CYCLE, leak);
                assassin.join().unwrap();
                self.run().was_killed = true;
                self.start();
            }
            Fault::Kill => {
                self.kill();
                self.start();
            }
            Fault::Restart => {
                let daemon = self.run().daemon.take().unwrap();
                assert!(daemon.terminate().0.success());
                self.start();
            }
            Fault::Acknowledge => {
                let answer = ask_with(
                    self.http_port,
                    "POST",
                    "/api/v1/axes/press-1/acknowledge",
                    "",
                    "{\"who\":\"me\"}",
                );
                assert!(
                    answer
                        .is_some_and(|answer| answer.code == 204 || answer.code == 202 || answer.code == 200)
                );
                thread::sleep(Duration::from_millis(100));
                self.settle();
            }
            Fault::Reload { records, version, leak } => {
                (self.records, self.version) = (records, version);
                assert!(self.send(2 * CYCLE, leak));
                self.reload(&self.config(), "the changed configuration is in force");
                self.settle();
            }
            Fault::BrokenReload(which) => {
                let broken = self.config();
                let broken = match BROKEN[which] {
                    key if key.starts_with('[') => broken + key,
                    key => key.to_owned() + &broken,
                };
                self.reload(&broken, "the old configuration stays in force");
                fs::write(self.path("seepd.toml"), self.config()).unwrap();
            }
            Fault::BrokerGoes => {
                if let Some((broker, _listener)) = self.broker.take() {
                    broker.end();
                }
            }
            Fault::BrokerComes => self.need_broker(),
        }
    }

    /// Reloads a configuration, and waits for what the daemon says of it.
    fn reload(&mut self, config: &str, says: &str) {
        fs::write(self.path("seepd.toml"), config).unwrap();
        let daemon = self.run().daemon.as_ref().unwrap();
        let said = daemon.words().matches(says).count();
        daemon.signal("HUP");
        until(says, SOON, || daemon.words().matches(says).count() > said);
    }

    fn need_broker(&mut self) {
        if self.broker.is_some() {
            return;
        }
        let persistence = format!(
            "allow_anonymous true\npersistence true\npersistence_location {}/\n",
            self.folder.path().display()
        );
        let broker = Mosquitto::start(self.folder.path(), self.broker_port, &persistence);
        let listener = broker.listen(&self.path("heard.txt"), &["-c", "-i", "listener"]);
        self.broker = Some((broker, listener));
    }

    /// Every event that the broker was told, once each, by run and number; that repeats say the same is seen here.
    fn delivered(&mut self) -> BTreeMap<String, Vec<Value>> {
        self.need_broker();
        let port = self.http_port;
        until("an empty spool", Duration::from_secs(60), || {
            let mqtt = sink(port, "mqtt");
            assert_eq!(mqtt["dropped"], 0, "{mqtt}");
            mqtt["waiting"] == 0
        });
        thread::sleep(Duration::from_millis(500));
        let text = fs::read_to_string(self.path("heard.txt")).unwrap();
        let mut runs: BTreeMap<String, BTreeMap<u64, Value>> = BTreeMap::new();
        for line in text.lines() {
            let Some((topic, message)) = line.split_once(' ') else { continue };
            if topic.ends_with("/status") {
                continue;
            }
            let event: Value = serde_json::from_str(message).unwrap();
            let (run, number) = event["id"].as_str().unwrap().rsplit_once('-').unwrap();
            let of_run = runs.entry(run.to_owned()).or_default();
            let number = number.parse().unwrap();
            // The first time an event is heard none behind it has been heard.
            match of_run.get(&number) {
                Some(before) => assert_eq!(*before, event, "a repeat that says something else"),
                None => {
                    assert!(of_run.keys().all(|earlier| *earlier < number), "out of order: {event}");
                    of_run.insert(number, event);
                }
            }
        }
        runs.into_iter()
            .map(|(run, events)| {
                let numbers: Vec<u64> = events.keys().copied().collect();
                assert!(
                    numbers.windows(2).all(|pair| pair[1] == pair[0] + 1),
                    "{run}: events are missing: {numbers:?}"
                );
                (run, events.into_values().collect())
            })
            .collect()
    }

    /// Holds what each run told against the model, which begins with what the run before may have left.
    fn judge(&mut self) {
        let delivered = self.delivered();
        let mut may_be = vec![Expected::default()];
        for run in &self.runs {
            let empty = Vec::new();
            let events = delivered.get(&run.name).unwrap_or(&empty);
            let beginnings: Vec<&Expected> =
                may_be.iter().filter(|begin| begin.status() == run.at_start).collect();
            assert!(
                !beginnings.is_empty(),
                "run {} begins with {:?}, which no cycle before has left: {may_be:?}",
                run.name,
                run.at_start
            );
            let walked: Vec<Result<Vec<(u64, Expected)>, String>> =
                beginnings.into_iter().map(|begin| run.walk(begin, events)).collect();
            let log = fs::read_to_string(self.path("daemon.log")).unwrap();
            assert!(walked.iter().any(Result::is_ok), "run {}: {walked:?}\n{log}", run.name);
            // A kill costs at most a cycle before all was worked through, and what is left was told of.
            let settled = run.seen.last().map_or(0, |(cycles, _)| cycles.saturating_sub(1));
            let left = |states: Vec<(u64, Expected)>| {
                // A disk that is behind costs the events, too, by which the state would have come to be.
                let last = states.last().unwrap().0;
                let oldest = if run.was_killed { settled.min(last) } else { last };
                states.into_iter().filter(move |(cycles, _)| *cycles >= oldest).map(|(_, state)| state)
            };
            may_be = walked.into_iter().flatten().flat_map(left).collect();
        }
    }
}

impl Run {
    /// The model's states before and after each cycle of a run; an error where the run told something else.
    fn walk(&self, begin: &Expected, events: &[Value]) -> Result<Vec<(u64, Expected)>, String> {
        let mut states = vec![(0, begin.clone())];
        let (mut now, mut cycles) = (begin.clone(), 0);
        let mut told = begin.flag();
        for event in events {
            match event["schema"].as_str().unwrap() {
                "seepd.cycle/1" => {
                    if told != now.flag() {
                        return Err(format!("no flag {:?} before {event}", now.flag()));
                    }
                    cycles += 1;
                    now.take_cycle(event["leak_flow_lpm"].as_f64());
                    states.push((cycles, now.clone()));
                }
                "seepd.event/1" => {
                    let flag = |key: &str| serde_json::from_value::<Flag>(event[key].clone()).unwrap();
                    if flag("flag_from") != told || flag("flag_to") != now.flag() {
                        return Err(format!("{told:?} to {:?} expected: {event}", now.flag()));
                    }
                    told = flag("flag_to");
                }
                "seepd.acknowledged/1" => {
                    now.acknowledge();
                    states.push((cycles, now.clone()));
                }
                other => return Err(format!("{other}: {event}")),
            }
        }
        for (cycle, known) in &self.seen {
            // The last events before a kill may not have been on disk yet; what the next run begins with tells whether they were.
            let is_lost = self.was_killed && *cycle >= cycles;
            if !is_lost && !states.iter().any(|(told, state)| told == cycle && state.status() == *known) {
                return Err(format!("after {cycle} cycles it knew {known:?}: {states:?}"));
            }
        }
        Ok(states)
    }
}

/// The command of a machine with each leak as text, some cycles.
fn commands(folder: &Path) -> Vec<Vec<String>> {
    let command = |(index, leak): (usize, &&str)| {
        let log = folder.join(format!("{index}.mcap"));
        simulate(
            &log,
            &["--cycles", "6", "--command-only", "--leak-area", leak, "--seed", &index.to_string()],
        );
        let mut source = seepd_logs::open(&log, &LogMapping::default()).unwrap();
        let mut command = Vec::new();
        while let Some(sample) = source.next_sample().unwrap() {
            command.push(sample.get(Signal::Command).unwrap().to_string());
        }
        assert_eq!(command.len() as u64, 6 * CYCLE);
        command
    };
    LEAKS_M2.iter().enumerate().map(command).collect()
}

/// `SEEPD_SEQUENCES=300 cargo test --workspace --test gateway faults::model -- --nocapture` for a long run.
#[test]
fn what_the_daemon_tells_under_random_faults_is_what_the_model_says() {
    if !has("mosquitto") || !has("mosquitto_sub") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let commands = commands(folder.path());
    let cases = sequences(6);
    // Most of a sequence is waiting, so that a long run goes on in four places; the first draws what a short run does.
    let places = if cases > 50 { 4 } else { 1 };
    let kills = thread::scope(|scope| {
        let at_work: Vec<_> = (0..places)
            .map(|place| {
                let commands = &commands;
                scope.spawn(move || run_sequences(cases.div_ceil(places), place as u8, commands))
            })
            .collect();
        at_work.into_iter().map(|place| place.join().unwrap()).sum::<usize>()
    });
    println!("{cases} sequences, {kills} kills");
    assert!(kills > cases as usize / 2, "{kills}");
}

/// Ports that are kept for one place of a run: a broker that is away would find its own taken by somebody else's connection, as the
/// system gives those out of the range in which it finds free ones.
struct Ports {
    first: u16,
    given: u16,
}

impl Ports {
    const OF_PLACE: u16 = 500;

    fn of_place(place: u8) -> Self {
        let of_process = std::process::id() as u16 % 8;
        Ports { first: 12_000 + (of_process * 4 + u16::from(place)) * Self::OF_PLACE, given: 0 }
    }

    fn next(&mut self) -> u16 {
        loop {
            self.given = (self.given + 1) % Self::OF_PLACE;
            let port = self.first + self.given;
            if TcpListener::bind(("127.0.0.1", port)).is_ok() {
                return port;
            }
        }
    }
}

/// Tries so many sequences that a seed draws; gives the kills among them.
fn run_sequences(cases: u32, seed: u8, commands: &[Vec<String>]) -> usize {
    let config = Config { cases, max_shrink_iters: 40, failure_persistence: None, ..Config::default() };
    let rng = match seed {
        0 => TestRng::deterministic_rng(RngAlgorithm::ChaCha),
        other => TestRng::from_seed(RngAlgorithm::ChaCha, &[other; 32]),
    };
    let (kills, ports) = (Cell::new(0), RefCell::new(Ports::of_place(seed)));
    let outcome = TestRunner::new_with_rng(config, rng).run(&faults(), |faults| {
        let mut plant = Plant::new(commands.to_vec(), &mut ports.borrow_mut());
        faults.iter().for_each(|fault| plant.meet(fault));
        plant.judge();
        kills.set(kills.get() + plant.runs.iter().filter(|run| run.was_killed).count());
        Ok(())
    });
    outcome.unwrap_or_else(|error| panic!("{error}"));
    kills.get()
}
