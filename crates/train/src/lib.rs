//! Simulated data sets, bagged regression trees, hyperparameter search and export.
//!
//! The way: [`duty`] derives from a machine's duty cycle what the monitor must know of it; [`dataset`] simulates
//! machines over leak areas and reads their cycles with the monitor's own code; [`pca`] and [`forest`] learn;
//! [`search`] picks the forest's size under the file's limit; [`train`](mod@train) puts the model together and
//! [`report`] measures it on machines that it has not seen.

mod conformal;
pub mod dataset;
pub mod duty;
pub mod forest;
mod linear;
mod out_of_distribution;
pub mod pca;
pub mod relative;
pub mod report;
pub mod search;
pub mod train;

pub use dataset::Spread;
pub use relative::{Conditions, RelativeReport};
pub use report::Report;
pub use train::{TrainError, Trained, TrainingSettings, train};
