//! From frames to samples: the mapped signals of a bus, by a DBC file's names or by bit layout.

use seepd_signals::{Sample, Signal};

use super::bit_field::BitField;
use super::dbc::{CanSignal, Dbc, Reading};
use super::j1939::{FrameChoice, SourceAddress};
use super::timeline::Timeline;
use super::{Content, Frame, Identifier};
use crate::error::LogError;
use crate::mapping::{BitsMapping, CounterMapping, SignalMapping, ToSi};

/// A signal of the mapping.
struct Wanted {
    signal: Signal,
    to_si: ToSi,
    /// Interface; empty: any.
    interface: Vec<u8>,
    source: CanSignal,
}

/// Frames and what was wrong with them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameCounts {
    /// Frames that gave a sample.
    pub given: u64,
    /// Too short for a mapped signal.
    pub too_short: u64,
    /// Frames whose sender says that it has no value for a mapped signal.
    pub not_available: u64,
    /// Remote frames, which carry no data.
    pub remote: u64,
    /// Error frames.
    pub error: u64,
    /// Frames that the counter says were lost.
    pub missing: u64,
    /// Frames with the counter of the frame before: sent twice, or by two senders.
    pub repeated: u64,
    /// Times that the counter went back: its sender began anew, or there are two.
    pub jumps: u64,
}

/// Turns frames into samples. A command is published with what was known beside it.
pub struct FrameDecoder {
    wanted: Vec<Wanted>,
    counter: Option<Counter>,
    timeline: Option<Timeline>,
    held: Sample,
    counts: FrameCounts,
}

/// A counter that its sender raises by one from frame to frame.
struct Counter {
    source: CanSignal,
    last: Option<u64>,
}

impl FrameDecoder {
    /// Finds the mapping's signals. A signal under its own name may be missing, unless it is the command.
    ///
    /// # Errors
    /// [`LogError::Mapping`]: a signal has neither bits nor a DBC file that names it, its bits are none of a frame, or the counter is not
    /// in the command's frame.
    pub fn new(
        mapping: Vec<(Signal, SignalMapping)>,
        counter: Option<&CounterMapping>,
        dbc: Option<&Dbc>,
    ) -> Result<Self, LogError> {
        let mut wanted = Vec::new();
        for (signal, mapping) in mapping {
            let name = format!("signals.{}", signal.name());
            match find(&name, &mapping.field, mapping.bits.as_ref(), mapping.source_address, dbc) {
                Ok(source) => wanted.push(Wanted {
                    signal,
                    to_si: mapping.to_si(signal, &source.unit),
                    interface: mapping.topic.into_bytes(),
                    source,
                }),
                Err(_) if mapping.bits.is_none() && mapping.may_be_missing(signal) => {}
                Err(error) => return Err(error),
            }
        }
        let counter = counter
            .map(|counter| find("source.counter", &counter.field, counter.bits.as_ref(), None, dbc))
            .transpose()?
            .map(|source| Counter { source, last: None });
        let command = wanted.iter().find(|wanted| wanted.signal == Signal::Command);
        if let (Some(counter), Some(command)) = (&counter, command)
            && counter.source.frames != command.source.frames
        {
            return Err(LogError::mapping(format!(
                "source.counter is in the frame {}, but signals.command is in {}; name a counter in the frame of the command, since it times that frame",
                counter.source.frames.identifier, command.source.frames.identifier
            )));
        }
        let (held, counts) = (Sample::new(0), FrameCounts::default());
        Ok(FrameDecoder { wanted, counter, timeline: None, held, counts })
    }

    /// Times frames by their counter, where there is one, as coming at a rate, Hz.
    #[must_use]
    pub fn timed_by_counter(mut self, rate_hz: f64) -> Self {
        self.timeline = self.counter.as_ref().map(|_| Timeline::new(rate_hz));
        self
    }

    /// The sample that a frame completes, if it carries a command.
    pub fn take(&mut self, frame: &Frame, interface: &[u8], time_ns: i64) -> Option<Sample> {
        match frame.content {
            Content::Remote => self.counts.remote += 1,
            Content::Error => self.counts.error += 1,
            Content::Data => {}
        }
        let steps = self.counter.as_mut().and_then(|counter| counter.take(frame, &mut self.counts));
        let mut has_command = false;
        let (mut too_short, mut not_available) = (false, false);
        for wanted in &self.wanted {
            if !wanted.interface.is_empty() && wanted.interface != interface {
                continue;
            }
            match wanted.source.read(frame) {
                Reading::Value(value) => {
                    self.held.set(wanted.signal, wanted.to_si.of(value));
                    has_command |= wanted.signal == Signal::Command;
                }
                Reading::TooShort => too_short = true,
                Reading::NotAvailable => not_available = true,
                Reading::Absent => {}
            }
        }
        self.counts.too_short += u64::from(too_short);
        self.counts.not_available += u64::from(not_available);
        self.counts.given += u64::from(has_command);
        if !has_command {
            return None;
        }
        self.held.time_ns = match &mut self.timeline {
            Some(timeline) => timeline.place(steps, time_ns),
            None => time_ns,
        };
        Some(self.held)
    }

    /// Frames so far.
    pub fn counts(&self) -> &FrameCounts {
        &self.counts
    }

    /// Frames that are looked at, each choice once.
    pub fn choices(&self) -> Vec<FrameChoice> {
        let counter = self.counter.iter().map(|counter| counter.source.frames);
        let mut all: Vec<FrameChoice> =
            self.wanted.iter().map(|wanted| wanted.source.frames).chain(counter).collect();
        all.sort_by_key(|choice| (choice.identifier, choice.mask));
        all.dedup();
        all
    }

    /// What the command is called and where it is, for messages.
    pub fn command_place(&self) -> String {
        let command = self.wanted.iter().find(|wanted| wanted.signal == Signal::Command);
        command.map_or("a command, which the mapping does not name".into(), |wanted| {
            let interface = String::from_utf8_lossy(&wanted.interface);
            let on = if interface.is_empty() { String::new() } else { format!(" on {interface}") };
            format!("{} (identifier {}){on}", wanted.source.name, wanted.source.frames.identifier)
        })
    }
}

impl Counter {
    /// Counts since the frame before; `None` where the counter does not say.
    fn take(&mut self, frame: &Frame, counts: &mut FrameCounts) -> Option<u64> {
        if !self.source.frames.takes(frame.identifier) || frame.content != Content::Data {
            return None;
        }
        let value = self.source.field.raw(frame.data())?;
        let largest = u64::MAX >> (64 - self.source.field.bits());
        let last = self.last.replace(value)?;
        let steps = value.wrapping_sub(last) & largest;
        if steps == 0 {
            counts.repeated += 1;
            return None;
        }
        if steps - 1 > largest / 2 {
            counts.jumps += 1;
            return None;
        }
        counts.missing += steps - 1;
        Some(steps)
    }
}

fn find(
    name: &str,
    field: &str,
    bits: Option<&BitsMapping>,
    source: Option<SourceAddress>,
    dbc: Option<&Dbc>,
) -> Result<CanSignal, LogError> {
    match (bits, dbc) {
        (Some(bits), _) => {
            let field = BitField::new(bits.start, bits.length, bits.order, bits.encoding, 1.0, 0.0)
                .map_err(|error| LogError::mapping(format!("{name}.bits: the field {error}")))?;
            let frames = frames_of(bits, source)
                .map_err(|error| LogError::mapping(format!("{name}.bits: {error}")))?;
            Ok(CanSignal::at(name, frames, field))
        }
        (None, Some(dbc)) => {
            let found = dbc.find(field).map_err(|error| LogError::mapping(format!("{name}: {error}")))?;
            match source {
                Some(source) => found.sent_by(source).ok_or_else(|| {
                    LogError::mapping(format!(
                        "{name}.source_address: `{field}` is in a frame of 11 bits, which has none"
                    ))
                }),
                None => Ok(found),
            }
        }
        (None, None) => Err(LogError::mapping(format!(
            "{name}: nothing says where `{field}` is in a frame: name the DBC file that describes the frames (dbc, --dbc FILE) or give \
             its bits ({name}.bits)"
        ))),
    }
}

/// The frames that a bit layout is of.
fn frames_of(bits: &BitsMapping, source: Option<SourceAddress>) -> Result<FrameChoice, LogError> {
    match (bits.pgn, source) {
        (Some(number), source) => {
            let source = source.unwrap_or(SourceAddress::Any);
            let what =
                || LogError::mapping(format!("there is no parameter group {number}; the largest is 262143"));
            FrameChoice::of_number(number, source).ok_or_else(what)
        }
        (None, Some(source)) => match bits.identifier()? {
            Identifier::Extended(bits) => Ok(FrameChoice::of_group(bits, source)),
            Identifier::Standard(_) => {
                Err(LogError::mapping("an identifier of 11 bits has no source_address"))
            }
        },
        (None, None) => bits.identifier().map(FrameChoice::one),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::can::bit_field::{ByteOrder, Encoding};

    fn bits(start: usize, length: usize, encoding: Encoding) -> BitsMapping {
        BitsMapping {
            id: 0x123,
            pgn: None,
            extended: None,
            start,
            length,
            order: ByteOrder::LittleEndian,
            encoding,
        }
    }

    fn decoder() -> FrameDecoder {
        let command = SignalMapping {
            bits: Some(bits(0, 16, Encoding::Signed)),
            scale: 1e-4,
            ..SignalMapping::default()
        };
        let counter =
            CounterMapping { bits: Some(bits(16, 8, Encoding::Unsigned)), ..CounterMapping::default() };
        FrameDecoder::new(vec![(Signal::Command, command)], Some(&counter), None).unwrap()
    }

    fn frame(bytes: &[u8]) -> Frame {
        let mut frame = Frame::new(Identifier::Standard(0x123), Content::Data);
        for byte in bytes {
            frame.push(*byte);
        }
        frame
    }

    #[test]
    fn bits_without_a_file_give_the_command() {
        let mut decoder = decoder();
        let sample = decoder.take(&frame(&[0x18, 0xfc, 0]), b"can0", 7).unwrap();
        assert_eq!((sample.time_ns, sample.get(Signal::Command)), (7, Some(-0.1)));
        assert_eq!(decoder.choices(), [FrameChoice::one(Identifier::Standard(0x123))]);
    }

    #[test]
    fn counters_tell_lost_repeated_and_restarted_frames() {
        let mut decoder = decoder();
        for counter in [254, 255, 0, 1, 1, 4, 3] {
            decoder.take(&frame(&[0, 0, counter]), b"", 0);
        }
        let counts = decoder.counts();
        assert_eq!((counts.given, counts.repeated, counts.missing, counts.jumps), (7, 1, 2, 1));
    }

    #[test]
    fn short_remote_error_and_other_frames_give_nothing() {
        let mut decoder = decoder();
        assert_eq!(decoder.take(&frame(&[1]), b"", 0), None);
        for content in [Content::Remote, Content::Error] {
            assert_eq!(decoder.take(&Frame::new(Identifier::Standard(0x123), content), b"", 0), None);
        }
        assert_eq!(decoder.take(&Frame::new(Identifier::Extended(0x123), Content::Data), b"", 0), None);
        let counts = decoder.counts();
        assert_eq!((counts.given, counts.too_short, counts.remote, counts.error), (0, 1, 1, 1));
    }

    #[test]
    fn a_counter_of_another_frame_is_refused() {
        let command = SignalMapping { bits: Some(bits(0, 16, Encoding::Signed)), ..SignalMapping::default() };
        let elsewhere = BitsMapping { id: 0x124, ..bits(16, 8, Encoding::Unsigned) };
        let counter = CounterMapping { bits: Some(elsewhere), ..CounterMapping::default() };
        let message = FrameDecoder::new(vec![(Signal::Command, command)], Some(&counter), None)
            .err()
            .unwrap()
            .to_string();
        assert!(
            message.starts_with("source.counter is in the frame 124, but signals.command is in 123"),
            "{message}"
        );
    }

    #[test]
    fn a_command_that_nothing_places_is_refused() {
        let command =
            vec![(Signal::Command, SignalMapping { field: "command".into(), ..SignalMapping::default() })];
        let message = FrameDecoder::new(command, None, None).err().unwrap().to_string();
        assert!(message.contains("signals.command.bits"), "{message}");
    }
}
