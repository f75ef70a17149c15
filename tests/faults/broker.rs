//! Connections to the broker that are cut, halved, delayed, repeated, answered falsely or not at all, in sequences drawn at random: every
//! event arrives all the same, in its order, and a repeat carries the name of the first.

use std::collections::VecDeque;
use std::fs;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use serde_json::Value;

use super::clocks::{Steps, stepped_clock};
use super::sequences;
use crate::daemon::{Daemon, Mosquitto, ask, free_port, has, log_axis_toml, sink, until};
use crate::live::secure_broker;
use crate::support::simulate;

/// Sequences at a time: daemons that mostly wait for their next try.
const AT_ONCE: usize = 8;
/// The first waits of a daemon that has lost its broker add up to less.
const LONG: Duration = Duration::from_secs(90);
/// Packets of MQTT by the upper half of their first byte.
const PUBLISH: u8 = 3;
const PUBACK: u8 = 4;

/// What becomes of one connection; packets are those of the daemon, counted from its greeting.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fate {
    Honest,
    Refused,
    /// Ends after so many packets.
    Cut {
        packets: usize,
    },
    /// Ends within the packet after so many.
    Halved {
        packets: usize,
    },
    /// Hands nothing on after so many packets, and ends later.
    Stalled {
        packets: usize,
        ms: u64,
    },
    /// Each packet is late by so much.
    Slow {
        ms: u64,
    },
    /// Each byte comes by itself.
    Crumbled,
    /// Every event is sent twice.
    Repeated,
    /// So many confirmations arrive; the broker has the event behind them, the daemon does not hear of it.
    Unconfirmed {
        after: usize,
    },
    /// A confirmation of what was never sent.
    FalselyConfirmed {
        packets: usize,
    },
    /// What is no MQTT.
    Babble {
        packets: usize,
    },
}

fn fates() -> impl Strategy<Value = Vec<Fate>> {
    let packets = 0..12_usize;
    let fate = prop_oneof![
        Just(Fate::Refused),
        packets.clone().prop_map(|packets| Fate::Cut { packets }),
        packets.clone().prop_map(|packets| Fate::Halved { packets }),
        (packets.clone(), 50..800_u64).prop_map(|(packets, ms)| Fate::Stalled { packets, ms }),
        (1..40_u64).prop_map(|ms| Fate::Slow { ms }),
        Just(Fate::Crumbled),
        Just(Fate::Repeated),
        packets.clone().prop_map(|after| Fate::Unconfirmed { after }),
        packets.clone().prop_map(|packets| Fate::FalselyConfirmed { packets }),
        packets.prop_map(|packets| Fate::Babble { packets }),
    ];
    // Five losses over one event would count as its refusal.
    prop::collection::vec(fate, 1..5)
}

/// Between the daemon and its broker.
struct Proxy {
    port: u16,
    is_ended: Arc<AtomicBool>,
}

impl Proxy {
    fn start(broker_port: u16, fates: &[Fate]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let is_ended = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&is_ended);
        let mut fates: VecDeque<Fate> = fates.iter().copied().collect();
        thread::spawn(move || {
            for client in listener.incoming().map_while(Result::ok) {
                if ended.load(Ordering::Relaxed) {
                    return;
                }
                let fate = fates.pop_front().unwrap_or(Fate::Honest);
                if fate != Fate::Refused {
                    join(client, TcpStream::connect(("127.0.0.1", broker_port)).unwrap(), fate);
                }
            }
        });
        Proxy { port, is_ended }
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.is_ended.store(true, Ordering::Relaxed);
        let _ = TcpStream::connect(("127.0.0.1", self.port));
    }
}

/// Hands packets on in both directions, as far as their fate has it.
fn join(client: TcpStream, broker: TcpStream, fate: Fate) {
    client.set_nodelay(true).unwrap();
    broker.set_nodelay(true).unwrap();
    let answers = (broker.try_clone().unwrap(), client.try_clone().unwrap());
    thread::spawn(move || {
        let _ = hand_on(client, broker, fate);
    });
    thread::spawn(move || {
        let _ = hand_back(answers.0, answers.1, fate);
    });
}

/// A packet, whole: its kind and its bytes.
fn packet(from: &mut TcpStream) -> std::io::Result<(u8, Vec<u8>)> {
    let mut bytes = vec![0];
    from.read_exact(&mut bytes)?;
    let kind = bytes[0] >> 4;
    let (mut length, mut shift) = (0usize, 0);
    loop {
        let mut byte = [0];
        from.read_exact(&mut byte)?;
        bytes.push(byte[0]);
        length |= usize::from(byte[0] & 0x7f) << shift;
        shift += 7;
        if byte[0] & 0x80 == 0 {
            break;
        }
    }
    let head = bytes.len();
    bytes.resize(head + length, 0);
    from.read_exact(&mut bytes[head..])?;
    Ok((kind, bytes))
}

/// What the daemon sends.
fn hand_on(mut client: TcpStream, mut broker: TcpStream, fate: Fate) -> std::io::Result<()> {
    let mut sent = 0;
    let end = |client: &TcpStream, broker: &TcpStream| {
        let _ = client.shutdown(Shutdown::Both);
        let _ = broker.shutdown(Shutdown::Both);
    };
    loop {
        let Ok((kind, bytes)) = packet(&mut client) else {
            end(&client, &broker);
            return Ok(());
        };
        match fate {
            Fate::Cut { packets } if sent == packets => {
                end(&client, &broker);
                return Ok(());
            }
            Fate::Halved { packets } if sent == packets => {
                broker.write_all(&bytes[..bytes.len() / 2])?;
                end(&client, &broker);
                return Ok(());
            }
            Fate::Stalled { packets, ms } if sent == packets => {
                thread::sleep(Duration::from_millis(ms));
                end(&client, &broker);
                return Ok(());
            }
            Fate::FalselyConfirmed { packets } if sent == packets => {
                // The short form is valid in both versions; no event here has so high a number.
                client.write_all(&[PUBACK << 4, 2, 0x77, 0x77])?;
            }
            Fate::Babble { packets } if sent == packets => {
                client.write_all(&[0xf7, 0xff, 0xff, 0xff, 0xff, 0x01])?;
            }
            Fate::Slow { ms } => thread::sleep(Duration::from_millis(ms)),
            _ => {}
        }
        let is_event = kind == PUBLISH && bytes[0] & 0b110 != 0;
        if fate == Fate::Crumbled {
            bytes.iter().try_for_each(|byte| broker.write_all(&[*byte]))?;
        } else {
            broker.write_all(&bytes)?;
        }
        if fate == Fate::Repeated && is_event {
            broker.write_all(&bytes)?;
        }
        sent += 1;
    }
}

/// What the broker answers.
fn hand_back(mut broker: TcpStream, mut client: TcpStream, fate: Fate) -> std::io::Result<()> {
    let mut confirmed = 0;
    while let Ok((kind, bytes)) = packet(&mut broker) {
        if kind == PUBACK {
            if matches!(fate, Fate::Unconfirmed { after } if confirmed >= after) {
                thread::sleep(Duration::from_millis(100));
                break;
            }
            confirmed += 1;
        }
        client.write_all(&bytes)?;
    }
    let _ = client.shutdown(Shutdown::Both);
    let _ = broker.shutdown(Shutdown::Both);
    Ok(())
}

/// An axis that reads a log at speed, and one that keeps the daemon alive behind it.
fn config(
    folder: &Path,
    log: &Path,
    prefix: &str,
    version: &str,
    broker_port: u16,
    http_port: u16,
) -> String {
    format!(
        "state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{http_port}\"\n\
         [mqtt]\nhost = \"127.0.0.1\"\nport = {broker_port}\nprefix = \"{prefix}\"\nversion = \"{version}\"\nclient_id = \"{}\"\n\
         {}[[axes]]\naxis = \"silent\"\n[axes.source]\ncan = \"unix:{}\"\nstale_after_s = 3600.0\n\
         [axes.signals.command]\nbits = {{ id = 0x123, start = 0, length = 16 }}\n",
        prefix.replace('/', "-"),
        log_axis_toml("press-1", log),
        folder.join("in.sock").display()
    )
}

/// Waits until every event of the log is with the broker.
fn deliver(http_port: u16) {
    until("the log's end", LONG, || {
        let found = ask(http_port, "GET", "/api/v1/status", "");
        found.is_some_and(|answer| answer.json()["axes"].to_string().contains("\"state\":\"ended\""))
    });
    // Between two events that are under way nothing waits either: it must stay so.
    let mut before = (Value::Null, Instant::now());
    until("an empty spool", LONG, || {
        let mqtt = sink(http_port, "mqtt");
        assert_eq!(mqtt["dropped"], 0, "{mqtt}");
        if before.0 != mqtt["sent"] || mqtt["waiting"] != 0 {
            before = (mqtt["sent"].clone(), Instant::now());
        }
        before.1.elapsed() > Duration::from_millis(500)
    });
}

/// What was heard under a prefix: events in the order in which they were first heard, and how many were repeats.
fn heard(file: &Path, prefix: &str) -> (Vec<String>, usize) {
    let text = fs::read_to_string(file).unwrap();
    let (mut names, mut events, mut repeats) = (Vec::new(), Vec::new(), 0);
    for line in text.lines() {
        let Some((topic, message)) = line.split_once(' ') else { continue };
        let of_axis = topic.strip_prefix(prefix).and_then(|rest| rest.strip_prefix("/press-1/"));
        let Some(kind) = of_axis.filter(|kind| *kind != "status") else { continue };
        let mut event: Value = serde_json::from_str(message).unwrap();
        let name = event["id"].as_str().unwrap().to_owned();
        let fields = event.as_object_mut().unwrap();
        fields.remove("id");
        fields.remove("published_at");
        let said = format!("{kind} {event}");
        match names.iter().position(|known| *known == name) {
            Some(index) => {
                assert_eq!(events[index], said, "a repeat that says something else");
                repeats += 1;
            }
            None => {
                names.push(name);
                events.push(said);
            }
        }
    }
    (events, repeats)
}

/// `SEEPD_SEQUENCES=200 cargo test --workspace --test gateway faults::broker -- --nocapture` for a long run.
#[test]
fn every_event_arrives_in_order_whatever_becomes_of_connections() {
    if !has("mosquitto") || !has("mosquitto_sub") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("worn.mcap");
    simulate(&log, &["--cycles", "20", "--leak-area", "5e-8", "--leak-growth", "8e-7"]);
    let broker =
        Mosquitto::start(folder.path(), free_port(), "allow_anonymous true\nmax_queued_messages 0\n");
    let file = folder.path().join("heard.txt");
    let _listener = broker.listen(&file, &[]);

    let mut runner =
        TestRunner::new_with_rng(Config::default(), TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    let drawn: Vec<Vec<Fate>> =
        (0..sequences(8)).map(|_| fates().new_tree(&mut runner).unwrap().current()).collect();
    // The first one is left alone, and says what must be heard of each.
    let queue =
        Mutex::new(std::iter::once(Vec::new()).chain(drawn.clone()).enumerate().collect::<VecDeque<_>>());
    thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                loop {
                    let next = queue.lock().unwrap().pop_front();
                    let Some((number, fates)) = next else { return };
                    let place = folder.path().join(number.to_string());
                    fs::create_dir(&place).unwrap();
                    let proxy = Proxy::start(broker.port, &fates);
                    let (http_port, version) = (free_port(), ["3.1.1", "5"][number % 2]);
                    let prefix = format!("seepd/{number}");
                    let config = config(&place, &log, &prefix, version, proxy.port, http_port);
                    let daemon = Daemon::start(&place, &config);
                    deliver(http_port);
                    drop(daemon);
                }
            });
        }
    });
    thread::sleep(Duration::from_millis(500));
    let (expected, _) = heard(&file, "seepd/0");
    assert!(
        expected.len() > 20 && expected.iter().any(|event| event.contains("\"flag_to\":\"severe\"")),
        "{expected:?}"
    );
    let mut repeats = 0;
    for (number, fates) in (1..).zip(&drawn) {
        let (events, repeated) = heard(&file, &format!("seepd/{number}"));
        assert_eq!(events.len(), expected.len(), "{number}: {fates:?}");
        assert_eq!(events, expected, "{number}: {fates:?}");
        repeats += repeated;
    }
    println!("{} sequences, {} events each, {repeats} repeats", drawn.len(), expected.len());
}

/// The broker's certificate has run out when a log is read, by the daemon's clock, and is good again later: what comes meanwhile waits.
#[test]
fn events_wait_for_a_broker_whose_certificate_has_expired() {
    if !["mosquitto", "mosquitto_sub", "mosquitto_passwd", "openssl"].into_iter().all(has) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let Some(library) = stepped_clock(folder.path()) else { return };
    let (clock, log) = (folder.path().join("clock"), folder.path().join("worn.mcap"));
    let mut steps = Steps::begin(&clock);
    simulate(&log, &["--cycles", "20", "--leak-area", "5e-8", "--leak-growth", "8e-7"]);
    let secure = secure_broker(folder.path());
    let ca = folder.path().join("ca.pem");
    let (port, http_port) = (free_port(), free_port());
    let config = config(folder.path(), &log, "seepd/late", "5", port, http_port).replace(
        "host = \"127.0.0.1\"\nport",
        "host = \"localhost\"\ntls = true\nca_file = \"ca.pem\"\nusername = \"press\"\npassword_file = \"mqtt-password\"\nport",
    );

    // Certificates of the broker are good for two days.
    steps.set_ahead(Duration::from_secs(3 * 86_400));
    let broker = Mosquitto::start(folder.path(), port, &secure);
    let file = folder.path().join("heard.txt");
    let listener = broker.listen(&file, &["--cafile", ca.to_str().unwrap(), "-u", "press", "-P", "a secret"]);
    let environment =
        [("LD_PRELOAD", library.to_str().unwrap()), ("SEEPD_TEST_CLOCK", clock.to_str().unwrap())];
    let daemon = Daemon::start_with(folder.path(), &config, &environment);
    until("the certificate's end told", LONG, || {
        crate::daemon::axis_status(http_port).is_some()
            && sink(http_port, "mqtt")["detail"].as_str().is_some_and(|detail| detail.contains("expired"))
    });
    until("the log's end", LONG, || sink(http_port, "mqtt")["waiting"].as_u64() > Some(20));
    assert_eq!(listener.messages("seepd/late/press-1/cycle"), Vec::<String>::new());
    // Somebody renews it.
    steps.set_ahead(Duration::ZERO);
    deliver(http_port);
    thread::sleep(Duration::from_millis(300));
    let (events, _) = heard(&file, "seepd/late");
    let cycles: Vec<u64> = listener
        .messages("seepd/late/press-1/cycle")
        .iter()
        .map(|text| serde_json::from_str::<Value>(text).unwrap()["cycle"].as_u64().unwrap())
        .collect();
    assert!(events.len() > 20, "{events:?}");
    assert!(cycles.is_sorted() && cycles.len() > 15, "{cycles:?}\n{}", daemon.words());
}
