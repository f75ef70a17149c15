//! MCAP files of what came in and what was said, for as long as there is room.
//!
//! A thread of its own writes them, so that a slow disk holds up nothing. Every second the open chunk is closed and the
//! file made durable: a power cut costs at most that second. Times are those of the daemon's line, which a replay reads as
//! they are: it gives the same estimates, byte by byte. Where nothing can be written, what comes is counted as dropped, and
//! the recording tries again now and then.

mod shelf;

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use seepd_signals::{Sample, Signal};

use super::mcap::{McapSink, schema};
use crate::config::{Pace, RecordingConfig};
use crate::durable::is_in_place;
use crate::failure::Failure;
use crate::hub::{Hub, Kind, Publication};
use shelf::{MB, Shelf};

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
/// Wait after a failed write, in looks.
const LOOKS_AFTER_FAILURE: u32 = 200;
/// The recording's name among the sinks.
pub const SINK: &str = "recording";

enum RecordingEntry {
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
    let writer = RecordingWriter {
        shelf: Shelf { folder: folder.to_owned(), config: config.clone() },
        axes,
        hub,
        lost,
        file: None,
        pause: 0,
        complaint: None,
        sent: 0,
        thrown_away: 0,
    };
    let thread = thread::Builder::new().name("recording".into()).spawn(move || writer.run(&inbox));
    let thread = thread.map_err(|error| Failure::writing(folder, error))?;
    Ok((recorder, thread))
}

struct RecordingWriter {
    shelf: Shelf,
    axes: Arc<[String]>,
    hub: Arc<Hub>,
    lost: Arc<AtomicU64>,
    file: Option<TapeFile>,
    /// Looks until the next try, after a failed one.
    pause: u32,
    /// Why nothing can be written; told once.
    complaint: Option<String>,
    /// Records that are on disk.
    sent: u64,
    /// Records that came while nothing could be written.
    thrown_away: u64,
}

impl RecordingWriter {
    fn run(mut self, inbox: &Inbox) {
        let mut looks = 0u32;
        while !self.drain(inbox) {
            looks = looks.wrapping_add(1);
            if looks.is_multiple_of(LOOKS_PER_SYNC) {
                let synced = self.sync_and_rotate();
                self.heed(synced);
                self.tell();
            }
            self.pause = self.pause.saturating_sub(1);
            thread::sleep(LOOK);
        }
        let closed = self.close();
        self.heed(closed);
        self.tell();
    }

    /// Writes what has come; `true` where it was the end.
    fn drain(&mut self, inbox: &Inbox) -> bool {
        let mut ending = false;
        loop {
            let record = match inbox.events.try_recv() {
                Ok(event) => RecordingEntry::Event(event),
                Err(_) if ending => return true,
                Err(_) => match inbox.samples.try_recv() {
                    Ok(Some((axis, sample))) => RecordingEntry::Sample(axis, sample),
                    Err(TryRecvError::Empty) => return false,
                    Ok(None) | Err(TryRecvError::Disconnected) => {
                        ending = true; // once the last events are written
                        continue;
                    }
                },
            };
            if self.pause > 0 {
                self.thrown_away += 1;
                continue;
            }
            let written = self.write(&record);
            self.thrown_away += u64::from(written.is_err());
            // A log that is read as fast as can be fills files between two looks.
            let rotated = written.and_then(|full| if full { self.rotate() } else { Ok(()) });
            self.heed(rotated);
        }
    }

    /// Writes a record; `true` where it is time to look at the file's size.
    fn write(&mut self, record: &RecordingEntry) -> io::Result<bool> {
        let time_ns = match record {
            RecordingEntry::Sample(_, sample) => sample.time_ns,
            RecordingEntry::Event(event) => event.t_ns,
        };
        // Events are about samples that came before them: they stay in the file of these, also where it is full.
        if matches!(record, RecordingEntry::Sample(..)) && self.file.as_ref().is_some_and(|file| file.is_due)
        {
            self.close()?;
        }
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(TapeFile::create(&self.shelf, time_ns)?),
        };
        match record {
            RecordingEntry::Sample(axis, sample) => {
                let name = self.axes.get(usize::from(*axis)).map_or("axis", String::as_str);
                file.write_sample(name, sample)?;
            }
            RecordingEntry::Event(event) => file.write_event(event)?,
        }
        file.buffered += 1;
        Ok(file.buffered.is_multiple_of(RECORDS_PER_SIZE))
    }

    /// Makes the file durable; where it is full or old, the next sample begins another one.
    fn sync_and_rotate(&mut self) -> io::Result<()> {
        let Some(file) = &mut self.file else { return Ok(()) };
        file.sync()?;
        self.sent += std::mem::take(&mut file.buffered);
        if self.complaint.take().is_some() {
            let folder = self.shelf.folder.display();
            tracing::info!(
                "the recording in {folder} goes on; {} records were dropped so far",
                self.dropped()
            );
        }
        self.rotate()
    }

    /// Has the next sample close the file where it is full or old; closes it where the disk is full.
    fn rotate(&mut self) -> io::Result<()> {
        let Some(file) = &mut self.file else { return Ok(()) };
        // What is written into a file that has lost its name nobody finds.
        if !is_in_place(&file.handle, &file.path) {
            let path = file.path.display();
            tracing::warn!("the recording {path} is no longer there; another one is begun");
            self.close()?;
            return Ok(());
        }
        let age_min = file.newest_ns.saturating_sub(file.begin_ns) as f64 / 60e9;
        file.is_due = file.bytes()? >= file.most_bytes || age_min >= self.shelf.config.file_min;
        if self.shelf.is_short()? {
            self.close()?;
            self.shelf.make_room()?;
        }
        Ok(())
    }

    fn close(&mut self) -> io::Result<()> {
        let Some(file) = &mut self.file else { return Ok(()) };
        file.finish()?;
        self.sent += file.buffered;
        self.file = None;
        Ok(())
    }

    /// Gives the file up after a failure, for a while.
    fn heed(&mut self, result: io::Result<()>) {
        let Err(error) = result else { return };
        if let Some(file) = self.file.take() {
            self.thrown_away += file.buffered;
            file.give_up();
        }
        self.pause = LOOKS_AFTER_FAILURE;
        let complaint = format!("recording into {}: {error}", self.shelf.folder.display());
        if self.complaint.as_ref() != Some(&complaint) {
            tracing::error!("{complaint}; trying again every {} s", (LOOK * LOOKS_AFTER_FAILURE).as_secs());
            self.complaint = Some(complaint);
        }
    }

    fn dropped(&self) -> u64 {
        self.lost.load(Ordering::Relaxed) + self.thrown_away
    }

    fn tell(&self) {
        let detail = match (&self.complaint, &self.file) {
            (Some(complaint), _) => Some(complaint.clone()),
            (None, Some(file)) => Some(file.describe()),
            (None, None) => None,
        };
        self.hub.update_sink(SINK, |status| {
            status.good = self.complaint.is_none();
            (status.sent, status.dropped) = (self.sent, self.dropped());
            status.detail = detail.unwrap_or_else(|| std::mem::take(&mut status.detail));
        });
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
    /// The file is full at this size.
    most_bytes: u64,
    /// It is full or old: the next sample closes it.
    is_due: bool,
    /// Records that are not on disk yet.
    buffered: u64,
    /// Whether records of it are on disk.
    holds_records: bool,
}

impl TapeFile {
    fn create(shelf: &Shelf, time_ns: i64) -> io::Result<Self> {
        fs::create_dir_all(&shelf.folder)?;
        let most_bytes = shelf.make_room()?;
        let (path, handle) = shelf.create(time_ns)?;
        let begun = handle.try_clone().and_then(|file| McapSink::new_for_recording(BufWriter::new(file)));
        let sink = begun.inspect_err(|_| remove_unused(&path))?;
        Ok(TapeFile {
            path,
            handle,
            sink,
            channels: BTreeMap::new(),
            line: Vec::with_capacity(512),
            begin_ns: time_ns,
            newest_ns: time_ns,
            most_bytes,
            is_due: false,
            buffered: 0,
            holds_records: false,
        })
    }

    fn channel(&mut self, axis: &str, topic: &'static str, name: &str, schema: &str) -> io::Result<u16> {
        if let Some((_, channel)) =
            self.channels.iter().find(|((known, known_topic), _)| known == axis && *known_topic == topic)
        {
            return Ok(*channel);
        }
        let channel = self.sink.add_channel(&format!("/{axis}/{topic}"), name, schema)?;
        self.channels.insert((axis.to_owned(), topic), channel);
        Ok(channel)
    }

    fn write_sample(&mut self, axis: &str, sample: &Sample) -> io::Result<()> {
        let channel = self.channel(axis, "signals", "seepd.Signals", schema::SIGNALS)?;
        self.line.clear();
        write_signals(&mut self.line, sample)?;
        self.newest_ns = self.newest_ns.max(sample.time_ns);
        self.sink.write(channel, sample.time_ns, &self.line)
    }

    fn write_event(&mut self, event: &Publication) -> io::Result<()> {
        let (topic, name, schema) = channel(event.kind);
        let channel = self.channel(&event.axis, topic, name, schema)?;
        self.sink.write(channel, event.t_ns, event.event_json.as_bytes())
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sink.flush()?;
        self.handle.sync_data()?;
        self.holds_records |= self.buffered > 0;
        Ok(())
    }

    fn bytes(&self) -> io::Result<u64> {
        Ok(self.handle.metadata()?.len())
    }

    fn describe(&self) -> String {
        let megabytes = self.bytes().unwrap_or_default() as f64 / MB;
        format!("{} ({megabytes:.1} MB)", self.path.display())
    }

    fn finish(&mut self) -> io::Result<()> {
        self.sink.finish()?;
        self.handle.sync_all()
    }

    /// Leaves what is on disk, which can be read up to there; a file without a record goes.
    fn give_up(self) {
        let TapeFile { path, sink, holds_records, .. } = self;
        drop(sink); // which writes as much of its end as it can
        if !holds_records {
            remove_unused(&path);
        }
    }
}

/// Removes a file in which there is nothing. Where even that fails, the next one is told of anyway.
fn remove_unused(path: &Path) {
    let _ = fs::remove_file(path);
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

/// The topic below an axis's name that events of a kind have, their schema's name, and their schema.
pub(super) const fn channel(kind: Kind) -> (&'static str, &'static str, &'static str) {
    match kind {
        Kind::Cycle => ("leakage", "seepd.cycle/1", schema::CYCLE),
        Kind::Flag => ("flags", "seepd.event/1", schema::EVENT),
        Kind::Notice => ("notices", "seepd.notice/1", schema::NOTICE),
        Kind::Acknowledged => ("acknowledged", "seepd.acknowledged/1", schema::ANY),
        Kind::Test => ("test", "seepd.test/1", schema::ANY),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file with events alone is one that no replay of all files could begin with or go on through.
    #[test]
    fn what_is_said_of_samples_is_in_their_file() {
        let folder = tempfile::tempdir().unwrap();
        let config = RecordingConfig { file_min: 0.1, ..RecordingConfig::default() };
        let mut writer = RecordingWriter {
            shelf: Shelf { folder: folder.path().to_owned(), config },
            axes: ["press-1".to_owned()].into(),
            hub: Hub::new("test".into()),
            lost: Arc::default(),
            file: None,
            pause: 0,
            complaint: None,
            sent: 0,
            thrown_away: 0,
        };
        let sample = |time_s: i64| RecordingEntry::Sample(0, Sample::command(time_s * 1_000_000_000, 0.1));
        let event = Publication {
            kind: Kind::Cycle,
            axis: "press-1".to_owned(),
            t_ns: 0,
            json: "{}".to_owned(),
            event_json: "{}".to_owned(),
        };
        let event = RecordingEntry::Event(Arc::new(event));
        // Old by its second sample, and nothing but what is said of it comes for a while.
        let records = [&sample(0), &sample(10), &event, &sample(20), &sample(30), &event];
        for record in records {
            writer.write(record).unwrap();
            writer.sync_and_rotate().unwrap();
        }
        writer.close().unwrap();
        let mut files: Vec<_> = fs::read_dir(&folder).unwrap().map(|file| file.unwrap().path()).collect();
        files.sort();
        let topics = |file: &PathBuf| -> Vec<String> {
            let bytes = fs::read(file).unwrap();
            let messages = mcap::MessageStream::new(&bytes).unwrap();
            messages.map(|message| message.unwrap().channel.topic.clone()).collect()
        };
        let of_each = ["/press-1/signals", "/press-1/signals", "/press-1/leakage"];
        assert_eq!(files.iter().map(topics).collect::<Vec<_>>(), [of_each, of_each]);
    }

    /// The layout for Foxglove asks for topics and fields that recordings have.
    #[test]
    fn the_layout_asks_for_what_there_is() {
        let layout = include_str!("../../../../packaging/foxglove/seepd.layout.json");
        let layout: serde_json::Value = serde_json::from_str(layout).unwrap();
        let known = [("signals", schema::SIGNALS), ("leakage", schema::CYCLE), ("flags", schema::EVENT)];
        let mut asked = 0;
        for panel in layout["configById"].as_object().unwrap().values() {
            let paths = panel["paths"].as_array().into_iter().flatten().map(|path| &path["value"]);
            for path in paths.chain(panel.get("topicPath")) {
                let path = path.as_str().unwrap().strip_prefix("/press-1/").unwrap();
                let (topic, field) = path.split_once('.').unwrap_or((path, ""));
                let of_topic = known.iter().find(|(name, _)| *name == topic).unwrap().1;
                let of_topic: serde_json::Value = serde_json::from_str(of_topic).unwrap();
                assert!(field.is_empty() || of_topic["properties"][field].is_object(), "{path}");
                asked += 1;
            }
        }
        assert_eq!(asked, 4);
    }
}
