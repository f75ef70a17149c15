//! A look at a whole log: topics, rates, gaps, numeric fields, and a guess what they are.

use std::collections::{BTreeMap, HashMap};
use std::io::{Cursor, Read, Seek};

use mcap::records::op;
use seepd_signals::Signal;
use serde::Serialize;

use super::bus_survey::{BusFound, BusSurvey, RawGuess};
use super::candump::{self, LONGEST_LINE};
use super::decode::{DECODERS_BYTES, Decoder, decoder_bytes};
use super::fields::{LONGEST_PATH, Paths};
use super::guess::{Guess, guess};
use super::intervals::Intervals;
use super::kind::{HEAD_BYTES, LogKind};
use super::lines::Lines;
use super::mcap_file::{ChannelRecord, McapFile, Schemas};
use super::rows::Rows;
use crate::can::dbc::Dbc;
use crate::error::LogError;
use crate::mapping::TimeUnit;

/// `seepd.inspect/1`: what a log holds.
#[derive(Serialize)]
pub struct LogSurvey {
    /// `seepd.inspect/1`.
    pub schema: &'static str,
    /// Name of the log.
    pub file: String,
    /// `MCAP`, `CSV` or `candump`.
    pub kind: &'static str,
    /// Topics in the order of their names.
    pub topics: Vec<TopicSurvey>,
    /// Where a CSV's time is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time: Option<TimeGuess>,
    /// The mapping that would read the guessed signals, by signal.
    pub mapping: BTreeMap<Signal, Guess>,
    /// What was damaged or could not be looked into.
    pub notes: Vec<String>,
}

/// A CSV's time column, with the unit that its name tells.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TimeGuess {
    /// Name.
    pub column: String,
    /// Unit.
    pub unit: TimeUnit,
}

/// A topic; a CSV's rows are one, and so are a CAN log's frames of one interface and identifier.
#[derive(Default, Serialize)]
pub struct TopicSurvey {
    /// Name.
    pub topic: String,
    /// Message encoding.
    pub encoding: String,
    /// Name of the schema.
    pub schema: String,
    /// Messages.
    pub messages: u64,
    /// Median rate, Hz.
    pub rate_hz: Option<f64>,
    /// Between the first and the last message, s.
    pub duration_s: f64,
    /// Intervals longer than 2.5 times the median.
    pub gaps: u64,
    /// The longest of them, s.
    pub longest_gap_s: f64,
    /// Why its messages cannot be decoded, if they cannot.
    pub problem: Option<String>,
    /// Messages that do not fit their encoding.
    pub unreadable: u64,
    /// Bits that change in a CAN frame's bytes, in hexadecimal, the first byte first.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub changing_bits: Option<String>,
    /// Numeric fields.
    pub fields: Vec<FieldSurvey>,
    /// What a mapping calls it.
    #[serde(skip)]
    pub(crate) mapping_topic: String,
    #[serde(skip)]
    pub(super) intervals: Intervals,
    /// Where each field stands in `fields`.
    #[serde(skip)]
    pub(super) places: HashMap<String, usize>,
    #[serde(skip)]
    pub(super) decoder: Option<Decoder>,
}

/// A numeric field.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FieldSurvey {
    /// Path in the message.
    pub path: String,
    /// Messages that have it.
    pub count: u64,
    /// Smallest value.
    pub least: f64,
    /// Largest value.
    pub largest: f64,
    /// The signal that it seems to be.
    pub guess: Option<&'static str>,
}

/// Messages of a topic whose fields are looked into; the times of all are.
const LOOKED_INTO: u64 = 20_000;
/// Bytes of messages that are looked into in all.
const BYTES_LOOKED_INTO: usize = 256 << 20;
/// Fields of a topic that are told.
pub(super) const FIELDS_KEPT: usize = 256;
/// Topics that are told; large robots have some hundred.
pub(super) const TOPICS_KEPT: usize = 1024;
/// Fields that are told in all.
const FIELDS_IN_ALL: usize = 1 << 15;

/// Looks through a log.
///
/// # Errors
/// [`LogError`] where it cannot be read or is of no kind that is known.
pub fn survey<R: Read + Seek>(
    mut input: R,
    name: &str,
    time_column: &str,
    dbc: Option<&Dbc>,
) -> Result<LogSurvey, LogError> {
    let io = |error: std::io::Error| LogError::reading(name, error);
    let mut head = Vec::new();
    input.by_ref().take(HEAD_BYTES as u64).read_to_end(&mut head).map_err(io)?;
    let kind = LogKind::of(&head, name)?;
    if kind == LogKind::Mcap {
        input.rewind().map_err(io)?;
    }
    // What has been read of a pipe does not come again.
    let text = Cursor::new(head).chain(&mut input);
    Ok(match kind {
        LogKind::Mcap => {
            let (topics, notes) = survey_mcap(input, name)?;
            LogSurvey::new(name, "MCAP", topics, None, notes)
        }
        LogKind::Csv => {
            let unit = TimeUnit::of_column(time_column);
            let (topic, mut notes) = survey_csv(text, name, time_column, unit)?;
            let time = notes.is_empty().then(|| TimeGuess { column: time_column.to_owned(), unit });
            if time.is_some() && unit != TimeUnit::S {
                notes.push(format!(
                    "by its name, the column `{time_column}` is taken to be in {}",
                    unit.name()
                ));
            }
            LogSurvey { time, ..LogSurvey::new(name, "CSV", vec![topic], None, notes) }
        }
        LogKind::Candump => {
            let ((topics, raw), notes) = survey_candump(text, name, dbc)?;
            LogSurvey::new(name, "candump", topics, raw, notes)
        }
    })
}

pub(crate) fn survey_mcap<R: Read + Seek>(
    input: R,
    name: &str,
) -> Result<(Vec<TopicSurvey>, Vec<String>), LogError> {
    let io = |error: std::io::Error| LogError::data(name, format!("{error}"));
    let mut file = McapFile::new(input).map_err(io)?;
    let mut topics = Topics::default();
    let mut record = Vec::new();
    while let Some(opcode) = file.next_record(&mut record).map_err(io)? {
        match opcode {
            op::SCHEMA => topics.schemas.take(&record),
            op::CHANNEL => topics.announce(&record),
            op::MESSAGE => topics.take(&record),
            _ => {}
        }
    }
    let mut notes = file.damage.notes();
    notes.extend(topics.note());
    Ok((topics.of_channel.into_values().map(TopicSurvey::finished).collect(), notes))
}

/// The topics of an MCAP log, by channel.
#[derive(Default)]
struct Topics {
    schemas: Schemas,
    of_channel: BTreeMap<u16, TopicSurvey>,
    /// Bytes that the topics' decoders may take.
    decoder_bytes: usize,
    /// Bytes of the messages that were.
    message_bytes: usize,
    fields: usize,
    /// Channels beyond those that are kept.
    left_out: u64,
}

impl Topics {
    fn announce(&mut self, record: &[u8]) {
        let Some(channel) = ChannelRecord::parse(record) else { return };
        if self.of_channel.contains_key(&channel.id) {
            return;
        }
        if self.of_channel.len() == TOPICS_KEPT {
            self.left_out += 1;
            return;
        }
        let schema = self.schemas.get(channel.schema_id);
        self.decoder_bytes += schema.map_or(0, decoder_bytes);
        let decoder = if self.decoder_bytes <= DECODERS_BYTES {
            Decoder::new(&channel.encoding, schema)
        } else {
            Err("is not looked into, since only so many schemas are".into())
        };
        let topic = TopicSurvey {
            mapping_topic: channel.topic.clone(),
            topic: channel.topic,
            encoding: channel.encoding,
            schema: schema.map_or(String::new(), |schema| schema.name.clone()),
            problem: decoder.as_ref().err().cloned(),
            decoder: decoder.ok(),
            ..TopicSurvey::default()
        };
        self.of_channel.insert(channel.id, topic);
    }

    fn take(&mut self, record: &[u8]) {
        let Some((header, message)) = record.split_at_checked(super::mcap::MESSAGE_HEADER_BYTES) else {
            return;
        };
        let Some(topic) = self.of_channel.get_mut(&super::mcap::channel_id(header)) else { return };
        topic.messages += 1;
        topic.take_time(super::mcap::log_time_ns(header));
        if self.message_bytes < BYTES_LOOKED_INTO {
            self.message_bytes += message.len();
            let room = FIELDS_IN_ALL.saturating_sub(self.fields);
            self.fields += topic.look_into(message, room);
        }
    }

    fn note(&self) -> Option<String> {
        (self.left_out > 0).then(|| format!("{} more topics, which are left out here", self.left_out))
    }
}

pub(crate) fn survey_csv(
    input: impl Read,
    name: &str,
    time_column: &str,
    unit: TimeUnit,
) -> Result<(TopicSurvey, Vec<String>), LogError> {
    let (mut rows, headers) = Rows::new(input).map_err(|what| LogError::data(name, what))?;
    let mut topic = TopicSurvey { topic: "rows".into(), encoding: "csv".into(), ..TopicSurvey::default() };
    while let Some(row) = rows.next().map_err(|error| LogError::reading(name, error))? {
        topic.messages += 1;
        let Ok(row) = row else {
            topic.unreadable += 1;
            continue;
        };
        for (column, text) in headers.iter().zip(row.fields()) {
            let value = std::str::from_utf8(text).ok().and_then(|text| text.parse::<f64>().ok());
            match value {
                None => {}
                Some(time) if column == time_column => topic.take_time((time * unit.nanoseconds()) as i64),
                Some(value) => topic.take_field(column, value),
            }
        }
    }
    let mut notes = Vec::new();
    if !headers.iter().any(|column| column == time_column) {
        notes.push(format!("no column `{time_column}` for the time; name it with --time-column"));
    }
    Ok((topic.finished(), notes))
}

pub(crate) fn survey_candump(
    input: impl Read,
    name: &str,
    dbc: Option<&Dbc>,
) -> Result<(BusFound, Vec<String>), LogError> {
    let mut lines = Lines::new(input, LONGEST_LINE);
    let mut bus = BusSurvey::new(dbc);
    let (mut unreadable, mut fractions, mut any) = (0, false, false);
    while let Some(line) = lines.next().map_err(|error| LogError::reading(name, error))? {
        match candump::parse(line) {
            None => {}
            Some(Err(_)) => unreadable += 1,
            Some(Ok(line)) => {
                any = true;
                fractions |= !line.whole_second;
                bus.take(line.interface, &line.frame, line.time_ns);
            }
        }
    }
    unreadable += bus.left_out;
    let mut notes = Vec::new();
    if unreadable > 0 {
        notes.push(format!("{unreadable} lines were left out"));
    }
    if !fractions && any {
        notes.push(
            "the time stamps are whole seconds, which is too coarse for replay; record with `candump -l`"
                .into(),
        );
    }
    if dbc.is_none() {
        notes.push(NO_DBC.into());
    }
    Ok((bus.finish(), notes))
}

const NO_DBC: &str = "name the DBC file that describes the frames (--dbc FILE) to see their signals";

impl BusSurvey<'_> {
    /// What was heard on an interface, as if it were a log.
    pub fn into_survey(self, interface: &str) -> LogSurvey {
        let notes = if self.has_dbc() { Vec::new() } else { vec![NO_DBC.to_owned()] };
        let (topics, raw) = self.finish();
        LogSurvey::new(interface, "CAN", topics, raw, notes)
    }
}

impl TopicSurvey {
    /// Looks for numbers in a message; gives how many fields it has that were not known, of at most `room`.
    fn look_into(&mut self, message: &[u8], room: usize) -> usize {
        let Some(decoder) = self.decoder.take().filter(|_| self.messages <= LOOKED_INTO) else { return 0 };
        let known = self.fields.len();
        let most = FIELDS_KEPT.min(known + room);
        let mut paths = Paths::new(|path: &str, value: f64| self.take_field_of(path, value, most));
        if decoder.visit(message, &mut paths).is_err() {
            self.unreadable += 1;
        }
        self.decoder = Some(decoder);
        self.fields.len() - known
    }

    pub(super) fn take_time(&mut self, time_ns: i64) {
        self.intervals.take(time_ns);
    }

    pub(super) fn take_field(&mut self, path: &str, value: f64) {
        self.take_field_of(path, value, FIELDS_KEPT);
    }

    fn take_field_of(&mut self, path: &str, value: f64, most: usize) {
        if !value.is_finite() {
            return;
        }
        if let Some(field) = self.places.get(path).and_then(|at| self.fields.get_mut(*at)) {
            field.count += 1;
            field.least = field.least.min(value);
            field.largest = field.largest.max(value);
        } else if self.fields.len() < most && path.len() <= LONGEST_PATH {
            self.places.insert(path.to_owned(), self.fields.len());
            let path = path.to_owned();
            self.fields.push(FieldSurvey { path, count: 1, least: value, largest: value, guess: None });
        }
    }

    pub(super) fn finished(mut self) -> Self {
        let found = std::mem::take(&mut self.intervals).found();
        self.rate_hz = found.rate_hz;
        self.duration_s = found.duration_s;
        self.gaps = found.gaps;
        self.longest_gap_s = found.longest_gap_s;
        (self.decoder, self.places) = (None, HashMap::new());
        self
    }
}

impl LogSurvey {
    fn new(
        file: &str,
        kind: &'static str,
        mut topics: Vec<TopicSurvey>,
        raw: Option<RawGuess>,
        notes: Vec<String>,
    ) -> Self {
        topics.sort_by(|a, b| a.topic.cmp(&b.topic));
        let mut mapping = guess(&mut topics);
        if let Some(raw) = raw {
            mapping
                .entry(Signal::Command)
                .or_insert_with(|| Guess::of_bits(raw.interface, raw.bits, raw.scale));
        }
        LogSurvey { schema: "seepd.inspect/1", file: file.into(), kind, topics, time: None, mapping, notes }
    }

    /// What stands at the top of `seepd.toml`, before the tables: where a CSV's time is.
    pub fn time_toml(&self) -> String {
        self.time.as_ref().map_or(String::new(), |time| {
            let column = toml_text(&time.column);
            format!("time_column = {column}\ntime_unit = \"{}\"\n\n", time.unit.name())
        })
    }

    /// The mapping as a part of `seepd.toml`.
    pub fn mapping_toml(&self) -> String {
        let mut text = String::new();
        if !self.mapping.contains_key(&Signal::Command) {
            text += "# No field looks like a valve command; fill in the topic and the field yourself.\n";
        }
        for (signal, guess) in &self.mapping {
            text += &format!("[signals.{}]  # in {}\n", signal.name(), signal.unit());
            if !guess.topic.is_empty() {
                text += &format!("topic = {}\n", toml_text(&guess.topic));
            }
            match &guess.bits {
                Some(bits) => {
                    text += "# A field that moves as a valve command does, without a name from a DBC file. Check it.\n";
                    text += &format!("bits = {}\n", bits.to_toml());
                }
                None => text += &format!("field = {}\n", toml_text(&guess.field)),
            }
            if guess.scale != 1.0 {
                text += &format!("scale = {}\n", toml::Value::from(guess.scale));
            }
            text.push('\n');
        }
        text
    }
}

/// A text as a TOML value in one line, whatever is in it: JSON's escapes are TOML's, which has one more.
pub fn toml_text(text: &str) -> String {
    serde_json::Value::from(text).to_string().replace('\u{7f}', "\\u007f")
}
