//! Samples from an MCAP log: JSON, protobuf or CDR messages, one signal a message or many.

use std::io::{Read, Seek};

use mcap::records::op;
use seepd_signals::{Sample, Signal};

use super::Source;
use super::channels::Channels;
use super::fields::Picked;
use super::mcap_file::McapFile;
use crate::error::LogError;
use crate::mapping::SignalMapping;
use crate::record_log::RecordLog;

/// Message header: channel, sequence, log time, publish time.
pub(crate) const MESSAGE_HEADER_BYTES: usize = 2 + 4 + 8 + 8;

/// Samples from an MCAP log: JSON, protobuf or CDR messages, one signal a message or many.
pub struct McapSource<'i> {
    name: String,
    file: Box<dyn RecordLog + Send + 'i>,
    channels: Channels,
    picked: Picked,
    /// The record at hand.
    record: Vec<u8>,
    /// The newest value of each signal: a command is published with what was known beside it.
    held: Sample,
    unreadable: LeftOut,
    without_command: LeftOut,
    given: u64,
    summary_asked: bool,
    begun: bool,
}

/// Messages of which no use is made.
#[derive(Default)]
struct LeftOut {
    count: u64,
    first: String,
}

impl LeftOut {
    fn add(&mut self, first: impl FnOnce() -> String) {
        if self.count == 0 {
            self.first = first();
        }
        self.count += 1;
    }

    fn note(&self, what: &str) -> Option<String> {
        let LeftOut { count, first } = self;
        (*count > 0).then(|| format!("{count} messages were left out {what}, the first {first}"))
    }
}

impl<'i> McapSource<'i> {
    /// Reads the magic bytes.
    ///
    /// # Errors
    /// [`LogError`] where the file cannot be read or is no MCAP file.
    pub fn new<R: Read + Seek + Send + 'i>(
        file: R,
        name: &str,
        mapping: Vec<(Signal, SignalMapping)>,
    ) -> Result<Self, LogError> {
        let file = McapFile::whole(file).map_err(|error| {
            LogError::data(name, format!("this is not an MCAP log, or it is cut short: {error}"))
        })?;
        Ok(Self::of(Box::new(file), name, mapping))
    }

    /// Reads the records of a log.
    pub(crate) fn of(
        file: Box<dyn RecordLog + Send + 'i>,
        name: &str,
        mapping: Vec<(Signal, SignalMapping)>,
    ) -> Self {
        McapSource {
            name: name.into(),
            file,
            channels: Channels::new(name, mapping),
            picked: Picked::default(),
            record: Vec::new(),
            held: Sample::new(0),
            unreadable: LeftOut::default(),
            without_command: LeftOut::default(),
            given: 0,
            summary_asked: false,
            begun: false,
        }
    }

    /// The error for a log in which nothing matched.
    fn nothing_matched(&self) -> LogError {
        let why: Vec<String> = self.file.notes().into_iter().chain(self.left_out()).collect();
        let why = if why.is_empty() { String::new() } else { format!(" ({})", why.join("; ")) };
        let (wanted, listed) = (self.channels.wanted(), self.channels.listed());
        LogError::data(&self.name, format!("no message has {wanted}; the log has {listed}{why}"))
    }

    fn left_out(&self) -> impl Iterator<Item = String> {
        let unreadable = self.unreadable.note("as unreadable");
        unreadable.into_iter().chain(self.without_command.note("since they have no command"))
    }

    fn io(&self, error: std::io::Error) -> LogError {
        LogError::reading(&self.name, error)
    }

    /// Channels of which the announcement was lost with a damaged chunk.
    #[cold]
    fn ask_summary(&mut self) -> Result<(), LogError> {
        self.summary_asked = true;
        let mut result = Ok(());
        let channels = &mut self.channels;
        let read = self.file.each_in_summary(&mut |opcode, content| {
            if result.is_ok() {
                result = channels.take_announcement(opcode, content);
            }
        });
        read.map_err(|error| self.io(error))?;
        result
    }

    /// Of a log that is far away, asks its index where the mapped channels are.
    #[cold]
    fn begin(&mut self) -> Result<(), LogError> {
        self.begun = true;
        if !self.file.has_far_index() {
            return Ok(());
        }
        self.ask_summary()?;
        if self.channels.has_mapped() {
            let channels = &self.channels;
            let read = self.file.only(&|id| channels.is_mapped(id) || !channels.is_announced(id));
            read.map_err(|error| LogError::reading(&self.name, error))?;
        }
        Ok(())
    }

    /// The sample that the message at hand completes, if it holds a command.
    fn take_message(&mut self) -> Option<Sample> {
        let (header, data) = self.record.split_at_checked(MESSAGE_HEADER_BYTES)?;
        let channel = self.channels.of_message(channel_id(header))?;
        let log_time_ns = log_time_ns(header);
        if let Err(error) = channel.decoder.pick(&channel.fields, data, &mut self.picked) {
            self.unreadable.add(|| format!("at {log_time_ns} ns: {error}"));
            return None;
        }
        let mut has_command = false;
        for (signal, value) in &self.picked.values {
            self.held.set(*signal, *value);
            has_command |= *signal == Signal::Command;
        }
        if !has_command {
            if channel.has_command {
                self.without_command.add(|| format!("at {log_time_ns} ns"));
            }
            return None;
        }
        self.held.time_ns = self.picked.time_ns().unwrap_or(log_time_ns);
        self.given += 1;
        Some(self.held)
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

impl Source for McapSource<'_> {
    fn next_sample(&mut self) -> Result<Option<Sample>, LogError> {
        if !self.begun {
            self.begin()?;
        }
        loop {
            match self.file.next_record(&mut self.record) {
                Err(error) => return Err(self.io(error)),
                Ok(None) if self.given == 0 => return Err(self.nothing_matched()),
                Ok(None) => return Ok(None),
                Ok(Some(op::MESSAGE)) if self.record.len() >= MESSAGE_HEADER_BYTES => {
                    if !self.summary_asked && !self.channels.is_announced(channel_id(&self.record)) {
                        self.ask_summary()?;
                    }
                    if let Some(sample) = self.take_message() {
                        return Ok(Some(sample));
                    }
                }
                Ok(Some(opcode)) => self.channels.take_announcement(opcode, &self.record)?,
            }
        }
    }

    fn notes(&self) -> Vec<String> {
        let damage = self.file.notes().into_iter();
        let notes = damage.chain(self.channels.note()).chain(self.left_out());
        notes.map(|note| format!("{}: {note}", self.name)).collect()
    }
}
