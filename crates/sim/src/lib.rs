#![doc = include_str!("../README.md")]

pub mod batch;
pub mod controller;
pub mod cycle;
pub mod effects;
pub mod electric;
mod elementary;
mod integration;
pub mod learned;
pub mod machine;
pub mod noise;
pub mod oil;
pub mod opening;
pub mod plant;
pub mod ports;
pub mod real;
mod sensor;
pub mod series;
mod simd;
pub mod size;
pub mod spec;

pub use controller::{Controller, ControllerKind};
pub use cycle::{DutyCycle, Schedule};
pub use integration::Steps;
pub use machine::{Input, Machine, MachineState, SimulatedSignals};
pub use plant::{Plant, PlantParameters, State};
pub use real::{Lanes, Real};
pub use sensor::SensorError;
pub use size::Size;
pub use spec::{MachineSpec, SpecError};
