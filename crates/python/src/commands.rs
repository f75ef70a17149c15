//! Commands of the program as functions: what they print is what these give.

use std::ffi::OsString;

use pyo3::prelude::*;
use pyo3::types::PyDict;
use seepd::Failure;
use seepd::commands::evaluate::{EvaluateArguments, evaluated};
use seepd::commands::gap::{GapArguments, diagnosed, headline};
use seepd::commands::learn_baseline::{LearnBaselineArguments, learned};
use seepd::commands::train::{TrainArguments, json_report, share_simulated, trained};
use seepd_gap::BinnedSignals;

use crate::error::{internal, released};

/// The program itself, with these arguments; gives its exit code.
#[pyfunction]
pub(crate) fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| seepd::cli::run(arguments))
}

/// A baseline's file, and what a person should know before trusting it.
#[pyfunction]
pub(crate) fn learn_baseline(py: Python<'_>, words: Vec<String>) -> PyResult<(String, Vec<String>)> {
    let ((file, mut remarks), warnings) = released(py, || {
        let arguments: LearnBaselineArguments = seepd::cli::parse(words)?;
        let (learned, ()) = learned(&arguments, |_| Ok(()))?;
        let remarks = learned.remarks().to_vec();
        Ok((learned.file, remarks))
    })?;
    remarks.extend(warnings);
    Ok((file, remarks))
}

/// A model's file and the report of its training.
#[pyfunction]
pub(crate) fn train(py: Python<'_>, words: Vec<String>) -> PyResult<(Vec<u8>, String, Vec<String>)> {
    let ((json, report), warnings) = released(py, || {
        let arguments: TrainArguments = seepd::cli::parse(words)?;
        let (trained, ()) = trained(&arguments, || Ok(()))?;
        let report = json_report("model.json", &trained)?;
        Ok((trained.json, report))
    })?;
    Ok((json, report, warnings))
}

/// What a share of a training's simulation came to, for `train`.
#[pyfunction]
pub(crate) fn simulate_share(py: Python<'_>, words: Vec<String>) -> PyResult<(Vec<u8>, Vec<String>)> {
    released(py, || {
        let arguments: TrainArguments = seepd::cli::parse(words)?;
        share_simulated(&arguments, || Ok(())).map(|(simulated, ())| simulated)
    })
}

/// An evaluation, as JSON.
#[pyfunction]
pub(crate) fn evaluate(py: Python<'_>, words: Vec<String>) -> PyResult<(String, Vec<String>)> {
    released(py, || {
        let arguments: EvaluateArguments = seepd::cli::parse(words)?;
        let (evaluation, ()) = evaluated(&arguments, |_| Ok(()))?;
        serde_json::to_string(&evaluation).map_err(internal)
    })
}

/// A diagnosis as JSON, its headline, the plant file as diagnosed, and the curves that were compared: time, phases, and by machine a row
/// for each signal.
#[pyfunction]
pub(crate) fn diagnose(py: Python<'_>, words: Vec<String>) -> PyResult<(Py<PyDict>, Vec<String>)> {
    let (diagnosed, warnings) = released(py, || {
        let arguments: GapArguments = seepd::cli::parse(words)?;
        diagnosed(&arguments, |_, _| Ok(())).map(|(diagnosed, _, ())| diagnosed)
    })?;
    let diagnosis = &diagnosed.diagnosis;
    let curves = &diagnosis.curves;
    let told = PyDict::new(py);
    let json =
        serde_json::to_string(diagnosis).map_err(|error| crate::error::raised(py, &internal(error)))?;
    told.set_item("json", json)?;
    told.set_item("headline", headline(diagnosis))?;
    let plant_file: Result<&String, &Failure> = diagnosed.plant_file.as_ref();
    told.set_item("plant", plant_file.ok())?;
    told.set_item("t_s", &curves.t_s)?;
    told.set_item("phases", &curves.phases)?;
    let by_machine = [
        ("recorded", &curves.recorded),
        ("nominal", &curves.nominal),
        ("calibrated", &curves.calibrated),
        ("chosen", &curves.chosen),
    ];
    for (name, signals) in by_machine {
        let rows: &BinnedSignals = signals;
        told.set_item(name, rows)?;
    }
    Ok((told.into(), warnings))
}

/// Every effect of the catalogue: key, law, signature, balance, parameters with unit, neutral value, range and source.
#[pyfunction]
pub(crate) fn effects(py: Python<'_>) -> PyResult<Vec<Py<PyDict>>> {
    let describe = |effect: &&dyn seepd_sim::effects::Effect| {
        let (info, told) = (effect.info(), PyDict::new(py));
        told.set_item("effect", info.key)?;
        told.set_item("law", info.law)?;
        told.set_item("signature", info.signature)?;
        told.set_item("equation", info.equation.name())?;
        let parameters = info.parameters.iter().map(|parameter| {
            let told = PyDict::new(py);
            told.set_item("name", parameter.name)?;
            told.set_item("unit", parameter.unit)?;
            told.set_item("neutral", parameter.neutral)?;
            told.set_item("range", parameter.range)?;
            told.set_item("source", parameter.source)?;
            Ok(told)
        });
        told.set_item("parameters", parameters.collect::<PyResult<Vec<_>>>()?)?;
        Ok(told.unbind())
    };
    seepd_sim::effects::ALL.iter().map(describe).collect()
}
