//! Where the daemon's own words go: the journal with levels and fields, or standard error.
//!
//! Standard error may be a file on a full disk, or a pipe whose reader has stopped. A thread of its own writes there, so that what nobody
//! takes holds up nothing: what finds no room is lost, counted, and told of once somebody takes lines again.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, Write};
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use tokio::time::Instant;
use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use crate::failure::{Code, Failure};
use crate::sink::plain::Plain;

/// Lines on their way to standard error.
const LINES_UNDER_WAY: usize = 1024;
/// What must be told although nothing more is logged is looked at this often.
const LOOK: Duration = Duration::from_secs(1);
/// At its end the program waits so long for its last lines to be taken.
const LAST_LINES: Duration = Duration::from_millis(500);

/// Begins logging: to the journal where standard error is connected to it, else to standard error. What is logged is written at the
/// latest when the answer goes.
///
/// # Errors
/// [`Failure`] where the level is none, or logging has begun already.
pub fn begin(level: &str) -> Result<Journal, Failure> {
    let level: LevelFilter = level.parse().map_err(|_| {
        let message = format!("--log-level is `{level}`; it must be error, warn, info, debug or trace");
        Failure::new(Code::Usage, message)
    })?;
    let internal = |error: &dyn std::fmt::Display| Failure::new(Code::Internal, error.to_string());
    let journal = std::env::var_os("JOURNAL_STREAM").and_then(|_| tracing_journald::layer().ok());
    let (lines, written) = match &journal {
        Some(_) => (None, None),
        None => {
            start_writing().map_err(|error| internal(&error)).map(|(lines, end)| (Some(lines), Some(end)))?
        }
    };
    let terminal = lines.clone().map(|lines| {
        let layer = tracing_subscriber::fmt::layer().with_writer(lines).with_target(false).with_ansi(false);
        // It would say on standard error that standard error takes nothing, and panic over it.
        layer.log_internal_errors(false)
    });
    tracing_subscriber::registry()
        .with(level)
        .with(journal.map(|journal| journal.with_syslog_identifier("seepd".into())))
        .with(terminal)
        .try_init()
        .map_err(|error| internal(&error))?;
    Ok(Journal { lines, written })
}

/// A journal that is being written.
pub struct Journal {
    lines: Option<Lines>,
    written: Option<Receiver<()>>,
}

impl Drop for Journal {
    fn drop(&mut self) {
        // A full queue has nobody who takes it, and is not waited for.
        if let (Some(lines), Some(written)) = (&self.lines, &self.written)
            && lines.sender.try_send(None).is_ok()
        {
            let _ = written.recv_timeout(LAST_LINES);
        }
    }
}

/// Where lines go on their way to standard error. `None` is the last.
#[derive(Clone)]
struct Lines {
    sender: SyncSender<Option<Vec<u8>>>,
    lost: Arc<AtomicU64>,
}

impl Write for Lines {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        if self.sender.try_send(Some(line.to_vec())).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl MakeWriter<'_> for Lines {
    type Writer = Self;

    fn make_writer(&self) -> Self {
        self.clone()
    }
}

/// Starts the thread that writes; the other end of what it gives is gone once all is written.
fn start_writing() -> io::Result<(Lines, Receiver<()>)> {
    // Not the library's own handle, which whoever waits for a reader would keep from everybody.
    let out = Plain(File::from(io::stderr().as_fd().try_clone_to_owned()?));
    let (sender, coming) = sync_channel(LINES_UNDER_WAY);
    let (end, written) = sync_channel(1);
    let lost = Arc::new(AtomicU64::new(0));
    let counted = Arc::clone(&lost);
    thread::Builder::new().name("journal".into()).spawn(move || {
        write_lines(out, &coming, &counted);
        drop(end);
    })?;
    Ok((Lines { sender, lost }, written))
}

/// Writes lines until the last.
fn write_lines(mut out: impl Write, coming: &Receiver<Option<Vec<u8>>>, lost: &AtomicU64) {
    loop {
        match coming.recv_timeout(LOOK) {
            Ok(Some(line)) => {
                if out.write_all(&line).is_err() {
                    lost.fetch_add(1, Ordering::Relaxed);
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Ok(None) | Err(RecvTimeoutError::Disconnected) => return tell_lost(&mut out, lost),
        }
        tell_lost(&mut out, lost);
    }
}

/// Tells how many lines are missing, once that can be told.
fn tell_lost(out: &mut impl Write, lost: &AtomicU64) {
    let count = lost.load(Ordering::Relaxed);
    if count > 0
        && writeln!(out, "{count} lines of the log before this one are lost: nobody took them").is_ok()
    {
        lost.fetch_sub(count, Ordering::Relaxed);
    }
}

/// Different warnings that are logged in a while, once each; the others are counted.
const WARNINGS: usize = 10;
/// That while.
const WHILE: Duration = Duration::from_secs(10);

/// Warnings about what others send: a flood of it must not become a flood in the journal.
#[derive(Debug)]
pub struct Warnings {
    since: Instant,
    said: BTreeSet<String>,
    unsaid: u64,
}

impl Warnings {
    /// None yet.
    pub fn new(now: Instant) -> Self {
        Warnings { since: now, said: BTreeSet::new(), unsaid: 0 }
    }

    /// Logs a warning, or counts it where it or many others were logged lately.
    pub fn warn(&mut self, now: Instant, text: &str) {
        match self.admit(now, text) {
            Some(0) => tracing::warn!("{text}"),
            Some(unsaid) => tracing::warn!("{text} ({unsaid} warnings before this one were not logged)"),
            None => {}
        }
    }

    /// Whether one more may be logged, and how many were not since the last.
    fn admit(&mut self, now: Instant, text: &str) -> Option<u64> {
        if now.duration_since(self.since) >= WHILE {
            self.since = now;
            self.said.clear();
        }
        if self.said.len() >= WARNINGS || !self.said.insert(text.to_owned()) {
            self.unsaid += 1;
            return None;
        }
        Some(std::mem::take(&mut self.unsaid))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_of_warnings_is_a_line_each_in_ten_seconds_and_a_count() {
        let begin = crate::clock::instant();
        let mut warnings = Warnings::new(begin);
        let mut line = |after_s, text: &str| warnings.admit(begin + Duration::from_secs(after_s), text);
        let of_one: Vec<u64> = (0..1000).filter_map(|_| line(1, "a")).collect();
        assert_eq!((of_one, line(2, "b"), line(2, "b")), (vec![0], Some(999), None));
        // Nor do ever new ones.
        assert_eq!((0..100).filter_map(|number| line(3, &number.to_string())).count(), WARNINGS - 2);
        assert_eq!((line(12, "a"), line(12, "b")), (Some(92), Some(0)));
    }

    /// Takes nothing while it is full.
    struct Disk {
        is_full: Arc<std::sync::atomic::AtomicBool>,
        text: Arc<std::sync::Mutex<Vec<u8>>>,
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.is_full.load(Ordering::Relaxed) {
                return Err(io::ErrorKind::StorageFull.into());
            }
            self.text.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn lines_that_nobody_takes_are_counted_and_told_of_once() {
        let (sender, coming) = sync_channel(4);
        let lost = Arc::new(AtomicU64::new(0));
        let mut lines = Lines { sender: sender.clone(), lost: Arc::clone(&lost) };
        for number in 0..6 {
            lines.write_all(format!("{number}\n").as_bytes()).unwrap();
        }
        assert_eq!(lost.load(Ordering::Relaxed), 2);
        let is_full = Arc::new(std::sync::atomic::AtomicBool::new(true));
        let text = Arc::<std::sync::Mutex<Vec<u8>>>::default();
        let disk = Disk { is_full: Arc::clone(&is_full), text: Arc::clone(&text) };
        let counted = Arc::clone(&lost);
        let writer = thread::spawn(move || write_lines(disk, &coming, &counted));
        while lost.load(Ordering::Relaxed) < 6 {
            thread::yield_now();
        }
        is_full.store(false, Ordering::Relaxed);
        sender.send(Some(b"again\n".to_vec())).unwrap();
        sender.send(None).unwrap();
        writer.join().unwrap();
        let text = String::from_utf8(text.lock().unwrap().clone()).unwrap();
        let mut told: Vec<&str> = text.lines().collect();
        told.sort_unstable();
        assert_eq!(told, ["6 lines of the log before this one are lost: nobody took them", "again"]);
    }
}
