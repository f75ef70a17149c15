#![doc = include_str!("../README.md")]
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
