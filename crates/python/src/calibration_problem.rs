//! The gap as a least-squares problem, for solvers in Python.

use std::collections::BTreeMap;

use numpy::ndarray::{Array2, Array3};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use seepd::Failure;
use seepd::commands::gap::{GapArguments, calibration_problem};
use seepd::failure::Code;
use seepd_gap::{BinnedSignals, Drive, ParameterValues, SimulatedAxis};
use seepd_signals::Signal;
use seepd_sim::MachineSpec;
use seepd_sim::cycle::DriveSample;

use crate::error::{internal, released};

/// A log and a press whose parameters and effects are to be found.
#[pyclass(frozen)]
pub(crate) struct CalibrationProblem {
    problem: seepd_gap::CalibrationProblem<MachineSpec>,
}

fn signal(name: &String) -> Result<Signal, Failure> {
    let known = || Signal::ALL.map(Signal::name).join(", ");
    let unknown = || Failure::new(Code::Usage, format!("there is no signal {name:?}; there are {}", known()));
    Signal::from_name(name).ok_or_else(unknown)
}

#[pymethods]
impl CalibrationProblem {
    /// Reads the log.
    #[new]
    fn new(py: Python<'_>, words: Vec<String>, signals: Option<Vec<String>>) -> PyResult<Self> {
        let (problem, _) = released(py, || {
            let arguments: GapArguments = seepd::cli::parse(words)?;
            let signals: Option<Vec<Signal>> =
                signals.map(|names| names.iter().map(signal).collect()).transpose()?;
            calibration_problem(&arguments, signals.as_deref())
        })?;
        Ok(CalibrationProblem { problem })
    }

    /// Every parameter that may be fitted.
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let parameters = self.problem.parameters().into_iter().map(|parameter| {
            let told = PyDict::new(py);
            told.set_item("key", parameter.key)?;
            told.set_item("effect", parameter.effect)?;
            told.set_item("value", parameter.value)?;
            told.set_item("low", parameter.bounds.0)?;
            told.set_item("high", parameter.bounds.1)?;
            told.set_item("logarithmic", parameter.logarithmic)?;
            told.set_item("sigma", parameter.sigma)?;
            Ok(told)
        });
        parameters.collect()
    }

    /// Signals that are compared.
    #[getter]
    fn signals(&self) -> Vec<&'static str> {
        self.problem.record().signals.iter().map(|signal| signal.name()).collect()
    }

    /// RMS over range of each signal's part that differs from cycle to cycle.
    #[getter]
    fn floor(&self) -> BTreeMap<&'static str, f64> {
        let record = self.problem.record();
        record.signals.iter().map(|signal| signal.name()).zip(record.floor.iter().copied()).collect()
    }

    /// Length of a cycle, s.
    #[getter]
    fn period_s(&self) -> f64 {
        self.problem.machine().cycle.period_s
    }

    /// Signals that are simulated.
    #[getter]
    fn simulated_signals(&self) -> Vec<&'static str> {
        self.problem.machine().signals().into_iter().map(Signal::name).collect()
    }

    /// Demand, m, and load, N, by drive and tick.
    fn drives<'py>(&self, py: Python<'py>) -> Vec<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>)> {
        let column = |drive: &Drive, of: fn(&DriveSample) -> f64| {
            PyArray1::from_iter(py, drive.samples.iter().map(of))
        };
        let of =
            |drive: &Drive| (column(drive, |sample| sample.demand_m), column(drive, |sample| sample.load_n));
        self.problem.drives().iter().map(of).collect()
    }

    /// What the log shows, by drive, signal and bin.
    fn recorded<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        stacked(py, self.problem.recorded().to_vec())
    }

    /// What a machine shows, by drive, simulated signal and bin.
    fn simulated<'py>(
        &self,
        py: Python<'py>,
        machine: ParameterValues,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let (drives, _) = released(py, || {
            let by_drive = self.problem.simulated(&self.machines(&[machine])?);
            Ok(by_drive.into_iter().flatten().collect())
        })?;
        stacked(py, drives)
    }

    /// Differences of simulation and record over their expected errors, one row a machine.
    fn residuals<'py>(
        &self,
        py: Python<'py>,
        machines: Vec<ParameterValues>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (rows, _) = released(py, || {
            let rows = self.problem.residuals(&self.machines(&machines)?);
            let shape = (rows.len(), rows.first().map_or(0, Vec::len));
            Array2::from_shape_vec(shape, rows.into_iter().flatten().collect()).map_err(internal)
        })?;
        Ok(rows.into_pyarray(py))
    }

    /// RMS over range of the differences on the cycles that residuals leave out, one dictionary a machine.
    fn held_out_gaps(
        &self,
        py: Python<'_>,
        machines: Vec<ParameterValues>,
    ) -> PyResult<Vec<BTreeMap<&'static str, f64>>> {
        let (gaps, _) = released(py, || Ok(self.problem.held_out_gaps(&self.machines(&machines)?)))?;
        Ok(gaps)
    }
}

/// By drive, signal and bin.
fn stacked(py: Python<'_>, drives: Vec<BinnedSignals>) -> PyResult<Bound<'_, PyArray3<f64>>> {
    let signals = drives.first().map_or(0, Vec::len);
    let bins = drives.first().and_then(|signals| signals.first()).map_or(0, Vec::len);
    let shape = (drives.len(), signals, bins);
    let array = Array3::from_shape_vec(shape, drives.into_iter().flatten().flatten().collect())
        .map_err(|error| crate::error::raised(py, &internal(error)))?;
    Ok(array.into_pyarray(py))
}

impl CalibrationProblem {
    fn machines(&self, values: &[ParameterValues]) -> Result<Vec<MachineSpec>, Failure> {
        let machine =
            |values| self.problem.with(values).map_err(|error| Failure::new(Code::Usage, error.to_string()));
        values.iter().map(machine).collect()
    }
}
