//! `seepd demo`.
use clap::Args;
use crate::cli::Outcome;
use crate::failure::Failure;
/// Demo.
#[derive(Debug, Args)]
pub struct DemoArguments {}
/// Runs the command.
///
/// # Errors
/// [`Failure`].
pub fn run(_arguments: &DemoArguments) -> Result<Outcome, Failure> { Ok(Outcome::Good) }
