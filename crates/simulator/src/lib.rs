#![doc = include_str!("../README.md")]

pub mod axis;
pub mod child;
pub mod demand;
pub mod fmu;
pub mod proposal;
pub mod simulators;
pub mod spec;

pub use axis::SimulatorAxis;
pub use simulators::{Budget, RunCounts, RunError, Simulators};
pub use spec::{SimulatorError, SimulatorSpec};
