//! Reloads drawn at random, half of them of configurations that must not come into force, while a machine sends its command a thousand times
//! a second: no sample is lost, each reload is answered in one line, what is in force is what was last good, and nothing leaks.
//!
//! One axis stays in every configuration, and is the machine's; others come, change, are renamed and go.

use std::cell::Cell;
use std::collections::BTreeSet;
use std::fs;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use serde_json::Value;

use super::patient::PatientMachine;
use super::sequences;
use crate::daemon::{Daemon, axis_toml, cycle, free_port, json, log_axis_toml, until};

const SOON: Duration = Duration::from_secs(20);
/// The machine's axis, and those that come and go.
const PRESS: &str = "press-1";
const OTHERS: [&str; 4] = ["clamp", "ejector 2", "Stößel", "zz.top"];
/// So many reloads are between two looks at what the process holds.
const LOOK_EVERY: usize = 20;
/// Growth of its own memory that is no leak, kB: what an allocator keeps.
const GROWTH_KB: u64 = 4 << 10;

/// What another axis is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Other {
    Absent,
    /// A bus that is not there.
    NoBus {
        raise_cycles: u32,
    },
    /// A socket that nobody sends to.
    Silent,
    /// A log that is read as fast as can be, and ends.
    Log,
    /// Without a model.
    Relative,
}

/// A configuration that is good.
#[derive(Debug, Clone, PartialEq)]
struct Good {
    others: [Other; OTHERS.len()],
    records: bool,
    has_broker: bool,
    has_influx: bool,
    has_panel: bool,
    has_token: bool,
}

/// What is wrong with one that is not.
#[derive(Debug, Clone)]
enum Broken {
    /// Cut within a table, at a share of its length.
    Cut(f64),
    /// Bytes that no text has.
    Bytes(u8),
    Text(&'static str),
    /// Something before the rest, or behind it.
    Before(&'static str),
    Behind(&'static str),
    NotThere,
    Folder,
    Fifo,
}

#[derive(Debug, Clone)]
enum Reload {
    Good(Good),
    Broken(Good, Broken),
}

/// What may not stand before a good configuration, nor behind one.
const BEFORE: [&str; 9] = [
    "spring = 3\n",
    "axis = \"one at the top\"\n",
    "state_dir = \"another\"\n",
    "= 3\n",
    "[[axes]\n",
    "\u{0}\n",
    "axis = \"a/b\"\n",
    "state_dir = \"state\"\nstate_dir = \"state\"\n",
    "alarm = 7\n",
];
const BEHIND: [&str; 14] = [
    "[[axes]]\naxis = \"press-1\"\n[axes.source]\ncan = \"can7\"\n",
    "[[axes]]\naxis = \"x\"\n",
    "[[axes]]\naxis = \"x\"\nmodel = \"missing.json\"\n[axes.source]\nlog = \"short.csv\"\n",
    "[[axes]]\naxis = \"x\"\ndbc = \"missing.dbc\"\n[axes.source]\ncan = \"can7\"\n[axes.signals.command]\nsignal = \"a\"\n",
    "[[axes]]\naxis = \"x\"\n[axes.source]\nlog = \"missing.csv\"\n",
    "[[axes]]\naxis = \"x\"\nreference_dp_pa = -1.0\n[axes.source]\nlog = \"short.csv\"\n",
    "[[axes]]\naxis = \"x\"\n[axes.alarm]\nraise_cycles = 0\n[axes.source]\nlog = \"short.csv\"\n",
    "[[axes]]\naxis = \"\\u001b[2J\"\n[axes.source]\nlog = \"short.csv\"\n",
    "[opentelemetry]\ntoken_file = \"missing\"\n",
    "[foxglove]\nlisten = \"0.0.0.0:8765\"\n",
    "[sparkplug]\nnode = \"a\"\n",
    "[[j1939]]\ninterface = \"can0\"\naddress = 254\n",
    "[unheard_of]\n",
    "[[can_out]]\ninterface = \"can0\"\nlength = 9\n",
];
const TEXTS: [&str; 5] = ["", "\n", "{\"axis\": 1}", "axis = 1\n", "[axes]\n"];

fn goods() -> impl Strategy<Value = Good> {
    let other = prop_oneof![
        3 => Just(Other::Absent),
        2 => (1..4_u32).prop_map(|raise_cycles| Other::NoBus { raise_cycles }),
        2 => Just(Other::Silent),
        1 => Just(Other::Log),
        1 => Just(Other::Relative),
    ];
    let others = prop::array::uniform4(other);
    (others, any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>()).prop_map(
        |(others, records, has_broker, has_influx, has_panel, has_token)| Good {
            others,
            records,
            has_broker,
            has_influx,
            has_panel,
            has_token,
        },
    )
}

fn reloads() -> impl Strategy<Value = Reload> {
    let broken = prop_oneof![
        2 => (0.0..1.0_f64).prop_map(Broken::Cut),
        1 => (0x80..=0xff_u8).prop_map(Broken::Bytes),
        1 => prop::sample::select(&TEXTS[..]).prop_map(Broken::Text),
        3 => prop::sample::select(&BEFORE[..]).prop_map(Broken::Before),
        5 => prop::sample::select(&BEHIND[..]).prop_map(Broken::Behind),
        1 => Just(Broken::NotThere),
        1 => Just(Broken::Folder),
        1 => Just(Broken::Fifo),
    ];
    prop_oneof![
        goods().prop_map(Reload::Good),
        (goods(), broken).prop_map(|(good, broken)| Reload::Broken(good, broken)),
    ]
}

/// The least that there may be: what a process holds is compared at it.
const BARE: Good = Good {
    others: [Other::Absent; OTHERS.len()],
    records: false,
    has_broker: false,
    has_influx: false,
    has_panel: false,
    has_token: false,
};

impl Good {
    fn axes(&self) -> BTreeSet<String> {
        let others = OTHERS.iter().zip(&self.others).filter(|(_, other)| **other != Other::Absent);
        others.map(|(name, _)| *name).chain([PRESS]).map(str::to_owned).collect()
    }

    fn sinks(&self) -> BTreeSet<String> {
        let named = [
            (true, "http"),
            (true, "state"),
            (self.records, "recording"),
            (self.has_broker, "mqtt"),
            (self.has_influx, "influx"),
        ];
        named.into_iter().filter(|(is_there, _)| *is_there).map(|(_, name)| name.to_owned()).collect()
    }
}

/// What a process holds.
#[derive(Debug, Clone, Copy)]
struct Held {
    descriptors: usize,
    threads: usize,
    anonymous_kb: u64,
}

impl Held {
    fn by(daemon: &Daemon) -> Self {
        let count = |what: &str| fs::read_dir(format!("/proc/{}/{what}", daemon.child.id())).unwrap().count();
        Held { descriptors: count("fd"), threads: count("task"), anonymous_kb: daemon.memory_kb("RssAnon") }
    }
}

struct Bench {
    folder: tempfile::TempDir,
    http_port: u16,
    /// Where nobody listens.
    dead_port: u16,
    _panel: UnixDatagram,
    daemon: Daemon,
    in_force: Good,
    answered: usize,
}

impl Bench {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let text: String = (0..2000).map(|ms| format!("{}.{:03},0.1\n", ms / 1000, ms % 1000)).collect();
        fs::write(folder.path().join("short.csv"), format!("t_s,command\n{text}")).unwrap();
        fs::write(folder.path().join("token"), "0123456789abcdef").unwrap();
        let panel = UnixDatagram::bind(folder.path().join("panel.sock")).unwrap();
        let (http_port, dead_port) = (free_port(), free_port());
        let config = config(folder.path(), http_port, dead_port, &BARE);
        let daemon = Daemon::start_with_one_heap(folder.path(), &config);
        let bench =
            Bench { folder, http_port, dead_port, _panel: panel, daemon, in_force: BARE, answered: 0 };
        until("a page", SOON, || crate::daemon::axis_status(http_port).is_some());
        bench
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("seepd.toml")
    }

    fn text(&self, good: &Good) -> String {
        config(self.folder.path(), self.http_port, self.dead_port, good)
    }

    /// Puts something in the place of the configuration.
    fn put(&self, reload: &Reload) {
        let path = self.path();
        let _ = fs::remove_file(&path);
        let _ = fs::remove_dir(&path);
        let (good, broken) = match reload {
            Reload::Good(good) => return fs::write(path, self.text(good)).unwrap(),
            Reload::Broken(good, broken) => (self.text(good), broken),
        };
        let bytes = match broken {
            // Within the first line's text, so that what is left is never a configuration.
            Broken::Cut(share) => good.as_bytes()[..1 + (share * 15.0) as usize].to_vec(),
            Broken::Bytes(byte) => [good.as_bytes(), &[*byte, b'\n']].concat(),
            Broken::Text(text) => text.as_bytes().to_vec(),
            Broken::Before(text) => format!("{text}{good}").into_bytes(),
            Broken::Behind(text) => format!("{good}{text}").into_bytes(),
            Broken::NotThere => return,
            Broken::Folder => return fs::create_dir(path).unwrap(),
            Broken::Fifo => return nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).unwrap(),
        };
        fs::write(path, bytes).unwrap();
    }

    /// Lines that answer reloads: those that say that the new configuration is in force, and those that say the old one is.
    fn answers(&self) -> (usize, usize) {
        let words = self.daemon.words();
        let count = |what: &str| words.lines().filter(|line| line.contains(what)).count();
        (count("the changed configuration is in force"), count("the old configuration stays in force"))
    }

    fn reload(&mut self, reload: &Reload) {
        self.put(reload);
        let before = self.answers();
        self.daemon.signal("HUP");
        until("an answer", SOON, || self.answers() != before);
        let expected = match reload {
            Reload::Good(good) => {
                self.in_force = good.clone();
                (before.0 + 1, before.1)
            }
            Reload::Broken(..) => (before.0, before.1 + 1),
        };
        assert_eq!(self.answers(), expected, "{reload:?}\n{}", self.daemon.words());
        self.answered += 1;
        self.check(reload);
    }

    /// What is in force is what was last good.
    fn check(&self, reload: &Reload) {
        let header = "Authorization: Bearer 0123456789abcdef\r\n";
        let mut status = Value::Null;
        // The page itself may have been closed and opened.
        until("the page", SOON, || {
            let answer = crate::daemon::ask(self.http_port, "GET", "/api/v1/status", header);
            status =
                answer.filter(|answer| answer.code == 200).map(|answer| answer.json()).unwrap_or_default();
            status["axes"].is_array()
        });
        let names = |what: &str, key: &str| -> BTreeSet<String> {
            let all = status[what].as_array().unwrap().iter();
            all.map(|one| one[key].as_str().unwrap().to_owned()).collect()
        };
        assert_eq!(names("axes", "axis"), self.in_force.axes(), "{reload:?}\n{}", self.daemon.words());
        // Those that are called by more than their kind are left out.
        let mut sinks = names("sinks", "name");
        sinks.retain(|name| !name.starts_with("can"));
        sinks.insert("state".into());
        assert_eq!(sinks, self.in_force.sinks(), "{reload:?}\n{}", self.daemon.words());
        let code = crate::daemon::ask(self.http_port, "GET", "/api/v1/status", "").map(|answer| answer.code);
        assert_eq!(code, Some(if self.in_force.has_token { 401 } else { 200 }), "{reload:?}");
    }

    /// What it holds at the least configuration, once what has ended is gone; threads of the runtime's pool go after ten idle seconds.
    fn held(&mut self) -> Held {
        self.reload(&Reload::Good(BARE));
        thread::sleep(Duration::from_millis(300));
        Held::by(&self.daemon)
    }
}

fn config(folder: &Path, http_port: u16, dead_port: u16, good: &Good) -> String {
    let mut text = format!("state_dir = \"state\"\n{}", axis_toml(PRESS, &folder.join("in.sock")));
    for (name, other) in OTHERS.iter().zip(&good.others) {
        let bits = "[axes.signals.command]\nbits = { id = 1, start = 0, length = 16 }\n";
        text += &match other {
            Other::Absent => String::new(),
            Other::NoBus { raise_cycles } => format!(
                "[[axes]]\naxis = \"{name}\"\n[axes.alarm]\nraise_cycles = {raise_cycles}\n[axes.source]\ncan = \"can77\"\n{bits}"
            ),
            Other::Silent => axis_toml(name, &folder.join(format!("{name}.sock"))),
            Other::Log => log_axis_toml(name, &folder.join("short.csv")),
            Other::Relative => format!(
                "[[axes]]\naxis = \"{name}\"\n[axes.monitor]\nkind = \"relative\"\n[axes.source]\ncan = \"can77\"\n{bits}"
            ),
        };
    }
    text += &format!("[http]\nlisten = \"127.0.0.1:{http_port}\"\n");
    let token = "token_file = \"token\"\n".to_owned();
    let tables = [
        (good.has_token, token),
        (good.records, "[recording]\n".into()),
        (good.has_broker, format!("[mqtt]\nhost = \"127.0.0.1\"\nport = {dead_port}\n")),
        (good.has_influx, format!("[influx]\nudp = \"127.0.0.1:{dead_port}\"\n")),
        (
            good.has_panel,
            format!(
                "[[can_out]]\naxis = \"{PRESS}\"\ninterface = \"unix:{}\"\n",
                folder.join("panel.sock").display()
            ),
        ),
    ];
    tables.into_iter().filter(|(is_there, _)| *is_there).for_each(|(_, table)| text += &table);
    text
}

/// `SEEPD_SEQUENCES=1000 cargo test --workspace --test gateway faults::reloads -- --nocapture` for a long run.
#[test]
fn reloads_under_load_lose_no_sample_and_leak_nothing() {
    let count = sequences(40) as usize;
    let mut runner =
        TestRunner::new_with_rng(Config::default(), TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    let mut bench = Bench::start();
    let machine =
        PatientMachine::start(&bench.folder.path().join("in.sock"), cycle("nominal_leak_1e-6.csv"), 0);
    let broken = Cell::new(0);
    // Memory is filled once before it is compared: pools, rings and caches.
    let mut looks = vec![bench.held()];
    for number in 1..=count {
        let reload = reloads().new_tree(&mut runner).unwrap().current();
        broken.set(broken.get() + usize::from(matches!(reload, Reload::Broken(..))));
        bench.reload(&reload);
        if number.is_multiple_of(LOOK_EVERY) {
            looks.push(bench.held());
        }
    }
    let longest_wait_us = machine.waits_us().into_iter().max().unwrap();
    let sent = machine.stop();
    let status =
        |key: &str| json(bench.http_port, "/api/v1/axes/press-1")["source"][key].as_u64().unwrap_or_default();
    until("the last sample", SOON, || status("samples") >= sent);
    let lost = (status("missing_by_counter"), status("dropped_in_socket"), status("reopened"));
    assert_eq!((status("samples"), lost), (sent, (0, 0, 0)), "{}", bench.daemon.words());
    println!(
        "{} reloads, {} of them broken; {sent} samples, none lost; the longest wait of the machine {:.1} ms; {:?} at first, {:?} at last; memory of its own after each tenth, kB: {:?}",
        bench.answered,
        broken.get(),
        f64::from(longest_wait_us) / 1000.0,
        looks[0],
        looks.last().unwrap(),
        looks.iter().step_by(looks.len().div_ceil(10)).map(|held| held.anonymous_kb).collect::<Vec<_>>()
    );
    let (first, last) = (looks[0], *looks.last().unwrap());
    // Ten idle seconds end the threads that wrote the state: of these a run may have one more or less.
    let pool = 4;
    assert!(last.descriptors <= first.descriptors, "{looks:?}");
    assert!(last.threads <= first.threads + pool, "{looks:?}");
    // The first tenth fills what is kept; from then on it is flat.
    let filled = looks[looks.len().div_ceil(10).min(looks.len() - 1)];
    assert!(last.anonymous_kb <= filled.anonymous_kb + GROWTH_KB, "{looks:?}");
}
