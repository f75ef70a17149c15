//! Whole machines that are not the article's: other sizes, valves, supplies, controllers and duty cycles, with their papers and their logs.
//!
//! For the blind check of `seepd adopt`. The equations are written apart from the simulator's, with round edges for the lands, all four
//! of them at once, an integrator of its own, and nothing that is logged but what a machine's log would have.

mod case;
mod controller;
mod data_sheet;
mod decency;
mod draw;
mod duty;
mod hydraulics;
mod integrator;
mod log_file;
mod machine;
mod run;
pub mod score;

pub use case::{Case, HEALTHY, Later, LogTruth, Truth, draw};
pub use controller::Controller;
pub use data_sheet::{ControllerSheet, CylinderSheet, DataSheet, OilSheet, SupplySheet, ValveSheet};
pub use duty::{Beginning, Duty, Move, Profile, Rapid};
pub use log_file::{Container, LogFormat, LoggedSignals, Style};
pub use machine::{
    Accumulator, Contact, Cylinder, FlowCurve, Leak, Machine, Oil, Pump, REFERENCE_PA, Supply, Valve,
};
