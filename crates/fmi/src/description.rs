//! `modelDescription.xml` of FMI 2.0 and 3.0, as far as a host that knows numbers needs it.
//!
//! It is read leniently, as tools write it: what is not known is passed over, and a bound of ±1e60 or the like is none.

use std::collections::BTreeMap;

use roxmltree::{Document, Node, ParsingOptions};
use thiserror::Error;

/// Why a description is none that can be used.
#[derive(Debug, Error)]
pub enum DescriptionError {
    /// Not XML, or with a document type, which could have entities.
    #[error("modelDescription.xml: {0}")]
    Xml(#[from] roxmltree::Error),
    /// Another root.
    #[error("modelDescription.xml begins with `{0}`, not with fmiModelDescription")]
    Root(String),
    /// Another version.
    #[error("the FMU is of FMI {0}; 2.0 and 3.0 are read")]
    Version(String),
    /// Model exchange or scheduled execution only.
    #[error("the FMU is not for co-simulation; export it as a co-simulation FMU with its solver inside")]
    NoCoSimulation,
    /// An identifier that would be a path.
    #[error("the FMU's modelIdentifier `{0}` is not a name of letters, digits and underscores")]
    Identifier(String),
    /// A variable without name or reference.
    #[error("modelDescription.xml: line {line}: a variable has no {attribute}")]
    Variable {
        /// Its line.
        line: u32,
        /// What it lacks.
        attribute: &'static str,
    },
}

/// FMI version.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Version {
    /// 2.0 and what tools call 2.0.x.
    Two,
    /// 3.0 and its minor versions.
    Three,
}

/// What a variable is to the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Causality {
    /// Set at every step.
    Input,
    /// Read after every step.
    Output,
    /// Set before initialisation.
    Parameter,
    /// Set in configuration mode (FMI 3).
    StructuralParameter,
    /// Everything else: local, calculated, independent.
    Other,
}

/// A unit in SI: a value in it times `factor` plus `offset` is the value in SI base units.
#[derive(Debug, Clone, PartialEq)]
pub struct Unit {
    /// Exponents of kg, m, s, A, K, mol, cd, rad.
    pub exponents: [i32; 8],
    /// Factor to SI.
    pub factor: f64,
    /// Offset in SI.
    pub offset: f64,
}

/// A variable with a floating-point value.
#[derive(Debug, Clone, PartialEq)]
pub struct Variable {
    /// Name.
    pub name: String,
    /// Reference by which it is set and read.
    pub reference: u32,
    /// What it is to the model.
    pub causality: Causality,
    /// Name of its unit; the declared type's where it has none of its own.
    pub unit: Option<String>,
    /// Start value, in its unit.
    pub start: Option<f64>,
    /// Least and largest value, in its unit, as far as there are any.
    pub bounds: (Option<f64>, Option<f64>),
    /// What the model's author says of it.
    pub description: String,
}

/// What an FMU says of itself.
#[derive(Debug, Clone)]
pub struct ModelDescription {
    /// FMI version.
    pub version: Version,
    /// The model's name.
    pub name: String,
    /// Name of the binary, a C identifier.
    pub identifier: String,
    /// Token that instantiation asks for.
    pub token: String,
    /// Step of the solver inside where that is fixed, s: communication steps are a whole multiple of it.
    pub fixed_step_s: Option<f64>,
    /// Whether it says that it needs the tool that made it.
    pub needs_tool: bool,
    /// Variables with floating-point values, in the order of the file.
    pub variables: Vec<Variable>,
    units: BTreeMap<String, Unit>,
}

/// Beyond it a bound is a tool's way to say that there is none.
const NO_BOUND: f64 = 1e60;

/// Nodes of a description at most, which take many times their text's memory: models of 300,000 variables have fewer.
const MOST_NODES: u32 = 2_000_000;

impl ModelDescription {
    /// Reads a description.
    ///
    /// # Errors
    /// [`DescriptionError`].
    pub fn parse(text: &str) -> Result<Self, DescriptionError> {
        let options = ParsingOptions { nodes_limit: MOST_NODES, ..ParsingOptions::default() };
        let document = Document::parse_with_options(text, options)?;
        let root = document.root_element();
        if root.tag_name().name() != "fmiModelDescription" {
            return Err(DescriptionError::Root(root.tag_name().name().to_owned()));
        }
        let stated = root.attribute("fmiVersion").unwrap_or("unknown version");
        let version = match stated.split('.').next() {
            Some("2") => Version::Two,
            Some("3") => Version::Three,
            _ => return Err(DescriptionError::Version(stated.to_owned())),
        };
        let simulation = child(root, "CoSimulation").ok_or(DescriptionError::NoCoSimulation)?;
        let identifier = simulation.attribute("modelIdentifier").unwrap_or_default();
        if !is_identifier(identifier) {
            return Err(DescriptionError::Identifier(identifier.to_owned()));
        }
        let token = match version {
            Version::Two => root.attribute("guid"),
            Version::Three => root.attribute("instantiationToken"),
        };
        Ok(ModelDescription {
            version,
            name: root.attribute("modelName").unwrap_or(identifier).to_owned(),
            identifier: identifier.to_owned(),
            token: token.unwrap_or_default().to_owned(),
            fixed_step_s: number(simulation, "fixedInternalStepSize").filter(|step_s| *step_s > 0.0),
            needs_tool: matches!(simulation.attribute("needsExecutionTool"), Some("true" | "1")),
            variables: variables(root)?,
            units: units(root),
        })
    }

    /// A variable's unit, where it has one whose relation to SI is stated.
    pub fn unit_of(&self, variable: &Variable) -> Option<&Unit> {
        self.units.get(variable.unit.as_deref()?)
    }

    /// The variable of that name.
    pub fn variable(&self, name: &str) -> Option<&Variable> {
        self.variables.iter().find(|variable| variable.name == name)
    }
}

fn is_identifier(text: &str) -> bool {
    let starts_well = text.starts_with(|first: char| first.is_ascii_alphabetic() || first == '_');
    starts_well && text.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
}

fn child<'a, 'input>(node: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    node.children().find(|child| child.has_tag_name(name))
}

fn number(node: Node<'_, '_>, attribute: &str) -> Option<f64> {
    node.attribute(attribute)?.trim().parse().ok().filter(|value: &f64| value.is_finite())
}

fn elements<'a, 'input>(root: Node<'a, 'input>, list: &str) -> impl Iterator<Item = Node<'a, 'input>> {
    child(root, list).into_iter().flat_map(|list| list.children()).filter(Node::is_element)
}

fn units(root: Node<'_, '_>) -> BTreeMap<String, Unit> {
    let of = |node: Node<'_, '_>| {
        let (name, base) = (node.attribute("name")?, child(node, "BaseUnit")?);
        let exponent = |root| base.attribute(root).and_then(|text| text.parse().ok()).unwrap_or(0);
        let unit = Unit {
            exponents: ["kg", "m", "s", "A", "K", "mol", "cd", "rad"].map(exponent),
            factor: number(base, "factor").unwrap_or(1.0),
            offset: number(base, "offset").unwrap_or(0.0),
        };
        Some((name.to_owned(), unit))
    };
    elements(root, "UnitDefinitions").filter_map(of).collect()
}

/// The declared types' nodes that hold unit and bounds, by name: in FMI 2 inside the type, in FMI 3 the type itself.
fn types<'a, 'input>(root: Node<'a, 'input>) -> BTreeMap<&'a str, Node<'a, 'input>> {
    let of = |node: Node<'a, 'input>| Some((node.attribute("name")?, child(node, "Real").unwrap_or(node)));
    elements(root, "TypeDefinitions").filter_map(of).collect()
}

fn variables(root: Node<'_, '_>) -> Result<Vec<Variable>, DescriptionError> {
    let types = types(root);
    let mut all = Vec::new();
    for node in elements(root, "ModelVariables") {
        // FMI 2 has the type inside, FMI 3 is the type.
        let typed = match node.tag_name().name() {
            "ScalarVariable" => child(node, "Real"),
            "Float64" => Some(node),
            _ => None,
        };
        let Some(typed) = typed else { continue };
        let lacks = |attribute| DescriptionError::Variable {
            line: root.document().text_pos_at(node.range().start).row,
            attribute,
        };
        let declared = typed.attribute("declaredType").and_then(|name| types.get(name)).copied();
        let bound = |attribute| {
            let stated = number(typed, attribute).or_else(|| number(declared?, attribute));
            stated.filter(|bound| bound.abs() < NO_BOUND)
        };
        let reference = node.attribute("valueReference").and_then(|text| text.parse().ok());
        let unit = typed.attribute("unit").or_else(|| declared?.attribute("unit"));
        all.push(Variable {
            name: node.attribute("name").ok_or_else(|| lacks("name"))?.to_owned(),
            reference: reference.ok_or_else(|| lacks("valueReference"))?,
            causality: causality(node.attribute("causality")),
            unit: unit.map(str::to_owned),
            start: number(typed, "start"),
            bounds: (bound("min"), bound("max")),
            description: node.attribute("description").unwrap_or_default().to_owned(),
        });
    }
    Ok(all)
}

fn causality(stated: Option<&str>) -> Causality {
    match stated {
        Some("input") => Causality::Input,
        Some("output") => Causality::Output,
        Some("parameter") => Causality::Parameter,
        Some("structuralParameter") => Causality::StructuralParameter,
        _ => Causality::Other,
    }
}
