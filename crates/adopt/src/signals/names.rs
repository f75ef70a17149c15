//! What the name of a field says, in the languages and abbreviations of machine builders: weak evidence, which physics overrules.

use seepd_logs::columns::Column;
use seepd_settings::words;
use seepd_signals::Signal;

/// What a field is, by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// An order to a valve.
    Command,
    /// Where the piston is to be.
    Demand,
    /// Where it is.
    Position,
    /// A pressure somewhere.
    Pressure,
    /// A force.
    Load,
    /// A mark of a cycle's start.
    CycleStart,
    /// The difference of demand and position.
    Error,
    /// None of these: a temperature, a speed, a current, a flow, a counter, a spool.
    Other,
    /// The name says nothing.
    Unknown,
}

/// What single words speak of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Topic {
    Valve,
    Command,
    Demand,
    Position,
    Feedback,
    Pressure,
    Load,
    CycleStart,
    Error,
    Other,
}

/// Where in the circuit a pressure is, by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Port {
    pub(super) signal: Option<Signal>,
    /// Whether the name says it in words rather than by a letter or a number.
    pub(super) in_words: bool,
}

/// Words of each topic; those of four letters and more also within longer ones.
const WORDS: &[(Topic, &[&str])] = &[
    (Topic::Valve, &["valve", "ventil", "vlv", "spool", "schieber"]),
    (
        Topic::Command,
        &[
            "command",
            "cmd",
            "output",
            "pid",
            "stellgroesse",
            "stellgröße",
            "stellwert",
            "stellsignal",
            "servo",
            "control",
            "ctrl",
            "steuer",
            "u",
            "uv",
            "y",
        ],
    ),
    (
        Topic::Demand,
        &[
            "demand",
            "setpoint",
            "setpos",
            "set",
            "sp",
            "target",
            "reference",
            "ref",
            "desired",
            "soll",
            "sollwert",
            "profile",
            "w",
        ],
    ),
    (
        Topic::Position,
        &[
            "position",
            "pos",
            "stroke",
            "displacement",
            "disp",
            "lvdt",
            "encoder",
            "hub",
            "weg",
            "kolbenweg",
            "zylinderweg",
            "travel",
            "height",
            "extension",
            "x",
        ],
    ),
    (Topic::Feedback, &["ist", "istwert", "actual", "act", "feedback", "fb", "measured", "meas"]),
    (
        Topic::Pressure,
        &[
            "pressure", "druck", "prs", "presion", "p", "pg", "pa", "pb", "pp", "ps", "pt", "p0", "p1", "p2",
            "p3",
        ],
    ),
    (Topic::Load, &["load", "force", "kraft", "last", "f"]),
    (Topic::CycleStart, &["cyclestart", "cycle", "start", "trigger", "sync", "takt", "zyklus"]),
    (Topic::Error, &["error", "err", "deviation", "abweichung", "lag", "following", "residual"]),
    (
        Topic::Other,
        &[
            "temp",
            "temperature",
            "temperatur",
            "tmp",
            "speed",
            "velocity",
            "vel",
            "geschwindigkeit",
            "current",
            "strom",
            "flow",
            "durchfluss",
            "count",
            "counter",
            "index",
            "seq",
            "sequence",
            "time",
            "timestamp",
            "zeit",
            "number",
            "zaehler",
            "torque",
            "moment",
            "power",
            "leistung",
            "level",
            "acceleration",
            "accel",
            "acc",
            "vibration",
            "humidity",
            "status",
            "state",
            "mode",
            "alarm",
            "integral",
            "integrator",
            "iterm",
            "pterm",
            "dterm",
            "gain",
            "active",
            "enable",
            "motor",
            "rpm",
            "limit",
            "lim",
            "switch",
            "term",
            "anteil",
            "ratio",
        ],
    ),
];

/// Words of an electric current, by which some valves are commanded.
const CURRENT: &[&str] = &["current", "strom"];

/// Words of a circuit's places, those in words first, letters and numbers after them.
const PORTS: &[(Signal, &[&str], &[&str])] = &[
    (
        Signal::PCap,
        &["cap", "kolben", "kolbenseite", "piston", "bore", "blind", "bottom", "boden", "bodenseite"],
        &["a", "1", "pa", "p1"],
    ),
    (
        Signal::PRod,
        &["rod", "ring", "ringseite", "stange", "stangenseite", "annulus"],
        &["b", "2", "pb", "p2"],
    ),
    (
        Signal::PSupply,
        &["supply", "pump", "pumpe", "system", "versorgung", "line", "main"],
        &["s", "p", "ps", "0", "p0"],
    ),
    (Signal::PInlet, &["inlet", "eingang", "einlass"], &["3", "p3", "in"]),
];

/// Words of the return line, whose pressure is none of the signals.
const RETURN: &[&str] = &["tank", "return", "ruecklauf", "rücklauf", "t", "pt", "r", "pr", "drain"];

/// Names that say nothing themselves, so that the topic does.
const GENERIC: &[&str] = &["data", "value", "val", "wert", "float", "double", "signal"];

/// The words of a column's name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Name {
    /// Words of the field itself.
    words: Vec<String>,
    /// Words of what it is in: the message, the topic.
    around: Vec<String>,
}

impl Name {
    pub(super) fn of(column: &Column) -> Self {
        let mut parts: Vec<&str> =
            column.topic.split('/').chain(column.field.split('.')).filter(|part| !part.is_empty()).collect();
        let mut own = parts.pop().unwrap_or_default();
        while GENERIC.contains(&own.to_lowercase().as_str())
            && let Some(outer) = parts.pop()
        {
            own = outer;
        }
        let mut words = words_of(own);
        let unit = column.unit.as_deref().unwrap_or_default().to_lowercase();
        // The unit is no word: `pressure_b_pa` is at no port called `pa`.
        words.pop_if(|last| own.len() > unit.len() && *last == unit);
        Name { words, around: parts.into_iter().flat_map(words_of).collect() }
    }

    /// What the field is, by its own name, or else by what it is in.
    pub(super) fn role(&self) -> Role {
        match role_of(&self.words) {
            Role::Unknown => role_of(&self.around),
            role => role,
        }
    }

    /// Where in the circuit a pressure is.
    pub(super) fn port(&self) -> Port {
        let named = |words: &[&str]| self.words.iter().any(|word| words.contains(&word.as_str()));
        for (signal, in_words, _) in PORTS {
            if self.words.iter().any(|word| is_of(word, in_words)) {
                return Port { signal: Some(*signal), in_words: true };
            }
        }
        if named(RETURN) {
            return Port { signal: None, in_words: true };
        }
        // A sole `p` says that it is a pressure, no more.
        let letters = |letters: &[&str]| {
            self.words
                .iter()
                .enumerate()
                .any(|(at, word)| letters.contains(&word.as_str()) && (at > 0 || word != "p"))
        };
        let signal = PORTS.iter().find(|(.., short)| letters(short)).map(|(signal, ..)| *signal);
        Port { signal, in_words: false }
    }
}

fn role_of(words: &[String]) -> Role {
    let has = |topic: Topic| {
        let known = WORDS.iter().find(|(known, _)| *known == topic).map_or(&[][..], |(_, words)| words);
        words.iter().any(|word| is_of(word, known))
    };
    let ordered = has(Topic::Command) || has(Topic::Demand);
    if has(Topic::Pressure) {
        // What a pressure is to be is none.
        return if ordered || has(Topic::Error) || has(Topic::Other) { Role::Other } else { Role::Pressure };
    }
    if has(Topic::Valve) {
        // What a valve's spool does is no order to it; its current may be.
        let told_back = (has(Topic::Feedback) || has(Topic::Position)) && !ordered;
        let is_current = words.iter().any(|word| is_of(word, CURRENT));
        let other = has(Topic::Error) || (has(Topic::Other) && !is_current);
        return if told_back || other { Role::Other } else { Role::Command };
    }
    if has(Topic::Error) {
        return Role::Error;
    }
    if has(Topic::Other) {
        return Role::Other;
    }
    match (has(Topic::Position), ordered) {
        (true, true) => return Role::Demand,
        (true, false) => return Role::Position,
        (false, _) => {}
    }
    let plain = [
        (Topic::CycleStart, Role::CycleStart),
        (Topic::Load, if ordered { Role::Other } else { Role::Load }),
        (Topic::Command, Role::Command),
        (Topic::Demand, Role::Demand),
        (Topic::Feedback, Role::Position),
    ];
    plain.into_iter().find(|(topic, _)| has(*topic)).map_or(Role::Unknown, |(_, role)| role)
}

fn is_of(word: &str, known: &[&str]) -> bool {
    known.iter().any(|known| word == *known || (known.chars().count() >= 4 && word.contains(known)))
}

/// `cylPos_mm` → cyl, pos, mm; what is in brackets is a unit and no word.
fn words_of(name: &str) -> Vec<String> {
    let name = name.split(['[', '(']).next().filter(|before| !before.trim().is_empty()).unwrap_or(name);
    words(name).into_iter().map(|(_, word)| word).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(topic: &str, field: &str) -> Name {
        Name::of(&Column { topic: topic.into(), field: field.into(), unit: None, values: Vec::new() })
    }

    #[test]
    fn names_are_words_whatever_divides_them() {
        assert_eq!(words_of("cylPos_mm"), ["cyl", "pos", "mm"]);
        assert_eq!(words_of("Druck A [bar]"), ["druck", "a"]);
    }

    #[test]
    fn roles_are_told_by_words_and_how_they_go_together() {
        for (topic, field, role) in [
            ("", "command", Role::Command),
            ("", "VentilSollwert", Role::Command),
            ("/axis/valve_command", "data", Role::Command),
            ("", "valve_position", Role::Other),
            ("", "spoolActual", Role::Other),
            ("", "position_command", Role::Demand),
            ("", "SollPosition", Role::Demand),
            ("", "Kolbenweg", Role::Position),
            ("", "boom_error_m", Role::Error),
            ("", "Temp_1", Role::Other),
            ("", "valve_pressure", Role::Pressure),
            ("", "pressure_setpoint", Role::Other),
            ("", "force_setpoint", Role::Other),
            ("", "valve_current", Role::Command),
            ("", "valve_temp", Role::Other),
            ("", "motor_current", Role::Other),
            ("", "oil_temp", Role::Other),
            ("", "p_cap", Role::Pressure),
            ("", "Pressure A", Role::Pressure),
            ("", "force_n", Role::Load),
            ("", "cycle_start", Role::CycleStart),
            // A topic's name speaks for fields that do not speak for themselves.
            ("/valve", "ch1", Role::Command),
            ("/valve", "position", Role::Position),
            ("", "ch1", Role::Unknown),
        ] {
            assert_eq!(name(topic, field).role(), role, "{topic} {field}");
        }
    }

    #[test]
    fn a_unit_is_no_word() {
        let (field, unit) = ("pressure_b_pa".to_owned(), Some("pa".to_owned()));
        let name = Name::of(&Column { topic: String::new(), field, unit, values: Vec::new() });
        assert_eq!(name.port(), Port { signal: Some(Signal::PRod), in_words: false });
    }

    #[test]
    fn ports_are_told_by_words_and_weaker_by_letters() {
        for (field, signal, in_words) in [
            ("p_cap", Some(Signal::PCap), true),
            ("Druck Stangenseite [bar]", Some(Signal::PRod), true),
            ("pressure_a_pa", Some(Signal::PCap), false),
            ("p2", Some(Signal::PRod), false),
            ("pump_pressure", Some(Signal::PSupply), true),
            ("p_tank", None, true),
            ("pressure", None, false),
            ("p", None, false),
        ] {
            assert_eq!(name("", field).port(), Port { signal, in_words }, "{field}");
        }
    }
}
