#![doc = include_str!("../README.md")]

pub mod calibration;
pub mod calibration_problem;
pub mod course;
pub mod diagnosable;
pub mod diagnosis;
mod electric;
mod fit;
mod learn;
pub mod next_test;
mod places;
pub mod posterior;
pub mod prediction;
mod press;
mod proposals;
mod quantisation;
mod rank;
pub mod record;
pub mod report;
mod resemblance;
mod runs;
mod screen;
mod search;
mod shrink;
mod simulate;
pub mod simulated_axis;
pub mod transducers;

pub use calibration::{Calibration, CalibrationSettings, Known, calibrate};
pub use calibration_problem::{CalibrationProblem, FreeParameter, NoSuchParameter, ParameterValues};
pub use diagnosable::Diagnosable;
pub use diagnosis::{DiagnosisSettings, cannot_tell, diagnose, nominal_gap};
pub use posterior::Posterior;
pub use record::{Log, Mismatch, Record, RecordError, Shortage};
pub use report::Diagnosis;
pub use runs::Run;
pub use simulate::{BinnedSignals, Drive};
pub use simulated_axis::SimulatedAxis;
