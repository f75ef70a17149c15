#![doc = include_str!("../README.md")]

pub mod alarm;
pub mod baseline;
pub mod cause;
pub mod energy;
pub mod event;
pub mod pipeline;
pub mod reason;
pub mod relative;
pub mod repair;

pub use alarm::{Alarm, AlarmConfig};
pub use baseline::{Baseline, BaselineError, BaselineFile};
pub use event::{Event, Flag};
pub use pipeline::{DutyCycle, Monitor, MonitorConfig, Pipeline};
