//! The trees of training, for features of any kind.

use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2, ToPyArray};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use seepd_model::Ensemble;
use seepd_model::schema::Tree;
use seepd_train::forest::{ForestParams, Table};

/// Bagged regression trees as `seepd train` grows them.
#[pyclass(frozen)]
pub(crate) struct Forest {
    ensemble: Ensemble,
    trees: Vec<Tree>,
    features: usize,
    out_of_bag_rms: f64,
}

impl Forest {
    fn of(trees: Vec<Tree>, features: usize, out_of_bag_rms: f64) -> PyResult<Self> {
        let ensemble =
            Ensemble::new(&trees, features).map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok(Forest { ensemble, trees, features, out_of_bag_rms })
    }
}

#[pymethods]
impl Forest {
    /// Grows a forest on rows of features and their targets; the same seed gives the same trees.
    #[staticmethod]
    fn grow(
        py: Python<'_>,
        rows: PyReadonlyArray2<'_, f64>,
        target: PyReadonlyArray1<'_, f64>,
        learners: usize,
        least_leaf: usize,
        feature_share: f64,
        seed: u64,
    ) -> PyResult<Self> {
        let rows = rows.as_array();
        let features = rows.ncols();
        let columns = rows.columns().into_iter().map(|column| column.to_vec()).collect();
        let table = Table { columns, target: target.as_slice()?.to_vec() };
        let params = ForestParams { learners, least_leaf, feature_share };
        let grown = py.detach(|| {
            let forest = seepd_train::forest::Forest::grow(&table, params, seed);
            let rms = forest.out_of_bag_rms(&table.target);
            (forest.trees, rms)
        });
        Forest::of(grown.0, features, grown.1)
    }

    /// A forest from its text.
    #[staticmethod]
    fn from_json(text: &str) -> PyResult<Self> {
        let (trees, features, rms): (Vec<Tree>, usize, Option<f64>) =
            serde_json::from_str(text).map_err(|error| PyValueError::new_err(error.to_string()))?;
        Forest::of(trees, features, rms.unwrap_or(f64::INFINITY))
    }

    /// Its text.
    fn to_json(&self) -> PyResult<String> {
        serde_json::to_string(&(&self.trees, self.features, self.out_of_bag_rms))
            .map_err(|error| PyValueError::new_err(error.to_string()))
    }

    /// Mean and standard deviation over the trees, of each row.
    #[expect(clippy::type_complexity, reason = "two arrays are a pair")]
    fn predict<'py>(
        &self,
        py: Python<'py>,
        rows: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>)> {
        let rows = rows.as_array();
        if rows.ncols() != self.features {
            let text = format!("{} features were learned, {} are given", self.features, rows.ncols());
            return Err(PyValueError::new_err(text));
        }
        let (means, spreads): (Vec<f64>, Vec<f64>) =
            py.detach(|| rows.rows().into_iter().map(|row| self.ensemble.vote(&row.to_vec())).unzip());
        Ok((means.to_pyarray(py), spreads.to_pyarray(py)))
    }

    /// Root mean square of the errors on observations that a tree has not seen.
    #[getter]
    fn out_of_bag_rms(&self) -> f64 {
        self.out_of_bag_rms
    }
}
