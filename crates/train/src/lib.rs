#![doc = include_str!("../README.md")]

mod absolute;
mod calibration;
mod cases;
mod causes;
mod conformal;
pub mod dataset;
pub mod duty;
pub mod forest;
mod hold_force;
pub mod leak_range;
mod linear;
mod null_region;
mod out_of_distribution;
mod pca;
pub mod portions;
pub mod relative;
pub mod report;
mod response_error;
mod search;
mod templates;
pub mod train;
mod unknown_contact;
mod unknown_overlap;
mod unknown_seal;

pub use causes::planted::{PlantedCause, plant_causes};
pub use dataset::Spread;
pub use portions::{Portions, Share};
pub use relative::{Conditions, RelativeReport};
pub use report::Report;
pub use search::BestForest;
pub use train::{TrainError, Trained, TrainingSettings, simulate_share, train, train_with};
