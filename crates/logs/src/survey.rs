//! A look at a whole log: topics, rates, gaps, numeric fields, and a guess what they are.

use std::collections::{BTreeMap, HashMap};
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

use mcap::records::op;
use seepd_signals::Signal;
use serde::Serialize;

use super::bus_survey::{BusFound, BusSurvey, RawGuess};
use super::decode::{DECODERS_BYTES, Decoder, decoder_bytes};
use super::fields::{LONGEST_PATH, Paths};
use super::guess::{Guess, guess};
use super::intervals::Intervals;
use super::kind::LogKind;
use super::mcap_file::{ChannelRecord, Schemas};
use crate::bus_log::Unreadable;
use crate::can::dbc::Dbc;
use crate::can::logged::{FrameLog, LoggedFrame};
use crate::columns::TimeColumn;
use crate::error::LogError;
use crate::mapping::TimeUnit;
use crate::mdf::{MdfFile, MdfFrames};
use crate::opened::{Bytes, Opened, Origin};
use crate::record_log::RecordLog;
use crate::schema_error::SchemaError;
use crate::series::logs_of;
use crate::source::log_name;
use crate::table::{Table, number};
use crate::table_time::{TablePlace, TableTime};

/// `seepd.inspect/1`: what a log holds.
#[derive(Serialize)]
pub struct LogSurvey {
    /// `seepd.inspect/1`.
    pub schema: &'static str,
    /// Name of the log.
    pub file: String,
    /// What people call its kind, such as `MCAP`, `CSV` or `candump`.
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

impl FieldSurvey {
    /// The largest value without its sign.
    pub(crate) fn size(&self) -> f64 {
        self.least.abs().max(self.largest.abs())
    }
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

/// Looks through a log that is at hand.
///
/// # Errors
/// [`LogError`] where it cannot be read or is of no kind that is known.
pub fn survey<R: Read + Seek + Send>(
    input: R,
    name: &str,
    time_column: &str,
    dbc: Option<&Dbc>,
) -> Result<LogSurvey, LogError> {
    let log = Opened::of(Bytes::File(Box::new(input)), name, Origin::default())?;
    of_opened(log, name, Some(time_column), dbc)
}

/// Looks through a log; of a folder or a pattern, through the first one. A CSV's time column is found where none is named. `on_bytes`
/// hears how many more bytes have been read.
///
/// # Errors
/// [`LogError`] where it cannot be read or is of no kind that is known.
pub fn survey_log(
    path: &Path,
    time_column: Option<&str>,
    dbc: Option<&Dbc>,
    on_bytes: impl FnMut(u64) + Send + 'static,
) -> Result<LogSurvey, LogError> {
    let logs = logs_of(path)?;
    let first = logs.first().map_or(path, PathBuf::as_path);
    let name = log_name(first);
    let found = time_column.is_none().then(|| TimeColumn::of_csv(first)).flatten();
    let time_column = time_column.or(found.as_ref().map(|found| found.column.as_str()));
    let mut survey = of_opened(Opened::at(first, on_bytes)?, &name, time_column, dbc)?;
    if let (Some(time), Some(found)) = (&mut survey.time, found) {
        time.unit = found.unit;
        survey.notes.retain(|note| !note.starts_with(BY_ITS_NAME));
        if found.column != "t_s" {
            survey.notes.push(found.why);
        }
    }
    if logs.len() > 1 {
        survey.notes.push(format!("the first of {} logs was looked into", logs.len()));
    }
    Ok(survey)
}

const BY_ITS_NAME: &str = "by its name, ";

fn of_opened(
    log: Opened<'_>,
    name: &str,
    time_column: Option<&str>,
    dbc: Option<&Dbc>,
) -> Result<LogSurvey, LogError> {
    Ok(match log {
        Opened::Records(kind, mut file) => {
            let (topics, notes) = survey_records(&mut *file, name)?;
            LogSurvey::new(name, kind, topics, None, notes)
        }
        Opened::Csv(text) => {
            let column = time_column.unwrap_or("t_s");
            let (topic, mut notes, unit) = survey_csv(text, name, column, None)?;
            let time = unit.map(|unit| TimeGuess { column: column.to_owned(), unit });
            if let Some(unit) = unit.filter(|unit| *unit != TimeUnit::S) {
                notes.push(format!("{BY_ITS_NAME}the column `{column}` is taken to be in {}", unit.name()));
            }
            LogSurvey { time, ..LogSurvey::new(name, LogKind::Csv, vec![topic], None, notes) }
        }
        Opened::Frames(kind, mut frames) => {
            let ((topics, raw), notes) = survey_frames(&mut *frames, name, dbc)?;
            LogSurvey::new(name, kind, topics, raw, notes)
        }
        Opened::Mdf(file) => {
            let ((topics, raw), notes) = survey_mdf(*file, name, dbc)?;
            LogSurvey::new(name, LogKind::Mdf, topics, raw, notes)
        }
    })
}

pub(crate) fn survey_records(
    file: &mut dyn RecordLog,
    name: &str,
) -> Result<(Vec<TopicSurvey>, Vec<String>), LogError> {
    let io = |error: std::io::Error| LogError::data(name, format!("{error}"));
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
    let mut notes = file.notes();
    notes.extend(topics.note());
    Ok((topics.of_channel.into_values().map(TopicSurvey::finished).collect(), notes))
}

/// The groups of measured signals, and the frames of a bus.
pub(crate) fn survey_mdf(
    mut file: MdfFile<'_>,
    name: &str,
    dbc: Option<&Dbc>,
) -> Result<(BusFound, Vec<String>), LogError> {
    let reading = |error| LogError::reading(name, error);
    if file.has_frames() && (dbc.is_some() || !file.has_signals()) {
        let mut frames = MdfFrames::new(file).map_err(reading)?;
        return survey_frames(&mut frames, name, dbc);
    }
    let mut topics: BTreeMap<(usize, usize), TopicSurvey> = BTreeMap::new();
    file.each_record(|record| {
        if !topics.contains_key(&record.topic) && topics.len() == TOPICS_KEPT {
            return;
        }
        let topic = topics.entry(record.topic).or_insert_with(|| TopicSurvey {
            topic: record.topic_name().to_owned(),
            mapping_topic: record.topic_name().to_owned(),
            encoding: "mdf".into(),
            ..TopicSurvey::default()
        });
        topic.messages += 1;
        topic.take_time(record.time_ns);
        if topic.messages <= LOOKED_INTO {
            record.numbers().for_each(|(_, name, _, value)| topic.take_field(name, value));
        }
    })
    .map_err(reading)?;
    let mut notes = file.notes();
    if file.has_frames() {
        notes.push(format!("it has the frames of a bus too; {NO_DBC}"));
    }
    Ok(((topics.into_values().map(TopicSurvey::finished).collect(), None), notes))
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
            Err(SchemaError::NoRoom)
        };
        let topic = TopicSurvey {
            mapping_topic: channel.topic.clone(),
            topic: channel.topic,
            encoding: channel.encoding,
            schema: schema.map_or(String::new(), |schema| schema.name.clone()),
            problem: decoder.as_ref().err().map(SchemaError::to_string),
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

/// The columns, what to tell of them, and the unit of the time where it is found.
pub(crate) fn survey_csv(
    input: impl Read,
    name: &str,
    time_column: &str,
    unit: Option<TimeUnit>,
) -> Result<(TopicSurvey, Vec<String>, Option<TimeUnit>), LogError> {
    let mut table =
        Table::new(input, &[time_column]).map_err(|error| LogError::data(name, error.to_string()))?;
    let place = TablePlace::in_column(&table, time_column, unit);
    let unit = match &place {
        Some(TablePlace::Column { unit, .. }) => Some(*unit),
        _ => None,
    };
    let time_index = table.column(time_column);
    let mut time = place.map(TableTime::new);
    let mut topic = TopicSurvey { topic: "rows".into(), encoding: "csv".into(), ..TopicSurvey::default() };
    let columns = table.columns.clone();
    while let Some(row) = table.next().map_err(|error| LogError::reading(name, error))? {
        topic.messages += 1;
        let Ok(row) = row else {
            topic.unreadable += 1;
            continue;
        };
        if let Some(time_ns) = time.as_mut().and_then(|time| time.of_row(row).ok()) {
            topic.take_time(time_ns);
        }
        for (index, (column, text)) in columns.iter().zip(row.fields()).enumerate() {
            if Some(index) != time_index
                && let Some(value) = number(text)
            {
                topic.take_field(column, value);
            }
        }
    }
    let mut notes = Vec::new();
    if time.is_none() {
        notes.push(format!("no column `{time_column}` for the time; name it with --time-column"));
    }
    if !table.has_names {
        notes.push("its columns have no names; they are called by their numbers, from 1 on".into());
    }
    Ok((topic.finished(), notes, unit))
}

pub(crate) fn survey_frames(
    frames: &mut dyn FrameLog,
    name: &str,
    dbc: Option<&Dbc>,
) -> Result<(BusFound, Vec<String>), LogError> {
    let mut bus = BusSurvey::new(dbc);
    let (mut unreadable, mut fractions, mut any) = (Unreadable::default(), false, false);
    while let Some(frame) = frames.next_frame().map_err(|error| LogError::reading(name, error))? {
        match frame {
            Err(what) => unreadable.take(what, frames),
            Ok(LoggedFrame { time_ns, interface, frame }) => {
                any = true;
                fractions |= time_ns % 1_000_000_000 != 0;
                bus.take(interface.name(), &frame, time_ns);
            }
        }
    }
    let mut notes = frames.notes();
    notes.extend(unreadable.note());
    if bus.left_out > 0 {
        notes.push(format!("{} frames of more identifiers, which are left out here", bus.left_out));
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
        LogSurvey::of(interface, "CAN", topics, raw, notes)
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
        kind: LogKind,
        topics: Vec<TopicSurvey>,
        raw: Option<RawGuess>,
        notes: Vec<String>,
    ) -> Self {
        Self::of(file, kind.name(), topics, raw, notes)
    }

    fn of(
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
            if let Some(remark) = guess.remark {
                text += &format!("# {remark}\n");
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
