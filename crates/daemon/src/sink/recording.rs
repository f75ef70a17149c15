//! MCAP files of what came in and what was said, for as long as there is room.
//!
//! A thread of its own writes them, so that a slow disk holds up nothing. Every second the open chunk is closed and the
//! file made durable: a power cut costs at most that second. Times are those of the daemon's line, which a replay reads as
//! they are: it gives the same estimates, byte by byte.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, UNIX_EPOCH};

use seepd_signals::{Sample, Signal};

use super::mcap::{McapSink, schema};
use crate::config::{Pace, RecordingConfig};
use crate::failure::Failure;
use crate::live::clock;
use crate::live::hub::{Hub, Kind, Publication};

/// Samples on their way to the thread.
const SAMPLES_UNDER_WAY: usize = 4096;
/// Events on their way to the thread: they do not queue behind samples, which may be dropped where the disk is slow.
const EVENTS_UNDER_WAY: usize = 1024;
/// The thread looks for them this often.
const LOOK: Duration = Duration::from_millis(50);
/// The file is made durable this often, in looks.
const LOOKS_PER_SYNC: u32 = 16;
/// The file's size is looked at after so many records.
const RECORDS_PER_SIZE: u64 = 4096;
/// Bytes in an MB.
const MB: f64 = 1e6;
/// Wait after a failed write, in looks.
const LOOKS_AFTER_FAILURE: u32 = 200;
/// The recording's name among the sinks.
pub const SINK: &str = "recording";

enum Record {
    /// A sample of the axis with this index.
    Sample(u16, Sample),
    Event(Arc<Publication>),
}

/// What is on its way to the thread.
struct Inbox {
    /// `None` ends the recording.
    samples: Receiver<Option<(u16, Sample)>>,
    events: Receiver<Arc<Publication>>,
}

/// Takes samples and events for the recording.
#[derive(Clone)]
pub struct Recorder {
    samples: SyncSender<Option<(u16, Sample)>>,
    events: SyncSender<Arc<Publication>>,
    axes: Arc<[String]>,
    lost: Arc<AtomicU64>,
}

impl Recorder {
    /// Records a sample of an axis. From a log that is read as fast as can be it waits for room, so that nothing is lost;
    /// a machine waits for nobody.
    pub fn sample(&self, axis: &str, sample: &Sample, pace: Pace) {
        let Some(index) = self.axes.iter().position(|known| known == axis) else { return };
        let record = Some((index as u16, *sample));
        match pace {
            Pace::Fast => drop(self.samples.send(record)),
            Pace::Recorded => self.count(self.samples.try_send(record).is_ok()),
        }
    }

    /// Records an event.
    pub fn event(&self, event: &Arc<Publication>) {
        self.count(self.events.try_send(Arc::clone(event)).is_ok());
    }

    fn count(&self, taken: bool) {
        if !taken {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Ends the recording once all that was sent is written.
    pub fn stop(&self) {
        let _ = self.samples.send(None);
    }
}

/// Starts recording into a folder, which is made where it is missing. One that cannot be written is told of and tried again.
///
/// # Errors
/// [`Failure`] where the thread cannot be started.
pub fn start(
    config: &RecordingConfig,
    folder: &Path,
    axes: Vec<String>,
    hub: Arc<Hub>,
) -> Result<(Recorder, JoinHandle<()>), Failure> {
    let (samples, coming_samples) = sync_channel(SAMPLES_UNDER_WAY);
    let (events, coming_events) = sync_channel(EVENTS_UNDER_WAY);
    let inbox = Inbox { samples: coming_samples, events: coming_events };
    let axes: Arc<[String]> = axes.into();
    let lost = Arc::new(AtomicU64::new(0));
    let recorder = Recorder { samples, events, axes: Arc::clone(&axes), lost: Arc::clone(&lost) };
    let tape = Tape {
        config: config.clone(),
        folder: folder.to_owned(),
        axes,
        hub,
        lost,
        file: None,
        sent: 0,
        thrown_away: 0,
    };
    let thread = thread::Builder::new().name("recording".into()).spawn(move || tape.run(&inbox));
    let thread = thread.map_err(|error| Failure::writing(folder, error))?;
    Ok((recorder, thread))
}

struct Tape {
    config: RecordingConfig,
    folder: PathBuf,
    axes: Arc<[String]>,
    hub: Arc<Hub>,
    lost: Arc<AtomicU64>,
    file: Option<TapeFile>,
    sent: u64,
    /// Records that came while nothing could be written.
    thrown_away: u64,
}

impl Tape {
    fn run(mut self, inbox: &Inbox) {
        let (mut looks, mut pause) = (0u32, 0u32);
        loop {
            let stop = self.drain(inbox, &mut pause);
            looks += 1;
            if stop {
                if let Some(file) = self.file.take()
                    && let Err(error) = file.finish()
                {
                    self.complain(&error);
                }
                return;
            }
            if looks.is_multiple_of(LOOKS_PER_SYNC)
                && let Err(error) = self.sync_and_rotate()
            {
                self.complain(&error);
                self.file = None;
                pause = LOOKS_AFTER_FAILURE;
            }
            pause = pause.saturating_sub(1);
            thread::sleep(LOOK);
        }
    }

    /// Writes what has come; `true` where it was the end.
    fn drain(&mut self, inbox: &Inbox, pause: &mut u32) -> bool {
        let mut ending = false;
        loop {
            let record = match inbox.events.try_recv() {
                Ok(event) => Record::Event(event),
                Err(_) if ending => return true,
                Err(_) => match inbox.samples.try_recv() {
                    Ok(Some((axis, sample))) => Record::Sample(axis, sample),
                    Err(TryRecvError::Empty) => return false,
                    Ok(None) | Err(TryRecvError::Disconnected) => {
                        ending = true; // once the last events are written
                        continue;
                    }
                },
            };
            if *pause > 0 {
                self.thrown_away += 1;
                continue;
            }
            let written = self.write(&record).and_then(|()| {
                // A log that is read as fast as can be fills files between two looks.
                if self.sent.is_multiple_of(RECORDS_PER_SIZE) { self.rotate() } else { Ok(()) }
            });
            match written {
                Ok(()) => self.sent += 1,
                Err(error) => {
                    self.complain(&error);
                    self.file = None;
                    self.thrown_away += 1;
                    *pause = LOOKS_AFTER_FAILURE;
                }
            }
        }
    }

    fn write(&mut self, record: &Record) -> io::Result<()> {
        let time_ns = match record {
            Record::Sample(_, sample) => sample.time_ns,
            Record::Event(event) => event.t_ns,
        };
        if self.file.is_none() {
            fs::create_dir_all(&self.folder)?;
            self.make_room()?;
            self.file = Some(TapeFile::create(&self.folder, time_ns)?);
        }
        let Some(file) = &mut self.file else { return Ok(()) };
        match record {
            Record::Sample(axis, sample) => {
                let name = self.axes.get(usize::from(*axis)).map_or("axis", String::as_str);
                file.write_sample(name, sample)
            }
            Record::Event(event) => file.write_event(event),
        }
    }

    /// Makes the file durable, tells of it, and closes it where it is full or old.
    fn sync_and_rotate(&mut self) -> io::Result<()> {
        let (lost, thrown_away, sent) = (self.lost.load(Ordering::Relaxed), self.thrown_away, self.sent);
        let Some(file) = &mut self.file else { return Ok(()) };
        file.sync()?;
        let bytes = file.bytes()?;
        let detail = format!("{} ({:.1} MB)", file.path.display(), bytes as f64 / MB);
        self.hub.update_sink(SINK, |status| {
            status.good = true;
            (status.detail, status.sent, status.dropped) = (detail, sent, lost + thrown_away);
        });
        self.rotate()
    }

    fn rotate(&mut self) -> io::Result<()> {
        let Some(file) = &self.file else { return Ok(()) };
        let age_min = file.newest_ns.saturating_sub(file.begin_ns) as f64 / 60e9;
        if file.bytes()? as f64 >= self.config.file_mb * MB || age_min >= self.config.file_min {
            if let Some(file) = self.file.take() {
                file.finish()?;
            }
            self.make_room()?;
        }
        Ok(())
    }

    fn complain(&self, error: &io::Error) {
        tracing::error!("recording into {}: {error}", self.folder.display());
        let detail = format!("writing into {}: {error}", self.folder.display());
        self.hub.update_sink(SINK, |status| (status.good, status.detail) = (false, detail));
    }

    /// Removes the oldest files until all fit, with one more of full size, and none is too old.
    fn make_room(&self) -> io::Result<()> {
        let mut files: Vec<(PathBuf, u64, i64)> = Vec::new();
        for entry in fs::read_dir(&self.folder)? {
            let entry = entry?;
            let name = entry.file_name();
            let ours =
                name.to_str().is_some_and(|name| name.starts_with("seepd-") && name.ends_with(".mcap"));
            if ours {
                let facts = entry.metadata()?;
                let changed = facts.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
                files.push((entry.path(), facts.len(), changed.as_secs() as i64));
            }
        }
        files.sort_by(|a, b| (a.2, &a.0).cmp(&(b.2, &b.0)));
        let now_s = clock::wall_ns().map(|ns| ns / 1_000_000_000);
        let keep_s = (self.config.keep_days * 86_400.0) as i64;
        let mut total: u64 = files.iter().map(|file| file.1).sum();
        for (path, bytes, changed_s) in files {
            let too_old = keep_s > 0 && now_s.is_some_and(|now| now - changed_s > keep_s);
            let too_much = total as f64 + self.config.file_mb * MB > self.config.total_mb * MB;
            if too_old || too_much {
                fs::remove_file(&path)?;
                total = total.saturating_sub(bytes);
            }
        }
        Ok(())
    }
}

struct TapeFile {
    path: PathBuf,
    /// The same file, to make it durable and to ask for its size.
    handle: File,
    sink: McapSink<BufWriter<File>>,
    channels: BTreeMap<(String, &'static str), u16>,
    line: Vec<u8>,
    begin_ns: i64,
    newest_ns: i64,
}

impl TapeFile {
    fn create(folder: &Path, time_ns: i64) -> io::Result<Self> {
        let stamp = jiff::Timestamp::from_nanosecond(i128::from(time_ns)).unwrap_or_default();
        let stamp = stamp.strftime("%Y%m%dT%H%M%SZ").to_string();
        let named = |number: u32| match number {
            0 => folder.join(format!("seepd-{stamp}.mcap")),
            _ => folder.join(format!("seepd-{stamp}-{number:03}.mcap")),
        };
        // After a start without a valid clock the same times come again.
        for number in 0..1000 {
            let path = named(number);
            match File::create_new(&path) {
                Ok(handle) => {
                    let sink = McapSink::new_for_recording(BufWriter::new(handle.try_clone()?));
                    let sink = sink.map_err(io::Error::other)?;
                    crate::live::state::sync_folder(&path)?;
                    return Ok(TapeFile {
                        path,
                        handle,
                        sink,
                        channels: BTreeMap::new(),
                        line: Vec::with_capacity(512),
                        begin_ns: time_ns,
                        newest_ns: time_ns,
                    });
                }
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
        Err(io::Error::other(format!("there are a thousand files of {stamp} already")))
    }

    fn channel(&mut self, axis: &str, topic: &'static str, name: &str, schema: &str) -> io::Result<u16> {
        if let Some((_, channel)) =
            self.channels.iter().find(|((known, known_topic), _)| known == axis && *known_topic == topic)
        {
            return Ok(*channel);
        }
        let channel =
            self.sink.add_channel(&format!("/{axis}/{topic}"), name, schema).map_err(io::Error::other)?;
        self.channels.insert((axis.to_owned(), topic), channel);
        Ok(channel)
    }

    fn write_sample(&mut self, axis: &str, sample: &Sample) -> io::Result<()> {
        let channel = self.channel(axis, "signals", "seepd.Signals", schema::SIGNALS)?;
        self.line.clear();
        write_signals(&mut self.line, sample)?;
        self.newest_ns = self.newest_ns.max(sample.time_ns);
        self.sink.write(channel, sample.time_ns, &self.line).map_err(io::Error::other)
    }

    fn write_event(&mut self, event: &Publication) -> io::Result<()> {
        let (topic, name, schema) = match event.kind {
            Kind::Cycle => ("leakage", "seepd.cycle/1", schema::CYCLE),
            Kind::Flag => ("flags", "seepd.event/1", schema::EVENT),
            Kind::Notice => ("notices", "seepd.notice/1", schema::NOTICE),
            Kind::Acknowledged => ("acknowledged", "seepd.acknowledged/1", schema::ANY),
            Kind::Test => ("test", "seepd.test/1", schema::ANY),
        };
        let channel = self.channel(&event.axis, topic, name, schema)?;
        self.sink.write(channel, event.t_ns, event.event_json.as_bytes()).map_err(io::Error::other)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sink.flush().map_err(io::Error::other)?;
        self.handle.sync_data()
    }

    fn bytes(&self) -> io::Result<u64> {
        Ok(self.handle.metadata()?.len())
    }

    fn finish(self) -> io::Result<()> {
        self.sink.finish().map_err(io::Error::other)?;
        self.handle.sync_all()
    }
}

/// A sample's signals as one JSON object; what is no number is written as the reader takes it.
fn write_signals(line: &mut Vec<u8>, sample: &Sample) -> io::Result<()> {
    line.push(b'{');
    for signal in Signal::ALL {
        if let Some(value) = sample.get(signal) {
            if line.len() > 1 {
                line.push(b',');
            }
            write!(line, "\"{}\":", signal.name())?;
            if value.is_finite() {
                serde_json::to_writer(&mut *line, &value)?;
            } else {
                line.extend_from_slice(b"NaN");
            }
        }
    }
    line.push(b'}');
    Ok(())
}
