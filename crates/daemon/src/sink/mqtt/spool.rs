//! Events that wait for the broker: one small file each, in order, bounded.
//!
//! A file is written whole before it takes its place, so a cut leaves the events before it. What cannot be read is moved
//! into `damaged`, what the broker refuses into `refused`, and counted; the others go on. What the disk does not take waits in
//! memory until it does.

use std::collections::{BTreeMap, VecDeque};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use seepd_settings::side_file;
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use crate::durable::write_durably;
use crate::failure::Failure;

/// Version of the entries that are written.
const SCHEMA: &str = "seepd.spool/2";
/// The first one, in which the event stood as a text within the text.
const SCHEMA_1: &str = "seepd.spool/1";

/// Where what cannot be read goes.
const DAMAGED: &str = "damaged";
/// Where what the broker refuses goes.
const REFUSED: &str = "refused";
/// Entries that are kept in such a folder; the oldest go first.
const KEPT_ASIDE: usize = 1000;
/// Entries that wait in memory while the disk takes none; the oldest of them go first.
const MOST_UNWRITTEN: usize = 1000;

/// An event that waits.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Entry {
    /// `seepd.spool/2`.
    schema: String,
    /// Where it goes below the prefix: `press-1/cycle`.
    pub topic: String,
    /// What is sent, to the letter.
    pub message: Box<RawValue>,
}

impl Entry {
    /// Reads an entry's text.
    ///
    /// # Errors
    /// One line: no entry, or one of a later version.
    pub fn parse(text: &[u8]) -> Result<Self, String> {
        let mut entry: Entry = serde_json::from_slice(text).map_err(|error| error.to_string())?;
        match entry.schema.as_str() {
            SCHEMA => Ok(entry),
            SCHEMA_1 => {
                let message: String =
                    serde_json::from_str(entry.message.get()).map_err(|error| error.to_string())?;
                entry.message = RawValue::from_string(message).map_err(|error| error.to_string())?;
                entry.schema = SCHEMA.into();
                Ok(entry)
            }
            other => Err(format!("its schema is {other}, which this version does not read")),
        }
    }
}

/// See the [module](self).
#[derive(Debug)]
pub struct Spool {
    folder: PathBuf,
    most: usize,
    numbers: VecDeque<u64>,
    next: u64,
    counts: Counts,
    /// Entries that the disk has not taken, and why.
    unwritten: BTreeMap<u64, Entry>,
    failure: Option<String>,
}

/// What is in the spool, and what went from it unsent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Entries that wait.
    pub waiting: u64,
    /// Entries that could not be read.
    pub damaged: u64,
    /// Entries that the broker refused.
    pub refused: u64,
    /// Entries that went because there were too many.
    pub dropped: u64,
}

impl Spool {
    /// Takes up what waits in a folder, which is made where it is missing.
    ///
    /// # Errors
    /// [`Failure`] where the folder cannot be made or read.
    pub fn open(folder: &Path, most: usize) -> Result<Self, Failure> {
        let failed = |error| Failure::writing(folder, error);
        fs::create_dir_all(folder).map_err(failed)?;
        let numbers = numbers(folder).map_err(failed)?;
        // A number that was set aside is not given again, or the new entry would take the old one's place there.
        let aside = [DAMAGED, REFUSED].map(|name| self::numbers(&folder.join(name)).unwrap_or_default());
        let last = aside.iter().chain([&numbers]).filter_map(|numbers| numbers.last()).max();
        let next = last.map_or(1, |last| last.saturating_add(1));
        Ok(Spool {
            folder: folder.to_owned(),
            most,
            numbers: numbers.into(),
            next,
            counts: Counts::default(),
            unwritten: BTreeMap::new(),
            failure: None,
        })
    }

    /// What is there, and what went.
    pub fn counts(&self) -> Counts {
        Counts { waiting: self.numbers.len() as u64, ..self.counts }
    }

    fn path(&self, number: u64) -> PathBuf {
        entry_path(&self.folder, number)
    }

    /// Why entries wait in memory, where some do.
    pub fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// Adds an event, durably where the disk takes it, and tells its number; where there are too many, the oldest goes.
    ///
    /// # Errors
    /// It is no JSON, or the oldest cannot be removed.
    pub fn push(&mut self, topic: &str, json: &str) -> io::Result<u64> {
        let message = RawValue::from_string(json.to_owned())?;
        let entry = Entry { schema: SCHEMA.into(), topic: topic.into(), message };
        let number = self.next;
        self.next += 1;
        self.numbers.push_back(number);
        self.unwritten.insert(number, entry);
        self.failure = self.write_out().err().map(|error| error.to_string());
        while self.numbers.len() > self.most {
            self.counts.dropped += 1;
            self.remove_first()?;
        }
        Ok(number)
    }

    /// Writes what the disk has not taken, in order.
    fn write_out(&mut self) -> io::Result<()> {
        while let Some((number, entry)) = self.unwritten.first_key_value() {
            let (path, bytes) = (self.path(*number), serde_json::to_vec(entry)?);
            let written = match write_durably(&path, &bytes) {
                // Somebody has removed the folder, or the disk that it was on is no longer there.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {
                    fs::create_dir_all(&self.folder).and_then(|()| write_durably(&path, &bytes))
                }
                written => written,
            };
            if let Err(error) = written {
                self.forget_surplus();
                return Err(error);
            }
            self.unwritten.pop_first();
        }
        Ok(())
    }

    fn forget_surplus(&mut self) {
        while self.unwritten.len() > MOST_UNWRITTEN
            && let Some((forgotten, _)) = self.unwritten.pop_first()
        {
            self.numbers.retain(|number| *number != forgotten);
            self.counts.dropped += 1;
        }
    }

    /// The event that has waited longest. Entries that cannot be read are moved aside on the way.
    pub fn first(&mut self) -> Option<(u64, Entry)> {
        while let Some(number) = self.numbers.front().copied() {
            if let Some(entry) = self.unwritten.get(&number) {
                return Some((number, entry.clone()));
            }
            let read = side_file::read(&self.path(number)).map_err(|error| error.to_string());
            match read.and_then(|text| Entry::parse(&text)) {
                Ok(entry) => return Some((number, entry)),
                Err(message) => self.set_first_aside(number, &message),
            }
        }
        None
    }

    fn set_first_aside(&mut self, number: u64, message: &str) {
        let from = self.path(number);
        tracing::error!("{}: {message}; the file is moved into `{DAMAGED}`", from.display());
        if let Err(error) = self.move_aside(number, DAMAGED) {
            tracing::error!("{}: the file cannot be moved: {error}", from.display());
        }
        self.counts.damaged += 1;
        self.numbers.pop_front();
    }

    /// Sets an event aside that the broker refuses, if it is still the first.
    ///
    /// # Errors
    /// Moving failed; it will be sent again after a restart.
    pub fn refuse(&mut self, number: u64) -> io::Result<()> {
        if self.numbers.front() != Some(&number) {
            return Ok(());
        }
        self.numbers.pop_front();
        self.counts.refused += 1;
        if self.unwritten.remove(&number).is_some() {
            return Ok(());
        }
        self.move_aside(number, REFUSED)
    }

    fn move_aside(&self, number: u64, name: &str) -> io::Result<()> {
        let aside = self.folder.join(name);
        fs::create_dir_all(&aside)?;
        fs::rename(self.path(number), entry_path(&aside, number))?;
        let kept = numbers(&aside)?;
        let surplus = kept.len().saturating_sub(KEPT_ASIDE);
        kept.iter().take(surplus).try_for_each(|number| fs::remove_file(entry_path(&aside, *number)))
    }

    /// Removes an event that has arrived, if it is still the first.
    ///
    /// # Errors
    /// Removing failed; it will be sent again after a restart.
    pub fn arrived(&mut self, number: u64) -> io::Result<()> {
        if self.numbers.front() == Some(&number) { self.remove_first() } else { Ok(()) }
    }

    fn remove_first(&mut self) -> io::Result<()> {
        let Some(number) = self.numbers.pop_front() else { return Ok(()) };
        if self.unwritten.remove(&number).is_some() {
            return Ok(());
        }
        fs::remove_file(self.path(number))
    }
}

fn entry_path(folder: &Path, number: u64) -> PathBuf {
    folder.join(format!("{number:012}.json"))
}

/// Numbers of the entries in a folder, in order.
fn numbers(folder: &Path) -> io::Result<Vec<u64>> {
    let mut numbers = Vec::new();
    for entry in fs::read_dir(folder)? {
        let name = entry?.file_name();
        let number = name.to_str().and_then(|name| name.strip_suffix(".json")).map(str::parse::<u64>);
        numbers.extend(number.and_then(Result::ok));
    }
    numbers.sort_unstable();
    Ok(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn topics(spool: &mut Spool) -> Vec<String> {
        let mut topics = Vec::new();
        while let Some((number, entry)) = spool.first() {
            topics.push(entry.topic);
            spool.arrived(number).unwrap();
        }
        topics
    }

    #[test]
    fn events_come_out_in_order_also_after_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::open(folder.path(), 10).unwrap();
        for topic in ["a", "b", "c"] {
            spool.push(topic, r#"{"x":1}"#).unwrap();
        }
        let (first, entry) = spool.first().unwrap();
        assert_eq!(entry.message.get(), r#"{"x":1}"#);
        spool.arrived(first).unwrap();
        spool.arrived(first).unwrap();
        let mut again = Spool::open(folder.path(), 10).unwrap();
        again.push("d", "{}").unwrap();
        assert_eq!(topics(&mut again), ["b", "c", "d"]);
        assert_eq!(Spool::open(folder.path(), 10).unwrap().counts(), Counts::default());
    }

    #[test]
    fn a_full_spool_loses_the_oldest_and_counts() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::open(folder.path(), 2).unwrap();
        for topic in ["a", "b", "c", "d"] {
            spool.push(topic, "{}").unwrap();
        }
        assert_eq!((spool.counts().dropped, topics(&mut spool)), (2, vec!["c".into(), "d".into()]));
    }

    #[test]
    fn events_that_the_disk_does_not_take_wait_in_memory_until_it_does() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("spool");
        let mut spool = Spool::open(&place, 10_000).unwrap();
        fs::remove_dir(&place).unwrap();
        fs::write(&place, "in the way").unwrap();
        for number in 0..MOST_UNWRITTEN + 5 {
            spool.push(&format!("event {number}"), "{}").unwrap();
        }
        assert!(spool.failure().is_some_and(|why| why.contains("Not a directory")));
        assert_eq!(spool.counts(), Counts { waiting: 1000, dropped: 5, ..Counts::default() });
        let (first, entry) = spool.first().unwrap();
        assert_eq!(entry.topic, "event 5");
        spool.arrived(first).unwrap();
        // The folder is made by whoever needs it.
        fs::remove_file(&place).unwrap();
        spool.push("the last", "{}").unwrap();
        assert_eq!(spool.failure(), None);
        let topics = topics(&mut Spool::open(&place, 10_000).unwrap());
        assert_eq!((topics.len(), topics[0].as_str()), (1000, "event 6"));
        assert_eq!(topics.last().unwrap(), "the last");
    }

    #[test]
    fn damaged_entries_are_set_aside_and_the_others_go_on() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::open(folder.path(), 10).unwrap();
        for topic in ["a", "b", "c"] {
            spool.push(topic, "{}").unwrap();
        }
        fs::write(spool.path(1), b"\xff\x00").unwrap();
        fs::write(spool.path(2), br#"{"schema":"seepd.spool/9","topic":"b","message":{}}"#).unwrap();
        // A cut within writing leaves a file that is not yet an entry.
        fs::write(folder.path().join("000000000009.new"), b"{").unwrap();
        let mut again = Spool::open(folder.path(), 10).unwrap();
        assert_eq!(topics(&mut again), ["c"]);
        assert_eq!(again.counts().damaged, 2);
        assert_eq!(fs::read_dir(folder.path().join("damaged")).unwrap().count(), 2);
    }

    #[test]
    fn refused_events_make_way_and_only_the_newest_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::open(folder.path(), KEPT_ASIDE + 10).unwrap();
        for number in 1..=KEPT_ASIDE as u64 + 2 {
            spool.numbers.push_back(number);
            fs::write(spool.path(number), "{}").unwrap();
        }
        // Only the first can be refused: it is the one under way.
        spool.refuse(2).unwrap();
        assert_eq!(spool.counts().refused, 0);
        for number in 1..=KEPT_ASIDE as u64 + 1 {
            spool.refuse(number).unwrap();
        }
        let counts = spool.counts();
        assert_eq!((counts.waiting, counts.refused), (1, KEPT_ASIDE as u64 + 1));
        let kept = numbers(&folder.path().join(REFUSED)).unwrap();
        assert_eq!((kept.len(), kept[0]), (KEPT_ASIDE, 2));
        // Their numbers are not given again.
        fs::remove_file(spool.path(KEPT_ASIDE as u64 + 2)).unwrap();
        assert_eq!(Spool::open(folder.path(), 10).unwrap().push("a", "{}").unwrap(), KEPT_ASIDE as u64 + 2);
    }

    #[test]
    fn entries_of_the_first_version_are_taken_over() {
        let text = br#"{"schema":"seepd.spool/1","topic":"a/cycle","message":"{\"x\":2}"}"#;
        let entry = Entry::parse(text).unwrap();
        assert_eq!((entry.topic.as_str(), entry.message.get()), ("a/cycle", r#"{"x":2}"#));
    }
}
