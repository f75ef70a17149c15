#![doc = include_str!("../README.md")]

pub mod archive;
pub mod description;
pub mod instance;

pub use archive::{Fmu, FmuError};
pub use description::{Causality, DescriptionError, ModelDescription, Unit, Variable, Version};
pub use instance::{Instance, InstanceError};
