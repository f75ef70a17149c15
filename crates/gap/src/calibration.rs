//! Calibration alone: a machine's parameters and its wear fitted to a record, without a search for effects.

use std::collections::BTreeMap;

use crate::diagnosable::Diagnosable;
use crate::diagnosis::split;
use crate::fit::{Fit, Free, Problem, Target, free_parameters, of_effect};
use crate::posterior::Posterior;
use crate::record::Record;
use crate::report::CalibratedValue;
use crate::shrink::HeldOut;
use crate::simulate::{BinnedSignals, binned_signals};
use crate::simulated_axis::SimulatedAxis;

/// A machine fitted to a record.
#[derive(Debug, Clone)]
pub struct Calibration<A> {
    /// The machine with the fitted parameters and wear.
    pub machine: A,
    /// The fitted parameters by key, wear among them where it was fitted; effects are in the machine.
    pub parameters: BTreeMap<String, CalibratedValue>,
    /// RMS over range of the differences on held-out cycles, by signal: before, and after.
    pub gaps: [BTreeMap<&'static str, f64>; 2],
    /// RMS over range of each signal's cycle-to-cycle part.
    pub floor: BTreeMap<&'static str, f64>,
    /// Mean of the held-out cycles in bins, by place in the record's signals.
    pub recorded: BinnedSignals,
    /// The fitted machine in bins, alike.
    pub simulated: BinnedSignals,
    /// How well the record tells the fitted parameters, all together.
    pub posterior: Posterior,
}

/// What is fitted beside the plant's parameters.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CalibrationSettings {
    /// Iterations of the fit.
    pub iterations: usize,
    /// Whether wear is fitted; without, it stays as the machine has it.
    pub wear: bool,
    /// Effects, and laws of parts, that the machine is given: by key, or a single parameter by `effect.parameter`.
    pub effects: Vec<String>,
    /// What is known beforehand by key, of an effect's parameter by `effect.parameter`. What is not here is known as [`SimulatedAxis`]
    /// says; an effect's not at all.
    pub known: BTreeMap<String, Known>,
    /// Command below which the loop is open, share of full command: where the overlap of a valve is known. What a controller's integral
    /// does there hangs on all else, so that a fit that follows it may end far off; a second one begins with what the rest of the cycle
    /// tells, and the nearer of both is taken.
    pub open_within: Option<f64>,
}

/// What is known of a parameter before the record tells of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Known {
    /// Value, SI.
    pub value: f64,
    /// Standard deviation: of the logarithm for a parameter that counts by it, SI for others.
    pub sigma: f64,
}

/// Fits a machine's parameters, within their bounds and priors, to a record, and what the settings ask for beside them. Effects that there
/// are none of by a name are left out.
pub fn calibrate<A: Diagnosable>(
    record: &Record,
    spec: &A,
    settings: &CalibrationSettings,
) -> Calibration<A> {
    spec.calibrated(record, settings)
}

/// Reached by `diagnosable!` alone.
#[doc(hidden)]
pub fn calibrate_axis<A: SimulatedAxis>(
    record: &Record,
    spec: &A,
    settings: &CalibrationSettings,
) -> Calibration<A> {
    let iterations = settings.iterations;
    let (fitted, held_out) = split(record);
    let problem = Problem::new(record, &fitted);
    let wear = spec.wear().map(|parameter| parameter.key);
    let is_wear = |free: &Free| matches!(&free.target, Target::Plant(parameter) if Some(&parameter.key) == wear.as_ref());
    let mut free = free_parameters(spec);
    free.retain(|free| (settings.wear || !is_wear(free)) && !free.is_hardly_told());
    let known_laws = spec.catalogue().into_iter().chain(spec.laws_of_parts());
    free.extend(known_laws.flat_map(|effect| {
        let mut parameters = of_effect(effect, spec);
        let is_wanted = |key: &str| settings.effects.iter().any(|wanted| wanted == key);
        parameters.retain(|parameter| is_wanted(effect.key) || is_wanted(&parameter.key()));
        parameters
    }));
    for parameter in &mut free {
        if let Some(known) = settings.known.get(&parameter.key()) {
            parameter.know(known);
        }
    }
    let mut fit = Fit::at(&problem, spec, free.clone()).fitted_from_afar(&problem, iterations);
    if let Some(command) = settings.open_within {
        let rest = problem.clone().with_open_loop_within(command);
        let begun = Fit::at(&rest, spec, free).fitted_from_afar(&rest, iterations);
        let other = Fit::at(&problem, &begun.spec, begun.free).fitted(&problem, iterations);
        if other.cost < fit.cost {
            fit = other;
        }
    }
    let fit = fit.renewed(&problem);
    let parameters = fit
        .free
        .iter()
        // Those who calibrate widen them by what the held-out cycles show.
        .zip(fit.estimates(1.0))
        .filter_map(|(free, (fitted, interval95))| match &free.target {
            Target::Plant(parameter) => {
                let nominal = spec.parameter(&parameter.key);
                Some((parameter.key.to_string(), CalibratedValue { nominal, fitted, interval95 }))
            }
            Target::Effect(..) => None,
        })
        .collect();
    let held_out = HeldOut { record, cycles: &held_out };
    let by_signal = |values: &[f64]| -> BTreeMap<&'static str, f64> {
        record.signals.iter().map(|signal| signal.name()).zip(values.iter().copied()).collect()
    };
    let gaps = held_out.gaps(&[spec.clone(), fit.spec.clone()]);
    let drive = &record.cycles[held_out.cycles[0]].drive;
    let simulated = binned_signals(std::slice::from_ref(&fit.spec), drive, &record.signals).swap_remove(0);
    Calibration {
        parameters,
        gaps: [by_signal(&gaps[0]), by_signal(&gaps[1])],
        floor: by_signal(&record.floor),
        recorded: record.mean(&record.alike(held_out.cycles)),
        simulated,
        posterior: Posterior::of(&fit),
        machine: fit.spec,
    }
}
