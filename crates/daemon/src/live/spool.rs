//! Events that wait for the broker: one small file each, in order, bounded.
//!
//! A file is written whole before it takes its place, so a cut leaves the events before it. What cannot be read is moved
//! into `damaged` and counted; the others go on.

use std::collections::VecDeque;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use crate::failure::Failure;
use crate::live::state::write_durably;

/// Version of the entries that are written.
const SCHEMA: &str = "seepd.spool/2";
/// The first one, in which the event stood as a text within the text.
const SCHEMA_1: &str = "seepd.spool/1";

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
            other => Err(format!("has the schema {other}")),
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
    /// Entries that could not be read.
    pub damaged: u64,
    /// Entries that went unsent because there were too many.
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
        let mut numbers = Vec::new();
        for entry in fs::read_dir(folder).map_err(failed)? {
            let name = entry.map_err(failed)?.file_name();
            let number = name.to_str().and_then(|name| name.strip_suffix(".json")).map(str::parse::<u64>);
            numbers.extend(number.and_then(Result::ok));
        }
        numbers.sort_unstable();
        let next = numbers.last().map_or(1, |last| last.saturating_add(1));
        Ok(Spool { folder: folder.to_owned(), most, numbers: numbers.into(), next, damaged: 0, dropped: 0 })
    }

    /// Events that wait.
    pub fn len(&self) -> usize {
        self.numbers.len()
    }

    /// Whether none waits.
    pub fn is_empty(&self) -> bool {
        self.numbers.is_empty()
    }

    fn path(&self, number: u64) -> PathBuf {
        self.folder.join(format!("{number:012}.json"))
    }

    /// Adds an event, durably, and tells its number; where there are too many, the oldest goes.
    ///
    /// # Errors
    /// Writing failed; the event is not kept.
    pub fn push(&mut self, topic: &str, json: &str) -> io::Result<u64> {
        let message = RawValue::from_string(json.to_owned())?;
        let entry = Entry { schema: SCHEMA.into(), topic: topic.into(), message };
        let number = self.next;
        write_durably(&self.path(number), &serde_json::to_vec(&entry)?)?;
        self.next += 1;
        self.numbers.push_back(number);
        while self.numbers.len() > self.most {
            self.dropped += 1;
            self.remove_first()?;
        }
        Ok(number)
    }

    /// The event that has waited longest. Entries that cannot be read are moved aside on the way.
    pub fn first(&mut self) -> Option<(u64, Entry)> {
        while let Some(number) = self.numbers.front().copied() {
            let read = fs::read(self.path(number)).map_err(|error| error.to_string());
            match read.and_then(|text| Entry::parse(&text)) {
                Ok(entry) => return Some((number, entry)),
                Err(message) => self.set_first_aside(number, &message),
            }
        }
        None
    }

    fn set_first_aside(&mut self, number: u64, message: &str) {
        let from = self.path(number);
        tracing::error!("{}: {message}; moved into `damaged`", from.display());
        let aside = self.folder.join("damaged");
        let moved = fs::create_dir_all(&aside)
            .and_then(|()| fs::rename(&from, aside.join(format!("{number:012}.json"))));
        if let Err(error) = moved {
            tracing::error!("{}: cannot be moved: {error}", from.display());
        }
        self.damaged += 1;
        self.numbers.pop_front();
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
        fs::remove_file(self.path(number))
    }
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
        assert!(Spool::open(folder.path(), 10).unwrap().is_empty());
    }

    #[test]
    fn a_full_spool_loses_the_oldest_and_counts() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::open(folder.path(), 2).unwrap();
        for topic in ["a", "b", "c", "d"] {
            spool.push(topic, "{}").unwrap();
        }
        assert_eq!((spool.dropped, topics(&mut spool)), (2, vec!["c".into(), "d".into()]));
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
        assert_eq!(again.damaged, 2);
        assert_eq!(fs::read_dir(folder.path().join("damaged")).unwrap().count(), 2);
    }

    #[test]
    fn entries_of_the_first_version_are_taken_over() {
        let text = br#"{"schema":"seepd.spool/1","topic":"a/cycle","message":"{\"x\":2}"}"#;
        let entry = Entry::parse(text).unwrap();
        assert_eq!((entry.topic.as_str(), entry.message.get()), ("a/cycle", r#"{"x":2}"#));
    }
}
