//! A table of Arrow columns on its way to Python: through the Arrow C data interface, or as numpy arrays.

use std::ffi::CStr;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::types::{Float64Type, Int64Type};
use arrow_array::{Array, RecordBatch, RecordBatchIterator};
use arrow_schema::DataType;
use arrow_schema::ffi::FFI_ArrowSchema;
use numpy::PyArray1;
use pyo3::exceptions::{PyKeyError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyList};

use crate::error::{internal, raised};

/// Names that the Arrow PyCapsule interface gives its capsules.
const STREAM: &CStr = c"arrow_array_stream";
const SCHEMA: &CStr = c"arrow_schema";

/// Columns of one length.
#[pyclass(frozen)]
pub(crate) struct Batch(pub(crate) RecordBatch);

#[pymethods]
impl Batch {
    fn __len__(&self) -> usize {
        self.0.num_rows()
    }

    #[getter]
    fn column_names(&self) -> Vec<String> {
        self.0.schema_ref().fields().iter().map(|field| field.name().clone()).collect()
    }

    /// The columns as an Arrow stream; their memory is shared, not copied.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        // A consumer casts what it wants otherwise, as the interface allows.
        drop(requested_schema);
        let batches = RecordBatchIterator::new([Ok(self.0.clone())], self.0.schema());
        PyCapsule::new_with_value(py, FFI_ArrowArrayStream::new(Box::new(batches)), STREAM)
    }

    fn __arrow_c_schema__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        let schema = FFI_ArrowSchema::try_from(self.0.schema_ref().as_ref())
            .map_err(|error| raised(py, &internal(error)))?;
        PyCapsule::new_with_value(py, schema, SCHEMA)
    }

    /// A column as a numpy array, absent numbers as NaN; texts and truths as a list, absent ones as None.
    fn column<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let column =
            self.0.column_by_name(name).ok_or_else(|| PyKeyError::new_err(format!("no column `{name}`")))?;
        match column.data_type() {
            DataType::Float64 => {
                let values = column.as_primitive::<Float64Type>();
                let numbers = values.iter().map(|value| value.unwrap_or(f64::NAN));
                Ok(PyArray1::from_iter(py, numbers).into_any())
            }
            DataType::Int64 if column.null_count() == 0 => {
                Ok(PyArray1::from_slice(py, column.as_primitive::<Int64Type>().values()).into_any())
            }
            DataType::Int64 => {
                Ok(PyList::new(py, column.as_primitive::<Int64Type>().iter().collect::<Vec<_>>())?.into_any())
            }
            DataType::Utf8 => {
                Ok(PyList::new(py, column.as_string::<i32>().iter().collect::<Vec<_>>())?.into_any())
            }
            DataType::Boolean => {
                Ok(PyList::new(py, column.as_boolean().iter().collect::<Vec<_>>())?.into_any())
            }
            nested => Err(PyTypeError::new_err(format!(
                "column `{name}` is {nested}, which is no array of numbers or texts: take it from to_pyarrow()"
            ))),
        }
    }
}

/// A batch of named columns.
///
/// # Errors
/// None: the columns have one length.
pub(crate) fn batch(
    columns: Vec<(&'static str, Arc<dyn Array>)>,
) -> Result<RecordBatch, arrow_schema::ArrowError> {
    RecordBatch::try_from_iter(columns)
}
