//! Bad input, each with its own test: one clear line or a counted rejection, and every good sample is used.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use seepd_logs::LogMapping;
use seepd_logs::McapSource;
use seepd_logs::Source;
use seepd_signals::Signal;

use crate::support::{estimates, fixture, mcap_of, reasons, replay, seepd, simulate, stderr, summary};

/// Exit code and the one line of a run that must fail.
fn refusal<A: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = A>) -> (i32, String) {
    let output = seepd(arguments);
    let text = stderr(&output);
    assert_eq!(text.trim_end().lines().count(), 1, "one line: {text}");
    (output.status.code().unwrap(), text)
}

fn replay_refusal(log: &Path) -> (i32, String) {
    refusal(["replay", log.to_str().unwrap()])
}

fn file(folder: &tempfile::TempDir, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, content).unwrap();
    path
}

/// The fixture's cycle four times over as CSV rows `time,command`, changed by row number.
fn rows(change: impl Fn(usize, f64, f64) -> Option<String>) -> String {
    let text = fs::read_to_string(fixture("nominal_leak_1e-6.csv")).unwrap();
    let commands: Vec<f64> =
        text.lines().skip(1).map(|row| row.split(',').nth(1).unwrap().parse().unwrap()).collect();
    let mut out = String::from("t_s,command\n");
    for number in 0..4 * commands.len() {
        if let Some(row) = change(number, number as f64 * 1e-3, commands[number % commands.len()]) {
            out += &row;
            out.push('\n');
        }
    }
    out
}

fn plain(time: f64, command: f64) -> Option<String> {
    Some(format!("{time:.3},{command}"))
}

#[test]
fn empty_file_is_unreadable_data() {
    let folder = tempfile::tempdir().unwrap();
    let (code, text) = replay_refusal(&file(&folder, "empty.mcap", ""));
    assert_eq!((code, text.contains("the file is empty")), (65, true), "{text}");
}

#[test]
fn missing_file_is_no_input_and_a_folder_too() {
    let folder = tempfile::tempdir().unwrap();
    let (code, text) = replay_refusal(&folder.path().join("nowhere.mcap"));
    assert_eq!((code, text.contains("nowhere.mcap")), (66, true), "{text}");
    assert_eq!(replay_refusal(folder.path()).0, 66);
}

#[test]
fn file_of_another_kind_is_unreadable_data() {
    let folder = tempfile::tempdir().unwrap();
    let (code, text) = replay_refusal(&file(&folder, "noise.bin", [0u8, 159, 146, 150, 1, 2, 3]));
    assert_eq!((code, text.contains("of no kind that is read")), (65, true), "{text}");
    let (code, text) = replay_refusal(&file(&folder, "prose.txt", "Dear reader,\nthis is no log.\n"));
    assert_eq!(
        (
            code,
            text.contains(
                "no column `t_s` for the time and no column `command` for the command; there are: Dear reader"
            )
        ),
        (65, true),
        "{text}"
    );
    assert_eq!(replay_refusal(&file(&folder, "cut.mcap", b"\x89MCAP")).0, 65);
}

#[test]
fn topic_that_matches_nothing_lists_what_is_there() {
    let (code, text) = replay_refusal(&fixture("mcap/generated/axis_lz4_chunked.mcap"));
    assert_eq!(code, 65);
    assert!(
        text.contains("the log has /axis/sample (json, 2000 messages), /axis/status (json, 20 messages)"),
        "{text}"
    );
    let (code, text) = refusal([
        "replay",
        "--topic",
        "/press/9",
        fixture("mcap/generated/axis_unchunked.mcap").to_str().unwrap(),
    ]);
    assert_eq!(
        (code, text.contains("`command` on topic /press/9; the log has /axis/sample")),
        (65, true),
        "{text}"
    );
}

#[test]
fn csv_without_a_command_lists_its_columns() {
    let folder = tempfile::tempdir().unwrap();
    let (code, text) = replay_refusal(&file(&folder, "log.csv", "t_s,valve,position\n0.0,0.1,0.2\n"));
    assert_eq!(
        (code, text.contains("no column `command`") && text.contains("t_s, valve, position")),
        (65, true),
        "{text}"
    );
}

#[test]
fn endless_chunk_length_is_refused_without_memory() {
    let (code, text) = replay_refusal(&fixture("mcap/rust_crate/chunk_not_closed.mcap"));
    assert_eq!((code, text.contains("the log has no topics at all")), (65, true), "{text}");
}

/// Found by fuzzing: a topic's length of 4 GiB.
#[test]
fn endless_topic_is_passed_over_without_memory() {
    let (code, text) = replay_refusal(&fixture("endless_topic.mcap"));
    assert_eq!((code, text.contains("no message has `command`")), (65, true), "{text}");
}

/// Time and command of every sample that a log gives, however it ends.
fn samples_of(bytes: &[u8]) -> Vec<(i64, u64)> {
    let Ok(mut source) = McapSource::new(Cursor::new(bytes), "log", LogMapping::default().places()) else {
        return Vec::new();
    };
    let mut samples = Vec::new();
    while let Ok(Some(sample)) = source.next_sample() {
        samples.push((sample.time_ns, sample.get(Signal::Command).unwrap().to_bits()));
    }
    samples
}

/// A log with chunks of 64 KiB that are `compression`, of 4 s.
fn small_log(compression: Option<mcap::Compression>) -> Vec<u8> {
    let options = mcap::WriteOptions::new().compression(compression).chunk_size(Some(1 << 14));
    mcap_of(options, (0..4000).map(|number| f64::from(number % 997) / 1000.0))
}

const COMPRESSIONS: [Option<mcap::Compression>; 3] =
    [None, Some(mcap::Compression::Lz4), Some(mcap::Compression::Zstd)];

/// Cut at any byte, what is read is a prefix of the log, and hardly less than the share that is there.
#[test]
fn property_log_cut_at_any_byte_is_read_up_to_the_cut() {
    for compression in COMPRESSIONS {
        let bytes = small_log(compression);
        let whole = samples_of(&bytes);
        assert_eq!(whole.len(), 4000);
        let mut before = 0;
        for cut in (0..bytes.len()).step_by(211) {
            let samples = samples_of(&bytes[..cut]);
            assert!(samples == whole[..samples.len()], "cut at {cut}");
            assert!(samples.len() >= before, "cut at {cut}");
            before = samples.len();
        }
        assert_eq!(before, 4000);
    }
}

#[test]
fn cut_log_says_what_it_missed() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    simulate(&log, &["--cycles", "4", "--leak-area", "1e-6"]);
    let bytes = fs::read(&log).unwrap();
    let cut = file(&folder, "cut.mcap", &bytes[..bytes.len() * 6 / 10]);
    let output = seepd(["replay", "--json", cut.to_str().unwrap()]);
    assert!(output.status.success());
    assert!(stderr(&output).contains("ends at byte"), "{}", stderr(&output));
    assert_eq!(estimates(&replay(&cut, &[])).len(), 2);
    assert_eq!(reasons(&replay(&cut, &[])), ["incomplete"]);
}

/// One flipped bit anywhere: every sample that is read is one of the log's, in a chunked log at most the chunks
/// that the bit touches are lost, and never the process.
#[test]
fn property_log_with_one_flipped_bit_loses_at_most_a_chunk() {
    for compression in COMPRESSIONS {
        let bytes = small_log(compression);
        let whole = samples_of(&bytes);
        let mut generator = 12345u64;
        for _ in 0..400 {
            generator = generator.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let at = (generator >> 20) as usize % bytes.len();
            let mut damaged = bytes.clone();
            damaged[at] ^= 1 << (generator >> 61);
            let samples = samples_of(&damaged);
            let mut remaining = whole.iter();
            assert!(samples.iter().all(|sample| remaining.any(|other| other == sample)), "bit in byte {at}");
            // A chunk holds about 300 of the 4,000 samples; the magic bytes are all or nothing.
            assert!(samples.len() >= 3300 || at < 8, "bit in byte {at}: {} samples", samples.len());
        }
    }
}

#[test]
fn wrong_crc_costs_its_chunk_alone_and_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    simulate(&log, &["--cycles", "6", "--leak-area", "1e-6", "--compression", "none"]);
    let mut bytes = fs::read(&log).unwrap();
    // A digit of a message's command about the middle of the log.
    let middle = bytes.len() / 2;
    let at = middle + bytes[middle..].windows(11).position(|w| w == b"{\"command\":").unwrap() + 14;
    bytes[at] ^= 1;
    let damaged = file(&folder, "damaged.mcap", &bytes);
    let output = seepd(["replay", "--json", damaged.to_str().unwrap()]);
    assert!(stderr(&output).contains("1 damaged chunks"), "{}", stderr(&output));
    let lines = replay(&damaged, &[]);
    let rejected = reasons(&lines);
    assert!(
        (1..=2).contains(&rejected.len()) && rejected.iter().all(|reason| reason == "gap"),
        "{rejected:?}"
    );
    assert_eq!(estimates(&lines).len() + rejected.len(), 6);
}

#[test]
fn command_that_is_stuck_has_no_estimate_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let log = file(&folder, "stuck.csv", rows(|_, t, _| plain(t, 0.0123)));
    let lines = replay(&log, &[]);
    assert_eq!(
        (summary(&lines)["cycles"].as_u64(), summary(&lines)["flag"].as_str()),
        (Some(0), Some("no_estimate"))
    );
    assert_eq!(summary(&lines)["reason"], "stuck");
    // Stuck for a while only, amid a stroke: that cycle alone.
    let log = file(
        &folder,
        "frozen.csv",
        rows(|n, t, u| plain(t, if (11_200..11_900).contains(&n) { 0.15 } else { u })),
    );
    let lines = replay(&log, &[]);
    assert_eq!((estimates(&lines).len(), reasons(&lines)), (3, vec!["stuck".to_owned()]));
}

#[test]
fn command_out_of_range_is_counted_and_its_cycle_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let log = file(
        &folder,
        "log.csv",
        rows(|n, t, u| plain(t, if (13_000..13_060).contains(&n) { 4.2 } else { u })),
    );
    let lines = replay(&log, &[]);
    assert_eq!((estimates(&lines).len(), reasons(&lines)), (3, vec!["out_of_range".to_owned()]));
    assert_eq!(summary(&lines)["samples_rejected"]["out_of_range"], 60);
    // A command in percent throughout: nothing can be used, and that is said.
    let log = file(&folder, "percent.csv", rows(|_, t, u| plain(t, 50.0 + 100.0 * u)));
    assert_eq!(summary(&replay(&log, &[]))["reason"], "out_of_range");
}

#[test]
fn command_not_a_number_is_counted_and_its_cycle_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let log = file(
        &folder,
        "log.csv",
        rows(|n, t, u| plain(t, if (13_000..13_060).contains(&n) { f64::NAN } else { u })),
    );
    let lines = replay(&log, &[]);
    assert_eq!((estimates(&lines).len(), reasons(&lines)), (3, vec!["not_a_number".to_owned()]));
    assert_eq!(summary(&lines)["samples_rejected"]["not_a_number"], 60);
    // A single one is bridged.
    let log = file(&folder, "one.csv", rows(|n, t, u| plain(t, if n == 13_000 { f64::NAN } else { u })));
    assert_eq!(estimates(&replay(&log, &[])).len(), 4);
}

#[test]
fn rows_that_are_no_numbers_are_left_out_and_told() {
    let folder = tempfile::tempdir().unwrap();
    let text = rows(|n, t, u| if n == 4_999 { Some("oops,0.1".into()) } else { plain(t, u) });
    let output = seepd(["replay", "--json", file(&folder, "log.csv", text).to_str().unwrap()]);
    assert!(
        stderr(&output).contains("1 rows were left out, the first at line 5001: `oops` is not a number"),
        "{}",
        stderr(&output)
    );
    assert_eq!(String::from_utf8(output.stdout).unwrap().lines().count(), 5);
}

#[test]
fn command_at_another_rate_is_refused_with_both_rates() {
    let folder = tempfile::tempdir().unwrap();
    let log = file(&folder, "log.csv", rows(|n, t, u| if n % 4 == 0 { plain(t, u) } else { None }));
    let (code, text) = refusal(["replay", "--quiet", log.to_str().unwrap()]);
    assert_eq!(code, 65);
    assert!(text.contains("the command comes at 250.0 Hz, the model reads 1000 Hz"), "{text}");
}

#[test]
fn model_for_another_rate_is_refused_with_both_rates() {
    let folder = tempfile::tempdir().unwrap();
    let model = String::from_utf8(seepd::EMBEDDED_MODEL.to_vec()).unwrap();
    let model = model
        .replace("\"sample_rate_hz\":1000.0", "\"sample_rate_hz\":500.0")
        .replace("\"bin_samples\":50", "\"bin_samples\":25");
    let model = file(&folder, "model.json", model);
    let log = fixture("nominal_leak_1e-6.csv");
    let (code, text) =
        refusal(["replay", "--quiet", "--model", model.to_str().unwrap(), log.to_str().unwrap()]);
    assert_eq!(code, 65);
    assert!(text.contains("comes at 1000.0 Hz, the model reads 500 Hz"), "{text}");
}

#[test]
fn time_that_goes_backwards_costs_one_cycle() {
    let folder = tempfile::tempdir().unwrap();
    // The clock is set back by 100 s amid the second cycle.
    let log =
        file(&folder, "log.csv", rows(|n, t, u| plain(if n < 14_000 { t + 200.0 } else { t + 100.0 }, u)));
    let lines = replay(&log, &[]);
    assert_eq!((estimates(&lines).len(), reasons(&lines)), (3, vec!["out_of_order".to_owned()]));
}

#[test]
fn damaged_model_is_a_configuration_error_with_its_path() {
    let folder = tempfile::tempdir().unwrap();
    let log = fixture("nominal_leak_1e-6.csv");
    let with = |model: &Path| refusal(["replay", "--model", model.to_str().unwrap(), log.to_str().unwrap()]);
    let (code, text) = with(&file(&folder, "cut.json", &seepd::EMBEDDED_MODEL[..9000]));
    assert_eq!((code, text.contains("cut.json: model:")), (78, true), "{text}");
    let other = String::from_utf8(seepd::EMBEDDED_MODEL.to_vec()).unwrap().replacen(
        "\"kurtosis\"",
        "\"kurtosys\"",
        1,
    );
    let (code, text) = with(&file(&folder, "other.json", other));
    assert_eq!((code, text.contains("features[3]: unknown feature `kurtosys`")), (78, true), "{text}");
    assert_eq!(with(&folder.path().join("none.json")).0, 66);
}

#[test]
fn plant_file_errors_name_file_line_and_key() {
    let folder = tempfile::tempdir().unwrap();
    let with = |text: &str| {
        let plant = file(&folder, "plant.toml", text);
        refusal([
            "simulate",
            "--out",
            folder.path().join("x.mcap").to_str().unwrap(),
            "--plant",
            plant.to_str().unwrap(),
        ])
    };
    let (code, text) = with("[plant]\nbulk_modulos_pa = 1e9\n");
    assert_eq!(code, 78);
    assert!(
        text.contains("plant.toml: line 2: unknown key `bulk_modulos_pa`; did you mean `bulk_modulus_pa`?"),
        "{text}"
    );
    let (code, text) = with("[plant]\nsupply_volume_m3 = -2e-3\n");
    assert_eq!(
        (code, text.contains("line 2: `plant.supply_volume_m3` is -0.002; it must be positive")),
        (78, true),
        "{text}"
    );
    let (code, text) = with("[plant]\ntransition_pressure_pa = 100.0\n");
    assert_eq!((code, text.contains("is unstable at 10 RK4 steps per period")), (78, true), "{text}");
    assert!(text.contains("set controller.steps_per_period to"), "{text}");
}

#[test]
fn configuration_errors_name_file_line_and_key() {
    let folder = tempfile::tempdir().unwrap();
    let with = |text: &str| {
        let config = file(&folder, "seepd.toml", text);
        refusal([
            "replay",
            "--config",
            config.to_str().unwrap(),
            fixture("nominal_leak_0.csv").to_str().unwrap(),
        ])
    };
    let (code, text) = with("axis = \"a\"\n[alarms]\nwatch_lpm = 0.2\n");
    assert_eq!(code, 78);
    assert!(text.contains("seepd.toml: line 2: unknown key `alarms`; did you mean `alarm`?"), "{text}");
    let (code, text) = with("[alarm]\nwatch_lpm = 5.0\n");
    assert_eq!((code, text.contains("must be positive and ascend")), (78, true), "{text}");
    let (code, text) = with("[signals.command]\nscale = 0.0\n");
    assert_eq!(
        (code, text.contains("signals.command: scale must be finite and not 0")),
        (78, true),
        "{text}"
    );
}

#[test]
fn wrong_arguments_are_usage() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("x.mcap");
    let out = out.to_str().unwrap();
    assert_eq!(seepd(["replay"]).status.code(), Some(64));
    assert_eq!(seepd(["replai"]).status.code(), Some(64));
    let (code, text) = refusal(["simulate", "--out", out, "--with", "valve_deadbnd.half_width=0.1"]);
    assert_eq!((code, text.contains("did you mean `valve_deadband`?")), (64, true), "{text}");
    let (code, text) = refusal(["simulate", "--out", out, "--leak-area=-1"]);
    assert_eq!((code, text.contains("--leak-area is -1; it must lie in 0 …")), (64, true), "{text}");
    assert_eq!(refusal(["simulate", "--out", out, "--with", "nonsense"]).0, 64);
    assert_eq!(refusal(["simulate", "--out", out, "--leak-step", "1e-7"]).0, 64);
    assert_eq!(refusal(["train", "--out", out, "--observations", "3"]).0, 64);
}

#[test]
fn output_that_cannot_be_written_is_an_input_output_error() {
    let (code, text) = refusal(["simulate", "--out", "/nonexistent-folder/x.mcap"]);
    assert_eq!((code, text.contains("writing /nonexistent-folder/x.mcap")), (74, true), "{text}");
}
