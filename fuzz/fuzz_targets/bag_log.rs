//! A ROS 2 bag in SQLite's format: as it is, or without its magic bytes one that is made of the input: a byte of what is odd about it, the
//! messages' definition, then messages, each after its length in two bytes.
//! Parser: crates/logs/src/bag.rs:open,announce,fetch,fetch_after,take_message,connect,is_damage,push_text,next_record,notes
#![no_main]
use rusqlite::{Connection, MAIN_DB};
use seepd_logs::fuzzing::read_log;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if data.starts_with(b"SQLite format 3\0") {
        read_log(data, "command");
    } else if let Some(bag) = bag(data) {
        read_log(&bag, "command");
    }
});

/// The next piece of the input, after its length.
fn piece<'d>(rest: &mut &'d [u8]) -> Option<&'d [u8]> {
    let (length, after) = rest.split_first_chunk()?;
    let (piece, after) = after.split_at(usize::from(u16::from_le_bytes(*length)).min(after.len()));
    *rest = after;
    Some(piece)
}

fn bag(data: &[u8]) -> Option<Vec<u8>> {
    let (odd, mut rest) = data.split_first()?;
    let definition = String::from_utf8_lossy(piece(&mut rest)?);
    let mut database = Connection::open_in_memory().expect("memory");
    let make = "PRAGMA page_size = 512;
        CREATE TABLE message_definitions (topic_type, encoding, encoded_message_definition);
        CREATE TABLE topics (id, name, type, serialization_format);
        CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data);
        INSERT INTO topics VALUES (1, '/plc', 'plc/msg/Axis', 'cdr'), (2, '/json', 'other', 'json');";
    database.execute_batch(make).expect("SQL");
    let define = "INSERT INTO message_definitions VALUES ('plc/msg/Axis', 'ros2msg', ?1)";
    database.execute(define, [&definition]).expect("SQL");
    // More would only take longer.
    let messages = std::iter::from_fn(|| piece(&mut rest)).take(500);
    for (time_ns, message) in (1_000_000_i64..).step_by(1_000_000).zip(messages) {
        let (topic, message) = message.split_first().unwrap_or((&1, &[]));
        let packed = zstd::bulk::compress(message, 1).expect("memory");
        let message = if odd & 1 == 0 { message } else { &packed };
        let insert = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?1, ?2, ?3)";
        database.execute(insert, (topic, time_ns, message)).expect("SQL");
    }
    let oddities = [
        "DROP TABLE message_definitions",
        "DROP TABLE topics",
        "UPDATE messages SET timestamp = 'noon' WHERE id = 2",
        "UPDATE messages SET data = NULL WHERE id = 2",
        "UPDATE messages SET data = zeroblob(9000000) WHERE id = 2",
        "UPDATE topics SET name = NULL",
    ];
    for (bit, oddity) in (1..).zip(oddities) {
        if odd >> bit & 1 == 1 {
            // A table that has been dropped has nothing to be changed.
            let _ = database.execute_batch(oddity);
        }
    }
    let mut bytes = database.serialize(MAIN_DB).expect("memory").to_vec();
    if odd >> 7 == 1 {
        // Damage in the last page, where messages are.
        let at = bytes.len().saturating_sub(500);
        bytes[at] ^= 0xff;
    }
    Some(bytes)
}
