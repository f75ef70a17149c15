//! `seepd` for Python: the rooms of the program behind functions that take a command's own words, numpy arrays without copies, and
//! give Arrow tables.
//!
//! What a command of the program does is done here by the command's own code, so that both give the same bits and the same errors. The
//! Python half (`python/seepd`) has names, types and documentation; this half has the work, with the interpreter's lock released.

mod calibration_problem;
mod commands;
mod cycles;
mod error;
mod estimator;
mod forest;
mod readings;
mod simulation;
mod table;

use pyo3::prelude::*;

/// The compiled half of the package.
#[pymodule]
mod _core {
    use super::*;

    #[pymodule_export]
    use super::calibration_problem::CalibrationProblem;
    #[pymodule_export]
    use super::commands::{diagnose, effects, evaluate, learn_baseline, main, simulate_share, train};
    #[pymodule_export]
    use super::cycles::{replay, replay_arrays};
    #[pymodule_export]
    use super::estimator::{RowReader, embedded_model};
    #[pymodule_export]
    use super::forest::Forest;
    #[pymodule_export]
    use super::readings::read;
    #[pymodule_export]
    use super::simulation::simulate;
    #[pymodule_export]
    use super::table::Batch;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        // A process that hosts an FMU is this package once more, not the interpreter alone.
        let python: String = module.py().import("sys")?.getattr("executable")?.extract()?;
        seepd::cli::is_started_by(vec![python, "-m".into(), "seepd".into()]);
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
