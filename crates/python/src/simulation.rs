//! Simulated machines as arrays.

use std::collections::BTreeMap;

use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;
use seepd::Failure;
use seepd::commands::simulate::{SimulateArguments, each_message, machine, runs, warn_of_cavitation};
use seepd::failure::Code;

use crate::error::released;

/// A log's columns.
type Columns = BTreeMap<&'static str, Vec<f64>>;

/// One machine's log, as `seepd simulate` writes it.
struct Simulated {
    time_ns: Vec<i64>,
    columns: Columns,
    clamped_pressures: u64,
}

fn simulated(arguments: &SimulateArguments) -> Result<Simulated, Failure> {
    let spec = machine(arguments)?;
    let planned = runs(arguments, &spec)?;
    let (mut time_ns, mut columns) = (Vec::new(), Columns::new());
    let clamped_pressures = each_message(arguments, &spec, &planned, |at_ns, _, message, truth| {
        time_ns.push(at_ns);
        let mut put = |name: &'static str, value: f64| columns.entry(name).or_default().push(value);
        put("command", message.command);
        if let Some(others) = &message.others {
            put("demand", others.demand);
            put("position", others.position);
            put("p_supply", others.p_supply);
            put("p_inlet", others.p_inlet);
            put("p_cap", others.p_cap);
            put("p_rod", others.p_rod);
            put("load", others.load);
        }
        if !arguments.no_truth {
            put("leak_area", truth.leak_area);
            put("leak_flow", truth.leak_flow);
        }
        Ok(())
    })?;
    Ok(Simulated { time_ns, columns, clamped_pressures })
}

/// Machines of the series side by side, each with noise and variation of its own.
fn series(arguments: &SimulateArguments, machines: u64) -> Result<Vec<Simulated>, Failure> {
    let of_machine = |index: u64| SimulateArguments {
        machine: Some(arguments.machine.unwrap_or(arguments.seed).wrapping_add(index)),
        seed: arguments.seed.wrapping_add(index),
        with: arguments.with.clone(),
        plant: arguments.plant.clone(),
        leak_step: arguments.leak_step.clone(),
        topic_prefix: String::new(),
        out: None,
        ..*arguments
    };
    let logs: Vec<Simulated> =
        (0..machines).into_par_iter().map(|index| simulated(&of_machine(index))).collect::<Result<_, _>>()?;
    let ticks = |log: &Simulated| log.time_ns.len();
    match (logs.iter().map(ticks).min(), logs.iter().map(ticks).max()) {
        (Some(least), Some(most)) if least != most => {
            let text = format!(
                "the machines' logs have {least} … {most} samples, as periods and pauses differ: simulate them one by one"
            );
            Err(Failure::new(Code::Usage, text))
        }
        _ => Ok(logs),
    }
}

/// Arrays by signal: of one machine, or, where `machines` is given, a row each.
#[pyfunction]
#[pyo3(signature = (words, machines=None))]
pub(crate) fn simulate(
    py: Python<'_>,
    words: Vec<String>,
    machines: Option<u64>,
) -> PyResult<(Py<PyDict>, Vec<String>)> {
    let (logs, warnings) = released(py, || {
        let arguments: SimulateArguments = seepd::cli::parse(words)?;
        let logs = match machines {
            None => vec![simulated(&arguments)?],
            Some(machines) if (1..=100_000).contains(&machines) => series(&arguments, machines)?,
            Some(machines) => {
                let text = format!("machines is {machines}; it must lie in 1 … 100000");
                return Err(Failure::new(Code::Usage, text));
            }
        };
        warn_of_cavitation(logs.iter().map(|log| log.clamped_pressures).sum());
        Ok(logs)
    })?;
    let arrays = PyDict::new(py);
    let rows = logs.len();
    let mut logs = logs.into_iter();
    let Some(Simulated { time_ns, mut columns, .. }) = logs.next() else {
        return Ok((arrays.into(), warnings));
    };
    for log in logs {
        for (name, values) in log.columns {
            columns.entry(name).or_default().extend(values);
        }
    }
    let samples = time_ns.len();
    arrays.set_item("time_ns", PyArray1::from_vec(py, time_ns))?;
    for (name, values) in columns {
        let array = PyArray1::from_vec(py, values);
        if machines.is_some() {
            arrays.set_item(name, array.reshape([rows, samples])?)?;
        } else {
            arrays.set_item(name, array)?;
        }
    }
    Ok((arrays.into(), warnings))
}
