//! Picks the mapped fields out of a JSON message without building the message.

use std::fmt;

use seepd_signals::Signal;
use serde::Deserializer;
use serde::de::{DeserializeSeed, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

use crate::config::SignalMapping;

/// What a field is for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// A signal, with scale and offset to SI.
    Signal {
        /// The signal.
        signal: Signal,
        /// Factor.
        scale: f64,
        /// Added after the factor.
        offset: f64,
    },
    /// The time, or a part of it: so many ns a unit.
    Time {
        /// Nanoseconds in the field's unit.
        unit_ns: f64,
    },
}

/// A field path's part.
#[derive(Debug, Clone, PartialEq)]
enum Step {
    Key(String),
    Index(usize),
}

/// The fields that are wanted of a message, as a tree along their paths.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FieldTree {
    children: Vec<(Step, FieldTree)>,
    targets: Vec<Target>,
}

/// What a message held, in the order of the fields in it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Picked {
    /// Signals in SI.
    pub values: Vec<(Signal, f64)>,
    /// Time, ns.
    pub time_ns: Option<i64>,
}

impl FieldTree {
    /// The tree of a topic's mappings.
    pub fn of<'c>(mappings: impl Iterator<Item = (Signal, &'c SignalMapping)>) -> Self {
        let mut tree = FieldTree::default();
        for (signal, mapping) in mappings {
            tree.add(&mapping.field, Target::Signal { signal, scale: mapping.scale, offset: mapping.offset });
            if !mapping.time.is_empty() {
                tree.add(&mapping.time, Target::Time { unit_ns: 1e9 });
                // A stamp of seconds and nanoseconds, as ROS and protobuf have it.
                for (part, unit_ns) in [("sec", 1e9), ("seconds", 1e9), ("nanosec", 1.0), ("nanos", 1.0)] {
                    tree.add(&format!("{}.{part}", mapping.time), Target::Time { unit_ns });
                }
            }
        }
        tree
    }

    fn add(&mut self, path: &str, target: Target) {
        let mut node = self;
        for step in steps(path) {
            let at = match node.children.iter().position(|(known, _)| *known == step) {
                Some(at) => at,
                None => {
                    node.children.push((step, FieldTree::default()));
                    node.children.len() - 1
                }
            };
            node = &mut node.children[at].1;
        }
        if !node.targets.contains(&target) {
            node.targets.push(target);
        }
    }

    /// Picks the fields out of a JSON message into `picked`, which is emptied first.
    ///
    /// # Errors
    /// The message is not JSON, or a wanted field is not a number.
    pub fn pick(&self, json: &[u8], picked: &mut Picked) -> Result<(), serde_json::Error> {
        picked.values.clear();
        picked.time_ns = None;
        let mut deserializer = serde_json::Deserializer::from_slice(json);
        Node { tree: self, picked }.deserialize(&mut deserializer)?;
        deserializer.end()
    }

    /// Picks the fields out of a decoded message into `picked`, which is emptied first.
    ///
    /// # Errors
    /// A wanted field is not a number.
    pub fn pick_value(
        &self,
        value: &serde_json::Value,
        picked: &mut Picked,
    ) -> Result<(), serde_json::Error> {
        picked.values.clear();
        picked.time_ns = None;
        Node { tree: self, picked }.deserialize(value)
    }
}

/// `a.b[2].c` → a, b, 2, c.
fn steps(path: &str) -> Vec<Step> {
    path.split(['.', '['])
        .filter(|part| !part.is_empty())
        .map(|part| match part.strip_suffix(']').and_then(|index| index.parse().ok()) {
            Some(index) => Step::Index(index),
            None => Step::Key(part.to_owned()),
        })
        .collect()
}

/// A node of the tree over a value of the message.
struct Node<'t, 'p> {
    tree: &'t FieldTree,
    picked: &'p mut Picked,
}

impl Node<'_, '_> {
    fn take<E>(self, value: f64) -> Result<(), E> {
        for target in &self.tree.targets {
            match target {
                Target::Signal { signal, scale, offset } => {
                    self.picked.values.push((*signal, value * scale + offset));
                }
                Target::Time { unit_ns } => {
                    let part = (value * unit_ns).round() as i64;
                    self.picked.time_ns = Some(self.picked.time_ns.unwrap_or(0).saturating_add(part));
                }
            }
        }
        Ok(())
    }
}

impl<'de> DeserializeSeed<'de> for Node<'_, '_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Node<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a message with the mapped fields as numbers")
    }

    fn visit_f64<E>(self, value: f64) -> Result<(), E> {
        self.take(value)
    }

    fn visit_i64<E>(self, value: i64) -> Result<(), E> {
        self.take(value as f64)
    }

    fn visit_u64<E>(self, value: u64) -> Result<(), E> {
        self.take(value as f64)
    }

    fn visit_bool<E>(self, value: bool) -> Result<(), E> {
        self.take(f64::from(u8::from(value)))
    }

    /// JSON has no NaN; writers put null in its place.
    fn visit_unit<E>(self) -> Result<(), E> {
        self.take(f64::NAN)
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<(), E> {
        match text.parse() {
            Ok(value) => self.take(value),
            Err(_) if self.tree.targets.is_empty() => Ok(()),
            Err(_) => Err(E::custom(format_args!("`{text}` is not a number"))),
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(child) = map.next_key_seed(KeyOf(self.tree))? {
            match child {
                Some(tree) => map.next_value_seed(Node { tree, picked: self.picked })?,
                None => {
                    map.next_value::<IgnoredAny>()?;
                }
            }
        }
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<(), A::Error> {
        for index in 0.. {
            let child = self.tree.children.iter().find(|(step, _)| *step == Step::Index(index));
            let more = match child {
                Some((_, tree)) => seq.next_element_seed(Node { tree, picked: self.picked })?.is_some(),
                None => seq.next_element::<IgnoredAny>()?.is_some(),
            };
            if !more {
                break;
            }
        }
        Ok(())
    }
}

/// A message's key, as the child of the tree that it leads to.
struct KeyOf<'t>(&'t FieldTree);

impl<'de, 't> DeserializeSeed<'de> for KeyOf<'t> {
    type Value = Option<&'t FieldTree>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl<'t> Visitor<'_> for KeyOf<'t> {
    type Value = Option<&'t FieldTree>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key")
    }

    fn visit_str<E>(self, key: &str) -> Result<Self::Value, E> {
        let child = self.0.children.iter().find(|(step, _)| matches!(step, Step::Key(known) if known == key));
        Ok(child.map(|(_, tree)| tree))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(mappings: &[(Signal, SignalMapping)]) -> FieldTree {
        FieldTree::of(mappings.iter().map(|(signal, mapping)| (*signal, mapping)))
    }

    fn mapping(field: &str, scale: f64, time: &str) -> SignalMapping {
        SignalMapping { field: field.into(), scale, time: time.into(), ..SignalMapping::default() }
    }

    #[test]
    fn nested_paths_and_indices_are_scaled() {
        let tree = tree(&[
            (Signal::Command, mapping("axis.valve[1]", 0.01, "stamp")),
            (Signal::PCap, mapping("axis.p", 1e5, "")),
        ]);
        let mut picked = Picked::default();
        tree.pick(br#"{"x":[1,{"y":2}],"stamp":7.5,"axis":{"valve":[3,25,4],"p":80}}"#, &mut picked).unwrap();
        assert_eq!(picked.values, [(Signal::Command, 0.25), (Signal::PCap, 8e6)]);
        assert_eq!(picked.time_ns, Some(7_500_000_000));
    }

    #[test]
    fn null_is_not_a_number_and_text_is_refused() {
        let tree = tree(&[(Signal::Command, mapping("command", 1.0, ""))]);
        let mut picked = Picked::default();
        tree.pick(br#"{"command":null}"#, &mut picked).unwrap();
        assert!(picked.values[0].1.is_nan());
        let error = tree.pick(br#"{"command":"fast"}"#, &mut picked).unwrap_err();
        assert!(error.to_string().contains("`fast` is not a number"));
        assert!(tree.pick(b"{\"command\":0.1", &mut picked).is_err());
    }
}
