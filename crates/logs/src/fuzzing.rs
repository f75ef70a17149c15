//! What a fuzz target reaches beside the public interface; no part of it.

use std::io::Cursor;

use seepd_signals::Signal;

use crate::can::bit_field::{ByteOrder, Encoding};
use crate::decode::Decoder;
use crate::fields::{FieldVisitor, Step, ValueError};
use crate::mapping::{BitsMapping, LogMapping, Selection, SignalMapping};
use crate::mcap_file::SchemaRecord;
use crate::opened::{Bytes, Opened, Origin};
use crate::source::of_opened;

/// Goes wherever there is something in a message, and counts.
#[derive(Debug, Default)]
pub struct Walk {
    /// Steps down that were not followed by one up.
    pub depth: usize,
    /// Numbers.
    pub numbers: usize,
    /// Whether the message fits its schema.
    pub good: bool,
}

impl FieldVisitor for Walk {
    fn enter(&mut self, _step: Step<'_>) -> bool {
        self.depth += 1;
        true
    }

    fn leave(&mut self) {
        self.depth -= 1;
    }

    fn number(&mut self, _value: f64) -> Result<(), ValueError> {
        self.numbers += 1;
        Ok(())
    }

    fn text(&mut self, _text: &str) -> Result<(), ValueError> {
        Ok(())
    }
}

/// Reads a log of any kind by its bytes, as they come through a pipe, with a command of that name; without one, the first byte of frames.
pub fn read_log(log: &[u8], command: &str) {
    let origin = Origin { path: None, length: Some(log.len() as u64), is_far: false };
    read(Bytes::Stream(Box::new(log)), origin, command);
}

/// The same of a file; of one that is far away, what is not needed is not read.
pub fn read_file(log: &[u8], is_far: bool, command: &str) {
    let origin = Origin { path: None, length: Some(log.len() as u64), is_far };
    read(Bytes::File(Box::new(Cursor::new(log))), origin, command);
}

fn read(log: Bytes<'_>, origin: Origin<'_>, command: &str) {
    let Ok(opened) = Opened::of(log, "log", origin) else { return };
    let mut mapping = LogMapping::default();
    if command.is_empty() {
        let bits = BitsMapping {
            id: 0x123,
            pgn: None,
            extended: None,
            start: 0,
            length: 8,
            order: ByteOrder::LittleEndian,
            encoding: Encoding::Unsigned,
        };
        let command = SignalMapping { bits: Some(bits), ..SignalMapping::default() };
        mapping.signals.insert(Signal::Command, command);
    } else {
        mapping.selection = Selection { command: Some(command.into()), ..Selection::default() };
    }
    if let Ok(mut source) = of_opened(opened, "log", &mapping) {
        while let Ok(Some(_)) = source.next_sample() {}
        let _ = source.notes();
    }
}

/// Walks through a message with a schema of that name and encoding; `None` for a schema that is not read.
pub fn walk(encoding: &str, (name, kind, schema): (&str, &str, &[u8]), message: &[u8]) -> Option<Walk> {
    let schema = SchemaRecord { id: 1, name: name.into(), encoding: kind.into(), data: schema.to_vec() };
    let decoder = Decoder::new(encoding, Some(&schema)).map_err(|error| error.to_string()).ok()?;
    let mut walk = Walk::default();
    walk.good = decoder.visit(message, &mut walk).map_err(|error| error.to_string()).is_ok();
    Some(walk)
}
