//! A baseline's file on disk.

use std::path::Path;

use seepd_model::Model;
use seepd_monitor::baseline::BaselineFile;
use seepd_monitor::relative::RelativeBaseline;
use seepd_settings::side_file;

use crate::failure::Failure;

/// Reads and checks an axis's file.
///
/// # Errors
/// [`Failure`] with the file's name, of another axis's file too.
pub(crate) fn read(path: &Path, axis: &str, model: &Model) -> Result<BaselineFile, Failure> {
    let text = side_file::read_text(path).map_err(|error| Failure::reading(path, &error))?;
    BaselineFile::parse(&text, model)
        .and_then(|file| file.check_axis(axis).map(|()| file))
        .map_err(|error| Failure::configuration(path, error))
}

/// Reads and checks the file of an axis without a model.
///
/// # Errors
/// [`Failure`] with the file's name, of another axis's file too.
pub(crate) fn read_relative(path: &Path, axis: &str) -> Result<RelativeBaseline, Failure> {
    let text = side_file::read_text(path).map_err(|error| Failure::reading(path, &error))?;
    RelativeBaseline::parse(&text)
        .and_then(|baseline| baseline.check_axis(axis).map(|()| baseline))
        .map_err(|error| Failure::configuration(path, error))
}
