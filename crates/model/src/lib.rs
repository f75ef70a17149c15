//! The `seepd.model/1` ensemble: schema, checks and evaluation.
//!
//! A model is self-contained: sample rate, filter, duty cycle, feature definitions, trees, calibration, and golden
//! input/output pairs that are checked as it is loaded. [`Model::from_json`] is the only way to one, so a
//! [`Model`] in hand has been checked and evaluates without a panic. `no_std` with `alloc`.
#![no_std]

extern crate alloc;

pub mod accuracy;
pub mod attribution;
mod check;
pub mod ensemble;
pub mod error;
pub mod model;
pub mod out_of_distribution;
pub mod relative;
pub mod schema;

pub use attribution::Attribution;
pub use check::MAX_FILE_BYTES;
pub use ensemble::{Ensemble, Estimate};
pub use error::{ModelError, TreeFault};
pub use model::Model;
pub use out_of_distribution::OutOfDistribution;
pub use relative::{Comparison, Relative, RelativeEstimate};
pub use schema::ModelFile;
