//! Where the signals are: topics, fields, columns, bits, and the way to SI.

use std::collections::BTreeMap;
use std::path::PathBuf;

use seepd_signals::Signal;
use serde::{Deserialize, Serialize};

use crate::can::Identifier;
use crate::can::bit_field::{ByteOrder, Encoding};
use crate::can::j1939::SourceAddress;
use crate::error::LogError;
use crate::fields::FieldTree;
use crate::unit::{factor, listed};

/// How a log's content becomes samples.
#[derive(Debug, Clone, PartialEq)]
pub struct LogMapping {
    /// Where each signal is. Empty: every signal under its own name, in MCAP logs on the one topic that ends in `/signals`.
    pub signals: BTreeMap<Signal, SignalMapping>,
    /// What goes before the mapping.
    pub selection: Selection,
    /// Name of a CSV file's time column.
    pub time_column: String,
    /// Unit of that column; absent: what its name ends in, such as `time_ms`, else seconds.
    pub time_unit: Option<TimeUnit>,
    /// Rows a second of a CSV file without a time column.
    pub sample_rate_hz: Option<f64>,
    /// DBC file that describes a CAN log's frames.
    pub dbc: Option<PathBuf>,
    /// Counter of the command's frame, by which lost frames are told.
    pub counter: Option<CounterMapping>,
}

impl Default for LogMapping {
    /// Every signal under its own name, the time as `t_s`.
    fn default() -> Self {
        LogMapping {
            signals: BTreeMap::new(),
            selection: Selection::default(),
            time_column: "t_s".into(),
            time_unit: None,
            sample_rate_hz: None,
            dbc: None,
            counter: None,
        }
    }
}

impl LogMapping {
    /// Each signal's place, with names filled in and the selection on top.
    pub fn places(&self) -> Vec<(Signal, SignalMapping)> {
        let mut places: Vec<(Signal, SignalMapping)> = if self.signals.is_empty() {
            Signal::ALL.into_iter().map(|signal| (signal, SignalMapping::default())).collect()
        } else {
            self.signals.iter().map(|(signal, mapping)| (*signal, mapping.clone())).collect()
        };
        for (signal, mapping) in &mut places {
            if mapping.field.is_empty() {
                mapping.field = signal.name().into();
            }
            if let Some(topic) = &self.selection.topic {
                mapping.topic.clone_from(topic);
            }
            if *signal == Signal::Command {
                self.selection.apply(mapping);
            }
        }
        places
    }
}

impl Selection {
    fn apply(&self, command: &mut SignalMapping) {
        if let Some(field) = &self.command {
            command.field.clone_from(field);
        }
        if let Some(scale) = self.scale {
            command.scale = scale;
            // What a person says of a factor counts alone.
            command.unit = "1".into();
        }
        command.invert ^= self.invert;
    }
}

/// Checks the signals of a mapping: their numbers, that there is a command, and that the fields of each topic can be looked
/// for together.
///
/// # Errors
/// [`LogError::Mapping`] that names the key.
pub fn check_signals(signals: &BTreeMap<Signal, SignalMapping>) -> Result<(), LogError> {
    for (signal, mapping) in signals {
        if !mapping.scale.is_finite() || mapping.scale == 0.0 || !mapping.offset.is_finite() {
            let name = signal.name();
            return Err(LogError::mapping(format!(
                "signals.{name}: scale must be finite and not 0, and offset must be finite"
            )));
        }
        if !mapping.unit.is_empty() && factor(*signal, &mapping.unit).is_none() {
            let (name, unit, known) = (signal.name(), &mapping.unit, listed(*signal));
            return Err(LogError::mapping(format!(
                "signals.{name}: the unit `{unit}` is none of {known}; leave it out and give scale and offset"
            )));
        }
    }
    for mapping in signals.values() {
        let of_topic = signals.iter().filter(|(_, other)| other.topic == mapping.topic);
        FieldTree::of(of_topic.map(|(signal, mapping)| (*signal, mapping)))
            .map_err(|error| LogError::mapping(error.to_string()))?;
    }
    if !signals.is_empty() && !signals.contains_key(&Signal::Command) {
        return Err(LogError::mapping(
            "signals.command is missing: the other signals are only read together with the command",
        ));
    }
    Ok(())
}

/// What a user says of where the signals are beside the mapping; it goes before it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Selection {
    /// Topic of all signals.
    pub topic: Option<String>,
    /// Field of the command.
    pub command: Option<String>,
    /// Factor of the command.
    pub scale: Option<f64>,
    /// Turns the command's sign.
    pub invert: bool,
}

/// Where a signal is and how it becomes SI: value · scale + offset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SignalMapping {
    /// Topic, or the interface in a CAN log; empty: as if no mapping were given. In MCAP logs `*/ending` is the one topic that
    /// ends so.
    pub topic: String,
    /// Path of the field in the message, such as `axis.valve.command` or `data[3]`; a CSV file's column; a DBC file's
    /// signal, as `Signal` or `Message.Signal`. Empty: the signal's name.
    pub field: String,
    /// Factor.
    pub scale: f64,
    /// Added after the factor.
    pub offset: f64,
    /// Path of a field with the time in seconds, or of a stamp with seconds and nanoseconds; empty: the message's log
    /// time.
    pub time: String,
    /// Unit of the field, such as `%`, `bar` or `mm`, which is made SI before `scale`; empty: where neither scale nor offset are given,
    /// what the DBC file or the MDF log says, else SI. `1` takes a command as it is.
    pub unit: String,
    /// Turns the sign: where a positive command retracts, a positive force pulls.
    pub invert: bool,
    /// Where the field is in a CAN frame, where no DBC file says so.
    pub bits: Option<BitsMapping>,
    /// Takes the frames of a J1939 parameter group from an address, or from any (`*`), whatever their priority.
    pub source_address: Option<SourceAddress>,
}

impl Default for SignalMapping {
    fn default() -> Self {
        SignalMapping {
            topic: String::new(),
            field: String::new(),
            scale: 1.0,
            offset: 0.0,
            time: String::new(),
            unit: String::new(),
            invert: false,
            bits: None,
            source_address: None,
        }
    }
}

impl SignalMapping {
    /// Whether a log may do without the signal: it is under its own name, and not the command.
    pub fn may_be_missing(&self, signal: Signal) -> bool {
        signal != Signal::Command && self.field == signal.name()
    }

    /// The way to SI of a signal whose description says that it is in a unit.
    pub fn to_si(&self, signal: Signal, described: &str) -> ToSi {
        let by_description = self.scale == 1.0 && self.offset == 0.0;
        let unit = if self.unit.is_empty() && by_description { described } else { &self.unit };
        let factor = factor(signal, unit).unwrap_or(1.0);
        let sign = if self.invert { -1.0 } else { 1.0 };
        ToSi { scale: sign * factor * self.scale, offset: sign * self.offset }
    }
}

/// The way from a field's value to SI: value · scale + offset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToSi {
    /// Factor.
    pub scale: f64,
    /// Added after the factor.
    pub offset: f64,
}

impl ToSi {
    /// A value in SI.
    #[inline]
    pub fn of(self, value: f64) -> f64 {
        value * self.scale + self.offset
    }
}

/// Where a field is in a CAN frame, where no DBC file says so.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BitsMapping {
    /// Identifier of the frame.
    #[serde(default)]
    pub id: u32,
    /// Number of its J1939 parameter group instead; `source_address` of the signal says whose.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pgn: Option<u32>,
    /// Whether the identifier has 29 bits; absent: where it does not fit 11.
    pub extended: Option<bool>,
    /// First bit: 8 b + i is bit i of byte b, 0 being a byte's lowest; in big-endian fields the highest bit's.
    pub start: usize,
    /// Size, bits.
    pub length: usize,
    /// `little_endian` (Intel) or `big_endian` (Motorola).
    #[serde(default)]
    pub order: ByteOrder,
    /// `unsigned`, `signed`, `float32` or `float64`.
    #[serde(default)]
    pub encoding: Encoding,
}

impl BitsMapping {
    /// The same as an inline table.
    pub fn to_toml(&self) -> String {
        let extended = self.extended.map_or(String::new(), |extended| format!("extended = {extended}, "));
        let order = match self.order {
            ByteOrder::LittleEndian => "little_endian",
            ByteOrder::BigEndian => "big_endian",
        };
        let encoding = match self.encoding {
            Encoding::Unsigned => "unsigned",
            Encoding::Signed => "signed",
            Encoding::Float32 => "float32",
            Encoding::Float64 => "float64",
        };
        let pgn = self.pgn.map_or(String::new(), |pgn| format!("pgn = {pgn}, "));
        format!(
            "{{ {pgn}id = {:#x}, {extended}start = {}, length = {}, order = \"{order}\", encoding = \"{encoding}\" }}",
            self.id, self.start, self.length
        )
    }

    /// The frame's identifier.
    ///
    /// # Errors
    /// It is none of CAN.
    pub fn identifier(&self) -> Result<Identifier, LogError> {
        identifier(self.id, self.extended)
    }
}

/// An identifier of 11 or 29 bits.
///
/// # Errors
/// It is none of CAN.
pub fn identifier(id: u32, extended: Option<bool>) -> Result<Identifier, LogError> {
    match (extended.unwrap_or(id > 0x7ff), id) {
        (false, 0..=0x7ff) => Ok(Identifier::Standard(id as u16)),
        (true, 0..=0x1fff_ffff) => Ok(Identifier::Extended(id)),
        (false, _) => Err(LogError::mapping(format!(
            "the identifier {id:#x} has more than 11 bits; set extended = true"
        ))),
        (true, _) => Err(LogError::mapping(format!("the identifier {id:#x} has more than 29 bits"))),
    }
}

/// A counter that the sender raises by one from frame to frame.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CounterMapping {
    /// A DBC file's signal.
    pub field: String,
    /// Where it is, without a DBC file.
    pub bits: Option<BitsMapping>,
}

/// Unit of a time column.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeUnit {
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
}

impl TimeUnit {
    /// The unit that a column's name ends in, such as `time_ms` or `Time [ms]`; seconds where it ends in none.
    pub fn of_column(name: &str) -> Self {
        let last = name.rsplit(|c: char| !c.is_alphanumeric()).find(|word| !word.is_empty());
        match last.unwrap_or_default().to_lowercase().as_str() {
            "ms" | "msec" | "millis" | "milliseconds" => TimeUnit::Ms,
            "us" | "µs" | "μs" | "usec" | "micros" | "microseconds" => TimeUnit::Us,
            "ns" | "nsec" | "nanos" | "nanoseconds" => TimeUnit::Ns,
            _ => TimeUnit::S,
        }
    }

    /// How many nanoseconds it is.
    pub fn nanoseconds(self) -> f64 {
        match self {
            TimeUnit::S => 1e9,
            TimeUnit::Ms => 1e6,
            TimeUnit::Us => 1e3,
            TimeUnit::Ns => 1.0,
        }
    }

    /// As the configuration writes it.
    pub fn name(self) -> &'static str {
        match self {
            TimeUnit::S => "s",
            TimeUnit::Ms => "ms",
            TimeUnit::Us => "us",
            TimeUnit::Ns => "ns",
        }
    }
}
