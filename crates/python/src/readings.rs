//! A log's samples as a table.

use std::path::PathBuf;
use std::sync::Arc;

use arrow_array::builder::{Float64Builder, Int64Builder};
use arrow_array::{Array, RecordBatch};
use clap::Args;
use pyo3::prelude::*;
use seepd::Failure;
use seepd::commands::reading::MappingArguments;
use seepd_logs::record;
use seepd_signals::{Sample, Signal};

use crate::error::{internal, released};
use crate::table::{Batch, batch};

/// What `read` is asked for, in the command line's words.
#[derive(Debug, Args)]
struct ReadArguments {
    #[arg(required = true)]
    logs: Vec<PathBuf>,
    #[command(flatten)]
    mapping: MappingArguments,
}

/// Samples by column; a signal that never comes has none.
#[derive(Default)]
struct Columns {
    time_ns: Int64Builder,
    signals: [Option<Float64Builder>; Signal::ALL.len()],
    rows: usize,
}

impl Columns {
    fn take(&mut self, sample: &Sample) {
        self.time_ns.append_value(sample.time_ns);
        for (signal, column) in Signal::ALL.into_iter().zip(&mut self.signals) {
            let value = sample.get(signal);
            if let Some(column) = column {
                column.append_option(value);
            } else if value.is_some() {
                let mut begun = Float64Builder::with_capacity(self.rows + 1);
                begun.append_nulls(self.rows);
                begun.append_option(value);
                *column = Some(begun);
            }
        }
        self.rows += 1;
    }

    fn finish(mut self) -> Result<RecordBatch, Failure> {
        let time: (&str, Arc<dyn Array>) = ("time_ns", Arc::new(self.time_ns.finish()));
        let signals = Signal::ALL.into_iter().zip(self.signals).filter_map(|(signal, column)| {
            let column: Arc<dyn Array> = Arc::new(column?.finish());
            Some((signal.name(), column))
        });
        batch([time].into_iter().chain(signals).collect()).map_err(internal)
    }
}

/// The samples of logs that are one machine's record, and what is to be known of them.
#[pyfunction]
pub(crate) fn read(py: Python<'_>, words: Vec<String>) -> PyResult<(Batch, Vec<String>)> {
    let (read, _) = released(py, || {
        let arguments: ReadArguments = seepd::cli::parse(words)?;
        let config = arguments.mapping.load()?;
        let mut columns = Columns::default();
        let notes = record::each_sample(
            &arguments.logs,
            &config.log_mapping(),
            |_| (),
            |sample| {
                columns.take(sample);
                Ok::<(), Failure>(())
            },
        )?;
        Ok((columns.finish()?, notes))
    })?;
    Ok((Batch(read.0), read.1))
}
