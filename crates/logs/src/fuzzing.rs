//! What a fuzz target reaches beside the public interface; no part of it.

use crate::decode::Decoder;
use crate::fields::{FieldVisitor, Step};
use crate::mcap_file::SchemaRecord;

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

    fn number(&mut self, _value: f64) -> Result<(), String> {
        self.numbers += 1;
        Ok(())
    }

    fn text(&mut self, _text: &str) -> Result<(), String> {
        Ok(())
    }
}

/// Walks through a message with a schema of that name and encoding; `None` for a schema that is not read.
pub fn walk(encoding: &str, (name, kind, schema): (&str, &str, &[u8]), message: &[u8]) -> Option<Walk> {
    let schema = SchemaRecord { id: 1, name: name.into(), encoding: kind.into(), data: schema.to_vec() };
    let decoder = Decoder::new(encoding, Some(&schema)).ok()?;
    let mut walk = Walk::default();
    walk.good = decoder.visit(message, &mut walk).is_ok();
    Some(walk)
}
