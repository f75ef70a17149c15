#![doc = include_str!("../README.md")]

pub mod diagnosis;
pub mod electric;
pub mod fit;
pub mod places;
pub mod press;
pub mod rank;
pub mod record;
pub mod report;
pub mod screen;
pub mod search;
pub mod shrink;
pub mod simulate;
pub mod simulated_axis;

pub use diagnosis::{DiagnosisSettings, cannot_tell, diagnose, nominal_gap};
pub use record::{Log, Mismatch, Record, RecordError, Shortage};
pub use report::Diagnosis;
pub use simulated_axis::SimulatedAxis;
