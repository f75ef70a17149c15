//! Where a simulator and a machine part, which effect that the simulator lacks causes it, and how far the gap shrinks once that
//! effect is added.
//!
//! The way: [`record`] aligns a log with the duty cycle and cuts it into cycles; [`simulate`] runs machines along the recorded
//! drive and bins what they show; [`fit`] calibrates the plant's own parameters and fits effects; [`screen`] picks the effects that are
//! worth fitting; [`rank`] weighs effects, "no effect" and "none of these"; [`places`] tells where the gap is; [`diagnosis`] puts it together.

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
