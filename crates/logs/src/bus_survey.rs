//! A look at a bus: identifiers, rates, which bits change, DBC names, and fields that behave like a valve command.

use std::collections::BTreeMap;

use super::survey::{FIELDS_KEPT, TOPICS_KEPT, TopicSurvey};
use crate::can::bit_field::{BitField, ByteOrder, Encoding};
use crate::can::dbc::{CanSignal, Dbc, Reading};
use crate::can::{Content, Frame, Identifier};
use crate::mapping::BitsMapping;

/// Size of the fields that are tried where no DBC file names any, bits.
const FIELD_BITS: usize = 16;
/// Mean step from frame to frame, as a share of the range, over which a field is no measured quantity.
const SMOOTH: f64 = 0.05;
/// Largest step as a share of the range: what counts up starts over with a whole range.
const JUMP: f64 = 0.5;
/// Smallest range of a raw field that could be a command, of its 65,536 values.
const LEAST_RANGE: f64 = 200.0;
/// Rates at which controllers send commands, Hz.
const RATES_HZ: std::ops::RangeInclusive<f64> = 50.0..=5000.0;

/// What was heard on a bus: identifiers, rates, bits that change, and a field that behaves like a valve command.
pub struct BusSurvey<'d> {
    dbc: Option<&'d Dbc>,
    topics: BTreeMap<(Vec<u8>, Identifier), IdentifierSurvey>,
    /// Frames of more identifiers than are kept.
    pub(crate) left_out: u64,
}

/// What was found of an identifier.
struct IdentifierSurvey {
    topic: TopicSurvey,
    signals: Vec<CanSignal>,
    first: Option<Frame>,
    changing: [u8; 64],
    shortest: usize,
    fields: Vec<RawField>,
}

/// A field that nobody has named, and how it moves.
struct RawField {
    place: BitField,
    start: usize,
    order: ByteOrder,
    last: Option<f64>,
    steps: f64,
    largest_step: f64,
    /// Bits of the raw values that differ from frame to frame.
    changing: u64,
    count: u64,
    least: f64,
    largest: f64,
}

/// A field that behaves like a valve command.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RawGuess {
    pub(crate) interface: String,
    pub(crate) bits: BitsMapping,
    pub(crate) scale: f64,
}

/// The identifiers' surveys, and the unnamed field that is most like a command.
pub(crate) type BusFound = (Vec<TopicSurvey>, Option<RawGuess>);

impl<'d> BusSurvey<'d> {
    /// Begins to listen; a DBC file names the signals.
    pub fn new(dbc: Option<&'d Dbc>) -> Self {
        BusSurvey { dbc, topics: BTreeMap::new(), left_out: 0 }
    }

    /// Takes a frame of an interface.
    pub fn take(&mut self, interface: &[u8], frame: &Frame, time_ns: i64) {
        let key = (interface.to_vec(), frame.identifier);
        if !self.topics.contains_key(&key) && self.topics.len() >= TOPICS_KEPT {
            self.left_out += 1;
            return;
        }
        let dbc = self.dbc;
        self.topics
            .entry(key)
            .or_insert_with(|| IdentifierSurvey::new(interface, frame, dbc))
            .take(frame, time_ns);
    }

    pub(crate) fn has_dbc(&self) -> bool {
        self.dbc.is_some()
    }

    /// What was found.
    pub(crate) fn finish(self) -> BusFound {
        let mut best: Option<(f64, RawGuess)> = None;
        let mut topics = Vec::new();
        for ((interface, identifier), mut found) in self.topics {
            found.topic.changing_bits = found.changing_text();
            let fields = std::mem::take(&mut found.fields);
            let topic = found.topic.finished();
            let usable = topic.rate_hz.is_some_and(|rate| RATES_HZ.contains(&rate));
            for field in fields.iter().filter(|_| usable) {
                let Some(roughness) = field.roughness() else { continue };
                if best.as_ref().is_none_or(|(least, _)| roughness < *least) {
                    let interface = String::from_utf8_lossy(&interface).into_owned();
                    best = Some((roughness, field.guess(interface, identifier)));
                }
            }
            topics.push(topic);
        }
        (topics, best.map(|(_, guess)| guess))
    }
}

impl IdentifierSurvey {
    fn new(interface: &[u8], frame: &Frame, dbc: Option<&Dbc>) -> Self {
        let interface = String::from_utf8_lossy(interface).into_owned();
        let identifier = frame.identifier;
        let topic = TopicSurvey {
            topic: format!("{interface} {identifier}"),
            mapping_topic: interface,
            encoding: "can".into(),
            schema: dbc.and_then(|dbc| dbc.message_name(identifier)).unwrap_or_default(),
            ..TopicSurvey::default()
        };
        let signals = dbc.map(|dbc| dbc.signals_of(identifier, FIELDS_KEPT)).unwrap_or_default();
        let fields = if signals.is_empty() { raw_fields(frame.data().len()) } else { Vec::new() };
        IdentifierSurvey {
            topic,
            signals,
            first: None,
            changing: [0; 64],
            shortest: frame.data().len(),
            fields,
        }
    }

    fn take(&mut self, frame: &Frame, time_ns: i64) {
        self.topic.messages += 1;
        self.topic.take_time(time_ns);
        if frame.content == Content::Data {
            let first = *self.first.get_or_insert(*frame);
            let pairs = self.changing.iter_mut().zip(frame.data()).zip(first.data());
            pairs.for_each(|((changing, byte), first)| *changing |= byte ^ first);
            self.shortest = self.shortest.min(frame.data().len());
            self.fields.iter_mut().for_each(|field| field.take(frame));
        }
        for signal in &self.signals {
            match signal.read(frame) {
                Reading::Value(value) => self.topic.take_field(&signal.name, value),
                Reading::TooShort => self.topic.unreadable += 1,
                Reading::Absent | Reading::NotAvailable => {}
            }
        }
    }

    /// The bytes' changing bits in hexadecimal, the first byte first.
    fn changing_text(&self) -> Option<String> {
        let bytes = self.first?.data().len();
        Some(self.changing[..bytes].iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" "))
    }
}

/// Fields of 16 bits at each byte, in both orders.
fn raw_fields(bytes: usize) -> Vec<RawField> {
    let starts = (0..bytes.saturating_sub(1))
        .flat_map(|byte| [(8 * byte, ByteOrder::LittleEndian), (8 * byte + 7, ByteOrder::BigEndian)]);
    starts
        .filter_map(|(start, order)| {
            let place = BitField::new(start, FIELD_BITS, order, Encoding::Signed, 1.0, 0.0).ok()?;
            let (least, largest) = (f64::INFINITY, f64::NEG_INFINITY);
            Some(RawField {
                place,
                start,
                order,
                last: None,
                steps: 0.0,
                largest_step: 0.0,
                changing: 0,
                count: 0,
                least,
                largest,
            })
        })
        .collect()
}

impl RawField {
    fn take(&mut self, frame: &Frame) {
        let Some(value) = self.place.value(frame.data()) else { return };
        if let Some(last) = self.last.replace(value) {
            self.steps += (value - last).abs();
            self.changing |= (value as i64 ^ last as i64) as u64;
            self.largest_step = self.largest_step.max((value - last).abs());
            self.count += 1;
        }
        self.least = self.least.min(value);
        self.largest = self.largest.max(value);
    }

    /// Mean step as a share of the range; `None` for what cannot be a command, which takes both signs and moves smoothly.
    fn roughness(&self) -> Option<f64> {
        let range = self.largest - self.least;
        let both_signs = self.least < 0.0 && self.largest > 0.0;
        let roughness = self.steps / self.count.max(1) as f64 / range;
        let jumps = self.largest_step > JUMP * range;
        // The upper byte of a command with something constant below it is as smooth; the command itself has fine steps.
        let fine = self.changing & 0xff != 0;
        (both_signs && fine && !jumps && range >= LEAST_RANGE && roughness < SMOOTH).then_some(roughness)
    }

    fn guess(&self, interface: String, identifier: Identifier) -> RawGuess {
        let (id, extended) = match identifier {
            Identifier::Standard(id) => (u32::from(id), None),
            Identifier::Extended(id) => (id, Some(true)),
        };
        let (start, length) = (self.start, FIELD_BITS);
        let bits = BitsMapping {
            id,
            pgn: None,
            extended,
            start,
            length,
            order: self.order,
            encoding: Encoding::Signed,
        };
        let largest = self.largest.max(-self.least);
        // Full command is usual as 1000, 10000 or all of the 16 bits.
        let full = [1000.0, 10_000.0, 32_767.0].into_iter().find(|full| largest <= 1.05 * full);
        RawGuess { interface, bits, scale: 1.0 / full.unwrap_or(32_767.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(id: u16, bytes: &[u8]) -> Frame {
        let mut frame = Frame::new(Identifier::Standard(id), Content::Data);
        for byte in bytes {
            frame.push(*byte);
        }
        frame
    }

    #[test]
    fn a_smooth_field_of_both_signs_is_found_among_counters_and_noise() {
        for order in [ByteOrder::LittleEndian, ByteOrder::BigEndian] {
            let mut survey = BusSurvey::new(None);
            for tick in 0..4000i64 {
                let command = (5000.0 * (tick as f64 / 400.0).sin()) as i16;
                let [a, b] =
                    if order == ByteOrder::BigEndian { command.to_be_bytes() } else { command.to_le_bytes() };
                let noise = (tick as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).to_be_bytes();
                survey.take(b"can0", &frame(0x123, &[tick as u8, a, b, 0x55]), tick * 1_000_000);
                survey.take(b"can0", &frame(0x200, &noise), tick * 1_000_000);
            }
            let (topics, guess) = survey.finish();
            assert_eq!(
                topics[0].changing_bits.as_deref().map(|bits| (&bits[..2], &bits[9..])),
                Some(("FF", "00"))
            );
            let guess = guess.unwrap();
            assert_eq!((guess.bits.id, guess.bits.order), (0x123, order));
            assert_eq!(guess.bits.start, if order == ByteOrder::BigEndian { 15 } else { 8 });
            assert!((guess.scale - 1e-4).abs() < 1e-12);
        }
    }

    #[test]
    fn a_bus_of_counters_has_no_command() {
        let mut survey = BusSurvey::new(None);
        for tick in 0..2000i64 {
            survey.take(b"can0", &frame(0x10, &[tick as u8, 0, 0, 1]), tick * 1_000_000);
        }
        assert_eq!(survey.finish().1, None);
    }
}
