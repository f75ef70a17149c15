//! A look at a whole log: topics, rates, gaps, numeric fields, and a guess what they are.

use std::collections::BTreeMap;
use std::io::{BufReader, Read, Seek, SeekFrom};

use mcap::records::op;
use seepd_signals::Signal;
use serde::Serialize;
use serde_json::Value;

use super::bus_survey::{BusFound, BusSurvey, RawGuess};
use super::candump::next_line;
use super::decode::Decoder;
use super::guess::{Guess, guess};
use super::kind::{HEAD_BYTES, LogKind};
use super::mcap_file::{ChannelRecord, McapFile, SchemaRecord};
use crate::can::candump::Line;
use crate::can::dbc::Dbc;
use crate::failure::{Code, Failure};

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
    /// The mapping that would read the guessed signals, by signal.
    pub mapping: BTreeMap<Signal, Guess>,
    /// What was damaged or could not be looked into.
    pub notes: Vec<String>,
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
    pub(super) times_ns: Vec<i64>,
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

/// Messages whose fields are looked into; the times of all are.
const LOOKED_INTO: u64 = 20_000;
/// Fields of a topic that are told.
const FIELDS_KEPT: usize = 256;
/// Times kept for the median interval.
const TIMES_KEPT: usize = 1 << 20;

/// Looks through a log.
///
/// # Errors
/// [`Failure`] where it cannot be read or is of no kind that is known.
pub fn survey<R: Read + Seek>(
    mut input: R,
    name: &str,
    time_column: &str,
    dbc: Option<&Dbc>,
) -> Result<LogSurvey, Failure> {
    let io = |error: std::io::Error| Failure::new(Code::Io, format!("{name}: {error}"));
    let mut head = Vec::new();
    input.by_ref().take(HEAD_BYTES as u64).read_to_end(&mut head).map_err(io)?;
    input.seek(SeekFrom::Start(0)).map_err(io)?;
    Ok(match LogKind::of(&head, name)? {
        LogKind::Mcap => {
            let (topics, notes) = survey_mcap(input, name)?;
            LogSurvey::new(name, "MCAP", topics, None, notes)
        }
        LogKind::Csv => {
            let (topic, notes) = survey_csv(input, name, time_column)?;
            LogSurvey::new(name, "CSV", vec![topic], None, notes)
        }
        LogKind::Candump => {
            let ((topics, raw), notes) = survey_candump(input, name, dbc)?;
            LogSurvey::new(name, "candump", topics, raw, notes)
        }
    })
}

fn survey_mcap<R: Read + Seek>(input: R, name: &str) -> Result<(Vec<TopicSurvey>, Vec<String>), Failure> {
    let io = |error: std::io::Error| Failure::data(format!("{name}: {error}"));
    let mut file = McapFile::new(input).map_err(io)?;
    let mut schemas: BTreeMap<u16, SchemaRecord> = BTreeMap::new();
    let mut topics: BTreeMap<u16, TopicSurvey> = BTreeMap::new();
    let mut record = Vec::new();
    while let Some(opcode) = file.next_record(&mut record).map_err(io)? {
        match opcode {
            op::SCHEMA => {
                if let Some(schema) = SchemaRecord::parse(&record) {
                    schemas.insert(schema.id, schema);
                }
            }
            op::CHANNEL => {
                if let Some(channel) = ChannelRecord::parse(&record) {
                    let schema = schemas.get(&channel.schema_id);
                    let decoder = Decoder::new(&channel.encoding, schema);
                    topics.entry(channel.id).or_insert_with(|| TopicSurvey {
                        mapping_topic: channel.topic.clone(),
                        topic: channel.topic,
                        encoding: channel.encoding,
                        schema: schema.map_or(String::new(), |schema| schema.name.clone()),
                        problem: decoder.as_ref().err().cloned(),
                        decoder: decoder.ok(),
                        ..TopicSurvey::default()
                    });
                }
            }
            op::MESSAGE => {
                if let Some((header, data)) = record.split_at_checked(super::mcap::MESSAGE_HEADER_BYTES)
                    && let Some(topic) = topics.get_mut(&super::mcap::channel_id(header))
                {
                    topic.take(super::mcap::log_time_ns(header), data);
                }
            }
            _ => {}
        }
    }
    let notes = file.damage.notes();
    Ok((topics.into_values().map(TopicSurvey::finished).collect(), notes))
}

fn survey_csv(
    input: impl Read,
    name: &str,
    time_column: &str,
) -> Result<(TopicSurvey, Vec<String>), Failure> {
    let data = |error: csv::Error| Failure::data(format!("{name}: {error}"));
    let mut reader = super::csv::csv_reader(input, name)?;
    let headers = reader.headers().map_err(data)?.clone();
    let mut topic = TopicSurvey { topic: "rows".into(), encoding: "csv".into(), ..TopicSurvey::default() };
    let mut row = csv::StringRecord::new();
    while reader.read_record(&mut row).map_err(data)? {
        topic.messages += 1;
        for (column, text) in headers.iter().zip(&row) {
            let Ok(value) = text.parse::<f64>() else { continue };
            if column == time_column {
                topic.take_time((value * 1e9) as i64);
            } else {
                topic.take_field(column, value);
            }
        }
    }
    let known = headers.iter().any(|column| column == time_column);
    let note = format!("no column `{time_column}` for the time; name it with --time-column");
    Ok((topic.finished(), if known { vec![] } else { vec![note] }))
}

fn survey_candump(
    input: impl Read,
    name: &str,
    dbc: Option<&Dbc>,
) -> Result<(BusFound, Vec<String>), Failure> {
    let mut reader = BufReader::with_capacity(1 << 16, input);
    let mut bus = BusSurvey::new(dbc);
    let (mut bytes, mut unreadable, mut fractions, mut any) = (Vec::new(), 0, false, false);
    while next_line(&mut reader, &mut bytes)
        .map_err(|error| Failure::new(Code::Io, format!("{name}: {error}")))?
    {
        let text = bytes.trim_ascii();
        if text.is_empty() {
            continue;
        }
        let Ok(line) = Line::parse(text) else {
            unreadable += 1;
            continue;
        };
        any = true;
        fractions |= !line.whole_second;
        bus.take(line.interface, &line.frame, line.time_ns);
    }
    unreadable += bus.left_out;
    let mut notes = Vec::new();
    if unreadable > 0 {
        notes.push(format!("{unreadable} lines left out"));
    }
    if !fractions && any {
        notes.push(
            "the time stamps are whole seconds: too coarse for replay; record with `candump -l`".into(),
        );
    }
    if dbc.is_none() {
        notes.push(NO_DBC.into());
    }
    Ok((bus.finish(), notes))
}

const NO_DBC: &str = "name the DBC file that describes the frames (--dbc FILE) to see their signals";

/// What was heard on a bus, as if it were a log.
#[cfg(feature = "live")]
pub(crate) fn survey_of_bus(bus: BusSurvey<'_>, interface: &str, has_dbc: bool) -> LogSurvey {
    let notes = if has_dbc { Vec::new() } else { vec![NO_DBC.to_owned()] };
    let (topics, raw) = bus.finish();
    LogSurvey::new(interface, "CAN", topics, raw, notes)
}

impl TopicSurvey {
    fn take(&mut self, time_ns: i64, message: &[u8]) {
        self.messages += 1;
        self.take_time(time_ns);
        let Some(decoder) = self.decoder.as_ref().filter(|_| self.messages <= LOOKED_INTO) else { return };
        match decoder.value(message) {
            Ok(value) => self.take_value(&mut String::new(), &value),
            Err(_) => self.unreadable += 1,
        }
    }

    pub(super) fn take_time(&mut self, time_ns: i64) {
        if self.times_ns.len() < TIMES_KEPT {
            self.times_ns.push(time_ns);
        }
    }

    /// Every number in a message, under its path.
    fn take_value(&mut self, path: &mut String, value: &Value) {
        let length = path.len();
        match value {
            Value::Number(number) => self.take_field(path, number.as_f64().unwrap_or(f64::NAN)),
            Value::Bool(bit) => self.take_field(path, f64::from(u8::from(*bit))),
            Value::Object(fields) => {
                for (key, value) in fields {
                    if length > 0 {
                        path.push('.');
                    }
                    path.push_str(key);
                    self.take_value(path, value);
                    path.truncate(length);
                }
            }
            Value::Array(values) => {
                // Long arrays are images and clouds of points, not signals.
                for (index, value) in values.iter().enumerate().take(16) {
                    path.push_str(&format!("[{index}]"));
                    self.take_value(path, value);
                    path.truncate(length);
                }
            }
            Value::Null | Value::String(_) => {}
        }
    }

    pub(super) fn take_field(&mut self, path: &str, value: f64) {
        if !value.is_finite() {
            return;
        }
        if let Some(field) = self.fields.iter_mut().find(|field| field.path == path) {
            field.count += 1;
            field.least = field.least.min(value);
            field.largest = field.largest.max(value);
        } else if self.fields.len() < FIELDS_KEPT {
            let path = path.to_owned();
            self.fields.push(FieldSurvey { path, count: 1, least: value, largest: value, guess: None });
        }
    }

    pub(super) fn finished(mut self) -> Self {
        let times = std::mem::take(&mut self.times_ns);
        let mut intervals: Vec<i64> = times.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
        if let (Some(first), Some(last)) = (times.first(), times.last()) {
            self.duration_s = last.saturating_sub(*first) as f64 / 1e9;
        }
        let unsorted = intervals.clone();
        // Messages out of order have negative intervals, which say nothing about the rate.
        intervals.retain(|interval| *interval > 0);
        intervals.sort_unstable();
        if let Some(median) = intervals.get(intervals.len() / 2).copied() {
            // Where most messages share a stamp, the stamps are too coarse for the median to be the rate.
            let coarse = 2 * intervals.len() < unsorted.len();
            let mean_ns = self.duration_s * 1e9 / unsorted.len() as f64;
            self.rate_hz = Some(1e9 / if coarse { mean_ns } else { median as f64 });
            let gaps = unsorted.iter().filter(|interval| **interval as f64 > 2.5 * median as f64);
            self.gaps = gaps.clone().count() as u64;
            self.longest_gap_s = gaps.max().map_or(0.0, |gap| *gap as f64 / 1e9);
        }
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
        LogSurvey { schema: "seepd.inspect/1", file: file.into(), kind, topics, mapping, notes }
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
                text += &format!("topic = {}\n", toml::Value::from(guess.topic.as_str()));
            }
            match &guess.bits {
                Some(bits) => {
                    text += "# A field that moves as a valve command does; no DBC file names it. Check it.\n";
                    text += &format!("bits = {}\n", bits.to_toml());
                }
                None => text += &format!("field = {}\n", toml::Value::from(guess.field.as_str())),
            }
            if guess.scale != 1.0 {
                text += &format!("scale = {}\n", toml::Value::from(guess.scale));
            }
            text.push('\n');
        }
        text
    }
}
