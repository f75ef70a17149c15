#![doc = include_str!("../README.md")]

pub mod axis;
pub mod child;
pub mod demand;
pub mod exported;
pub mod fmu;
pub mod mapping;
pub mod parameter_set;
pub mod proposal;
pub mod simulators;
pub mod spec;

pub use axis::SimulatorAxis;
pub use parameter_set::ParameterSet;
pub use simulators::{Budget, RunCounts, RunError, Simulators};
pub use spec::{SimulatorError, SimulatorSpec};
