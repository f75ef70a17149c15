//! Logs that are cut at every byte and logs with bits turned over, of every format that is read: what is before a cut is read as it was, and
//! nothing makes the reader panic, hang or give more than there is.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use seepd_logs::{LogMapping, SignalMapping};
use seepd_signals::Signal;

use super::sequences;
use crate::support::{fixture, mcap_of};

/// A log of a few hundred samples takes a millisecond.
const LONGEST: Duration = Duration::from_secs(5);

/// What a log holds, each frame or sample as text; an error ends it.
fn read(path: &Path) -> Vec<String> {
    let begin = Instant::now();
    let mut items = Vec::new();
    if let Ok(mut frames) = seepd_logs::frames(path) {
        while let Ok(Some(frame)) = frames.next_frame() {
            items.extend(frame.ok().map(|frame| format!("{frame:?}")));
        }
    } else if let Ok(mut source) = seepd_logs::open(path, &mapping(path)) {
        while let Ok(Some(sample)) = source.next_sample() {
            items.push(format!("{sample:?}"));
        }
    }
    assert!(begin.elapsed() < LONGEST, "{}: {:?}", path.display(), begin.elapsed());
    items
}

/// The command's name in measured signals; everywhere else it has its own.
fn mapping(path: &Path) -> LogMapping {
    let is_measured = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("asammdf"));
    let valve = SignalMapping { field: "valve".into(), ..SignalMapping::default() };
    let signals = is_measured.then_some((Signal::Command, valve)).into_iter().collect();
    LogMapping { signals, ..LogMapping::default() }
}

/// Whether all of some are among others, in their order.
fn are_among(some: &[String], others: &[String]) -> bool {
    let mut others = others.iter();
    some.iter().all(|one| others.any(|other| other == one))
}

/// An MCAP of a few hundred messages, in chunks of some.
fn mcap(compression: Option<mcap::Compression>, has_chunks: bool) -> Vec<u8> {
    let options = mcap::WriteOptions::new();
    let options = options.compression(compression).chunk_size(Some(4000)).use_chunks(has_chunks);
    mcap_of(options, (0..300).map(|number| f64::from(number) / 1000.0))
}

/// A small log of each format, under a name that ends as theirs do.
fn logs() -> Vec<(String, Vec<u8>)> {
    let mut logs = vec![
        ("plain.mcap".to_owned(), mcap(None, false)),
        ("zstd.mcap".to_owned(), mcap(Some(mcap::Compression::Zstd), true)),
        ("lz4.mcap".to_owned(), mcap(Some(mcap::Compression::Lz4), true)),
    ];
    let csv: String = (0..300).map(|number| format!("0.{number:03},0.{number:03}\n")).collect();
    logs.push(("table.csv".to_owned(), format!("t_s,command\n{csv}").into_bytes()));
    let mut files: Vec<PathBuf> =
        fs::read_dir(fixture("logs")).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    for file in files.into_iter().filter(|file| file.is_file()) {
        let name = file.file_name().unwrap().to_str().unwrap().to_owned();
        if !name.ends_with(".json") && !name.ends_with(".dbc") && fs::metadata(&file).unwrap().len() < 20_000
        {
            logs.push((name, fs::read(&file).unwrap()));
        }
    }
    logs
}

/// A log beside what is made of it.
struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        Bench { folder: tempfile::tempdir().unwrap() }
    }

    fn read(&self, name: &str, bytes: &[u8]) -> Vec<String> {
        let path = self.folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        read(&path)
    }
}

/// Every byte with `SEEPD_SEQUENCES=0`; else each so many-th.
#[test]
fn what_is_before_a_cut_is_read_as_it_was() {
    let (bench, step) = (Bench::new(), sequences(61).max(1) as usize);
    let mut cuts = 0;
    for (name, whole) in logs() {
        let all = bench.read(&name, &whole);
        let mut most = 0;
        for length in (0..whole.len()).step_by(step) {
            let some = bench.read(&name, &whole[..length]);
            // A number that is cut may be another one, in the last place. Of MDF whole groups of frames may be behind the cut.
            let sure = &some[..some.len().saturating_sub(1)];
            let holds = if name.ends_with(".mf4") { are_among(sure, &all) } else { all.starts_with(sure) };
            assert!(some.len() <= all.len() && holds, "{name} cut at {length}");
            most = most.max(some.len());
            cuts += 1;
        }
        println!("{name}: {} bytes, {} items, {most} of a cut one", whole.len(), all.len());
    }
    println!("{cuts} cuts");
}

/// `SEEPD_SEQUENCES=8000` turns over so many bits of each log, one at a time and then some at once.
#[test]
fn bits_that_are_turned_over_break_no_reader() {
    let (bench, turns) = (Bench::new(), sequences(60));
    let (mut seed, mut turned) = (11_u64, 0);
    for (name, whole) in logs() {
        for turn in 0..turns {
            let mut bytes = whole.clone();
            for _ in 0..=turn % 8 {
                let place = (super::random(&mut seed) % (whole.len() as u64 * 8)) as usize;
                bytes[place / 8] ^= 1 << (place % 8);
            }
            bench.read(&name, &bytes);
            turned += 1;
        }
    }
    println!("{turned} logs");
}
