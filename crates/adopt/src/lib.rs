#![doc = include_str!("../README.md")]

pub mod controller;
pub mod duty_cycle;
pub mod machine_data;
pub mod plant;
pub mod recording;
pub mod signals;
pub mod strokes;
