//! The commands, one file each.

#[cfg(feature = "gap")]
pub mod blind;
pub mod check;
#[cfg(feature = "simulate")]
pub mod demo;
#[cfg(feature = "gap")]
pub mod gap;
pub mod inspect;
pub mod replay;
#[cfg(feature = "live")]
pub mod run;
pub mod shell;
#[cfg(feature = "simulate")]
pub mod simulate;
#[cfg(feature = "study")]
pub mod study;
#[cfg(feature = "train")]
pub mod train;
