//! `seepd`: the command line, sources, the pipeline, sinks.
//!
//! Data flow one way: a [`source`] yields samples, the [`pipeline`] turns them into events, [`sink`]s turn events
//! into text and files. Files and the terminal are known here and nowhere else.

pub mod alarm;
pub mod baseline;
pub mod can;
pub mod cli;
pub mod commands;
pub mod config;
pub mod energy;
pub mod evaluation;
pub mod event;
pub mod failure;
pub mod html;
#[cfg(feature = "live")]
pub mod live;
pub mod output;
pub mod pipeline;
mod progress;
mod side_file;
pub mod sink;
pub mod source;

pub use cli::main;
pub use failure::Failure;

/// The model that the program brings: trained on the default plant by `seepd train`.
pub const EMBEDDED_MODEL: &[u8] = include_bytes!("../assets/model.json");
