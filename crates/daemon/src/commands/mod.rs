//! The commands, one file each.

#[cfg(feature = "simulate")]
pub mod demo;
pub mod replay;
#[cfg(feature = "simulate")]
pub mod simulate;
#[cfg(feature = "train")]
pub mod train;
