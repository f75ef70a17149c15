//! What other implementations read from logs, value by value.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use seepd_logs::can::{Content, Identifier};
use seepd_logs::{LogMapping, SignalMapping};
use seepd_signals::Signal;
use serde_json::Value;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures").join(name)
}

/// Frames of a fixture against what another implementation read from it; `other` says which files and values.
fn compare(folder: &Path) -> (usize, usize) {
    let expected: Value = serde_json::from_slice(&fs::read(folder.join("expected.json")).unwrap()).unwrap();
    let (mut frames, mut values) = (0, 0);
    for (name, expected) in expected.as_object().unwrap() {
        let log = folder.join(name);
        if let Some(expected) = expected["frames"].as_array() {
            frames += compare_frames(&log, expected);
        }
        if !cfg!(feature = "bags") && name.starts_with("bag") {
            continue;
        }
        for (channel, expected) in expected["signals"].as_object().into_iter().flatten() {
            values += compare_signal(&log, channel, expected.as_array().unwrap());
        }
    }
    (frames, values)
}

fn compare_frames(log: &Path, expected: &[Value]) -> usize {
    let mut source = seepd_logs::frames(log).unwrap();
    let mut first_ns = None;
    let read = std::iter::from_fn(|| source.next_frame().unwrap()).map(Result::unwrap);
    let read: Vec<_> = read.filter(|logged| logged.frame.content != Content::Error).collect();
    assert_eq!(read.len(), expected.len(), "{}", log.display());
    for (logged, expected) in read.iter().zip(expected) {
        let place = format!("{} at {}", log.display(), expected[0]);
        let time_s = (logged.time_ns - *first_ns.get_or_insert(logged.time_ns)) as f64 / 1e9;
        assert!((time_s - expected[0].as_f64().unwrap()).abs() < 2e-6, "{place}: {time_s}");
        let (id, extended) = match logged.frame.identifier {
            Identifier::Standard(id) => (u32::from(id), false),
            Identifier::Extended(id) => (id, true),
        };
        assert_eq!(
            (u64::from(id), Some(extended)),
            (expected[1].as_u64().unwrap(), expected[2].as_bool()),
            "{place}"
        );
        let kind = if logged.frame.content == Content::Remote { "remote" } else { "data" };
        assert_eq!(kind, expected[3].as_str().unwrap(), "{place}");
        let data: String = logged.frame.data().iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(data, expected[4].as_str().unwrap(), "{place}");
    }
    expected.len()
}

fn compare_signal(log: &Path, channel: &str, expected: &[Value]) -> usize {
    // As it is: neither scaled by its unit nor otherwise.
    let topic = if channel.starts_with("vector") { "/axis" } else { "" };
    let (topic, field, unit) = (topic.into(), channel.into(), "1".into());
    let command = SignalMapping { topic, field, unit, ..SignalMapping::default() };
    let mapping = LogMapping { signals: [(Signal::Command, command)].into(), ..LogMapping::default() };
    let mut source = seepd_logs::open(log, &mapping).unwrap();
    let mut first_ns = None;
    let first_s = expected[0][0].as_f64().unwrap();
    for expected in expected {
        let sample = source.next_sample().unwrap().unwrap();
        let time_s = first_s + (sample.time_ns - *first_ns.get_or_insert(sample.time_ns)) as f64 / 1e9;
        let (expected_s, value) = (expected[0].as_f64().unwrap(), expected[1].as_f64().unwrap());
        let found = sample.get(Signal::Command).unwrap();
        assert!(
            (time_s - expected_s).abs() < 1e-8,
            "{} {channel}: {time_s}, not {expected_s}",
            log.display()
        );
        assert!(
            (found - value).abs() <= 1e-12 * value.abs(),
            "{} {channel}: {found}, not {value}",
            log.display()
        );
    }
    assert_eq!(source.next_sample().unwrap(), None);
    expected.len()
}

#[test]
fn reference_python_can_and_asammdf_read_the_same_from_the_fixtures() {
    let (frames, values) = compare(&fixture("logs"));
    assert!(frames > 800 && values > 4000, "{frames} frames, {values} values");
}

/// The same with logs that the libraries write now, where they are installed.
#[test]
fn reference_python_can_and_asammdf_write_logs_that_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let tool = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/other_readers.py");
    let run =
        Command::new("python3").arg(tool).arg(folder.path()).arg(std::process::id().to_string()).output();
    match run {
        Ok(output) if output.status.success() => {
            let (frames, values) = compare(folder.path());
            assert!(frames > 700 && values > 4000, "{frames} frames, {values} values");
        }
        Ok(output) if String::from_utf8_lossy(&output.stderr).contains("ModuleNotFoundError") => {
            eprintln!("left out: python-can or asammdf is not installed (tools/requirements.txt)");
        }
        Ok(output) => panic!("{}", String::from_utf8_lossy(&output.stderr)),
        Err(error) => eprintln!("left out: no python3 ({error})"),
    }
}

#[test]
fn reference_busmasters_and_candumps_of_one_recording_have_the_same_frames() {
    // SavvyCAN has both of one bus; the candump is what can-utils wrote of it, with whole seconds.
    let read = |name: &str| {
        let mut frames = seepd_logs::frames(&fixture(name)).unwrap();
        let frames =
            std::iter::from_fn(move || frames.next_frame().unwrap()).map(|frame| frame.unwrap().frame);
        frames.take(20).collect::<Vec<_>>()
    };
    assert_eq!(read("can/busmaster.log")[..20], read("can/whole_seconds.log")[..20]);
}

/// A page of a bag is overwritten: the messages in it are lost, and told of.
#[cfg(feature = "bags")]
#[test]
fn a_damaged_bag_loses_what_is_damaged() {
    let mut bytes = fs::read(fixture("logs/bag/bag.db3")).unwrap();
    let page = usize::from(u16::from_be_bytes([bytes[16], bytes[17]]));
    let command =
        || SignalMapping { topic: "/axis".into(), field: "vector.y".into(), ..SignalMapping::default() };
    let mapping = LogMapping { signals: [(Signal::Command, command())].into(), ..LogMapping::default() };
    let (mut whole, mut torn) = (0, 0);
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("torn.db3");
    for at in (page..bytes.len()).step_by(page) {
        let kept = bytes[at..at + page].to_vec();
        bytes[at..at + page].fill(0xa5);
        fs::write(&log, &bytes).unwrap();
        bytes[at..at + page].copy_from_slice(&kept);
        let Ok(mut source) = seepd_logs::open(&log, &mapping) else { continue };
        let mut given = 0;
        while let Ok(Some(_)) = source.next_sample() {
            given += 1;
        }
        let told = source.notes().iter().any(|note| note.contains("damaged places"));
        // A page of the index costs nothing.
        whole += usize::from(given == 100 && !told);
        torn += usize::from((1..100).contains(&given) && told);
        assert!(given == 100 || given == 0 || told, "{given} messages at {at}: {:?}", source.notes());
    }
    assert!(whole > 0 && torn > 0, "{whole} whole, {torn} torn");
}
