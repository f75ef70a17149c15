//! The program's commands on whole logs, as a user runs them.
//!
//! One binary for all of them: each of its own would link the whole program once more, and two cores would wait for the slowest test of
//! each.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

mod adopt;
mod advice;
mod bad_input;
mod bare_metal;
mod baseline;
mod can;
mod causes;
mod commands;
mod conditions;
mod documents;
mod encodings;
mod evaluate;
mod export_fmu;
mod gap;
mod gap_cylinder;
mod gap_fmu;
mod gap_learned;
mod gap_next_test;
mod gap_simulator;
mod log_formats;
mod models;
mod pages;
mod parquet;
mod quality;
mod reports;
mod support;
mod transcripts;
mod trust;
