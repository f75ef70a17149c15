//! Samples from an MCAP log: JSON, protobuf or CDR messages, one signal a message or many.

use std::collections::BTreeMap;
use std::io::{Read, Seek};

use mcap::records::op;
use seepd_signals::{Sample, Signal};

use super::Source;
use super::decode::Decoder;
use super::fields::{FieldTree, Picked};
use super::mcap_file::{ChannelRecord, McapFile, SchemaRecord};
use crate::config::SignalMapping;
use crate::failure::{Code, Failure};

/// Ending of the topics that are read when no mapping names one.
const DEFAULT_TOPIC_ENDING: &str = "/signals";
/// Message header: channel, sequence, log time, publish time.
pub(crate) const MESSAGE_HEADER_BYTES: usize = 2 + 4 + 8 + 8;

/// The ending of a mapping's topics, where it does not name one.
fn topic_ending(mapping: &SignalMapping) -> Option<&str> {
    if mapping.topic.is_empty() { Some(DEFAULT_TOPIC_ENDING) } else { mapping.topic.strip_prefix('*') }
}

/// What is known of a channel.
struct Channel {
    topic: String,
    encoding: String,
    messages: u64,
    /// How its messages are decoded and which fields are wanted of them, if any.
    wanted: Option<(Decoder, FieldTree)>,
}

/// See the [module](self).
pub struct McapSource<R> {
    name: String,
    file: McapFile<R>,
    mapping: Vec<(Signal, SignalMapping)>,
    schemas: BTreeMap<u16, SchemaRecord>,
    channels: BTreeMap<u16, Channel>,
    picked: Picked,
    /// The record at hand.
    message: Vec<u8>,
    /// The newest value of each signal: a command is published with what was known beside it.
    held: Sample,
    unreadable: u64,
    first_unreadable: Option<String>,
    given: u64,
    /// Messages of channels that are announced nowhere.
    unannounced: u64,
    summary_asked: bool,
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
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            picked: Picked::default(),
            message: Vec::new(),
            held: Sample::new(0),
            unreadable: 0,
            first_unreadable: None,
            given: 0,
            unannounced: 0,
            summary_asked: false,
        })
    }

    fn add_channel(&mut self, channel: ChannelRecord) -> Result<(), Failure> {
        let ChannelRecord { id, schema_id, topic, encoding } = channel;
        if self.channels.contains_key(&id) {
            return Ok(());
        }
        let wanted = |mapping: &&(Signal, SignalMapping)| {
            topic_ending(&mapping.1).map_or(mapping.1.topic == topic, |ending| topic.ends_with(ending))
        };
        let mappings: Vec<_> = self.mapping.iter().filter(wanted).collect();
        let by_ending = mappings.iter().any(|mapping| topic_ending(&mapping.1).is_some());
        let other =
            self.channels.values().find(|other| by_ending && other.wanted.is_some() && other.topic != topic);
        if let Some(other) = other {
            return Err(Failure::data(format!(
                "{}: holds several axes, {} and {topic}; choose one with --topic",
                self.name, other.topic
            )));
        }
        let mut wanted = None;
        if !mappings.is_empty() {
            let decoder = Decoder::new(&encoding, self.schemas.get(&schema_id))
                .map_err(|what| Failure::data(format!("{}: topic {topic} {what}", self.name)))?;
            let fields = FieldTree::of(mappings.iter().map(|mapping| (mapping.0, &mapping.1)));
            wanted = Some((decoder, fields));
        }
        self.channels.insert(id, Channel { topic, encoding, messages: 0, wanted });
        Ok(())
    }

    /// The error for a log in which nothing matched.
    fn nothing_matched(&self) -> Failure {
        let mut listed: Vec<String> = self
            .channels
            .values()
            .map(|channel| format!("{} ({}, {} messages)", channel.topic, channel.encoding, channel.messages))
            .collect();
        if self.unannounced > 0 {
            listed.push(format!("{} messages of topics that it does not name", self.unannounced));
        }
        let listed = if listed.is_empty() { "no topics at all".to_owned() } else { listed.join(", ") };
        let command =
            self.mapping.iter().find(|(signal, _)| *signal == Signal::Command).map(|(_, mapping)| mapping);
        let wanted = match command {
            Some(m) => match topic_ending(m) {
                Some(ending) => format!("`{}` on a topic that ends in {ending}", m.field),
                None => format!("`{}` on topic {}", m.field, m.topic),
            },
            None => "a command: the mapping has none".into(),
        };
        let damage = self.file.damage.notes().join("; ");
        let damage = if damage.is_empty() { damage } else { format!(" ({damage})") };
        Failure::data(format!("{}: no message has {wanted}; the log holds {listed}{damage}", self.name))
    }

    fn io(&self, error: &std::io::Error) -> Failure {
        Failure::new(Code::Io, format!("{}: {error}", self.name))
    }

    /// Channels of which the announcement was lost with a damaged chunk.
    #[cold]
    fn ask_summary(&mut self) -> Result<(), Failure> {
        self.summary_asked = true;
        let found = self.file.summary_channels().map_err(|error| self.io(&error))?;
        self.schemas.extend(found.schemas.into_iter().map(|schema| (schema.id, schema)));
        for channel in found.channels {
            self.add_channel(channel)?;
        }
        Ok(())
    }

    /// The sample that the message in `self.message` completes, if it holds a command.
    fn take_message(&mut self) -> Option<Sample> {
        let (header, data) = self.message.split_at_checked(MESSAGE_HEADER_BYTES)?;
        let Some(channel) = self.channels.get_mut(&channel_id(header)) else {
            self.unannounced += 1;
            return None;
        };
        channel.messages += 1;
        let (decoder, fields) = channel.wanted.as_ref()?;
        let log_time_ns = log_time_ns(header);
        let picked = &mut self.picked;
        if let Err(error) = decoder.pick(fields, data, picked) {
            self.unreadable += 1;
            self.first_unreadable.get_or_insert_with(|| format!("at {log_time_ns} ns: {error}"));
            return None;
        }
        let mut has_command = false;
        for (signal, value) in &self.picked.values {
            self.held.set(*signal, *value);
            has_command |= *signal == Signal::Command;
        }
        self.held.time_ns = self.picked.time_ns.unwrap_or(log_time_ns);
        self.given += u64::from(has_command);
        has_command.then_some(self.held)
    }
}

/// Channel of a message.
pub(crate) fn channel_id(message: &[u8]) -> u16 {
    u16::from_le_bytes([message[0], message[1]])
}

/// Log time of a message, ns.
pub(crate) fn log_time_ns(message: &[u8]) -> i64 {
    let stamp = u64::from_le_bytes(std::array::from_fn(|index| message[6 + index]));
    i64::try_from(stamp).unwrap_or(i64::MAX)
}

impl<R: Read + Seek> Source for McapSource<R> {
    fn next_sample(&mut self) -> Result<Option<Sample>, Failure> {
        loop {
            match self.file.next_record(&mut self.message) {
                Err(error) => return Err(self.io(&error)),
                Ok(None) if self.given == 0 => return Err(self.nothing_matched()),
                Ok(None) => return Ok(None),
                Ok(Some(op::MESSAGE)) if self.message.len() >= MESSAGE_HEADER_BYTES => {
                    if !self.summary_asked && !self.channels.contains_key(&channel_id(&self.message)) {
                        self.ask_summary()?;
                    }
                    if let Some(sample) = self.take_message() {
                        return Ok(Some(sample));
                    }
                }
                Ok(Some(op::SCHEMA)) => {
                    self.schemas.extend(SchemaRecord::parse(&self.message).map(|schema| (schema.id, schema)));
                }
                Ok(Some(op::CHANNEL)) => {
                    if let Some(channel) = ChannelRecord::parse(&self.message) {
                        self.add_channel(channel)?;
                    }
                }
                Ok(Some(_)) => {}
            }
        }
    }

    fn notes(&self) -> Vec<String> {
        let mut notes: Vec<String> =
            self.file.damage.notes().into_iter().map(|note| format!("{}: {note}", self.name)).collect();
        if self.unannounced > 0 {
            notes.push(format!(
                "{}: {} messages of topics that it does not name",
                self.name, self.unannounced
            ));
        }
        if self.unreadable > 0 {
            let first = self.first_unreadable.as_deref().unwrap_or_default();
            notes.push(format!(
                "{}: {} messages left out as unreadable, the first {first}",
                self.name, self.unreadable
            ));
        }
        notes
    }
}
