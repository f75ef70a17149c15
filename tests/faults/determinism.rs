//! Recordings with faults in them, drawn at random: what the daemon says of a source, and what a replay says of the daemon's recording of it and
//! of the source itself, are the same bytes.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

use super::sequences;
use crate::daemon::{Daemon, cycle};
use crate::support::{seepd, stderr};

const MS_NS: i64 = 1_000_000;
/// Samples of a cycle.
const CYCLE: usize = 10_000;

/// What happened to a stretch of a recording; where it begins and how long it is are shares of the whole, in thousandths.
#[derive(Debug, Clone)]
enum Harm {
    Gap,
    /// Each sample twice, at the same time.
    Twice,
    /// The whole stretch again, with its old times.
    Again,
    Backwards,
    NotANumber,
    Infinite,
    /// What the command cannot be.
    Wild(f64),
    Frozen,
    /// All from here on is so much later, or earlier.
    TimeStep(i64),
    /// Times are off by up to so many ns.
    Jitter(i64),
}

#[derive(Debug, Clone)]
struct Recording {
    leak: usize,
    from: usize,
    samples: usize,
    begin_ns: i64,
    harms: Vec<(Harm, usize, usize)>,
    is_mcap: bool,
    /// The file is cut at this share of its length, in thousandths.
    cut: Option<usize>,
    /// Files of the daemon's recording are this large, MB.
    file_mb: f64,
}

const LEAKS: [&str; 2] = ["nominal_leak_0.csv", "nominal_leak_1e-6.csv"];
/// From a clock that was never set to the last that a signed number of nanoseconds holds.
const BEGINNINGS_NS: [i64; 4] = [0, 1_800_000_000_000_000_000, 4_294_967_290_000_000_000, 3_600_000_000_123];

fn recordings() -> impl Strategy<Value = Recording> {
    let steps = prop_oneof![
        Just(1_i64),
        Just(-1),
        Just(3_600_000_000_000),
        Just(-3_600_000_000_000),
        Just(946_684_800_000_000_000),
        Just(-946_684_800_000_000_000),
        -20_000_000_000..20_000_000_000_i64,
    ];
    let harm = prop_oneof![
        Just(Harm::Gap),
        Just(Harm::Twice),
        Just(Harm::Again),
        Just(Harm::Backwards),
        Just(Harm::NotANumber),
        Just(Harm::Infinite),
        (-1e6..1e6_f64).prop_map(Harm::Wild),
        Just(Harm::Frozen),
        steps.prop_map(Harm::TimeStep),
        (1..3_000_000_i64).prop_map(Harm::Jitter),
    ];
    let lengths = prop_oneof![3 => 0..20_usize, 1 => 0..400_usize];
    let harms = prop::collection::vec((harm, 0..1000_usize, lengths), 0..5);
    let cut = prop::option::weighted(0.3, 0..1000_usize);
    (
        0..LEAKS.len(),
        0..CYCLE,
        CYCLE / 2..4 * CYCLE,
        prop::sample::select(&BEGINNINGS_NS[..]),
        harms,
        any::<bool>(),
        cut,
        prop_oneof![Just(0.2), Just(50.0)],
    )
        .prop_map(|(leak, from, samples, begin_ns, harms, is_mcap, cut, file_mb)| Recording {
            leak,
            from,
            samples,
            begin_ns,
            harms,
            is_mcap,
            cut,
            file_mb,
        })
}

impl Harm {
    fn befall(&self, samples: &mut Vec<(i64, f64)>, from: usize, length: usize) {
        let until = (from + length).min(samples.len());
        let stretch = from..until;
        match *self {
            Harm::Gap => drop(samples.drain(stretch)),
            Harm::Twice => {
                let twice: Vec<_> = samples[stretch.clone()].iter().flat_map(|sample| [*sample; 2]).collect();
                samples.splice(stretch, twice);
            }
            Harm::Again => {
                let again = samples[stretch].to_vec();
                samples.splice(until..until, again);
            }
            Harm::Backwards => samples[stretch].reverse(),
            Harm::NotANumber => samples[stretch].iter_mut().for_each(|sample| sample.1 = f64::NAN),
            Harm::Infinite => samples[stretch].iter_mut().for_each(|sample| sample.1 = f64::NEG_INFINITY),
            Harm::Wild(value) => samples[stretch].iter_mut().for_each(|sample| sample.1 = value),
            Harm::Frozen => {
                let value = samples.get(from).map_or(0.0, |sample| sample.1);
                samples[stretch].iter_mut().for_each(|sample| sample.1 = value);
            }
            Harm::TimeStep(ns) => {
                samples[from..].iter_mut().for_each(|sample| sample.0 = sample.0.saturating_add(ns));
            }
            Harm::Jitter(most_ns) => {
                let mut seed = from as u64;
                for sample in &mut samples[stretch] {
                    sample.0 += (super::random(&mut seed) % most_ns as u64) as i64;
                }
            }
        }
    }
}

impl Recording {
    fn samples(&self) -> Vec<(i64, f64)> {
        let command = cycle(LEAKS[self.leak]);
        let sample = |number: usize| {
            let value = command[(self.from + number) % command.len()];
            (self.begin_ns + number as i64 * MS_NS, value)
        };
        let mut samples: Vec<(i64, f64)> = (0..self.samples).map(sample).collect();
        for (harm, from, length) in &self.harms {
            let whole = samples.len();
            harm.befall(&mut samples, from * whole / 1000, length * whole / 1000);
        }
        // A recording is MCAP, whose times have no sign: a log from before 1970 is recorded as of 1970. No live sample is from there.
        samples.retain(|(time_ns, _)| *time_ns >= 0);
        samples
    }

    /// Size of the daemon's files, MB. A clock that knows no date is taken to begin anew with a file that begins before the end of the
    /// one before it, which is right for machines and wrong for a log that runs backwards just there: such a log has one file.
    fn file_mb(&self) -> f64 {
        let know_dates = self.samples().iter().all(|(time_ns, _)| seepd_logs::record::knows_date(*time_ns));
        if know_dates { self.file_mb } else { 50.0 }
    }

    fn write(&self, folder: &Path) -> PathBuf {
        let samples = self.samples();
        let mut bytes = if self.is_mcap { mcap(&samples) } else { csv(&samples) };
        if let Some(share) = self.cut {
            bytes.truncate(bytes.len() * share / 1000);
        }
        let path = folder.join(if self.is_mcap { "source.mcap" } else { "source.csv" });
        fs::write(&path, bytes).unwrap();
        path
    }
}

fn csv(samples: &[(i64, f64)]) -> Vec<u8> {
    let mut text = b"t_s,command\n".to_vec();
    for (time_ns, command) in samples {
        let sign = if *time_ns < 0 { "-" } else { "" };
        let (seconds, rest) =
            (time_ns.unsigned_abs() / 1_000_000_000, time_ns.unsigned_abs() % 1_000_000_000);
        writeln!(text, "{sign}{seconds}.{rest:09},{command}").unwrap();
    }
    text
}

fn mcap(samples: &[(i64, f64)]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new().chunk_size(Some(50_000)).compression(None);
    let mut writer = options.create(&mut bytes).unwrap();
    let schema = writer.add_schema("seepd.Signals", "jsonschema", b"{}").unwrap();
    let channel_id = writer.add_channel(schema, "/axis/signals", "json", &Default::default()).unwrap();
    for (sequence, (time_ns, command)) in (0..).zip(samples) {
        let time = *time_ns as u64;
        let header =
            mcap::records::MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        let number = if command.is_finite() { command.to_string() } else { "NaN".into() };
        writer.write_to_known_channel(&header, format!("{{\"command\":{number}}}").as_bytes()).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    bytes.into_inner()
}

/// What the daemon has said, as its recording has it: everything but samples, in order.
fn said(files: &[PathBuf]) -> Vec<String> {
    let mut said = Vec::new();
    for file in files {
        let bytes = fs::read(file).unwrap();
        for message in mcap::MessageStream::new(&bytes).unwrap() {
            let message = message.unwrap();
            if !message.channel.topic.ends_with("/signals") {
                said.push(String::from_utf8(message.data.into_owned()).unwrap());
            }
        }
    }
    said
}

/// What a replay says: cycles, flags and notices, in order.
///
/// # Errors
/// It cannot read a log, and why.
fn replayed(folder: &Path, files: &[PathBuf], more: &[&str]) -> Result<Vec<String>, String> {
    let out = folder.join("replay.mcap");
    let mut arguments = vec!["replay", "--quiet", "--force", "--mcap", out.to_str().unwrap()];
    arguments.extend(more);
    arguments.extend(files.iter().map(|path| path.to_str().unwrap()));
    let output = seepd(arguments);
    if !output.status.success() {
        return Err(format!("{}: {}", output.status, stderr(&output)));
    }
    let as_named = |line: String| line.replacen("\"axis\":\"axis\",", "\"axis\":\"press-1\",", 1);
    Ok(said(&[out]).into_iter().map(as_named).collect())
}

/// Lines of the daemon and of both replays of a recording, which must be the same.
fn try_recording(recording: &Recording) -> Result<usize, TestCaseError> {
    let folder = tempfile::tempdir().unwrap();
    let source = recording.write(folder.path());
    let config = format!(
        "axis = \"press-1\"\nstate_dir = \"state\"\n[source]\nlog = \"{}\"\npace = \"fast\"\n[recording]\nfile_mb = {:.1}\n",
        source.display(),
        recording.file_mb()
    );
    let daemon = Daemon::start(folder.path(), &config);
    let log = daemon.log.clone();
    daemon.wait();
    let words = fs::read_to_string(log).unwrap();
    prop_assert!(!words.contains("panic"), "{}", words);
    let mut files: Vec<PathBuf> = fs::read_dir(folder.path().join("state/recordings"))
        .into_iter()
        .flatten()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort_by_key(|file| file.to_string_lossy().rsplit_once('-').map(|(_, number)| number.to_owned()));
    let said = said(&files);
    // What cannot be read at all says nothing, wherever it is refused.
    let or_nothing = |replayed: Result<Vec<String>, String>| {
        if said.is_empty() { Ok(replayed.unwrap_or_default()) } else { replayed }
    };
    if !files.is_empty() {
        let of_recording = replayed(folder.path(), &files, &["--topic", "/press-1/signals"]);
        prop_assert_eq!(
            or_nothing(of_recording),
            Ok(said.clone()),
            "of the recording; the daemon: {}",
            words
        );
    }
    let of_source = replayed(folder.path(), &[source], &[]);
    prop_assert_eq!(or_nothing(of_source), Ok(said.clone()), "of the source; the daemon: {}", words);
    Ok(said.len())
}

/// `SEEPD_SEQUENCES=1000 cargo test --workspace --test gateway faults::determinism -- --nocapture` for a long run.
#[test]
fn the_daemon_and_replays_say_the_same_bytes_of_recordings_with_faults() {
    let cases = sequences(16);
    let config = Config { cases, max_shrink_iters: 30, failure_persistence: None, ..Config::default() };
    let rng = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    let lines = std::cell::Cell::new(0);
    let outcome = TestRunner::new_with_rng(config, rng).run(&recordings(), |recording| {
        lines.set(lines.get() + try_recording(&recording)?);
        Ok(())
    });
    println!("{cases} recordings, {} lines", lines.get());
    outcome.unwrap_or_else(|error| panic!("{error}"));
    assert!(lines.get() > cases as usize, "{} lines: nothing was compared", lines.get());
    // One more, of which a reader knows that it is right: a whole recording has its cycles.
    let whole = Recording {
        leak: 1,
        from: 0,
        samples: 3 * CYCLE,
        begin_ns: 0,
        harms: Vec::new(),
        is_mcap: true,
        cut: None,
        file_mb: 0.2,
    };
    assert!(try_recording(&whole).unwrap() >= 3);
}
