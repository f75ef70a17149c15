//! From a valve command to the features of each duty cycle: intake checks, Kalman filter, cycle
//! segmentation, features.
//!
//! `no_std`, no allocation, no panic on any input, finite or not. Configuration is borrowed ([`CycleReader`]),
//! state is a value ([`CycleState`]): the same two types run over a log, on a live bus and on a
//! microcontroller, and give the same bits.
//!
//! The way of a sample: [`intake`] (order, gaps, range) → [`kalman`] → ring buffer of one cycle →
//! [`segment`] (where cycles are) → [`feature`] (what they look like).
#![no_std]

pub mod feature;
pub mod intake;
pub mod kalman;
pub mod load;
pub mod moments;
mod noise;
pub mod reader;
pub mod segment;
pub mod statistics;

pub use feature::Feature;
pub use intake::Counts;
pub use kalman::{Kalman, KalmanState};
pub use load::{LoadSummary, PistonAreas};
pub use moments::Moments;
pub use reader::{CycleReader, CycleState, Outcome, ReaderError, Reason, RejectedCycle, ValidCycle};
pub use segment::{Anchor, CycleDefinition, DemandMark, Phase, PhaseKind, Projection, Projections};
