#![doc = include_str!("../README.md")]
#![no_std]

extern crate alloc;

pub mod accuracy;
pub mod attribution;
pub mod causes;
mod check;
pub mod ensemble;
pub mod error;
pub mod model;
pub mod out_of_distribution;
pub mod relative;
pub mod schema;

pub use attribution::Attribution;
pub use causes::{Causes, Explanation};
pub use check::MAX_FILE_BYTES;
pub use ensemble::{Ensemble, Estimate};
pub use error::{ModelError, TreeFault};
pub use model::Model;
pub use out_of_distribution::OutOfDistribution;
pub use relative::{Comparison, Relative, RelativeEstimate};
pub use schema::ModelFile;
