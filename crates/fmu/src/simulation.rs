//! A model that runs: values by reference, and what may be done when.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use seepd_model::ModelError as TrainedModelError;
use seepd_settings::FormatError;
use seepd_sim::SpecError;
use thiserror::Error;

use crate::axis::AxisEngine;
use crate::machine::Engine;
use crate::monitor::MonitorEngine;
use crate::press::PressEngine;
use crate::resources::{Resources, Subject};
use crate::variable::{Causality, Kind, Variability, Variable, Variables};

/// Why a model cannot be made, or cannot go on.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ModelError {
    /// A resource that cannot be read.
    #[error("{}: {error}", .file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// The resource that says which model it is.
    #[error("resources/fmu.toml: {0}")]
    Head(FormatError),
    /// The machine, as the file or the parameters have it.
    #[error(transparent)]
    Machine(#[from] SpecError),
    /// The trained model.
    #[error(transparent)]
    Trained(#[from] TrainedModelError),
    /// The trained model is too large for its reader.
    #[error("the model cannot be read by: {0}")]
    Reader(#[from] seepd_features::ReaderError),
    /// A reference that no variable of that type has.
    #[error("there is no {0:?} variable with the reference {1}")]
    Unknown(Kind, u32),
    /// A variable that may not be set, or not any more.
    #[error("`{name}` {why}")]
    Refused {
        /// The variable.
        name: String,
        /// Why.
        why: &'static str,
    },
    /// An order that is not for now.
    #[error("{0}")]
    Order(&'static str),
    /// A step that the model does not make.
    #[error("a step of {step_s} s: {why}")]
    Step {
        /// Its length, s.
        step_s: f64,
        /// Why.
        why: String,
    },
    /// The simulated machine has left all bounds.
    #[error("the simulation went out of bounds at {0:.3} s")]
    OutOfBounds(f64),
}

/// Where a model stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Instantiated,
    Initialising,
    Stepping,
}

/// A model with its values.
pub struct Simulation {
    variables: Arc<[Variable]>,
    values: Vec<f64>,
    engine: Box<dyn Engine>,
    phase: Phase,
    /// Whether outputs are those of the values as they are.
    settled: bool,
}

impl Simulation {
    /// The model of an unpacked FMU, by its folder of resources, and the token that it was made for.
    ///
    /// # Errors
    /// [`ModelError`].
    pub fn open(resources: &Path) -> Result<(Self, String), ModelError> {
        let resources = Resources::read(resources)?;
        Ok((Simulation::new(&resources)?, resources.token().to_owned()))
    }

    /// The model that resources tell.
    ///
    /// # Errors
    /// [`ModelError`].
    pub fn new(resources: &Resources) -> Result<Self, ModelError> {
        let mut variables = Variables::new();
        let engine: Box<dyn Engine> = match resources.subject {
            Subject::Press => Box::new(PressEngine::new(resources, &mut variables)?),
            Subject::ElectricAxis => Box::new(AxisEngine::new(resources, &mut variables)?),
            Subject::Monitor => Box::new(MonitorEngine::new(resources, &mut variables)?),
        };
        let variables: Arc<[Variable]> = variables.into_vec().into();
        let values = variables.iter().map(|variable| variable.start).collect();
        Ok(Simulation { variables, values, engine, phase: Phase::Instantiated, settled: false })
    }

    /// The variables by their references.
    pub fn variables(&self) -> &[Variable] {
        &self.variables
    }

    /// How long one step of the model is, s, and whether others must be whole multiples of it.
    pub fn step_s(&self) -> (f64, bool) {
        self.engine.step_s()
    }

    /// Length of a duty cycle, s.
    pub fn cycle_s(&self) -> f64 {
        self.engine.cycle_s()
    }

    /// Whether its state can be kept.
    pub fn is_copied(&self) -> bool {
        self.engine.copied().is_some()
    }

    fn place(&self, kind: Kind, reference: u32) -> Result<usize, ModelError> {
        let place = reference as usize;
        let found = self.variables.get(place).filter(|variable| variable.kind == kind);
        found.map(|_| place).ok_or(ModelError::Unknown(kind, reference))
    }

    /// A value; a truth is 0 or 1.
    ///
    /// # Errors
    /// [`ModelError::Unknown`]; in the initialisation, whatever is wrong with the parameters.
    pub fn get(&mut self, kind: Kind, reference: u32) -> Result<f64, ModelError> {
        let place = self.place(kind, reference)?;
        if self.phase == Phase::Initialising && self.variables[place].causality == Causality::Output {
            self.settle()?;
        }
        Ok(self.values[place])
    }

    /// Sets a value.
    ///
    /// # Errors
    /// [`ModelError::Unknown`], [`ModelError::Refused`].
    pub fn set(&mut self, kind: Kind, reference: u32, value: f64) -> Result<(), ModelError> {
        let place = self.place(kind, reference)?;
        let variable = &self.variables[place];
        let refused = |why| Err(ModelError::Refused { name: variable.name.clone(), why });
        let is_late = self.phase == Phase::Stepping && variable.variability == Variability::Fixed;
        match variable.causality {
            Causality::Independent | Causality::Output => return refused("cannot be set"),
            Causality::Parameter if is_late => return refused("is fixed: it is set before the first step"),
            Causality::Parameter | Causality::Input if !value.is_finite() => {
                return refused("was set to something that is no number");
            }
            Causality::Parameter | Causality::Input => {}
        }
        self.values[place] = value;
        self.settled = false;
        Ok(())
    }

    fn settle(&mut self) -> Result<(), ModelError> {
        if !self.settled {
            self.engine.initialise(&mut self.values)?;
            self.settled = true;
        }
        Ok(())
    }

    /// Begins the initialisation, at a time, s.
    ///
    /// # Errors
    /// [`ModelError::Order`].
    pub fn enter_initialisation(&mut self, start_s: f64) -> Result<(), ModelError> {
        if self.phase != Phase::Instantiated {
            return Err(ModelError::Order("the model is initialised already: reset it first"));
        }
        self.phase = Phase::Initialising;
        self.values[0] = start_s;
        Ok(())
    }

    /// Ends the initialisation: what the parameters make is checked here.
    ///
    /// # Errors
    /// [`ModelError`].
    pub fn exit_initialisation(&mut self) -> Result<(), ModelError> {
        if self.phase != Phase::Initialising {
            return Err(ModelError::Order("the initialisation has not begun"));
        }
        self.settle()?;
        self.phase = Phase::Stepping;
        Ok(())
    }

    /// Makes a step, s.
    ///
    /// # Errors
    /// [`ModelError`].
    pub fn step(&mut self, step_s: f64) -> Result<(), ModelError> {
        if self.phase != Phase::Stepping {
            return Err(ModelError::Order("the model is not initialised"));
        }
        if !(step_s.is_finite() && step_s > 0.0) {
            return Err(ModelError::Step { step_s, why: "it must be positive".into() });
        }
        self.engine.step(&mut self.values, step_s)?;
        self.values[0] += step_s;
        Ok(())
    }

    /// Back to where it was when it was made.
    ///
    /// # Errors
    /// [`ModelError`] where it cannot be made again.
    pub fn reset(&mut self) -> Result<(), ModelError> {
        self.engine.reset()?;
        for (value, variable) in self.values.iter_mut().zip(self.variables.iter()) {
            *value = variable.start;
        }
        (self.phase, self.settled) = (Phase::Instantiated, false);
        Ok(())
    }

    /// The same model in the same state; `None` where that cannot be kept.
    pub fn copied(&self) -> Option<Self> {
        Some(Simulation {
            variables: Arc::clone(&self.variables),
            values: self.values.clone(),
            engine: self.engine.copied()?,
            phase: self.phase,
            settled: self.settled,
        })
    }
}
