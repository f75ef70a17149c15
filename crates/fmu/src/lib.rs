#![doc = include_str!("../README.md")]

mod archive;
mod axis;
mod description;
mod machine;
mod monitor;
mod press;
mod resources;
mod simulation;
mod units;
mod variable;

pub use archive::{LibraryError, Package, Platform};
pub use monitor::ALARM_OUTPUTS;
pub use resources::{Placement, Resources, Subject};
pub use simulation::{ModelError, Simulation};
pub use units::exponents;
pub use variable::{Causality, Kind, Variability, Variable};
