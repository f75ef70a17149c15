//! The channels of an MCAP log: which are mapped, how these are decoded, and what to tell of the others.

use std::collections::{BTreeMap, BTreeSet};

use mcap::records::op;
use seepd_signals::Signal;

use super::decode::{DECODERS_BYTES, Decoder, decoder_bytes};
use super::fields::FieldTree;
use super::mcap_file::{ChannelRecord, Schemas};
use crate::error::LogError;
use crate::mapping::SignalMapping;

/// Ending of the topics that are read when no mapping names one.
const DEFAULT_TOPIC_ENDING: &str = "/signals";
/// Topics that are told of where none is mapped.
const TOPICS_TOLD: usize = 32;
/// Channels that may be mapped: a topic has one, or one a sender.
const MOST_MAPPED: usize = 64;

/// The ending of a mapping's topics, where it does not name one.
fn topic_ending(mapping: &SignalMapping) -> Option<&str> {
    if mapping.topic.is_empty() { Some(DEFAULT_TOPIC_ENDING) } else { mapping.topic.strip_prefix('*') }
}

/// See the [module](self).
pub(super) struct Channels {
    log: String,
    mapping: Vec<(Signal, SignalMapping)>,
    schemas: Schemas,
    mapped: BTreeMap<u16, MappedChannel>,
    /// Bytes that the decoders of `mapped` may take.
    decoder_bytes: usize,
    announced: BTreeSet<u16>,
    told: BTreeMap<u16, ToldChannel>,
    /// Messages of channels that are announced nowhere.
    unannounced: u64,
    /// The one topic that was found by its ending.
    by_ending: Option<String>,
}

/// A channel from which signals are read.
pub(super) struct MappedChannel {
    pub(super) decoder: Decoder,
    pub(super) fields: FieldTree,
    /// Whether each of its messages is to hold a command.
    pub(super) has_command: bool,
}

struct ToldChannel {
    topic: String,
    encoding: String,
    messages: u64,
}

impl Channels {
    pub(super) fn new(log: &str, mapping: Vec<(Signal, SignalMapping)>) -> Self {
        Channels {
            log: log.into(),
            mapping,
            schemas: Schemas::default(),
            mapped: BTreeMap::new(),
            decoder_bytes: 0,
            announced: BTreeSet::new(),
            told: BTreeMap::new(),
            unannounced: 0,
            by_ending: None,
        }
    }

    /// Takes a record that announces a schema or a channel; others are none of its business.
    ///
    /// # Errors
    /// [`LogError`] where a mapped channel cannot be read, or the log has several axes.
    pub(super) fn take_announcement(&mut self, opcode: u8, content: &[u8]) -> Result<(), LogError> {
        match opcode {
            op::SCHEMA => self.schemas.take(content),
            op::CHANNEL => {
                if let Some(channel) = ChannelRecord::parse(content) {
                    self.add(&channel)?;
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn add(&mut self, channel: &ChannelRecord) -> Result<(), LogError> {
        let ChannelRecord { id, schema_id, topic, encoding } = channel;
        if !self.announced.insert(*id) {
            return Ok(());
        }
        if self.told.len() < TOPICS_TOLD {
            let (topic, encoding) = (topic.clone(), encoding.clone());
            self.told.insert(*id, ToldChannel { topic, encoding, messages: 0 });
        }
        let wanted = |mapping: &&(Signal, SignalMapping)| {
            topic_ending(&mapping.1).map_or(mapping.1.topic == *topic, |ending| topic.ends_with(ending))
        };
        let mappings: Vec<_> = self.mapping.iter().filter(wanted).collect();
        if mappings.is_empty() {
            return Ok(());
        }
        if mappings.iter().any(|mapping| topic_ending(&mapping.1).is_some()) {
            let other = self.by_ending.get_or_insert_with(|| topic.clone());
            if other != topic {
                return Err(LogError::data(
                    &self.log,
                    format!("the log has several axes, {other} and {topic}; choose one with --topic"),
                ));
            }
        }
        let schema = self.schemas.get(*schema_id);
        self.decoder_bytes += schema.map_or(0, decoder_bytes);
        if self.mapped.len() == MOST_MAPPED || self.decoder_bytes > DECODERS_BYTES {
            return Err(LogError::data(
                &self.log,
                format!(
                    "topic {topic} is announced too often, or with schemas that are too long, to be read"
                ),
            ));
        }
        let decoder = Decoder::new(encoding, schema)
            .map_err(|error| LogError::data(&self.log, format!("topic {topic} {error}")))?;
        let fields = FieldTree::of(mappings.iter().map(|mapping| (mapping.0, &mapping.1)))
            .map_err(|error| LogError::mapping(error.to_string()))?;
        let has_command = fields.wants_command();
        self.mapped.insert(*id, MappedChannel { decoder, fields, has_command });
        Ok(())
    }

    pub(super) fn is_announced(&self, id: u16) -> bool {
        self.announced.contains(&id)
    }

    /// Whether any channel is mapped so far.
    pub(super) fn has_mapped(&self) -> bool {
        !self.mapped.is_empty()
    }

    pub(super) fn is_mapped(&self, id: u16) -> bool {
        self.mapped.contains_key(&id)
    }

    /// The channel of a message, if it is mapped; counts the message.
    pub(super) fn of_message(&mut self, id: u16) -> Option<&MappedChannel> {
        if let Some(told) = self.told.get_mut(&id) {
            told.messages += 1;
        } else if !self.announced.contains(&id) {
            self.unannounced += 1;
        }
        self.mapped.get(&id)
    }

    /// What a person should know of messages without a channel.
    pub(super) fn note(&self) -> Option<String> {
        (self.unannounced > 0)
            .then(|| format!("{} messages of topics that it does not name", self.unannounced))
    }

    /// What the log holds, in a line.
    pub(super) fn listed(&self) -> String {
        let channel = |channel: &ToldChannel| {
            format!("{} ({}, {} messages)", channel.topic, channel.encoding, channel.messages)
        };
        let mut listed: Vec<String> = self.told.values().map(channel).collect();
        if self.announced.len() > listed.len() {
            listed.push(format!("{} more topics", self.announced.len() - listed.len()));
        }
        if self.unannounced > 0 {
            listed.push(format!("{} messages of topics that it does not name", self.unannounced));
        }
        if listed.is_empty() { "no topics at all".to_owned() } else { listed.join(", ") }
    }

    /// What the mapping asks for, in words.
    pub(super) fn wanted(&self) -> String {
        let command = self.mapping.iter().find(|(signal, _)| *signal == Signal::Command);
        match command {
            Some((_, mapping)) => match topic_ending(mapping) {
                Some(ending) => format!("`{}` on a topic that ends in {ending}", mapping.field),
                None => format!("`{}` on topic {}", mapping.field, mapping.topic),
            },
            None => "a command, which the mapping does not name".into(),
        }
    }
}
