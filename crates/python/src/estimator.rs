//! Cycles that come as rows of an array, each by itself.

use numpy::{PyArray1, PyReadonlyArray2, ToPyArray};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rayon::prelude::*;
use seepd_features::{Outcome, ReaderError, ValidCycle};
use seepd_model::Model;
use seepd_monitor::baseline::{BaselineComparator, BaselineFile, Learner, MOST_CYCLES};
use seepd_signals::Sample;

/// Times that a row is read in a row: the filter settles in the first, the cycle of interest is whole by the last, wherever in the row it
/// begins.
const TIMES: usize = 3;

/// The model that the program brings, as JSON.
#[pyfunction]
pub(crate) fn embedded_model() -> &'static [u8] {
    seepd::EMBEDDED_MODEL
}

/// Reads rows of commands with a model, each row one cycle.
#[pyclass(frozen)]
pub(crate) struct RowReader {
    model: Model,
}

#[pymethods]
impl RowReader {
    /// Reads a model's JSON.
    #[new]
    fn new(json: &[u8]) -> PyResult<Self> {
        let model = Model::from_json(json).map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok(RowReader { model })
    }

    /// Samples of a cycle as planned.
    #[getter]
    fn samples(&self) -> usize {
        let file = self.model.file();
        (file.cycle.period_s * file.sample_rate_hz).round() as usize
    }

    /// The rows' baseline as a file's text; rows that are no cycle count as left out by the reader.
    fn learn(&self, py: Python<'_>, rows: PyReadonlyArray2<'_, f64>, occasion: &str) -> PyResult<String> {
        let rows = rows_of(&rows);
        py.detach(|| {
            let mut learner = Learner::new(occasion, MOST_CYCLES);
            for (index, row) in rows.iter().enumerate() {
                self.read(row, index, &mut |cycle| {
                    learner.take(cycle, self.model.estimate_at(cycle.features, cycle.statistics.noise));
                })
                .map_err(|error| error.to_string())?;
            }
            let baseline = learner.baseline(&self.model).map_err(|error| error.to_string())?;
            let mut file = BaselineFile::new("axis", &self.model);
            file.baselines.push(baseline);
            file.to_json().map_err(|error| error.to_string())
        })
        .map_err(PyValueError::new_err)
    }

    /// Estimate and ends of the interval of each row, m²; NaN where a row is no cycle, or unlike all of training. With a baseline's text
    /// the estimates are relative to it.
    #[expect(clippy::type_complexity, reason = "three arrays are three arrays")]
    #[pyo3(signature = (rows, baseline=None))]
    fn estimate<'py>(
        &self,
        py: Python<'py>,
        rows: PyReadonlyArray2<'py, f64>,
        baseline: Option<&str>,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>)> {
        let file = baseline
            .map(|text| BaselineFile::parse(text, &self.model))
            .transpose()
            .map_err(|error| PyValueError::new_err(error.to_string()))?;
        let baseline = file.as_ref().and_then(BaselineFile::newest);
        let comparator = baseline.map(|baseline| BaselineComparator::new(baseline.clone(), &self.model));
        let rows = rows_of(&rows);
        let estimates = py
            .detach(|| {
                rows.par_iter()
                    .enumerate()
                    .map(|(index, row)| self.estimated(row, index, comparator.as_ref()))
                    .collect::<Result<Vec<_>, ReaderError>>()
            })
            .map_err(|error| PyValueError::new_err(error.to_string()))?;
        let column = |which: usize| {
            estimates.iter().map(|estimate| estimate[which]).collect::<Vec<f64>>().to_pyarray(py)
        };
        Ok((column(0), column(1), column(2)))
    }
}

impl RowReader {
    /// Hands the row's cycle to `take`, where it has one.
    fn read(
        &self,
        row: &[f64],
        index: usize,
        take: &mut dyn FnMut(&ValidCycle<'_>),
    ) -> Result<(), ReaderError> {
        let reader = self.model.reader()?;
        let mut state = reader.start(vec![0.0; reader.definition().ring_samples()])?;
        let rate_hz = self.model.file().sample_rate_hz;
        let begin = index * TIMES * row.len();
        let mut found = 0;
        for (tick, command) in row.iter().cycle().take(TIMES * row.len()).enumerate() {
            let time_ns = ((begin + tick) as f64 * 1e9 / rate_hz).round() as i64;
            let mut hear = |outcome: Outcome<'_>| {
                // The first is read while the filter settles.
                if let Outcome::Valid(cycle) = &outcome {
                    found += 1;
                    if found == 2 {
                        take(cycle);
                    }
                }
            };
            reader.push(&mut state, &Sample::command(time_ns, *command), &mut hear);
        }
        Ok(())
    }

    fn estimated(
        &self,
        row: &[f64],
        index: usize,
        comparator: Option<&BaselineComparator>,
    ) -> Result<[f64; 3], ReaderError> {
        let mut estimate = [f64::NAN; 3];
        self.read(row, index, &mut |cycle| {
            let (given, score) = match comparator {
                Some(comparator) => {
                    let Some((relative, ..)) = comparator.compare(&self.model, cycle) else { return };
                    (relative.estimate, relative.out_of_distribution.score)
                }
                None => {
                    let alone = self.model.estimate_at(cycle.features, cycle.statistics.noise);
                    let known = self.model.out_of_distribution(&alone, &cycle.statistics.phase_means());
                    (alone, known.score)
                }
            };
            if score <= 1.0 {
                estimate = [given.value, given.interval[0], given.interval[1]];
            }
        })?;
        Ok(estimate)
    }
}

fn rows_of(rows: &PyReadonlyArray2<'_, f64>) -> Vec<Vec<f64>> {
    rows.as_array().rows().into_iter().map(|row| row.to_vec()).collect()
}
