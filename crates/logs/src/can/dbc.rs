//! DBC files: which frame carries a signal, and where in it.

use std::collections::HashMap;
use std::path::Path;

use can_dbc::{
    AttributeDefinition, AttributeValue, AttributeValueType, ByteOrder as DbcByteOrder, Dbc as Parsed,
    DbcError, Message, MessageId, MultiplexIndicator, Signal, SignalExtendedValueType, ValueType,
};
use seepd_settings::{nearest, side_file};

use super::bit_field::{BitField, BitFieldError, ByteOrder, Encoding};
use super::dbc_error::{LookUpError, PlaceError};
use super::j1939::{FrameChoice, NULL_ADDRESS, SourceAddress};
use super::{Content, Frame, Identifier};
use crate::error::{LogError, listed};

/// A signal of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct CanSignal {
    /// `Message.Signal`.
    pub name: String,
    /// Frames that carry it.
    pub frames: FrameChoice,
    /// Unit, as the file has it; may be empty.
    pub unit: String,
    pub(super) field: BitField,
    /// All must hold for the frame to carry the signal.
    selectors: Vec<Selector>,
    /// Raw values that say that there is none.
    missing: Missing,
}

/// Raw values by which a sender says that it has no value.
#[derive(Debug, Clone, PartialEq, Default)]
struct Missing {
    /// Those that the file gives such a name, sorted.
    named: Vec<u64>,
    /// The least of those that J1939 keeps for errors and for signals that are not there; 0: none.
    from: u64,
}

/// A multiplexer's field, and for which of its values a signal is there.
#[derive(Debug, Clone, PartialEq)]
struct Selector {
    field: BitField,
    ranges: Vec<(u64, u64)>,
}

/// What a frame says of a signal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reading {
    /// Its value.
    Value(f64),
    /// The frame is another, or its multiplexer selects others.
    Absent,
    /// The frame is too short for it.
    TooShort,
    /// Its sender says that it has none: by a value that the file calls so, or by those that J1939 keeps for that.
    NotAvailable,
}

impl CanSignal {
    /// A signal at a place of its own, without a file that names it.
    pub fn at(name: &str, frames: FrameChoice, field: BitField) -> Self {
        let (unit, selectors, missing) = (String::new(), Vec::new(), Missing::default());
        CanSignal { name: name.into(), frames, unit, field, selectors, missing }
    }

    /// The same of its J1939 parameter group from an address; `None` for a frame of 11 bits, which has none.
    pub fn sent_by(mut self, source: SourceAddress) -> Option<Self> {
        let Identifier::Extended(bits) = self.frames.identifier else { return None };
        self.frames = FrameChoice::of_group(bits, source);
        Some(self)
    }

    /// Reads the signal.
    pub fn read(&self, frame: &Frame) -> Reading {
        if !self.frames.takes(frame.identifier) || frame.content != Content::Data {
            return Reading::Absent;
        }
        for selector in &self.selectors {
            let Some(raw) = selector.field.raw(frame.data()) else { return Reading::TooShort };
            if !selector.ranges.iter().any(|(least, most)| (*least..=*most).contains(&raw)) {
                return Reading::Absent;
            }
        }
        let Some(raw) = self.field.raw(frame.data()) else { return Reading::TooShort };
        let Missing { named, from } = &self.missing;
        if *from > 0 && raw >= *from || !named.is_empty() && named.binary_search(&raw).is_ok() {
            return Reading::NotAvailable;
        }
        self.field.value(frame.data()).map_or(Reading::TooShort, Reading::Value)
    }
}

/// A DBC file.
#[derive(Debug, Clone, PartialEq)]
pub struct Dbc {
    file: String,
    parsed: Parsed,
    /// The signals' whole names, where the file cuts them to 32 characters, by message and cut name.
    long_names: HashMap<MessageId, HashMap<String, String>>,
}

/// Words in the names of values that say that a signal has none.
const NOT_AVAILABLE: &[&str] =
    &["not available", "not_available", "notavailable", "invalid", "signal error", "no signal"];

/// What to do with descriptions of buses in XML.
const XML: &str = "this is an XML file, perhaps KCD or ARXML, and DBC files are read; convert it: pip install cantools canmatrix lxml; \
                   cantools convert IN.kcd OUT.dbc, or canconvert IN.arxml OUT.dbc";

/// Levels of multiplexers within multiplexers that are followed.
pub(super) const DEEPEST_MULTIPLEX: usize = 64;

/// Signals that a message names.
const SIGNALS_TOLD: usize = 8;

impl Dbc {
    /// Reads a file.
    ///
    /// # Errors
    /// [`LogError`] with file and line.
    pub fn read(path: &Path) -> Result<Self, LogError> {
        let name = path.display().to_string();
        let bytes = side_file::read(path).map_err(|error| LogError::reading(&name, error))?;
        Self::parse(&bytes, &name)
    }

    /// Reads a file's content; texts that are not UTF-8 are taken as Latin-1, which names are the same in.
    ///
    /// # Errors
    /// [`LogError::Dbc`] with the line of the file.
    pub fn parse(bytes: &[u8], file: &str) -> Result<Self, LogError> {
        let text = std::str::from_utf8(bytes).map_or_else(
            |_| bytes.iter().map(|byte| char::from(*byte)).collect(),
            |text| text.trim_start_matches('\u{feff}').to_owned(),
        );
        if text.trim_start().starts_with('<') {
            return Err(LogError::Dbc { name: file.into(), what: XML.into() });
        }
        let mut parsed = Parsed::try_from(text.as_str())
            .map_err(|error| LogError::Dbc { name: file.into(), what: one_line(&error) })?;
        let mut long_names: HashMap<MessageId, HashMap<String, String>> = HashMap::new();
        for attribute in std::mem::take(&mut parsed.attribute_values_signal) {
            if attribute.name == "SystemSignalLongSymbol"
                && let AttributeValue::String(long) = attribute.value
                && !long.is_empty()
            {
                long_names
                    .entry(attribute.message_id)
                    .or_default()
                    .entry(attribute.signal_name)
                    .or_insert(long);
            }
        }
        Ok(Dbc { file: file.into(), parsed, long_names })
    }

    /// Names of all messages and signals, as `Message.Signal`.
    pub fn names(&self) -> impl Iterator<Item = String> {
        self.all().map(|(message, signal)| self.full_name(message, signal))
    }

    /// Name of the message of an identifier.
    pub fn message_name(&self, identifier: Identifier) -> Option<String> {
        self.message(identifier).map(|message| self.long_message_name(message))
    }

    /// The message of an identifier: the one that has it, else one whose parameter group it is of.
    fn message(&self, identifier: Identifier) -> Option<&Message> {
        let mut messages = self.parsed.messages.iter();
        let has = |message: &&Message| self.identifier(message) == Some(identifier);
        let takes = |message: &&Message| self.frames(message).is_some_and(|frames| frames.takes(identifier));
        messages.find(has).or_else(|| self.parsed.messages.iter().find(takes))
    }

    /// The frames of a message: of J1939 its parameter group, from any address where the file's is none or the null address.
    fn frames(&self, message: &Message) -> Option<FrameChoice> {
        let identifier = self.identifier(message)?;
        Some(match identifier {
            Identifier::Extended(bits) if self.is_j1939(message) => {
                let address = bits as u8;
                let source =
                    if address >= NULL_ADDRESS { SourceAddress::Any } else { SourceAddress::Of(address) };
                FrameChoice::of_group(bits, source)
            }
            _ => FrameChoice::one(identifier),
        })
    }

    /// Whether the file says that a message is of J1939.
    fn is_j1939(&self, message: &Message) -> bool {
        const FORMAT: &str = "VFrameFormat";
        let Some(value) = self.parsed.resolved_message_attribute(message.id, FORMAT) else { return false };
        let index = match value {
            AttributeValue::String(name) => return name == "J1939PG",
            AttributeValue::Uint(index) => Some(*index as usize),
            AttributeValue::Int(index) => usize::try_from(*index).ok(),
            AttributeValue::Double(index) => Some(*index as usize),
        };
        self.parsed.attribute_definitions.iter().any(|definition| match definition {
            AttributeDefinition::Message(name, AttributeValueType::Enum(names)) if name == FORMAT => {
                index.and_then(|index| names.get(index)).is_some_and(|name| name == "J1939PG")
            }
            _ => false,
        })
    }

    /// The raw values that say that a signal has none.
    fn missing(&self, message: &Message, signal: &Signal, field: &BitField) -> Missing {
        let described =
            self.parsed.value_descriptions_for_signal(message.id, &signal.name).unwrap_or_default();
        let mask = u64::MAX >> (64 - field.bits());
        let says_none = |text: &str| {
            let text = text.to_lowercase();
            NOT_AVAILABLE.iter().any(|word| text.contains(word)) || text == "sna"
        };
        let named = described.iter().filter(|value| says_none(&value.description));
        let mut named: Vec<u64> = named.map(|value| value.id as u64 & mask).collect();
        named.sort_unstable();
        // SAE J1939-71: the highest byte says 0xFE for an error, 0xFF for a signal that is not there.
        let is_number = signal.value_type == ValueType::Unsigned;
        let from = match field.bits() {
            bits @ (8 | 16 | 32) if is_number && self.is_j1939(message) => 0xfe << (bits - 8),
            _ => 0,
        };
        Missing { named, from }
    }

    fn all(&self) -> impl Iterator<Item = (&Message, &Signal)> {
        self.parsed
            .messages
            .iter()
            .flat_map(|message| message.signals.iter().map(move |signal| (message, signal)))
    }

    /// The signal of that name, `Signal` or `Message.Signal`.
    ///
    /// # Errors
    /// [`LogError::Mapping`]: there is none (with the nearest name), there are several, or it cannot be where the file says.
    pub fn find(&self, name: &str) -> Result<CanSignal, LogError> {
        self.look_up(name).map_err(|error| LogError::mapping(format!("{}: {error}", self.file)))
    }

    fn look_up(&self, name: &str) -> Result<CanSignal, LookUpError> {
        let is = |(message, signal): &(&Message, &Signal)| {
            let full = self.full_name(message, signal);
            full == name || full.rsplit_once('.').is_some_and(|(_, short)| short == name)
        };
        let found: Vec<(&Message, &Signal)> = self.all().filter(is).collect();
        match found.as_slice() {
            [] => Err(self.no_such(name)),
            [(message, signal)] => self
                .resolve(message, signal)
                .map_err(|error| LookUpError::NoPlace { name: name.into(), error }),
            several => {
                let full_names =
                    several.iter().map(|(message, signal)| self.full_name(message, signal)).collect();
                Err(LookUpError::Ambiguous { name: name.into(), full_names })
            }
        }
    }

    fn no_such(&self, name: &str) -> LookUpError {
        let full: Vec<String> = self.names().collect();
        let short = full.iter().filter_map(|full| full.rsplit_once('.')).map(|(_, short)| short);
        let all: Vec<&str> = full.iter().map(String::as_str).chain(short).collect();
        let near = nearest(name, all.iter().copied()).map(str::to_owned);
        let name = name.to_owned();
        match near {
            Some(near) => LookUpError::Misspelt { name, near },
            None if full.is_empty() => LookUpError::NoSignals { name },
            None => LookUpError::Unknown { name, listed: listed(&full, SIGNALS_TOLD) },
        }
    }

    /// The signals of a frame that can be read, up to so many.
    pub fn signals_of(&self, identifier: Identifier, most: usize) -> Vec<CanSignal> {
        let message = self.message(identifier);
        let signals = message.into_iter().flat_map(|message| {
            message.signals.iter().filter_map(|signal| self.resolve(message, signal).ok())
        });
        signals.take(most).collect()
    }

    fn resolve(&self, message: &Message, signal: &Signal) -> Result<CanSignal, PlaceError> {
        let frames =
            self.frames(message).ok_or_else(|| PlaceError::NoIdentifier { message: message.name.clone() })?;
        let field = self.field(message, signal)?;
        // Sizes of 0 stand for a length that varies.
        let size = message.size as usize;
        if size > 0 && field.least_bytes() > size {
            let (last, message) = (field.least_bytes(), message.name.clone());
            return Err(PlaceError::BeyondMessage { last, message, size });
        }
        let selectors = self.selectors(message, signal)?;
        let (name, unit) = (self.full_name(message, signal), signal.unit.clone());
        let missing = self.missing(message, signal, &field);
        Ok(CanSignal { name, frames, unit, field, selectors, missing })
    }

    /// Identifier of a message; `None` for the collection of signals without a message and for impossible ones.
    fn identifier(&self, message: &Message) -> Option<Identifier> {
        match message.id {
            MessageId::Standard(id) if id <= 0x7ff => Some(Identifier::Standard(id)),
            MessageId::Extended(id) if message.name != "VECTOR__INDEPENDENT_SIG_MSG" => {
                Some(Identifier::Extended(id & 0x1fff_ffff))
            }
            _ => None,
        }
    }

    fn field(&self, message: &Message, signal: &Signal) -> Result<BitField, BitFieldError> {
        let extended = self.parsed.extended_value_type_for_signal(message.id, &signal.name);
        let encoding = match (extended, signal.value_type) {
            (Some(SignalExtendedValueType::IEEEfloat32Bit), _) => Encoding::Float32,
            (Some(SignalExtendedValueType::IEEEdouble64bit), _) => Encoding::Float64,
            (_, ValueType::Signed) => Encoding::Signed,
            (_, ValueType::Unsigned) => Encoding::Unsigned,
        };
        let order = match signal.byte_order {
            DbcByteOrder::LittleEndian => ByteOrder::LittleEndian,
            DbcByteOrder::BigEndian => ByteOrder::BigEndian,
        };
        let place = |value: u64| usize::try_from(value).unwrap_or(usize::MAX);
        BitField::new(
            place(signal.start_bit),
            place(signal.size),
            order,
            encoding,
            signal.factor,
            signal.offset,
        )
    }

    /// What must hold of the frame's multiplexers, from the signal's own up to the outermost.
    fn selectors(&self, message: &Message, signal: &Signal) -> Result<Vec<Selector>, PlaceError> {
        let mut selectors = Vec::new();
        let mut inner = signal;
        // A file may go in circles.
        for _ in 0..DEEPEST_MULTIPLEX {
            let (MultiplexIndicator::MultiplexedSignal(value)
            | MultiplexIndicator::MultiplexorAndMultiplexedSignal(value)) = inner.multiplexer_indicator
            else {
                return Ok(selectors);
            };
            let extended = self
                .parsed
                .extended_multiplex
                .iter()
                .find(|rule| rule.message_id == message.id && rule.signal_name == inner.name);
            let outer = message.signals.iter().find(|other| match extended {
                Some(rule) => rule.multiplexor_signal_name == other.name,
                None => other.multiplexer_indicator == MultiplexIndicator::Multiplexor,
            });
            let outer = outer.ok_or(PlaceError::NoMultiplexer)?;
            let ranges = match extended {
                Some(rule) => rule.mappings.iter().map(|range| (range.min_value, range.max_value)).collect(),
                None => vec![(value, value)],
            };
            let field = self.field(message, outer)?;
            selectors.push(Selector { field, ranges });
            inner = outer;
        }
        Err(PlaceError::MultiplexedTooDeep)
    }

    /// `Message.Signal`, by the long names where the file cuts them to 32 characters.
    fn full_name(&self, message: &Message, signal: &Signal) -> String {
        let long = self.long_names.get(&message.id).and_then(|names| names.get(&signal.name));
        let name = long.unwrap_or(&signal.name);
        format!("{}.{name}", self.long_message_name(message))
    }

    fn long_message_name(&self, message: &Message) -> String {
        let long = self.parsed.attribute_values_message.iter().find(|attribute| {
            attribute.message_id == message.id && attribute.name == "SystemMessageLongSymbol"
        });
        text_of(long.map(|attribute| &attribute.value)).unwrap_or(&message.name).to_owned()
    }
}

fn text_of(value: Option<&AttributeValue>) -> Option<&str> {
    match value {
        Some(AttributeValue::String(text)) if !text.is_empty() => Some(text),
        _ => None,
    }
}

/// The parser's message draws the place over several lines: line, column and what was expected, in one.
fn one_line(error: &DbcError) -> String {
    let text = error.to_string();
    let place = text.lines().find_map(|line| line.trim().strip_prefix("--> "));
    let what = text.lines().find_map(|line| line.trim().strip_prefix("= ")).unwrap_or(text.trim());
    let what = what.replace('\n', " ");
    match place.and_then(|place| place.split_once(':')) {
        Some((line, column)) => format!("line {line}, column {column}: this is not a DBC file: {what}"),
        None => format!("this is not a DBC file: {what}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(messages: &str, name: &str) -> String {
        let file = format!("VERSION \"\"\n\nBU_: A\n\n{messages}");
        Dbc::parse(file.as_bytes(), "dbc").unwrap().find(name).unwrap_err().to_string()
    }

    #[test]
    fn signals_that_are_not_found_say_what_there_is() {
        let two = "BO_ 1 One: 8 A\n SG_ Valve : 0|8@1+ (1,0) [0|1] \"\" A\n\nBO_ 2 Two: 8 A\n SG_ Valve : 0|8@1+ (1,0) [0|1] \"\" A\n";
        let signals: String =
            (0..10).map(|n| format!(" SG_ S{n}{n}{n} : 0|8@1+ (1,0) [0|1] \"\" A\n")).collect();
        let ten = format!("BO_ 1 M: 8 A\n{signals}");
        for (messages, name, told) in [
            (two, "Valv", "dbc: there is no signal `Valv`; did you mean `Valve`?"),
            (two, "Valve", "dbc: several messages have a signal `Valve`; write One.Valve or Two.Valve"),
            ("BO_ 1 One: 8 A\n", "Valve", "dbc: there is no signal `Valve`; the file has no signals at all"),
            (two, "Temperature", "dbc: there is no signal `Temperature`; the file has One.Valve, Two.Valve"),
            (
                &ten,
                "Temperature",
                "dbc: there is no signal `Temperature`; the file has M.S000, M.S111, M.S222, M.S333, M.S444, M.S555, M.S666, M.S777 \
                 and 2 more",
            ),
        ] {
            assert_eq!(refused(messages, name), told);
        }
    }

    #[test]
    fn signals_that_cannot_be_read_say_why() {
        for (messages, told) in [
            (
                "BO_ 3000 M: 8 A\n SG_ S : 0|8@1+ (1,0) [0|1] \"\" A\n",
                "is in the message M, whose identifier cannot occur on a CAN bus",
            ),
            ("BO_ 1 M: 8 A\n SG_ S : 0|65@1+ (1,0) [0|1] \"\" A\n", "has 65 bits; Unsigned has 1 … 64"),
            (
                "BO_ 1 M: 1 A\n SG_ S : 8|8@1+ (1,0) [0|1] \"\" A\n",
                "ends in byte 2 of the message M, which has 1 bytes",
            ),
            (
                "BO_ 1 M: 8 A\n SG_ S m1 : 0|8@1+ (1,0) [0|1] \"\" A\n",
                "is multiplexed, but its message has no multiplexer",
            ),
            (
                "BO_ 1 M: 8 A\n SG_ X M : 8|65@1+ (1,0) [0|1] \"\" A\n SG_ S m1 : 0|8@1+ (1,0) [0|1] \"\" A\n",
                "has 65 bits; Unsigned has 1 … 64",
            ),
            (
                "BO_ 1 M: 8 A\n SG_ S m1M : 0|8@1+ (1,0) [0|1] \"\" A\n\nSG_MUL_VAL_ 1 S S 1-1;\n",
                "is multiplexed by itself, or more than 64 levels deep",
            ),
        ] {
            assert_eq!(refused(messages, "S"), format!("dbc: the signal `S` {told}"));
        }
    }
}
