//! Which variables of an FMU the names of a plant file are: looked up in the model's description before anything of it runs.

use seepd_fmi::{Causality, ModelDescription, Variable};
use seepd_settings::UnknownKey;
use seepd_signals::Signal;
use thiserror::Error;

use crate::spec::{FmuVariable, SimulatorSpec, VELOCITY};

/// Exponents of kg, m, s, A, K, mol, cd and rad, by which kinds of quantity are told apart.
pub(crate) type Dimension = [i32; 8];

const LENGTH: Dimension = [0, 1, 0, 0, 0, 0, 0, 0];
const SPEED: Dimension = [0, 1, -1, 0, 0, 0, 0, 0];
const FORCE: Dimension = [1, 1, -2, 0, 0, 0, 0, 0];
pub(crate) const PRESSURE: Dimension = [1, -1, -2, 0, 0, 0, 0, 0];
const SHARE: Dimension = [0; 8];
const TIME: Dimension = [0, 0, 1, 0, 0, 0, 0, 0];

/// Why a plant file does not fit an FMU.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum MappingError {
    /// A plant file of another simulator.
    #[error("the plant file has no [fmu]")]
    NoFmu,
    /// A variable that the model does not have.
    #[error("{key}: {unknown}")]
    Unknown {
        /// Key in the plant file.
        key: String,
        /// The name, with those that there are.
        #[source]
        unknown: UnknownKey,
    },
    /// A variable of another kind of quantity.
    #[error(
        "{key}: `{variable}` is in {unit}, and {key} is asked in {expected}; where that is meant, say what one of its SI units is: \
         {{ variable = \"{variable}\", scale = … }}"
    )]
    Unit {
        /// Key in the plant file.
        key: String,
        /// The model's variable.
        variable: String,
        /// The unit that the model states for it.
        unit: String,
        /// Ours.
        expected: &'static str,
    },
}

/// A variable and the factor from its own unit to ours.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Mapped {
    pub(crate) reference: u32,
    factor: f64,
    offset: f64,
}

impl Mapped {
    pub(crate) fn ours(&self, value: f64) -> f64 {
        self.factor * value + self.offset
    }

    pub(crate) fn its(&self, value: f64) -> f64 {
        (value - self.offset) / self.factor
    }
}

/// All that a plant file names of an FMU.
#[derive(Debug)]
pub(crate) struct FmuMapping {
    /// What drives it: its command or its demand.
    pub(crate) reference: Mapped,
    pub(crate) load: Option<Mapped>,
    /// Signals, and the velocity, which is none.
    pub(crate) outputs: Vec<(Option<Signal>, Mapped)>,
    pub(crate) start_position: Option<Mapped>,
    pub(crate) start_time: Option<Mapped>,
    /// Start values of further variables.
    pub(crate) set: Vec<(u32, f64)>,
}

impl FmuMapping {
    /// Looks every name up.
    ///
    /// # Errors
    /// [`MappingError`] for the first that the model does not have, or has as another kind of quantity.
    pub(crate) fn new(spec: &SimulatorSpec, description: &ModelDescription) -> Result<Self, MappingError> {
        let fmu = spec.fmu.as_ref().ok_or(MappingError::NoFmu)?;
        let input = |name: &str| {
            let variable = fmu.inputs.get(name);
            variable
                .map(|of| mapped(description, &format!("fmu.inputs.{name}"), name, of, Causality::Input))
                .transpose()
        };
        let start = |name: &str, variable: &Option<String>| {
            let variable = variable.clone().map(FmuVariable::Name);
            let key = format!("fmu.{name}");
            variable.map(|of| mapped(description, &key, name, &of, Causality::Parameter)).transpose()
        };
        let mut outputs = Vec::new();
        for (name, of) in &fmu.outputs {
            let found = mapped(description, &format!("fmu.outputs.{name}"), name, of, Causality::Output)?;
            outputs.push((Signal::from_name(name), found));
        }
        let set = fmu.set.iter().map(|(name, value)| {
            Ok((named(description, "fmu.set", name, Causality::Parameter)?.reference, *value))
        });
        let mapping = FmuMapping {
            // A checked file has one.
            reference: input(spec.reference())?.unwrap_or(Mapped { reference: 0, factor: 1.0, offset: 0.0 }),
            load: input("load")?,
            outputs,
            start_position: start("start_position", &fmu.start_position)?,
            start_time: start("start_time", &fmu.start_time)?,
            set: set.collect::<Result<_, MappingError>>()?,
        };
        for (key, name, _) in ranges(spec) {
            named(description, &key, name, Causality::Parameter)?;
        }
        for (effect, variables) in &spec.inside {
            for (parameter, name) in variables {
                named(description, &format!("inside.{effect}.{parameter}"), name, Causality::Parameter)?;
            }
        }
        Ok(mapping)
    }
}

/// Parameters that calibration and effects of the simulator's own may change: key in the file, the model's name, least and largest value.
fn ranges(spec: &SimulatorSpec) -> impl Iterator<Item = (String, &str, (f64, f64))> {
    let calibrated = spec
        .parameters
        .iter()
        .map(|(name, parameter)| ("parameters".to_owned(), name.as_str(), parameter.bounds()));
    let effects = spec.effects.iter().map(|(name, effect)| {
        (format!("effects.{name}.parameter"), effect.parameter.as_str(), (effect.range[0], effect.range[1]))
    });
    calibrated.chain(effects)
}

/// What a file may ask of the model, and whoever wrote it should know.
pub(crate) fn remarks(spec: &SimulatorSpec, description: &ModelDescription) -> Vec<String> {
    let beyond = |(key, name, (low, high)): (String, &str, (f64, f64))| {
        let (least, most) = description.variable(name)?.bounds;
        let (least, most) = (least.unwrap_or(f64::NEG_INFINITY), most.unwrap_or(f64::INFINITY));
        (low < least || high > most).then(|| {
            format!(
                "{key}: `{name}` may become {low} … {high}, and the model bounds it to {least} … {most}: runs beyond may fail"
            )
        })
    };
    let mut remarks: Vec<String> = ranges(spec).filter_map(beyond).collect();
    if let Some(step_s) = description.fixed_step_s {
        let steps = spec.tick_s() / step_s;
        if (steps - steps.round()).abs() > 1e-6 || steps < 0.5 {
            remarks.push(format!(
                "a tick of {} s is no whole multiple of the {step_s} s by which the model's solver steps: it may refuse",
                spec.tick_s()
            ));
        }
    }
    if description.needs_tool {
        remarks.push("the model says that it needs the tool that made it".into());
    }
    remarks
}

/// The kind of quantity that one of our names is, and its unit.
pub(crate) fn quantity(name: &str) -> (Dimension, &'static str) {
    match name {
        VELOCITY => (SPEED, "m/s"),
        "start_position" => (LENGTH, "m"),
        "start_time" => (TIME, "s"),
        _ => match Signal::from_name(name).map_or("1", Signal::unit) {
            "m" => (LENGTH, "m"),
            "N" => (FORCE, "N"),
            "Pa" => (PRESSURE, "Pa"),
            _ => (SHARE, "shares of one"),
        },
    }
}

fn mapped(
    description: &ModelDescription,
    key: &str,
    ours: &str,
    variable: &FmuVariable,
    causality: Causality,
) -> Result<Mapped, MappingError> {
    let found = named(description, key, variable.name(), causality)?;
    let (unit, (expected, expected_unit)) = (description.unit_of(found), quantity(ours));
    // Whoever gives a scale has said how a valve's current is a share, or an angle a stroke.
    let is_converted = matches!(variable, FmuVariable::Scaled { .. });
    if !is_converted && unit.is_some_and(|unit| unit.exponents != expected) {
        return Err(MappingError::Unit {
            key: key.to_owned(),
            variable: found.name.clone(),
            unit: found.unit.clone().unwrap_or_default(),
            expected: expected_unit,
        });
    }
    let scale = variable.scale();
    Ok(Mapped {
        reference: found.reference,
        factor: scale * unit.map_or(1.0, |unit| unit.factor),
        offset: scale * unit.map_or(0.0, |unit| unit.offset),
    })
}

/// A variable by its name, or the nearest names of its kind.
pub(crate) fn named<'d>(
    description: &'d ModelDescription,
    key: &str,
    name: &str,
    causality: Causality,
) -> Result<&'d Variable, MappingError> {
    let of_kind = |variable: &&Variable| match causality {
        // What is no input may be set before the start, and read.
        Causality::Parameter => variable.causality != Causality::Input,
        Causality::Output => true,
        other => variable.causality == other,
    };
    let found = description.variable(name).filter(of_kind);
    found.ok_or_else(|| {
        let known: Vec<&str> =
            description.variables.iter().filter(of_kind).map(|variable| variable.name.as_str()).collect();
        MappingError::Unknown { key: key.to_owned(), unknown: UnknownKey::new(name, &known) }
    })
}
