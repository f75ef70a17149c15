//! What an FMU has, and the plant file that would map it: by causality and unit first, then by what names are usually for.

use std::collections::BTreeSet;

use seepd_fmi::{Causality, ModelDescription, Variable};
use seepd_settings::words;
use seepd_signals::Signal;

use crate::mapping::{PRESSURE, quantity};
use crate::spec::VELOCITY;

/// Parts of names by which two of the same unit are told apart; compared without case, as whole words between other letters.
const NAMES: [(&str, &[&str]); 9] = [
    ("command", &["u", "y", "cmd", "command", "valve", "spool", "opening", "stell"]),
    ("demand", &["ref", "demand", "set", "setpoint", "soll", "xref", "target"]),
    ("load", &["load", "force", "f", "last", "ext"]),
    ("position", &["x", "s", "pos", "position", "stroke", "ist", "weg", "hub"]),
    (VELOCITY, &["v", "vel", "velocity", "speed"]),
    ("p_cap", &["cap", "pa", "p1", "a", "bore", "head", "kolben"]),
    ("p_rod", &["rod", "pb", "p2", "b", "ring", "annulus", "stange"]),
    ("p_supply", &["supply", "ps", "pump", "system", "p"]),
    ("p_inlet", &["inlet", "p3"]),
];

/// A variable for one of our names, or those among which a person decides.
enum Guess<'d> {
    Sure(&'d Variable),
    Among(Vec<&'d Variable>),
}

/// Whether a name has one of the parts as a word: letters and digits between other characters, or between small and large letters.
fn is_named(name: &str, parts: &[&str]) -> bool {
    words(name).iter().any(|(_, word)| parts.contains(&word.as_str()))
}

fn guess<'d>(description: &'d ModelDescription, name: &str, causality: Causality) -> Option<Guess<'d>> {
    let (unit, _) = quantity(name);
    let parts = NAMES.iter().find(|(ours, _)| *ours == name).map_or(&[][..], |(_, parts)| parts);
    let of_kind = description.variables.iter().filter(|variable| variable.causality == causality);
    let mut among: Vec<&Variable> = of_kind
        .filter(|variable| match description.unit_of(variable) {
            Some(own) => own.exponents == unit,
            // One that says nothing of its unit is told by its name alone.
            None => is_named(&variable.name, parts),
        })
        .collect();
    let named: Vec<&Variable> =
        among.iter().filter(|variable| is_named(&variable.name, parts)).copied().collect();
    match (among.len(), named.as_slice()) {
        (0, _) => None,
        (_, [one]) => Some(Guess::Sure(one)),
        // The only one of its unit; chambers and supply have the same unit, and one pressure may be any of them.
        (1, _) if unit != PRESSURE => among.pop().map(Guess::Sure),
        _ => Some(Guess::Among(among)),
    }
}

/// One line for each input, output and parameter: name, causality, unit, start, bounds, and what its author says of it.
pub fn overview(description: &ModelDescription) -> String {
    let number = |value: Option<f64>| value.map_or("–".to_owned(), number);
    let kind = |causality| match causality {
        Causality::Input => Some("input"),
        Causality::Output => Some("output"),
        Causality::Parameter => Some("parameter"),
        Causality::StructuralParameter => Some("structural parameter"),
        Causality::Other => None,
    };
    let mut text = format!("{:<32} {:<12} {:<10} {:>12}  bounds\n", "variable", "causality", "unit", "start");
    for variable in &description.variables {
        let Some(kind) = kind(variable.causality) else { continue };
        let unit = variable.unit.as_deref().unwrap_or("–");
        let bounds = format!("{} … {}", number(variable.bounds.0), number(variable.bounds.1));
        text += &format!(
            "{:<32} {kind:<12} {unit:<10} {:>12}  {bounds}  {}\n",
            variable.name,
            number(variable.start),
            variable.description
        );
    }
    text
}

/// All of a number's digits, very small and very large ones with their power of ten.
fn number(value: f64) -> String {
    if value == 0.0 || (1e-4..1e7).contains(&value.abs()) { value.to_string() } else { format!("{value:e}") }
}

/// A plant file for the model, where it is named so. What cannot be told stands in it as a comment with the variables that it may be.
pub fn plant_file(file: &str, description: &ModelDescription) -> String {
    let of = |name: &str, causality| guess(description, name, causality);
    let demand = of("demand", Causality::Input);
    // A model that takes a position takes the demand, and has its controller inside.
    let reference = match demand {
        Some(guess) => ("demand", Some(guess)),
        None => ("command", of("command", Causality::Input)),
    };
    let inside = reference.0 == "demand";
    let inputs = [reference, ("load", of("load", Causality::Input))];
    let mut outputs = vec![
        (Signal::Position.name(), of("position", Causality::Output)),
        (VELOCITY, of(VELOCITY, Causality::Output)),
    ];
    if inside {
        outputs.insert(0, (Signal::Command.name(), of("command", Causality::Output)));
    }
    for signal in [Signal::PCap, Signal::PRod, Signal::PSupply, Signal::PInlet] {
        outputs.push((signal.name(), of(signal.name(), Causality::Output)));
    }
    let mut text = format!(
        "# Proposed from the model's description: check it, and fill in what is yours.\nkind = \"simulator\"\n{}\
         stroke_m = 0.5  # What the axis can travel, m\n\n[fmu]\nfile = {}\n",
        if inside { "period_s = 0.001  # Length of a tick, s\n" } else { "" },
        quoted(file)
    );
    text += &table("inputs", &inputs);
    text += &table("outputs", &outputs);
    text += "\n# What calibration may change: leave out what is known. Without bounds: a quarter to four times the start.\n[parameters]\n";
    let mut proposed = BTreeSet::new();
    for variable in &description.variables {
        // Names are unique in a good description; in a bad one a table may have each once all the same.
        if proposed.insert(variable.name.as_str()) {
            text += &parameter(variable);
        }
    }
    if !inside {
        text +=
            "\n# Your controller, around the model.\n[controller]\nkp = 12.0\nki = 15.0\nperiod_s = 0.001\n";
    }
    text + CYCLE
}

/// What no model says.
const CYCLE: &str = "\n# Your duty cycle: a log's own demand is used where there is one, and these moves serve to find the cycles in it.\n\
                     [cycle]\nperiod_s = 10.0\nload = []\n\n[[cycle.moves]]\nname = \"extend\"\nfrom_s = 0.5\nto_s = 2.5\nto_m = 0.35\n\n\
                     [[cycle.moves]]\nname = \"retract\"\nfrom_s = 6.0\nto_s = 8.5\nto_m = 0.10\n";

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// A name as a key, which has one line, where a value may be written over several.
fn key(text: &str) -> String {
    let quoted = quoted(text);
    if !quoted.starts_with("'''") && !quoted.starts_with("\"\"\"") {
        return quoted;
    }
    let alone = toml::Table::from_iter([(text.to_owned(), toml::Value::Boolean(true))]).to_string();
    alone.trim_end().trim_end_matches(" = true").to_owned()
}

fn table(name: &str, guesses: &[(&str, Option<Guess<'_>>)]) -> String {
    let mut text = format!("\n[fmu.{name}]\n");
    for (ours, guess) in guesses {
        text += &match guess {
            Some(Guess::Sure(variable)) => format!("{ours} = {}\n", quoted(&variable.name)),
            Some(Guess::Among(variables)) => {
                let names: Vec<String> = variables.iter().map(|variable| quoted(&variable.name)).collect();
                format!("# {ours} = one of {}\n", names.join(", "))
            }
            None => String::new(),
        };
    }
    text
}

fn parameter(variable: &Variable) -> String {
    let Some(start) = variable.start.filter(|_| variable.causality == Causality::Parameter) else {
        return String::new();
    };
    let name = key(&variable.name);
    match variable.bounds {
        (Some(low), Some(high)) if low < high && (low..=high).contains(&start) => {
            format!("{name} = {{ start = {start:?}, bounds = [{low:?}, {high:?}] }}\n")
        }
        _ if start > 0.0 => format!("{name} = {{ start = {start:?} }}\n"),
        _ => format!("# {name} = {{ start = {start:?}, bounds = [ … ] }}\n"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_with_quotes_and_backslashes_read_back() {
        for name in ["valve.lag", "v\\lve'.lag", "a\"b'c\\d", "", "\u{7f}'''\"\"\"", "two\nlines'"] {
            let text = format!("{} = 1\n", key(name));
            let table: toml::Table = toml::from_str(&text).unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!(table.keys().next().map(String::as_str), Some(name), "{text}");
        }
    }

    #[test]
    fn numbers_are_short_and_exact() {
        let told = [0.0, 0.5, -250.0, 1.5e-3, f64::MIN_POSITIVE, -2e9].map(number);
        assert_eq!(told, ["0", "0.5", "-250", "0.0015", "2.2250738585072014e-308", "-2e9"]);
    }

    #[test]
    fn names_are_taken_apart_at_points_and_large_letters() {
        assert!(
            is_named("cylinder.pA", &["a"]) && is_named("xRef", &["ref"]) && is_named("F_load", &["load"])
        );
        assert!(!is_named("exponent", &["x", "pos"]) && !is_named("velocity", &["v"]));
    }

    /// Chambers by their names; a second force, which nothing tells from the load, is a person's to decide.
    #[test]
    fn what_is_not_sure_is_left_to_a_person() {
        let variable = |name: &str, reference: u32, causality: &str, unit: &str| {
            format!(
                "<Float64 name=\"{name}\" valueReference=\"{reference}\" causality=\"{causality}\" unit=\"{unit}\"/>"
            )
        };
        let variables = [
            variable("u", 1, "input", "1"),
            variable("push", 2, "input", "N"),
            variable("pull", 3, "input", "N"),
            variable("cyl.s", 4, "output", "m"),
            variable("cyl.pA", 5, "output", "bar"),
            variable("cyl.pB", 6, "output", "bar"),
            "<Float64 name=\"mass\" valueReference=\"7\" causality=\"parameter\" start=\"1\"/>".to_owned(),
            "<Float64 name=\"mass\" valueReference=\"8\" causality=\"parameter\" start=\"2\"/>".to_owned(),
        ];
        let text = format!(
            "<fmiModelDescription fmiVersion=\"3.0\" modelName=\"m\" instantiationToken=\"t\"><UnitDefinitions>\
             <Unit name=\"1\"><BaseUnit/></Unit><Unit name=\"m\"><BaseUnit m=\"1\"/></Unit>\
             <Unit name=\"N\"><BaseUnit kg=\"1\" m=\"1\" s=\"-2\"/></Unit>\
             <Unit name=\"bar\"><BaseUnit kg=\"1\" m=\"-1\" s=\"-2\" factor=\"1e5\"/></Unit></UnitDefinitions>\
             <CoSimulation modelIdentifier=\"m\"/><ModelVariables>{}</ModelVariables></fmiModelDescription>",
            variables.concat()
        );
        let description = ModelDescription::parse(&text).unwrap();
        let proposed = plant_file("m.fmu", &description);
        for line in [
            "command = \"u\"",
            "# load = one of \"push\", \"pull\"",
            "position = \"cyl.s\"",
            "p_cap = \"cyl.pA\"",
            "p_rod = \"cyl.pB\"",
            "# p_supply = one of \"cyl.pA\", \"cyl.pB\"",
        ] {
            assert!(proposed.lines().any(|other| other == line), "{line}\n{proposed}");
        }
        crate::SimulatorSpec::from_toml(&proposed).unwrap();
    }
}
