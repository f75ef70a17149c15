//! JSON messages, shown to a visitor as they are read, without building them: no allocation a sample, and any nesting.

use std::fmt;

use serde::Deserializer;
use serde::de::{DeserializeSeed, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

use super::fields::{FieldVisitor, Step};
use super::message_error::MessageError;

/// Longest message in which NaN and Infinity are looked for, bytes: it is copied for it.
const LONGEST_MENDED: usize = 1 << 20;

/// Shows a message to a visitor. NaN and Infinity, which some writers put into JSON, are read as null.
///
/// # Errors
/// [`MessageError::Json`]: the message is not JSON, or a wanted field is not a number.
pub(crate) fn visit(json: &[u8], visitor: &mut impl FieldVisitor) -> Result<(), MessageError> {
    let mut deserializer = serde_json::Deserializer::from_slice(json);
    Node(visitor).deserialize(&mut deserializer)?;
    Ok(deserializer.end()?)
}

/// The message with null in the place of numbers that JSON has not; `None` where there are none.
#[cold]
pub(crate) fn mended(json: &[u8]) -> Option<Vec<u8>> {
    let text = std::str::from_utf8(json.get(..json.len().min(LONGEST_MENDED))?).ok()?;
    if json.len() > LONGEST_MENDED || !(text.contains("NaN") || text.contains("Infinity")) {
        return None;
    }
    Some(text.replace("-Infinity", "null").replace("Infinity", "null").replace("NaN", "null").into_bytes())
}

/// A value of the message.
struct Node<'v, V>(&'v mut V);

impl<'de, V: FieldVisitor> DeserializeSeed<'de> for Node<'_, V> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de, V: FieldVisitor> Visitor<'de> for Node<'_, V> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a message with the mapped fields as numbers")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<(), E> {
        self.0.number(value).map_err(E::custom)
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<(), E> {
        self.visit_f64(value as f64)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<(), E> {
        self.visit_f64(value as f64)
    }

    fn visit_bool<E: Error>(self, value: bool) -> Result<(), E> {
        self.visit_f64(f64::from(u8::from(value)))
    }

    /// JSON has no NaN; writers put null in its place.
    fn visit_unit<E: Error>(self) -> Result<(), E> {
        self.visit_f64(f64::NAN)
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<(), E> {
        self.0.text(text).map_err(E::custom)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(wanted) = map.next_key_seed(Key(self.0))? {
            if wanted {
                map.next_value_seed(Node(self.0))?;
                self.0.leave();
            } else {
                map.next_value::<IgnoredAny>()?;
            }
        }
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<(), A::Error> {
        for index in 0.. {
            let wanted = self.0.enter(Step::Index(index));
            let more = if wanted {
                seq.next_element_seed(Node(self.0))?.is_some()
            } else {
                seq.next_element::<IgnoredAny>()?.is_some()
            };
            if wanted {
                self.0.leave();
            }
            if !more {
                break;
            }
        }
        Ok(())
    }
}

/// A key; its value tells whether the visitor went down to it.
struct Key<'v, V>(&'v mut V);

impl<'de, V: FieldVisitor> DeserializeSeed<'de> for Key<'_, V> {
    type Value = bool;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<bool, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl<V: FieldVisitor> Visitor<'_> for Key<'_, V> {
    type Value = bool;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key")
    }

    fn visit_str<E>(self, key: &str) -> Result<bool, E> {
        Ok(self.0.enter(Step::Key(key)))
    }
}
