#![doc = include_str!("../README.md")]

pub mod adoption;
pub mod controller;
pub mod drive;
pub mod duty_cycle;
mod flow_curve;
pub mod machine_data;
pub mod open_loop;
mod overlap;
pub mod plant;
pub mod process_force;
pub mod recording;
pub mod signals;
pub mod strokes;
#[cfg(test)]
mod test_recordings;
pub mod training;
