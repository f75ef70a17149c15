#![doc = include_str!("../README.md")]
#![no_std]

pub mod feature;
mod intake;
mod kalman;
mod load;
mod moments;
mod noise;
pub mod reader;
pub mod segment;
pub mod statistics;
mod stored;

pub use feature::Feature;
pub use intake::Counts;
pub use kalman::{Kalman, KalmanState};
pub use load::{LoadSummary, PistonAreas};
pub use moments::MomentSummary;
pub use reader::{CycleReader, CycleState, Outcome, ReaderError, Reason, RejectedCycle, ValidCycle};
pub use segment::{Anchor, Anchors, CycleDefinition, DemandMark, Phase, PhaseKind, Projection, Projections};
