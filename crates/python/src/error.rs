//! Failures of the program as Python exceptions: the same line, the exit code as the class.

use pyo3::prelude::*;
use seepd::Failure;
use seepd::failure::Code;

/// The exception of `seepd.errors` for a failure.
pub(crate) fn raised(py: Python<'_>, failure: &Failure) -> PyErr {
    let exception = py
        .import("seepd.errors")
        .and_then(|module| module.getattr("of_exit_code"))
        .and_then(|of_exit_code| of_exit_code.call1((failure.code as u8, &failure.message)));
    match exception {
        Ok(exception) => PyErr::from_value(exception),
        Err(error) => error,
    }
}

/// A fault of this package.
pub(crate) fn internal(error: impl std::fmt::Display) -> Failure {
    Failure::new(Code::Internal, error.to_string())
}

/// Does the work with the interpreter's lock released, and gives its warnings beside what comes of it.
///
/// # Errors
/// The exception of its failure.
pub(crate) fn released<R: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<R, Failure> + Send,
) -> PyResult<(R, Vec<String>)> {
    let (result, warnings) = py.detach(|| seepd::progress::gathering_warnings(work));
    Ok((result.map_err(|failure| raised(py, &failure))?, warnings))
}
