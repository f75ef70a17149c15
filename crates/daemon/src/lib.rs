//! `seepd`: the command line, the daemon, sinks and pages.
//!
//! Data flow one way: a log or a bus yields samples, the monitor turns them into events, [`sink`]s turn events into text and files.
//! Files that are written, the terminal, sockets and clocks are known here and nowhere else.

pub mod advice;
mod baseline_file;
pub mod cli;
#[cfg(feature = "live")]
pub mod clock;
pub mod commands;
pub mod config;
#[cfg(feature = "live")]
mod durable;
pub mod evaluation;
pub mod failure;
#[cfg(all(fuzzing, feature = "live"))]
mod fuzzing;
pub mod html;
#[cfg(feature = "live")]
pub mod hub;
#[cfg(feature = "live")]
pub mod journal;
#[cfg(feature = "live")]
pub mod live;
pub mod output;
#[cfg(feature = "live")]
mod private_folder;
pub mod progress;
mod quantity;
pub mod reasons;
pub mod repair_log;
pub mod sink;
pub mod verdict;

pub use cli::main;
pub use failure::Failure;

/// The model that the program brings: trained on the default plant by `seepd train`.
pub const EMBEDDED_MODEL: &[u8] = include_bytes!("../assets/model.json");
