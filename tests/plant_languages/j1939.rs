//! DM1 and DM2 of J1939, read by another implementation's tester.

use std::time::Duration;

use serde_json::Value;

use super::{SOON, two_axes, worn_log};
use crate::daemon::{Companion, Daemon, Machine, axis_status, cycle, free_port, sink, until};
use crate::support::{python, seepd, simulate};

/// What a tester on J1939 has heard of a message's kind.
fn spoken(heard: &[Value], kind: &str) -> Vec<Value> {
    heard.iter().filter(|line| line["message"] == kind).cloned().collect()
}

#[test]
fn a_tester_reads_dm1_asks_for_dm2_and_takes_the_address_away() {
    let Some(tester) = python("j1939") else { return };
    let folder = tempfile::tempdir().unwrap();
    let log = worn_log(folder.path());
    let bus = folder.path().join("bus.sock");
    let tester = Companion::start(tester, "j1939_tester.py", folder.path(), &[bus.to_str().unwrap()]);
    until("the bus", SOON, || bus.exists());
    let port = free_port();
    let speaker = |axis: &str, address: u8| {
        format!(
            "[[j1939]]\ninterface = \"unix:{}\"\naxis = \"{axis}\"\naddress = {address}\nspn = 520000\n",
            bus.display()
        )
    };
    let config = two_axes(folder.path(), port, &log, &speaker("Press 1", 0x80));
    let daemon = Daemon::start(folder.path(), &config);
    let last = || spoken(&tester.heard(), "DM1").last().cloned().unwrap_or_default();
    until("the leak", SOON, || last()["codes"][0]["fmi"] == 16);
    let told = last();
    assert_eq!(
        (&told["address"], &told["codes"]),
        (&0x80.into(), &serde_json::json!([{ "spn": 520_000, "fmi": 16, "oc": 1 }]))
    );
    // Amber is on, the others are off, none flashes.
    assert_eq!(told["lamps"], serde_json::json!({ "pl": 0, "awl": 1, "rsl": 0, "mil": 0 }));
    let heard = tester.heard();
    assert_eq!(heard[0]["message"], "0EEFF", "the address is claimed before anything is said: {}", heard[0]);
    let so_far = spoken(&heard, "DM1").len();
    until("three more", SOON, || spoken(&tester.heard(), "DM1").len() >= so_far + 3);
    let times: Vec<f64> =
        spoken(&tester.heard(), "DM1")[so_far..].iter().filter_map(|line| line["time"].as_f64()).collect();
    assert!(times.windows(2).all(|pair| (0.9..1.3).contains(&(pair[1] - pair[0]))), "{times:?}");
    // Asked, it answers: nothing was active before, of this address or of all.
    tester.say("ask feca 80");
    tester.say("ask fecb 80");
    until("an answer", SOON, || {
        !spoken(&tester.heard(), "DM2").is_empty() || {
            tester.say("ask fecb ff");
            std::thread::sleep(Duration::from_millis(200));
            false
        }
    });
    assert_eq!(
        spoken(&tester.heard(), "DM2")[0]["codes"],
        serde_json::json!([{ "spn": 0, "fmi": 0, "times": 0, "cm": 0 }])
    );
    // What it does not know is refused, where it alone is asked.
    std::thread::sleep(Duration::from_millis(300));
    tester.say("ask fee5 80");
    until("the refusal", SOON, || {
        spoken(&tester.heard(), "0E8FF").iter().any(|line| line["data"] == "01fffffff9e5fe00")
    });
    // A name that comes later is answered by a claim, one that comes before takes the address.
    let claims = spoken(&tester.heard(), "0EEFF").len();
    std::thread::sleep(Duration::from_millis(300));
    tester.say("claim 80 7fffffffffffffff");
    until("the claim", SOON, || spoken(&tester.heard(), "0EEFF").len() > claims);
    assert!(sink(port, &format!("j1939 unix:{} 80", bus.display()))["good"].as_bool().unwrap());
    tester.say("claim 80 1");
    until("silence", SOON, || spoken(&tester.heard(), "0EEFF").iter().any(|line| line["address"] == 254));
    let status = sink(port, &format!("j1939 unix:{} 80", bus.display()));
    assert!(status["detail"].as_str().unwrap().contains("belongs to the name 0000000000000001"), "{status}");
    let count = spoken(&tester.heard(), "DM1").len();
    std::thread::sleep(Duration::from_millis(2500));
    assert_eq!(spoken(&tester.heard(), "DM1").len(), count, "one that has no address says nothing");
    assert_eq!(axis_status(port).unwrap()["flag"], "leak");
    drop(daemon);
}

#[test]
fn codes_that_are_over_go_into_dm2_and_are_counted() {
    let Some(tester) = python("j1939") else { return };
    let folder = tempfile::tempdir().unwrap();
    let bus = folder.path().join("bus.sock");
    let tester = Companion::start(tester, "j1939_tester.py", folder.path(), &[bus.to_str().unwrap()]);
    until("the bus", SOON, || bus.exists());
    let port = free_port();
    let socket = folder.path().join("in.sock");
    let config = format!(
        "state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{port}\"\n[[j1939]]\ninterface = \"unix:{}\"\naddress = 0x81\n{}[alarm]\nraise_cycles = 1\n",
        bus.display(),
        crate::daemon::machine_toml(&socket)
    );
    let _daemon = Daemon::start(folder.path(), &config.replace("[source]", "[source]\nstale_after_s = 3.0"));
    let dm1 = || spoken(&tester.heard(), "DM1");
    // No command: the code of it alone, with no lamp of the seal.
    until("no command", SOON, || {
        dm1().last().is_some_and(|told| told["codes"][0]["spn"] == 516_112 && told["codes"][0]["fmi"] == 9)
    });
    // Before that nothing was known: the lamps were not available, rather than off.
    let first = dm1()[0].clone();
    assert_eq!((&first["lamps"]["awl"], &first["codes"][0]["spn"]), (&4.into(), &0.into()), "{first}");
    let machine = Machine::start(&socket, cycle("nominal_leak_1e-6.csv"));
    until("the severe leak", Duration::from_secs(60), || {
        dm1().last().is_some_and(|told| told["codes"][0]["spn"] == 516_096)
    });
    let told = dm1().last().cloned().unwrap();
    assert_eq!((&told["codes"][0]["fmi"], &told["lamps"]["rsl"]), (&0.into(), &1.into()), "{told}");
    // The missing command is over, and in DM2.
    let dm2 = || spoken(&tester.heard(), "DM2");
    tester.say("ask fecb 81");
    until("DM2", SOON, || !dm2().is_empty());
    assert_eq!(dm2()[0]["codes"], serde_json::json!([{ "spn": 516_112, "fmi": 9, "times": 1, "cm": 0 }]));
    // It stops: the leak is no longer told as active, the command is missing again, the second time.
    machine.stop();
    until("no command again", SOON, || dm1().last().is_some_and(|told| told["codes"][0]["fmi"] == 9));
    let told = dm1().last().cloned().unwrap();
    assert_eq!(told["codes"], serde_json::json!([{ "spn": 516_112, "fmi": 9, "oc": 2 }]));
    std::thread::sleep(Duration::from_millis(300));
    tester.say("ask fecb 81");
    until("DM2 again", SOON, || dm2().len() >= 2);
    assert_eq!(
        dm2()[1]["codes"],
        serde_json::json!([{ "spn": 516_096, "fmi": 0, "times": 1, "cm": 0 }]),
        "the latch is not acknowledged"
    );
}

#[test]
fn a_leak_beside_a_shifted_null_is_two_codes_in_packets_that_a_tester_puts_together() {
    let Some(tester) = python("j1939") else { return };
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let machine =
        ["--parameter-spread", "0.05", "--machine", "3", "--load-variation", "0.02", "--noise", "0.003"];
    simulate(&place("healthy.mcap"), &[&machine[..], &["--cycles", "60", "--seed", "2"]].concat());
    let (baseline, healthy) = (place("baseline.json"), place("healthy.mcap"));
    let learned = seepd(["learn-baseline", "--out", baseline.to_str().unwrap(), healthy.to_str().unwrap()]);
    assert!(learned.status.success());
    let worn =
        ["--cycles", "10", "--seed", "5", "--leak-area", "1.9e-7", "--with", "valve_bias.offset=0.005"];
    simulate(&place("worn.mcap"), &[&machine[..], &worn[..]].concat());
    let (bus, port) = (place("bus.sock"), free_port());
    let tester = Companion::start(tester, "j1939_tester.py", folder.path(), &[bus.to_str().unwrap()]);
    until("the bus", SOON, || bus.exists());
    let sinks =
        format!("[[j1939]]\ninterface = \"unix:{}\"\naxis = \"Press 1\"\naddress = 0x82\n", bus.display());
    let fast = "pace = \"fast\"\n";
    let with_baseline = format!("{fast}[axes.baseline]\nfile = \"baseline.json\"\n");
    let config = two_axes(folder.path(), port, &place("worn.mcap"), &sinks).replace(fast, &with_baseline);
    let _daemon = Daemon::start(folder.path(), &config);
    until("two codes", SOON, || {
        spoken(&tester.heard(), "DM1").last().is_some_and(|told| told["codes"].as_array().unwrap().len() == 2)
    });
    let status = axis_status(port).unwrap();
    assert_eq!(
        (&status["flag"], &status["conditions"][0]["cause"]),
        (&"leak".into(), &"valve_null".into()),
        "{status}"
    );
    let told = spoken(&tester.heard(), "DM1").last().cloned().unwrap();
    let codes = told["codes"].as_array().unwrap();
    assert_eq!(codes[0], serde_json::json!({ "spn": 516_096, "fmi": 16, "oc": 1 }));
    assert_eq!((&codes[1]["spn"], &told["lamps"]["awl"]), (&516_097.into(), &1.into()));
    // Announced, and in packets with the standard's distance and priority.
    let heard = tester.heard();
    let announced = spoken(&heard, "0ECFF")[0].clone();
    assert_eq!((&announced["data"], &announced["priority"]), (&"200a0002ffcafe00".into(), &7.into()));
    let packets = spoken(&heard, "0EBFF");
    let between = packets[1]["time"].as_f64().unwrap() - packets[0]["time"].as_f64().unwrap();
    assert!((0.045..0.2).contains(&between), "{between}");
}
