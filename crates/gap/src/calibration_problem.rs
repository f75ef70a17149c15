//! The gap as a least-squares problem, for solvers and methods beside this crate's own: the same record, simulator, priors and expected
//! errors as a [diagnosis](crate::diagnose) has.

use std::borrow::Cow;
use std::collections::BTreeMap;

use seepd_sim::effects::EffectInfo;

use crate::diagnosis::split;
use crate::fit::{Free, Problem, Target, free_parameters, of_effect};
use crate::record::Record;
use crate::shrink::HeldOut;
use crate::simulate::{BinnedSignals, Drive, binned_signals};
use crate::simulated_axis::{Scale, SimulatedAxis};

/// A parameter that may be fitted.
#[derive(Debug, Clone)]
pub struct FreeParameter {
    /// Key in the plant file; of an effect `effect.parameter`.
    pub key: String,
    /// The effect that it belongs to.
    pub effect: Option<&'static str>,
    /// Value on the machine as it was given, SI; of an effect that it lacks the neutral one.
    pub value: f64,
    /// Least and largest value, SI.
    pub bounds: (f64, f64),
    /// Whether it counts by its logarithm.
    pub logarithmic: bool,
    /// Standard deviation of what is known of it before the log tells of it, of its logarithm where it counts by it; `None` for nothing.
    pub sigma: Option<f64>,
}

/// A key that the machine has no such parameter for.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no parameter {0:?}")]
pub struct NoSuchParameter(pub String);

/// Values by [`FreeParameter::key`], SI; what is not here stays as the machine has it.
pub type ParameterValues = BTreeMap<String, f64>;

/// A record and a machine, whose parameters and effects are to be found.
#[derive(Debug, Clone)]
pub struct CalibrationProblem<A> {
    machine: A,
    problem: Problem<'static>,
    held_out: Vec<usize>,
    free: BTreeMap<String, Free>,
}

impl FreeParameter {
    fn of<A: SimulatedAxis>(free: &Free, machine: &A) -> Self {
        let effect = match &free.target {
            Target::Plant(_) => None,
            Target::Effect(effect, _) => Some(effect.key),
        };
        let sigma = free.prior.map(|(_, sigma)| match free.scale {
            Scale::Logarithmic => sigma,
            Scale::Linear(unit) => sigma * unit,
        });
        let logarithmic = free.scale == Scale::Logarithmic;
        FreeParameter {
            key: free.key(),
            effect,
            value: free.value_on(machine),
            bounds: free.bounds(),
            logarithmic,
            sigma,
        }
    }
}

impl<A: SimulatedAxis> CalibrationProblem<A> {
    /// The problem that a diagnosis of this record against this machine solves. Effects that `without` names are not in the catalogue.
    pub fn new(record: Record, machine: A, without: &[String]) -> Self {
        let (fitted, held_out) = split(&record);
        let problem = Problem::of(Cow::Owned(record), &fitted);
        let known = |effect: &&'static EffectInfo| !without.iter().any(|left_out| left_out == effect.key);
        let effects = machine.catalogue().into_iter().filter(known);
        let effects: Vec<Free> = effects.flat_map(|effect| of_effect(effect, &machine)).collect();
        let free =
            free_parameters(&machine).into_iter().chain(effects).map(|free| (free.key(), free)).collect();
        CalibrationProblem { machine, problem, held_out, free }
    }

    /// Every parameter that may be fitted: what wear changes, the plant's, those of the effects in the catalogue.
    pub fn parameters(&self) -> Vec<FreeParameter> {
        self.free.values().map(|free| FreeParameter::of(free, &self.machine)).collect()
    }

    /// The record.
    pub fn record(&self) -> &Record {
        &self.problem.record
    }

    /// The machine as it was given.
    pub fn machine(&self) -> &A {
        &self.machine
    }

    /// The machine with other values, each held within its bounds. An effect of which a value is given is on it, with neutral values for
    /// those of its parameters that are not.
    ///
    /// # Errors
    /// [`NoSuchParameter`] for a key that none of [`CalibrationProblem::parameters`] has.
    pub fn with(&self, values: &ParameterValues) -> Result<A, NoSuchParameter> {
        let mut machine = self.machine.clone();
        for (key, value) in values {
            let free = self.free.get(key).ok_or_else(|| NoSuchParameter(key.clone()))?;
            free.write_value(*value, &mut machine);
        }
        Ok(machine)
    }

    /// Differences of simulation and record over their expected errors, one row a machine, by drive, signal and bin: the sum of a row's
    /// squares is minus twice the logarithm of the likelihood. What transducers are off by within their classes is taken off, as in a
    /// diagnosis. Two cycles in three are compared, along their mean drive, or along two of them where drives differ.
    pub fn residuals(&self, machines: &[A]) -> Vec<Vec<f64>> {
        let rows = self.problem.residuals(machines);
        rows.into_iter().map(|row| row.data.into()).collect()
    }

    /// RMS over range of the differences on the cycles that residuals leave out, one map a machine.
    pub fn held_out_gaps(&self, machines: &[A]) -> Vec<BTreeMap<&'static str, f64>> {
        let gaps = HeldOut { record: self.record(), cycles: &self.held_out }.gaps(machines);
        let names = || self.record().signals.iter().map(|signal| signal.name());
        gaps.into_iter().map(|gaps| names().zip(gaps).collect()).collect()
    }

    /// What drives the machines whose residuals are compared: demand and load, tick by tick.
    pub fn drives(&self) -> &[Drive] {
        self.problem.drives()
    }

    /// What the log shows along each drive, by signal of the record and bin.
    pub fn recorded(&self) -> &[BinnedSignals] {
        self.problem.shown()
    }

    /// What machines show along each drive, those signals too that the log lacks: by drive and machine, signal of
    /// [`SimulatedAxis::signals`], and bin; NaN from where a simulation goes out of bounds.
    pub fn simulated(&self, machines: &[A]) -> Vec<Vec<BinnedSignals>> {
        let signals = self.machine.signals();
        self.drives().iter().map(|drive| binned_signals(machines, drive, &signals)).collect()
    }
}
