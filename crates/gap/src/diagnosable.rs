//! Axes whose diagnosis is compiled with them.

use std::collections::BTreeMap;

use crate::calibration::{Calibration, CalibrationSettings};
use crate::diagnosis::DiagnosisSettings;
use crate::record::{Log, Record, RecordError};
use crate::report::Diagnosis;
use crate::runs::Run;
use crate::simulated_axis::SimulatedAxis;

/// An axis whose diagnosis is compiled in the crate that it comes from, once, as far optimised as that crate is. A diagnosis is large: with
/// generics alone each crate that calls it would compile it anew. [`diagnosable!`](crate::diagnosable!) implements it.
pub trait Diagnosable: SimulatedAxis {
    /// [`Record::new`] for this axis.
    ///
    /// # Errors
    /// As there.
    fn record(&self, log: &Log) -> Result<Record, RecordError>;
    /// [`Record::of_runs`] for this axis.
    ///
    /// # Errors
    /// As there.
    fn record_of_runs(&self, runs: &[Run]) -> Result<Record, RecordError>;
    /// [`diagnose`](crate::diagnose) for this axis.
    fn diagnosed(
        &self,
        record: &Record,
        settings: &DiagnosisSettings,
        tell: &mut dyn FnMut(usize),
    ) -> (Diagnosis, Self);
    /// [`calibrate`](crate::calibrate) for this axis.
    fn calibrated(&self, record: &Record, settings: &CalibrationSettings) -> Calibration<Self>;
    /// [`nominal_gap`](crate::nominal_gap) for this axis.
    fn nominal_gap(&self, record: &Record) -> BTreeMap<&'static str, f64>;
}

/// Implements [`Diagnosable`] for a type that implements [`SimulatedAxis`], in that type's crate.
#[macro_export]
macro_rules! diagnosable {
    ($axis:ty) => {
        impl $crate::Diagnosable for $axis {
            fn record(&self, log: &$crate::Log) -> Result<$crate::Record, $crate::RecordError> {
                $crate::Record::of_log(log, self)
            }

            fn record_of_runs(&self, runs: &[$crate::Run]) -> Result<$crate::Record, $crate::RecordError> {
                $crate::Record::of_runs_on(runs, self)
            }

            fn diagnosed(
                &self,
                record: &$crate::Record,
                settings: &$crate::DiagnosisSettings,
                tell: &mut dyn FnMut(usize),
            ) -> ($crate::Diagnosis, Self) {
                $crate::diagnosis::diagnose_axis(record, self, settings, tell)
            }

            fn calibrated(
                &self,
                record: &$crate::Record,
                settings: &$crate::CalibrationSettings,
            ) -> $crate::Calibration<Self> {
                $crate::calibration::calibrate_axis(record, self, settings)
            }

            fn nominal_gap(&self, record: &$crate::Record) -> std::collections::BTreeMap<&'static str, f64> {
                $crate::diagnosis::nominal_gap_of_axis(record, self)
            }
        }
    };
}
