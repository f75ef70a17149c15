#![doc = include_str!("../README.md")]

pub mod machine_data;
pub mod signals;
