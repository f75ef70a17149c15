#![doc = include_str!("../README.md")]

pub mod axis;
pub mod child;
mod confinement;
pub mod demand;
pub mod exported;
pub mod fmu;
pub mod mapping;
pub mod parameter_set;
mod process_group;
pub mod proposal;
pub mod simulators;
pub mod spec;

pub use axis::SimulatorAxis;
pub use parameter_set::ParameterSet;
pub use simulators::{Budget, RunCounts, RunError, Simulators};
pub use spec::{SimulatorError, SimulatorSpec};
