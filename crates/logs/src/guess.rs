//! Guesses which field of a log is which signal, by name and range.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use seepd_settings::words;
use seepd_signals::Signal;
use serde::Serialize;

use super::survey::{FieldSurvey, TopicSurvey};
use crate::mapping::BitsMapping;

/// Where a signal seems to be.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Guess {
    /// Topic, or interface of a CAN log; empty for a CSV.
    pub topic: String,
    /// Path of the field, or column, or `Message.Signal`.
    pub field: String,
    /// Factor to SI.
    pub scale: f64,
    /// Where it is in a CAN frame, where no DBC file names it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bits: Option<BitsMapping>,
    /// What a person has to say of it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remark: Option<&'static str>,
    #[serde(skip)]
    score: i32,
}

impl Guess {
    pub(crate) fn of_bits(interface: String, bits: BitsMapping, scale: f64) -> Self {
        Guess { topic: interface, field: String::new(), scale, bits: Some(bits), remark: None, score: 0 }
    }
}

/// Words in a field's path that speak for a signal, the strongest first.
const WORDS: [(Signal, &[&str]); 8] = [
    (Signal::Command, &["command", "cmd", "valve", "output", "pid", "u"]),
    (Signal::Demand, &["demand", "setpoint", "set_point", "target", "reference", "desired"]),
    (Signal::Position, &["position", "pos", "stroke", "x"]),
    (Signal::PSupply, &["p_supply", "supply", "pump", "p_s"]),
    (Signal::PInlet, &["p_inlet", "inlet", "p_3"]),
    (Signal::PCap, &["p_cap", "cap", "p_1", "p_a"]),
    (Signal::PRod, &["p_rod", "rod", "p_2", "p_b"]),
    (Signal::Load, &["load", "force"]),
];

/// Words that say that a field is another quantity, whatever else its name has: `pump_temp` is no pressure.
const OTHER_QUANTITIES: [&str; 14] = [
    "temp",
    "temperature",
    "accel",
    "acceleration",
    "vel",
    "velocity",
    "speed",
    "rpm",
    "flow",
    "level",
    "vibration",
    "humidity",
    "count",
    "counter",
];

/// Shorter words are looked for at the beginning of a name's word alone: `p_1` is in `temp_1`, `cap` in `escape`.
const LONG_ENOUGH: usize = 5;

/// Marks the fields with what they seem to be, and gives the mapping.
pub(crate) fn guess(topics: &mut [TopicSurvey]) -> BTreeMap<Signal, Guess> {
    let mut mapping: BTreeMap<Signal, Guess> = BTreeMap::new();
    for topic in topics.iter() {
        for field in &topic.fields {
            let Some((signal, score, scale)) = guess_field(&topic.topic, field) else { continue };
            if mapping.get(&signal).is_none_or(|other| score > other.score) {
                let topic = topic.mapping_topic.clone();
                let is_unsure = signal == Signal::Command && VOLTS_OR_PER_CENT.contains(&field.size());
                let remark = is_unsure.then_some(UNSURE_COMMAND);
                let field = field.path.clone();
                mapping.insert(signal, Guess { topic, field, scale, bits: None, remark, score });
            }
        }
    }
    for topic in topics {
        for field in &mut topic.fields {
            let is = |guess: &Guess| guess.field == field.path && guess.topic == topic.mapping_topic;
            field.guess = mapping.iter().find(|(_, guess)| is(guess)).map(|(signal, _)| signal.name());
        }
    }
    mapping
}

/// The signal that a field seems to be, how strongly, and the factor to SI.
fn guess_field(topic: &str, field: &FieldSurvey) -> Option<(Signal, i32, f64)> {
    if topic.ends_with("/truth") || field.least == field.largest {
        return None;
    }
    let parts = words(&field.path);
    if parts.iter().any(|(_, part)| OTHER_QUANTITIES.contains(&part.as_str())) {
        return None;
    }
    let path = field.path.to_ascii_lowercase();
    let begins = |at: usize| parts.iter().any(|(begin, _)| *begin == at);
    let words: Vec<&str> = path.split(|c: char| !c.is_ascii_alphanumeric() && c != '_').collect();
    let mut best: Option<(Signal, i32, f64)> = None;
    for (signal, known) in WORDS {
        for (rank, word) in known.iter().enumerate() {
            let strength = if path == *word {
                40
            } else if words.contains(word) {
                30
            } else if word.len() > 2
                && path
                    .match_indices(word)
                    .any(|(at, _)| word.len() >= LONG_ENOUGH && !word.contains('_') || begins(at))
            {
                20
            } else {
                continue;
            };
            let Some(scale) = scale_to_si(signal, field.size()) else {
                continue;
            };
            let score = strength - rank as i32;
            if best.is_none_or(|best| score > best.1) {
                best = Some((signal, score, scale));
            }
        }
    }
    best
}

/// Largest values of a command that may be volts out of ten, a few per cent, or none of these.
const VOLTS_OR_PER_CENT: RangeInclusive<f64> = 1.1..=11.0;
const UNSURE_COMMAND: &str = "Its values go beyond 1: say what a full command is. Volts of ±10 have scale = 0.1, per cent scale = 0.01.";

/// The factor to SI that makes a range plausible: percent, millimetres, bar, kilonewtons are told by their size.
fn scale_to_si(signal: Signal, largest: f64) -> Option<f64> {
    let candidates: &[(f64, f64, f64)] = match signal {
        Signal::Command => &[(1e-3, 11.0, 1.0), (11.0, 110.0, 0.01)],
        Signal::Demand | Signal::Position => &[(1e-3, 10.0, 1.0), (10.0, 1e4, 1e-3)],
        Signal::PSupply | Signal::PInlet | Signal::PCap | Signal::PRod => &[(1e4, 1e8, 1.0), (0.5, 1e3, 1e5)],
        Signal::Load => &[(500.0, 1e9, 1.0), (0.1, 500.0, 1e3)],
        Signal::CycleStart => &[],
    };
    candidates.iter().find(|(low, high, _)| (*low..=*high).contains(&largest)).map(|(_, _, scale)| *scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guessed(path: &str, largest: f64) -> Option<Signal> {
        let field = FieldSurvey { path: path.into(), count: 1, least: 0.0, largest, guess: None };
        guess_field("", &field).map(|(signal, ..)| signal)
    }

    #[test]
    fn names_are_told_by_their_words() {
        for (path, largest, signal) in [
            ("valve_cmd", 0.9, Signal::Command),
            ("axis.u", 80.0, Signal::Command),
            ("istposition", 0.3, Signal::Position),
            ("PumpPressure", 160.0, Signal::PSupply),
            ("press.p_1", 80.0, Signal::PCap),
            ("RodPressure", 5e6, Signal::PRod),
            ("setpoint_mm", 300.0, Signal::Demand),
        ] {
            assert_eq!(guessed(path, largest), Some(signal), "{path}");
        }
    }

    /// A few per cent and volts out of ten look alike: neither is taken for the other.
    #[test]
    fn a_command_beyond_one_asks_for_its_scale() {
        let of = |largest: f64| {
            let field = FieldSurvey { path: "cmd".into(), count: 9, least: -largest, largest, guess: None };
            let mut topics = [TopicSurvey { fields: vec![field], ..TopicSurvey::default() }];
            let found = guess(&mut topics).remove(&Signal::Command).unwrap();
            (found.scale, found.remark.is_some())
        };
        assert_eq!([of(0.9), of(8.0), of(90.0)], [(1.0, false), (1.0, true), (0.01, false)]);
    }

    /// Names of a real rig's log (and some more) that have a signal's letters in another word.
    #[test]
    fn other_quantities_are_no_signals() {
        for (path, largest) in [
            ("Temp_1", 12297.0),
            ("Temp_3", 16383.0),
            ("Internal_Temp", 24.0),
            ("pump_temp", 45.0),
            ("escape_a", 100.0),
            ("product", 100.0),
            ("valve_flow", 80.0),
            ("PumpSpeed", 1450.0),
        ] {
            assert_eq!(guessed(path, largest), None, "{path}");
        }
    }
}
