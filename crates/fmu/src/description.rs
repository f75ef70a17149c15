//! `modelDescription.xml`, as FMI 2.0 and 3.0 each want it.

use std::fmt::Write;

use seepd_fmi::Version;

use crate::resources::{Placement, Resources, Subject};
use crate::simulation::Simulation;
use crate::units::exponents;
use crate::variable::{Causality, Kind, Variable};

/// The description of a model.
pub(crate) fn description(simulation: &Simulation, resources: &Resources, version: Version) -> String {
    let mut text = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    head(&mut text, simulation, resources, version);
    units(&mut text, simulation.variables());
    let (step_s, _) = simulation.step_s();
    let stop_s = simulation.cycle_s();
    text += &format!(
        "  <DefaultExperiment startTime=\"0\" stopTime=\"{stop_s}\" stepSize=\"{step_s:?}\"/>\n  <ModelVariables>\n"
    );
    for (reference, variable) in simulation.variables().iter().enumerate() {
        text += &match version {
            Version::Two => variable_of_two(reference, variable),
            Version::Three => variable_of_three(reference, variable),
        };
    }
    text += "  </ModelVariables>\n";
    structure(&mut text, simulation.variables(), version);
    text + "</fmiModelDescription>\n"
}

/// Name and purpose of a model.
fn about(resources: &Resources) -> (String, &'static str) {
    let (name, what) = match resources.subject {
        Subject::Press => {
            ("seepd press", "Hydraulic press axis: pump, relief valve, line, 4/3 valve, cylinder")
        }
        Subject::ElectricAxis => ("seepd electric axis", "Electric positioning axis: drive, mass on a guide"),
        Subject::Monitor => {
            return ("seepd leak monitor".into(), "Sizes the leak past a piston seal from the valve command");
        }
    };
    let with = if resources.placement == Placement::Inside { " with controller" } else { "" };
    (format!("{name}{with}"), what)
}

fn head(text: &mut String, simulation: &Simulation, resources: &Resources, version: Version) {
    let (name, what) = about(resources);
    let tool = concat!("seepd ", env!("CARGO_PKG_VERSION"));
    let (number, token) = match version {
        Version::Two => ("2.0", "guid"),
        Version::Three => ("3.0", "instantiationToken"),
    };
    *text += &format!(
        "<fmiModelDescription fmiVersion=\"{number}\" modelName=\"{}\" {token}=\"{}\" description=\"{}\" version=\"{}\" \
         generationTool=\"{tool}\" license=\"MIT OR Apache-2.0\" variableNamingConvention=\"structured\"{}>\n",
        escaped(&name),
        escaped(resources.token()),
        escaped(what),
        env!("CARGO_PKG_VERSION"),
        if version == Version::Two { " numberOfEventIndicators=\"0\"" } else { "" }
    );
    let (step_s, is_fixed) = simulation.step_s();
    let (identifier, is_copied) = (resources.subject.identifier(), simulation.is_copied());
    *text += &match version {
        Version::Two => format!(
            "  <CoSimulation modelIdentifier=\"{identifier}\" canHandleVariableCommunicationStepSize=\"{}\" \
             canGetAndSetFMUstate=\"{is_copied}\" canNotUseMemoryManagementFunctions=\"true\"/>\n",
            !is_fixed
        ),
        Version::Three => format!(
            "  <CoSimulation modelIdentifier=\"{identifier}\" canHandleVariableCommunicationStepSize=\"{}\" \
             canGetAndSetFMUState=\"{is_copied}\"{}/>\n",
            !is_fixed,
            if is_fixed { format!(" fixedInternalStepSize=\"{step_s:?}\"") } else { String::new() }
        ),
    };
}

fn units(text: &mut String, variables: &[Variable]) {
    let mut names: Vec<&str> = variables.iter().map(|variable| variable.unit).collect();
    names.sort_unstable();
    names.dedup();
    *text += "  <UnitDefinitions>\n";
    for name in names {
        let base = exponents(name).map(|exponents| {
            let mut base = String::from("<BaseUnit");
            for (unit, exponent) in ["kg", "m", "s"].into_iter().zip(exponents).filter(|(_, e)| *e != 0) {
                // Writing to a text does not fail.
                let _ = write!(base, " {unit}=\"{exponent}\"");
            }
            base + "/>"
        });
        *text += &format!("    <Unit name=\"{}\">{}</Unit>\n", escaped(name), base.unwrap_or_default());
    }
    *text += "  </UnitDefinitions>\n";
}

/// What both versions say alike.
fn common(reference: usize, variable: &Variable) -> String {
    format!(
        "name=\"{}\" valueReference=\"{reference}\" causality=\"{}\" variability=\"{}\"{} description=\"{}\"",
        escaped(&variable.name),
        variable.causality.name(),
        variable.variability.name(),
        match variable.causality {
            Causality::Output => " initial=\"calculated\"",
            Causality::Parameter => " initial=\"exact\"",
            Causality::Input | Causality::Independent => "",
        },
        escaped(&variable.description)
    )
}

/// Unit, bounds and start of a number; start of a truth.
fn typed(variable: &Variable) -> String {
    let has_start = matches!(variable.causality, Causality::Input | Causality::Parameter);
    if variable.kind == Kind::Boolean {
        return String::new();
    }
    let mut text = format!(" unit=\"{}\"", escaped(variable.unit));
    for (name, bound) in [("min", variable.bounds.0), ("max", variable.bounds.1)] {
        if let Some(bound) = bound {
            text += &format!(" {name}=\"{bound:?}\"");
        }
    }
    if has_start {
        text += &format!(" start=\"{:?}\"", variable.start);
    }
    text
}

fn variable_of_two(reference: usize, variable: &Variable) -> String {
    let kind = match variable.kind {
        Kind::Real => "Real",
        Kind::Boolean => "Boolean",
    };
    let (common, typed) = (common(reference, variable), typed(variable));
    format!("    <ScalarVariable {common}><{kind}{typed}/></ScalarVariable>\n")
}

fn variable_of_three(reference: usize, variable: &Variable) -> String {
    let kind = match variable.kind {
        Kind::Real => "Float64",
        Kind::Boolean => "Boolean",
    };
    format!("    <{kind} {}{}/>\n", common(reference, variable), typed(variable))
}

/// Which outputs there are; each may depend on all inputs.
fn structure(text: &mut String, variables: &[Variable], version: Version) {
    let outputs = || {
        let all = variables.iter().enumerate();
        all.filter(|(_, variable)| variable.causality == Causality::Output).map(|(place, _)| place)
    };
    *text += "  <ModelStructure>\n";
    match version {
        Version::Two => {
            for list in ["Outputs", "InitialUnknowns"] {
                // Places count from 1 here.
                let unknowns: String =
                    outputs().map(|place| format!("<Unknown index=\"{}\"/>", place + 1)).collect();
                *text += &format!("    <{list}>{unknowns}</{list}>\n");
            }
        }
        Version::Three => {
            for element in ["Output", "InitialUnknown"] {
                for place in outputs() {
                    *text += &format!("    <{element} valueReference=\"{place}\"/>\n");
                }
            }
        }
    }
    *text += "  </ModelStructure>\n";
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
