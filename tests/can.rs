//! CAN logs: fields against an independent decoder, and whole runs from candump's format with a DBC file.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use seepd_logs::can::Frame;
use seepd_logs::can::candump::Line;
use seepd_logs::can::dbc::{Dbc, Reading};
use seepd_signals::Signal;
use serde_json::Value;

use crate::support::{estimates, fixture, replay, seepd, simulate, stderr, stdout, summary};

/// Command and demand in an 11-bit frame, Motorola; load in a 29-bit FD frame, Intel, behind a multiplexer.
const DBC: &str = r#"VERSION ""

NS_ :

BS_:

BU_: PLC

BO_ 513 AxisStatus: 8 PLC
 SG_ Counter : 7|8@0+ (1,0) [0|255] "" Vector__XXX
 SG_ ValveCommand : 15|24@0- (0.0002,0) [-100|100] "%" Vector__XXX
 SG_ PositionDemand : 39|32@0- (0.00001,0) [0|1000] "mm" Vector__XXX

BO_ 514 AxisCycle: 1 PLC
 SG_ CycleStart : 3|1@1+ (1,0) [0|1] "" Vector__XXX

BO_ 2566849025 AxisLoad: 12 PLC
 SG_ Page M : 0|8@1+ (1,0) [0|255] "" Vector__XXX
 SG_ LoadForce m1 : 32|32@1- (1,0) [0|0] "N" Vector__XXX

SIG_VALTYPE_ 2566849025 LoadForce : 1;
"#;

fn text_of(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// The controller tells a cycle's start so many samples after it.
const LATE: usize = 7;

/// The log of a simulated machine as frames: a load, a start-of-cycle and a status frame a millisecond.
fn candump_of(csv_rows: &[[f64; 4]]) -> String {
    let mut log = String::new();
    for (number, [time_s, command, demand, load]) in csv_rows.iter().enumerate() {
        let micros = (time_s * 1e6).round() as u64 + 1_700_000_000_000_000;
        let stamp = format!("({}.{:06})", micros / 1_000_000, micros % 1_000_000);
        let command = ((command * 100.0 / 0.0002).round() as i32).to_be_bytes();
        let demand = ((demand * 1000.0 / 0.00001).round() as i32).to_be_bytes();
        let status = [[number as u8].as_slice(), &command[1..], &demand].concat();
        let mut load_frame = [0u8; 12];
        load_frame[0] = 1;
        load_frame[4..8].copy_from_slice(&(*load as f32).to_le_bytes());
        writeln!(log, "{stamp} can0 18FF0001##1{}", hex(&load_frame)).unwrap();
        let start = if (number + 10_000 - LATE) % 10_000 < 50 { 0x08 } else { 0x00 };
        writeln!(log, "{stamp} can0 202#{}", hex(&[start])).unwrap();
        writeln!(log, "{stamp} can0 201#{}", hex(&status)).unwrap();
        // The same identifier on another bus, and frames without data: none of them is the command.
        if number % 50 == 0 {
            writeln!(log, "{stamp} can1 201#00FFFFFF00000000").unwrap();
            writeln!(log, "{stamp} can0 201#R8").unwrap();
            writeln!(log, "{stamp} can0 20000004#0000000000000000").unwrap();
        }
    }
    log
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |text, byte| text + &format!("{byte:02X}"))
}

/// The signals of a simulated log, read through the library.
fn rows_of(log: &Path) -> Vec<[f64; 4]> {
    let mut source = seepd_logs::open(log, &seepd_logs::LogMapping::default()).unwrap();
    let mut rows = Vec::new();
    while let Some(sample) = source.next_sample().unwrap() {
        let of = |signal| sample.get(signal).unwrap();
        rows.push([sample.time_ns as f64 / 1e9, of(Signal::Command), of(Signal::Demand), of(Signal::Load)]);
    }
    rows
}

struct Logs {
    folder: tempfile::TempDir,
    mcap: PathBuf,
    candump: PathBuf,
    dbc: PathBuf,
}

fn logs() -> Logs {
    let folder = tempfile::tempdir().unwrap();
    let (mcap, candump, dbc) =
        (folder.path().join("a.mcap"), folder.path().join("a.log"), folder.path().join("press.dbc"));
    simulate(&mcap, &["--cycles", "4", "--leak-area", "1e-6"]);
    fs::write(&candump, candump_of(&rows_of(&mcap))).unwrap();
    fs::write(&dbc, DBC).unwrap();
    Logs { folder, mcap, candump, dbc }
}

#[test]
fn reference_cantools_decodes_the_same_values() {
    let cases: Vec<Value> =
        serde_json::from_str(&fs::read_to_string(fixture("can/decoded.json")).unwrap()).unwrap();
    let mut files: BTreeMap<String, Dbc> = BTreeMap::new();
    let (mut compared, mut not_available) = (0, 0);
    for case in &cases {
        let name = case["dbc"].as_str().unwrap();
        let dbc =
            files.entry(name.into()).or_insert_with(|| Dbc::read(&fixture("can/dbc").join(name)).unwrap());
        let line = format!("(0.0) can0 {}", case["frame"].as_str().unwrap());
        let frame: Frame = Line::parse(line.as_bytes()).unwrap().frame;
        // What its sender says that it does not have is a number to cantools, and none here.
        let found: BTreeMap<String, Option<f64>> = dbc
            .signals_of(frame.identifier, usize::MAX)
            .iter()
            .filter_map(|signal| match signal.read(&frame) {
                Reading::Value(value) if value.is_finite() => Some((signal.name.clone(), Some(value))),
                Reading::NotAvailable => Some((signal.name.clone(), None)),
                _ => None,
            })
            .collect();
        let expected = case["values"].as_object().unwrap();
        assert_eq!(
            found.keys().collect::<Vec<_>>(),
            expected.keys().collect::<std::collections::BTreeSet<_>>().into_iter().collect::<Vec<_>>(),
            "{name} {line}"
        );
        for (signal, value) in expected {
            let Some(found) = found[signal] else {
                not_available += 1;
                continue;
            };
            let expected = value.as_f64().unwrap();
            // cantools computes integers exactly; 64-bit ones do not fit a double.
            let tolerance = 1e-12 * expected.abs().max(found.abs());
            assert!((expected - found).abs() <= tolerance, "{name} {line} {signal}: {found}, not {expected}");
            compared += 1;
        }
    }
    assert!(compared > 1000 && 50 * not_available < compared, "{compared} {not_available}");
}

#[test]
fn every_dbc_fixture_is_read() {
    for entry in fs::read_dir(fixture("can/dbc")).unwrap() {
        let path = entry.unwrap().path();
        let dbc = Dbc::read(&path).unwrap();
        for name in dbc.names() {
            if let Err(error) = dbc.find(&name) {
                let message = error.to_string();
                assert!(
                    text_of(&path).ends_with("bad_message_length.dbc")
                        || message.contains("is in the message"),
                    "{message}"
                );
            }
        }
    }
    let broken = Dbc::read(&fixture("can/dbc/bad_message_length.dbc")).unwrap();
    assert!(
        broken
            .find("Signal1")
            .unwrap_err()
            .to_string()
            .contains("ends in byte 2 of the message Message1, which has 1")
    );
}

#[test]
fn candump_gives_the_estimates_of_the_log_that_it_was_made_of() {
    let logs = logs();
    let mcap = replay(&logs.mcap, &[]);
    let config = logs.folder.path().join("seepd.toml");
    let text = "dbc = \"press.dbc\"\n[signals.command]\ntopic = \"can0\"\nfield = \"AxisStatus.ValveCommand\"\nscale = 0.01\n\
                [signals.demand]\nfield = \"PositionDemand\"\nscale = 0.001\n[signals.load]\nfield = \"LoadForce\"\n";
    fs::write(&config, text).unwrap();
    let can = replay(&logs.candump, &["--config", text_of(&config)]);
    let (expected, found) = (estimates(&mcap), estimates(&can));
    assert_eq!((expected.len(), found.len()), (4, 4));
    for (expected, found) in expected.iter().zip(&found) {
        // The frames resolve 2e-6 of full command; times and demand are the same.
        assert!((expected - found).abs() <= 1e-3 * expected, "{found} against {expected}");
    }
    assert_eq!(summary(&can)["samples"], summary(&mcap)["samples"]);
    stdout(&seepd(["check", text_of(&config)]));
}

/// A bit that rises says where a cycle begins, to the sample; it goes before the demand, and before what the strokes say.
#[test]
fn a_start_of_cycle_bit_tells_the_start() {
    let logs = logs();
    let config = logs.folder.path().join("seepd.toml");
    let command =
        "dbc = \"press.dbc\"\n[signals.command]\ntopic = \"can0\"\nfield = \"ValveCommand\"\nscale = 0.01\n";
    let demand = "[signals.demand]\nfield = \"PositionDemand\"\nscale = 0.001\n";
    let bit = "[signals.cycle_start]\nfield = \"AxisCycle.CycleStart\"\n";
    let starts = |text: String| -> Vec<f64> {
        fs::write(&config, text).unwrap();
        let lines = replay(&logs.candump, &["--config", text_of(&config)]);
        assert_eq!(estimates(&lines).len(), 4);
        lines.iter().filter_map(|line| line["t_start_s"].as_f64()).collect()
    };
    // The first cycle begins with the log: its rise was before it.
    for cycle in 1..4 {
        let at_s = |late: usize| 10.0 * cycle as f64 + late as f64 / 1000.0;
        let near = |found: f64, wanted: f64| (found - wanted).abs() < 0.5e-3;
        assert!(near(starts(format!("{command}{demand}{bit}"))[cycle], at_s(LATE)));
        assert!(near(starts(format!("{command}{bit}"))[cycle], at_s(LATE)));
        assert!(near(starts(format!("{command}{demand}"))[cycle], at_s(0)));
    }
}

#[test]
fn what_inspect_proposes_reads_the_log() {
    let logs = logs();
    let proposal = stdout(&seepd(["inspect", "--dbc", text_of(&logs.dbc), text_of(&logs.candump)]));
    let config = logs.folder.path().join("proposed.toml");
    fs::write(&config, &proposal).unwrap();
    let lines = replay(&logs.candump, &["--config", text_of(&config)]);
    assert_eq!(estimates(&lines).len(), 4, "{proposal}");
    let json = stdout(&seepd(["inspect", "--json", "--dbc", text_of(&logs.dbc), text_of(&logs.candump)]));
    let survey: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(survey["kind"], "candump");
    assert_eq!(survey["mapping"]["command"]["field"], "AxisStatus.ValveCommand");
    assert_eq!(survey["mapping"]["command"]["scale"], 0.01);
    let topic = survey["topics"].as_array().unwrap().iter().find(|t| t["topic"] == "can0 201").unwrap();
    assert_eq!(topic["schema"], "AxisStatus");
    assert!((topic["rate_hz"].as_f64().unwrap() - 1000.0).abs() < 1.0);
}

#[test]
fn candump_is_read_from_a_pipe() {
    let logs = logs();
    let input = fs::File::open(&logs.candump).unwrap();
    let config = logs.folder.path().join("seepd.toml");
    fs::write(
        &config,
        "dbc = \"press.dbc\"\n[signals.command]\ntopic = \"can0\"\nfield = \"ValveCommand\"\nscale = 0.01\n",
    )
    .unwrap();
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_seepd"))
        .args(["replay", "--json", "-", "--config", text_of(&config)])
        .stdin(input)
        .output()
        .unwrap();
    assert_eq!(stdout(&output).lines().count(), 4 + 1, "{}", stderr(&output));
    assert!(stderr(&output).contains("remote frames"), "{}", stderr(&output));
}

/// Exit code and the one line of a run that must fail.
fn refusal(arguments: &[&str]) -> (i32, String) {
    let output = seepd(arguments);
    let text = stderr(&output);
    assert_eq!(text.trim_end().lines().count(), 1, "one line: {text}");
    (output.status.code().unwrap(), text)
}

#[test]
fn whole_second_stamps_are_refused() {
    let log = fixture("can/whole_seconds.log");
    let dbc = fixture("can/dbc/savvycan_LeafPowertrainBus.dbc");
    let (code, text) =
        refusal(&["replay", text_of(&log), "--dbc", text_of(&dbc), "--command", "RequestedTorque"]);
    assert_eq!(code, 65);
    assert!(text.contains("its time stamps are whole seconds"), "{text}");
}

#[test]
fn a_log_without_its_dbc_and_a_dbc_without_the_signal() {
    let logs = logs();
    let (code, text) = refusal(&["replay", text_of(&logs.candump)]);
    assert_eq!(code, 78);
    assert!(text.contains("name the DBC file"), "{text}");
    let dbc = text_of(&logs.dbc);
    let (code, text) = refusal(&["replay", text_of(&logs.candump), "--dbc", dbc, "--command", "ValveComand"]);
    assert_eq!(code, 78);
    assert!(text.contains("there is no signal `ValveComand`; did you mean `ValveCommand`?"), "{text}");
    let config = logs.folder.path().join("seepd.toml");
    fs::write(&config, "dbc = \"press.dbc\"\n[signals.command]\nfield = \"Valve\"\n").unwrap();
    let (code, text) = refusal(&["check", text_of(&config)]);
    assert_eq!(code, 78);
    assert!(text.contains("there is no signal `Valve`"), "{text}");
}

#[test]
fn a_dbc_that_does_not_parse_is_told_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let dbc = folder.path().join("broken.dbc");
    fs::write(&dbc, DBC.replace("15|24@0-", "15|24@7-")).unwrap();
    let log = folder.path().join("a.log");
    fs::write(&log, "(1.5) can0 201#00\n").unwrap();
    let (code, text) = refusal(&["replay", text_of(&log), "--dbc", text_of(&dbc)]);
    assert_eq!(code, 78);
    assert!(text.contains("broken.dbc: line 11"), "{text}");
}

#[test]
fn damaged_lines_and_short_frames_are_counted_and_the_rest_counts() {
    let logs = logs();
    let text = fs::read_to_string(&logs.candump).unwrap();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    // In a hold of the third cycle: a few samples are bridged.
    let at = lines.iter().position(|line| line.contains("1700000020.2")).unwrap();
    lines[at + 2] = lines[at + 2].replace("201#", "201#00 was ");
    lines[at + 8] = "(1700000020.x) can0 201#".into();
    let log = logs.folder.path().join("damaged.log");
    fs::write(&log, lines.join("\n")).unwrap();
    let arguments = ["--dbc", text_of(&logs.dbc), "--command", "ValveCommand", "--topic", "can0", "--json"];
    let config = logs.folder.path().join("seepd.toml");
    fs::write(&config, "[signals.command]\nscale = 0.01\n").unwrap();
    let output = seepd(["replay", text_of(&log), "--config", text_of(&config)].into_iter().chain(arguments));
    assert_eq!(stdout(&output).lines().count(), 4 + 1);
    let notes = stderr(&output);
    assert!(notes.contains("1 lines were left out, the first at line"), "{notes}");
    assert!(notes.contains("1 frames were left out, since they are too short"), "{notes}");
}

#[test]
fn a_log_without_the_frame_says_what_it_lacks() {
    let logs = logs();
    let log = logs.folder.path().join("other.log");
    fs::write(&log, "(1.5) can0 300#00\n(1.6) can0 300#01\n").unwrap();
    let (code, text) =
        refusal(&["replay", text_of(&log), "--dbc", text_of(&logs.dbc), "--command", "ValveCommand"]);
    assert_eq!(code, 65);
    assert!(text.contains("no frame carries AxisStatus.ValveCommand (identifier 201)"), "{text}");
}
