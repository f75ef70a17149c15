//! When files were last changed, by which a reload tells what to take up anew although the configuration still says the same.

use std::fs;
use std::path::PathBuf;
use std::time::SystemTime;

use crate::config::AxisConfig;

/// Each file's time of change; none where it is not there.
pub(super) type Stamps = Vec<Option<SystemTime>>;

/// Those of files.
pub(super) fn stamps<'a>(files: impl IntoIterator<Item = &'a PathBuf>) -> Stamps {
    files.into_iter().map(|path| fs::metadata(path).ok()?.modified().ok()).collect()
}

/// The files that an axis is made of.
pub(super) fn axis_files(config: &AxisConfig) -> impl Iterator<Item = &PathBuf> {
    let of_axis = [&config.model, &config.dbc, &config.baseline.file].into_iter().flatten();
    let of_duty_cycles = config.duty_cycles.iter();
    of_axis.chain(
        of_duty_cycles.flat_map(|duty_cycle| [&duty_cycle.model].into_iter().chain(&duty_cycle.baseline)),
    )
}
