//! The commands, one file each.

#[cfg(feature = "gap")]
pub mod blind;
pub mod check;
#[cfg(feature = "simulate")]
pub mod demo;
pub mod evaluate;
pub mod explain;
#[cfg(feature = "gap")]
pub mod gap;
#[cfg(feature = "live")]
pub mod init;
pub mod inspect;
pub mod learn_baseline;
pub mod reading;
pub mod replay;
#[cfg(feature = "live")]
pub mod run;
pub mod shell;
#[cfg(feature = "simulate")]
pub mod simulate;
#[cfg(feature = "study")]
pub mod study;
#[cfg(feature = "live")]
pub mod test_sinks;
#[cfg(feature = "train")]
pub mod train;
