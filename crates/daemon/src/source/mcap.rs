//! Samples from an MCAP log: JSON messages, one signal a message or many.

use std::collections::BTreeMap;
use std::io::{Read, Seek};

use mcap::records::{Record, op};
use seepd_signals::{Sample, Signal};

use super::fields::{FieldTree, Picked};
use super::mcap_file::{McapFile, parse};
use super::Source;
use crate::config::SignalMapping;
use crate::failure::Failure;

/// Ending of the topics that are read when no mapping names one.
const DEFAULT_TOPIC_ENDING: &str = "/signals";
/// Message header: channel, sequence, log time, publish time.
const MESSAGE_HEADER_BYTES: usize = 2 + 4 + 8 + 8;

/// What is known of a channel.
struct Channel {
    topic: String,
    encoding: String,
    messages: u64,
    /// Fields that are wanted of its messages, if any.
    fields: Option<FieldTree>,
}

/// See the [module](self).
pub struct McapSource<R> {
    name: String,
    file: McapFile<R>,
    mapping: Vec<(Signal, SignalMapping)>,
    channels: BTreeMap<u16, Channel>,
    picked: Picked,
    /// The newest value of each signal: a command is published with what was known beside it.
    held: Sample,
    unreadable: u64,
    first_unreadable: Option<String>,
    given: u64,
}

impl<R: Read + Seek> McapSource<R> {
    /// Reads the magic bytes.
    ///
    /// # Errors
    /// [`Failure`] where the file cannot be read or is no MCAP file.
    pub fn new(file: R, name: &str, mapping: Vec<(Signal, SignalMapping)>) -> Result<Self, Failure> {
        let file = McapFile::new(file)
            .map_err(|error| Failure::data(format!("{name}: is cut short or no MCAP log: {error}")))?;
        Ok(McapSource {
            name: name.into(),
            file,
            mapping,
            channels: BTreeMap::new(),
            picked: Picked::default(),
            held: Sample::new(0),
            unreadable: 0,
            first_unreadable: None,
            given: 0,
        })
    }

    fn add_channel(&mut self, id: u16, topic: String, encoding: String) -> Result<(), Failure> {
        if self.channels.contains_key(&id) {
            return Ok(());
        }
        let wanted = |mapping: &&(Signal, SignalMapping)| {
            if mapping.1.topic.is_empty() { topic.ends_with(DEFAULT_TOPIC_ENDING) } else { mapping.1.topic == topic }
        };
        let mappings: Vec<_> = self.mapping.iter().filter(wanted).collect();
        if !mappings.is_empty() && encoding != "json" {
            return Err(Failure::data(format!(
                "{}: topic {topic} has the message encoding `{encoding}`; this version reads `json`",
                self.name
            )));
        }
        let default = mappings.iter().any(|mapping| mapping.1.topic.is_empty());
        let other = self.channels.values().find(|other| default && other.fields.is_some() && other.topic != topic);
        if let Some(other) = other {
            return Err(Failure::data(format!(
                "{}: holds several axes, {} and {topic}; choose one with --topic",
                self.name, other.topic
            )));
        }
        let fields =
            (!mappings.is_empty()).then(|| FieldTree::of(mappings.iter().map(|mapping| (mapping.0, &mapping.1))));
        self.channels.insert(id, Channel { topic, encoding, messages: 0, fields });
        Ok(())
    }

    /// The error for a log in which nothing matched.
    fn nothing_matched(&self) -> Failure {
        let listed: Vec<String> = self
            .channels
            .values()
            .map(|channel| format!("{} ({}, {} messages)", channel.topic, channel.encoding, channel.messages))
            .collect();
        let listed = if listed.is_empty() { "no topics at all".to_owned() } else { listed.join(", ") };
        let command = self.mapping.iter().find(|(signal, _)| *signal == Signal::Command).map(|(_, mapping)| mapping);
        let wanted = match command {
            Some(m) if !m.topic.is_empty() => format!("`{}` on topic {}", m.field, m.topic),
            Some(m) => format!("`{}` on a topic that ends in {DEFAULT_TOPIC_ENDING}", m.field),
            None => "a command: the mapping has none".into(),
        };
        let damage = self.damage_notes().join("; ");
        let damage = if damage.is_empty() { damage } else { format!(" ({damage})") };
        Failure::data(format!("{}: no message has {wanted}; the log holds {listed}{damage}", self.name))
    }

    fn damage_notes(&self) -> Vec<String> {
        let damage = &self.file.damage;
        let mut notes = Vec::new();
        if let Some(at) = damage.cut_at {
            notes.push(format!("ends at byte {at} in the middle of its data; read up to there"));
        }
        if damage.chunks > 0 || damage.skipped_bytes > 0 {
            let at = damage.first_at.unwrap_or(0);
            notes.push(format!(
                "{} damaged chunks and {} damaged bytes between them left out, the first at byte {at}",
                damage.chunks, damage.skipped_bytes
            ));
        }
        notes
    }
}

impl<R: Read + Seek> Source for McapSource<R> {
    fn next_sample(&mut self) -> Result<Option<Sample>, Failure> {
        loop {
            let record = self.file.next_record();
            let record = record.map_err(|error| Failure::new(crate::failure::Code::Io, format!("{}: {error}", self.name)))?;
            let Some((opcode, content)) = record else {
                return if self.given == 0 { Err(self.nothing_matched()) } else { Ok(None) };
            };
            if opcode == op::MESSAGE {
                let Some((header, data)) = content.split_at_checked(MESSAGE_HEADER_BYTES) else { continue };
                let id = u16::from_le_bytes([header[0], header[1]]);
                let Some(channel) = self.channels.get_mut(&id) else { continue };
                channel.messages += 1;
                let Some(fields) = &channel.fields else { continue };
                let log_time = u64::from_le_bytes(std::array::from_fn(|index| header[6 + index]));
                if let Err(error) = fields.pick(data, &mut self.picked).or_else(|_| pick_with_nan(fields, data, &mut self.picked)) {
                    self.unreadable += 1;
                    self.first_unreadable.get_or_insert_with(|| format!("at {log_time} ns: {error}"));
                    continue;
                }
                let mut has_command = false;
                for (signal, value) in &self.picked.values {
                    self.held.set(*signal, *value);
                    has_command |= *signal == Signal::Command;
                }
                if has_command {
                    let time_ns = self.picked.time_s.map_or(log_time as i64, |time_s| (time_s * 1e9).round() as i64);
                    self.given += 1;
                    self.held.time_ns = time_ns;
                    return Ok(Some(self.held));
                }
            } else if opcode == op::CHANNEL {
                let channel = match parse(opcode, content) {
                    Some(Record::Channel(channel)) => channel,
                    _ => continue,
                };
                self.add_channel(channel.id, channel.topic, channel.message_encoding)?;
            }
        }
    }

    fn notes(&self) -> Vec<String> {
        let mut notes: Vec<String> = self.damage_notes().into_iter().map(|note| format!("{}: {note}", self.name)).collect();
        if self.unreadable > 0 {
            let first = self.first_unreadable.as_deref().unwrap_or_default();
            notes.push(format!("{}: {} messages left out as unreadable, the first {first}", self.name, self.unreadable));
        }
        notes
    }
}

/// Some writers put NaN and Infinity into JSON, which has neither: reads them as null.
#[cold]
fn pick_with_nan(fields: &FieldTree, json: &[u8], picked: &mut Picked) -> Result<(), serde_json::Error> {
    let text = String::from_utf8_lossy(json);
    let mended = text.replace("-Infinity", "null").replace("Infinity", "null").replace("NaN", "null");
    fields.pick(mended.as_bytes(), picked)
}
