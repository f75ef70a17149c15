//! ROS 2 bags in SQLite's format (`.db3`), as the records that an MCAP log would have.
//!
//! SQLite reads what it can of a damaged bag; where a page cannot be read, the messages after it are looked for. A bag without message
//! definitions (before ROS 2 Iron) cannot be decoded by itself and is refused.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use mcap::records::op;
use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::{Connection, Error, ErrorCode, OpenFlags, Row};

use crate::error::LogError;
use crate::mcap_file::LONGEST_RECORD;
use crate::record_log::RecordLog;

/// Messages that are fetched at a time.
const BATCH: usize = 256;
/// Bytes of them.
const BATCH_BYTES: usize = 4 << 20;
/// Topics and definitions that are read.
const MOST_TOPICS: usize = 1024;
/// What begins a message that was packed by itself.
const ZSTD: &[u8] = b"\x28\xb5\x2f\xfd";
/// What converts a bag that is not read.
const CONVERT: &str =
    "pip install rosbags; rosbags-convert --src FOLDER --dst OTHER_FOLDER --dst-storage mcap";

/// See the [module](self).
pub(crate) struct Bag {
    database: Connection,
    /// Announcements that have not been given: opcode and content, the next last.
    announced: Vec<(u8, Vec<u8>)>,
    /// Channel by the bag's number of a topic.
    channels: BTreeMap<i64, u16>,
    batch: Vec<Message>,
    /// Messages of the batch that have been given, and that there are.
    given: usize,
    fetched: usize,
    /// Number of the newest message that was fetched.
    newest: i64,
    damaged: u64,
    too_long: u64,
    ended: bool,
}

/// A message; its memory is kept for others.
#[derive(Default)]
struct Message {
    channel: u16,
    time_ns: u64,
    data: Vec<u8>,
}

impl Bag {
    /// Opens a bag's file.
    ///
    /// # Errors
    /// [`LogError`] where it is no bag, or one without definitions.
    pub(crate) fn open(path: &Path, name: &str) -> Result<Self, LogError> {
        let wrong = |error: Error| {
            LogError::data(name, format!("this is an SQLite file, but no ROS 2 bag that is read: {error}"))
        };
        let database = connect(path).map_err(wrong)?;
        let is_table = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = ?1";
        let has = |table: &str| {
            database.query_row(is_table, [table], |row| row.get::<_, i64>(0)).map(|count| count > 0)
        };
        if !has("messages").map_err(wrong)? || !has("topics").map_err(wrong)? {
            return Err(LogError::data(
                name,
                "this is an SQLite file, but no ROS 2 bag: it has no messages and topics",
            ));
        }
        if !has("message_definitions").map_err(wrong)? {
            let what = "this is a ROS 2 bag without message definitions, as they were before ROS 2 Iron";
            return Err(LogError::data(name, format!("{what}; convert it: {CONVERT}")));
        }
        let mut bag = Bag {
            database,
            announced: Vec::new(),
            channels: BTreeMap::new(),
            batch: Vec::new(),
            given: 0,
            fetched: 0,
            newest: i64::MIN,
            damaged: 0,
            too_long: 0,
            ended: false,
        };
        bag.announce().map_err(wrong)?;
        Ok(bag)
    }

    /// Turns topics and definitions into announcements.
    fn announce(&mut self) -> Result<(), Error> {
        let mut schemas: BTreeMap<String, u16> = BTreeMap::new();
        let mut records = Vec::new();
        let sql = format!(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions LIMIT {MOST_TOPICS}"
        );
        let mut statement = self.database.prepare(&sql)?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            let (kind, encoding, text): (String, String, String) = (row.get(0)?, row.get(1)?, row.get(2)?);
            let id = schemas.len() as u16 + 1;
            let mut record = id.to_le_bytes().to_vec();
            push_text(&mut record, &kind);
            push_text(&mut record, &encoding);
            push_text(&mut record, &text);
            schemas.insert(kind, id);
            records.push((op::SCHEMA, record));
        }
        let sql = format!("SELECT id, name, type, serialization_format FROM topics LIMIT {MOST_TOPICS}");
        let mut statement = self.database.prepare(&sql)?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            let (number, topic): (i64, String) = (row.get(0)?, row.get(1)?);
            let (kind, encoding): (String, String) = (row.get(2)?, row.get(3)?);
            let id = self.channels.len() as u16 + 1;
            let schema = schemas.get(&kind).copied().unwrap_or(0);
            let mut record = [id.to_le_bytes(), schema.to_le_bytes()].concat();
            push_text(&mut record, &topic);
            push_text(&mut record, &encoding);
            record.extend(0u32.to_le_bytes());
            self.channels.insert(number, id);
            records.push((op::CHANNEL, record));
        }
        records.reverse();
        self.announced = records;
        Ok(())
    }

    /// Fetches messages; whether there are any.
    fn fetch(&mut self) -> io::Result<bool> {
        (self.given, self.fetched) = (0, 0);
        match self.fetch_after(self.newest) {
            Ok(()) => return Ok(self.fetched > 0),
            Err(error) if self.fetched > 0 && is_damage(&error) => return Ok(true),
            Err(error) if is_damage(&error) => {}
            Err(error) => return Err(io::Error::other(error)),
        }
        // A page cannot be read: messages further on may be.
        self.damaged += 1;
        for reach in 0..62 {
            let Some(from) = self.newest.max(0).checked_add(1 << reach) else { break };
            let fetched = self.fetch_after(from);
            if self.fetched > 0 {
                return Ok(true);
            }
            if fetched.is_ok() {
                break;
            }
        }
        self.ended = true;
        Ok(false)
    }

    fn fetch_after(&mut self, after: i64) -> Result<(), Error> {
        let mut statement = self.database.prepare(
            "SELECT id, topic_id, timestamp, length(data), CASE WHEN length(data) <= ?2 THEN data END FROM messages WHERE id > ?1 ORDER BY id LIMIT ?3",
        )?;
        let mut rows = statement.query((after, LONGEST_RECORD as i64, BATCH as i64))?;
        let mut bytes = 0;
        while let Some(row) = rows.next()? {
            let number = row.get(0)?;
            // In a damaged page numbers may go backwards, and what follows would be fetched again for ever.
            if number <= after.max(self.newest) {
                return Err(Error::IntegralValueOutOfRange(0, number));
            }
            self.newest = number;
            if self.batch.len() == self.fetched {
                self.batch.push(Message::default());
            }
            let message = &mut self.batch[self.fetched];
            if !take_message(row, &self.channels, message)? {
                self.too_long += 1;
                message.data.clear();
                // A message of no topic, which nothing reads; the batch is not to end here.
                message.channel = 0;
            }
            bytes += message.data.len();
            self.fetched += 1;
            if bytes > BATCH_BYTES {
                break;
            }
        }
        Ok(())
    }
}

/// Takes a row's message; `false` where it is too long to be held.
fn take_message(row: &Row<'_>, channels: &BTreeMap<i64, u16>, message: &mut Message) -> Result<bool, Error> {
    message.channel = channels.get(&row.get::<_, i64>(1)?).copied().unwrap_or(0);
    message.time_ns = row.get::<_, i64>(2)?.max(0) as u64;
    let Some(data) = row.get_ref(4)?.as_blob_or_null().unwrap_or_default() else {
        return Ok(row.get::<_, Option<i64>>(3)?.unwrap_or(0) == 0);
    };
    message.data.clear();
    if data.starts_with(ZSTD) {
        let limit = LONGEST_RECORD as usize;
        let unpacked = zstd::bulk::decompress(data, limit);
        message.data.extend_from_slice(&unpacked.unwrap_or_default());
    } else {
        message.data.extend_from_slice(data);
    }
    Ok(true)
}

/// Opens a file that is only read, and that is trusted with nothing.
fn connect(path: &Path) -> Result<Connection, Error> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let database = Connection::open_with_flags(path, flags)?;
    database.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true)?;
    database.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
    database.set_limit(Limit::SQLITE_LIMIT_LENGTH, 64 << 20)?;
    database
        .execute_batch("PRAGMA cell_size_check = ON; PRAGMA mmap_size = 0; PRAGMA cache_size = -4000;")?;
    Ok(database)
}

fn is_damage(error: &Error) -> bool {
    matches!(
        error.sqlite_error_code(),
        Some(
            ErrorCode::DatabaseCorrupt
                | ErrorCode::NotADatabase
                | ErrorCode::SystemIoFailure
                | ErrorCode::TooBig
        )
    ) || matches!(
        error,
        Error::InvalidColumnType(..)
            | Error::FromSqlConversionFailure(..)
            | Error::IntegralValueOutOfRange(..)
    )
}

fn push_text(record: &mut Vec<u8>, text: &str) {
    record.extend((text.len() as u32).to_le_bytes());
    record.extend_from_slice(text.as_bytes());
}

impl RecordLog for Bag {
    fn next_record(&mut self, record: &mut Vec<u8>) -> io::Result<Option<u8>> {
        if let Some((opcode, content)) = self.announced.pop() {
            *record = content;
            return Ok(Some(opcode));
        }
        if self.given == self.fetched && (self.ended || !self.fetch()?) {
            return Ok(None);
        }
        let message = &self.batch[self.given];
        self.given += 1;
        record.clear();
        record.extend(message.channel.to_le_bytes());
        record.extend([0; 4]);
        record.extend(message.time_ns.to_le_bytes());
        record.extend(message.time_ns.to_le_bytes());
        record.extend_from_slice(&message.data);
        Ok(Some(op::MESSAGE))
    }

    fn each_in_summary(&mut self, _take: &mut dyn FnMut(u8, &[u8])) -> io::Result<()> {
        Ok(())
    }

    fn notes(&self) -> Vec<String> {
        let damaged = (self.damaged > 0).then(|| {
            format!("{} damaged places in the bag were left out, with the messages in them", self.damaged)
        });
        let too_long = (self.too_long > 0).then(|| {
            format!("{} messages longer than {} MiB were passed over", self.too_long, LONGEST_RECORD >> 20)
        });
        damaged.into_iter().chain(too_long).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Found by fuzzing: one that went on for ever.
    #[test]
    fn a_bag_of_which_a_byte_is_turned_over_ends() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bag.db3");
        let database = Connection::open(&path).unwrap();
        let make = "PRAGMA page_size = 512;
            CREATE TABLE message_definitions (topic_type, encoding, encoded_message_definition);
            CREATE TABLE topics (id, name, type, serialization_format);
            CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data);
            INSERT INTO topics VALUES (1, '/plc', 'plc/msg/Axis', 'cdr');";
        database.execute_batch(make).unwrap();
        for number in 1..=40 {
            let insert = "INSERT INTO messages VALUES (?1, 1, ?1, x'00010000000000000000e03f')";
            database.execute(insert, [number]).unwrap();
        }
        drop(database);
        let whole = std::fs::read(&path).unwrap();
        let mut record = Vec::new();
        // The last page is one of messages.
        for at in whole.len() - 512..whole.len() {
            let mut turned = whole.clone();
            turned[at] ^= 0xff;
            std::fs::write(&path, turned).unwrap();
            let mut bag = Bag::open(&path, "bag").unwrap();
            let records = (0..100).take_while(|_| bag.next_record(&mut record).unwrap().is_some());
            assert!(records.count() < 100, "byte {at}");
        }
    }
}
