//! What a diagnosis found, for the tool that has the model: values as a parameter set of SSP 1.0 (`.ssv`), which importers of FMUs read,
//! and, for effects at the model's ports, which no value inside of it brings about, what to add there, in words.

use seepd_gap::simulated_axis::EffectValues;
use seepd_sim::effects::{self, EffectInfo};
use seepd_sim::electric;
use seepd_sim::ports::{Port, port_of};
use seepd_sim::{MachineSpec, PlantParameters};

use crate::demand;
use crate::spec::SimulatorSpec;

/// Values by the model's names for them, and what stands beside the model.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ParameterSet {
    values: Vec<(String, f64)>,
    /// A sentence each.
    pub additions: Vec<String>,
}

impl ParameterSet {
    /// Of a simulator of the user's, as diagnosed.
    pub fn of_simulator(spec: &SimulatorSpec) -> Self {
        let mut values: Vec<(String, f64)> =
            spec.parameters.iter().map(|(name, parameter)| (name.clone(), parameter.start)).collect();
        let mut additions = Vec::new();
        for (key, given) in &spec.with {
            if let Some(own) = spec.effects.get(key) {
                values.extend(given.values().next().map(|value| (own.parameter.clone(), *value)));
            } else if let Some(inside) = spec.inside.get(key) {
                let named = |(name, value): (&String, &f64)| Some((inside.get(name)?.clone(), *value));
                values.extend(given.iter().filter_map(named));
            } else if let Some(info) = effects::find(key).map(|effect| effect.info()).or(demand::find(key)) {
                additions.push(addition(spec, info, given));
            }
        }
        ParameterSet { values, additions }
    }

    /// Of the press, by the names that its FMU has.
    pub fn of_press(spec: &MachineSpec) -> Self {
        let plant = PlantParameters::ALL
            .iter()
            .filter_map(|info| Some((format!("plant.{}", info.key), spec.plant.get(info.key)?)));
        ParameterSet { values: plant.chain(of_effects(&spec.effects)).collect(), additions: Vec::new() }
    }

    /// Of the electric axis, by the names that its FMU has.
    pub fn of_electric_axis(axis: &electric::ElectricAxis) -> Self {
        let plant = &axis.plant;
        let plant = [
            ("mass_kg", plant.mass_kg),
            ("viscous_friction_n_s_per_m", plant.viscous_friction_n_s_per_m),
            ("full_force_n", plant.full_force_n),
            ("stroke_m", plant.stroke_m),
        ];
        let plant = plant.into_iter().map(|(key, value)| (format!("plant.{key}"), value));
        ParameterSet { values: plant.chain(of_effects(&axis.effects)).collect(), additions: Vec::new() }
    }

    /// The parameter set's file. What is to be added to the model stands in it as comments.
    pub fn to_ssv(&self, name: &str) -> String {
        let mut text = format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
             <ssv:ParameterSet xmlns:ssv=\"http://ssp-standard.org/SSP1/SystemStructureParameterValues\" version=\"1.0\" name=\"{}\" \
             generationTool=\"seepd {}\">\n",
            escaped(name),
            env!("CARGO_PKG_VERSION")
        );
        for addition in &self.additions {
            // Two hyphens would end a comment.
            text += &format!("  <!-- {} -->\n", addition.replace("--", "- -"));
        }
        text += "  <ssv:Parameters>\n";
        for (name, value) in &self.values {
            text += &format!(
                "    <ssv:Parameter name=\"{}\"><ssv:Real value=\"{value:?}\"/></ssv:Parameter>\n",
                escaped(name)
            );
        }
        text + "  </ssv:Parameters>\n</ssv:ParameterSet>\n"
    }
}

fn of_effects(effects: &EffectValues) -> impl Iterator<Item = (String, f64)> {
    effects.iter().flat_map(|(key, values)| {
        values.iter().map(move |(name, value)| (format!("effects.{key}.{name}"), *value))
    })
}

/// What to put where, in a sentence.
fn addition(
    spec: &SimulatorSpec,
    info: &EffectInfo,
    given: &std::collections::BTreeMap<String, f64>,
) -> String {
    let variable = |name: &str| {
        let fmu = spec.fmu.as_ref();
        let variable = fmu.and_then(|fmu| fmu.inputs.get(name).or_else(|| fmu.outputs.get(name)));
        variable.map_or(format!("`{name}`"), |variable| format!("`{}`", variable.name()))
    };
    let place = match port_of(info.key) {
        Some(Port::Command) => format!("between controller and {}", variable("command")),
        Some(Port::Controller) => "in the controller".to_owned(),
        Some(Port::Position) if spec.controller.is_some() => {
            format!("between {} and the controller", variable("position"))
        }
        Some(Port::Position) => {
            format!(
                "at {}, and what it adds to the position taken off {}",
                variable("position"),
                variable("demand")
            )
        }
        Some(Port::Load) => format!("on {}", variable("load")),
        None => format!("before {}", variable("demand")),
    };
    let values: Vec<String> = given.iter().map(|(name, value)| format!("{name} = {value:?}")).collect();
    format!("to add to the model {place}: {} ({}), with {}", info.law, info.key, values.join(", "))
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_parameters_and_laws_at_ports_are_words() {
        let text = r#"
kind = "simulator"
stroke_m = 0.5
[fmu]
file = "x.fmu"
inputs = { command = "u<1>", load = "F" }
outputs = { position = "x" }
[parameters]
"valve.gain" = { start = 0.61 }
[effects.guide_friction]
parameter = "friction"
neutral = 0.0
range = [0.0, 100.0]
[inside.valve_bias]
offset = "valve.null"
[with]
guide_friction = { friction = 20.5 }
valve_bias = { offset = -0.01 }
valve_deadband = { half_width = 0.04 }
[controller]
[cycle]
"#;
        let set = ParameterSet::of_simulator(&SimulatorSpec::from_toml(text).unwrap());
        let named = |name: &str, value: f64| (name.to_owned(), value);
        assert_eq!(
            set.values,
            [named("valve.gain", 0.61), named("friction", 20.5), named("valve.null", -0.01)]
        );
        assert_eq!(
            set.additions,
            [
                "to add to the model between controller and `u<1>`: spool = o(u) − o(−u), o(u) = ½ (b + √(b² + rounding²)) the opening \
                 of a land, b = u − half_width; where edges are sharp: sign(u) · max(|u| − half_width, 0) (valve_deadband), with \
                 half_width = 0.04"
            ]
        );
        let ssv = set.to_ssv("press & <3>");
        assert!(
            ssv.contains("name=\"press &amp; &lt;3&gt;\"") && ssv.contains("<!-- to add to the model"),
            "{ssv}"
        );
        assert!(
            ssv.contains("<ssv:Parameter name=\"valve.null\"><ssv:Real value=\"-0.01\"/></ssv:Parameter>")
        );
    }
}
