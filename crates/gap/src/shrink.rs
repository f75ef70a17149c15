//! How far the gap shrinks on cycles that nothing was fitted to, and which effect takes which part of it.

use std::rc::Rc;

use seepd_signals::Signal;
use seepd_sim::SensorError;

use crate::fit::{Fit, INDEPENDENT, MODEL_ERROR, Problem};
use crate::record::Record;
use crate::search::Explanation;
use crate::simulate::{BinnedSignals, Drive, binned_signals};
use crate::simulated_axis::SimulatedAxis;
use crate::transducers::most_likely;

/// Signals whose nominal gap exceeds this many floors count in the shrink.
const FLOORS: f64 = 1.5;

/// Gaps on cycles that nothing was fitted to.
pub(crate) struct HeldOut<'r> {
    /// The record.
    pub(crate) record: &'r Record,
    /// The cycles.
    pub(crate) cycles: &'r [usize],
}

impl HeldOut<'_> {
    /// RMS over range, by machine and signal, each cycle against its own simulation, beside what the sensors' classes explain.
    pub(crate) fn gaps<A: SimulatedAxis>(&self, machines: &[A]) -> Vec<Vec<f64>> {
        let simulated = self.simulated(machines);
        (0..machines.len())
            .map(|machine| {
                let errors = self.sensor_errors(&simulated, machine);
                self.record
                    .range
                    .iter()
                    .enumerate()
                    .map(|(signal, range)| {
                        let error = errors[signal].unwrap_or_default();
                        let pairs = self.values(&simulated, machine, signal);
                        let squares = pairs.map(|(recorded, there)| (recorded - error.shown(there)).powi(2));
                        let (square, count) =
                            squares.fold((0.0, 0), |(sum, n), square| (sum + square, n + 1));
                        (square / f64::from(count)).sqrt() / range
                    })
                    .collect()
            })
            .collect()
    }

    /// Sum over signals of the gap beyond the floor, in squares of what is expected of a model.
    pub(crate) fn beyond_expected(&self, gaps: &[f64]) -> f64 {
        let of = |(gap, floor): (&f64, &f64)| {
            (gap * gap - floor * floor).max(0.0) / floor.hypot(MODEL_ERROR).powi(2)
        };
        gaps.iter().zip(&self.record.floor).map(of).sum()
    }

    /// The largest of the signals' gaps, in squares of what is expected of a model.
    pub(crate) fn largest_over_expected(&self, gaps: &[f64]) -> f64 {
        let of = |(gap, floor): (&f64, &f64)| (gap / floor.hypot(MODEL_ERROR)).powi(2);
        gaps.iter().zip(&self.record.floor).map(of).fold(0.0, f64::max)
    }

    /// The first of the cycles; of runs, which have different signals and commands, all.
    pub(crate) fn first(&self) -> Self {
        let count = if self.record.is_open_loop { self.cycles.len() } else { 1 };
        HeldOut { cycles: &self.cycles[..count], ..*self }
    }

    /// How far each signal's sensor is most likely off, if the machine is that one; read off the first of the cycles.
    pub(crate) fn sensors<A: SimulatedAxis>(&self, machine: &A) -> Vec<Option<SensorError>> {
        let first = self.first();
        first.sensor_errors(&first.simulated(std::slice::from_ref(machine)), 0)
    }

    /// What each machine shows along each cycle's drive; cycles with the very same drive share it.
    fn simulated<A: SimulatedAxis>(&self, machines: &[A]) -> Vec<Rc<Vec<BinnedSignals>>> {
        let mut simulated: Vec<Rc<Vec<BinnedSignals>>> = Vec::with_capacity(self.cycles.len());
        let mut last: Option<&Drive> = None;
        for cycle in self.cycles {
            let drive = &self.record.cycles[*cycle].drive;
            let same = simulated.last().filter(|_| last == Some(drive)).cloned();
            let shown =
                same.unwrap_or_else(|| Rc::new(binned_signals(machines, drive, &self.record.signals)));
            simulated.push(shown);
            last = Some(drive);
        }
        simulated
    }

    /// Recorded and simulated values of a signal over all cycles.
    fn values<'v>(
        &'v self,
        simulated: &'v [Rc<Vec<BinnedSignals>>],
        machine: usize,
        signal: usize,
    ) -> impl Iterator<Item = (f64, f64)> + 'v {
        self.cycles.iter().zip(simulated).flat_map(move |(cycle, shown)| {
            let recorded = &self.record.cycles[*cycle].bins[signal];
            let pairs = recorded.iter().copied().zip(shown[machine][signal].iter().copied());
            // What this run has no transducer for.
            pairs.filter(|(recorded, _)| recorded.is_finite())
        })
    }

    fn sensor_errors(
        &self,
        simulated: &[Rc<Vec<BinnedSignals>>],
        machine: usize,
    ) -> Vec<Option<SensorError>> {
        let record = self.record;
        let of = |(signal, kind): (usize, &Signal)| {
            let (recorded, there): (Vec<f64>, Vec<f64>) = self.values(simulated, machine, signal).unzip();
            let expected = record.floor[signal].hypot(MODEL_ERROR) * record.range[signal];
            // As many independent values as a fit counts.
            let values = recorded.len() as f64;
            most_likely(*kind, &recorded, &there, expected * (values / INDEPENDENT).sqrt())
        };
        record.signals.iter().enumerate().map(of).collect()
    }

    /// Mean over signals with a gap of what is gone of it; of what is above the floor, or of the whole.
    pub(crate) fn shrink(&self, nominal: &[f64], now: &[f64], to_floor: bool) -> f64 {
        let shares: Vec<f64> = nominal
            .iter()
            .zip(now)
            .zip(&self.record.floor)
            .filter(|((nominal, _), floor)| **nominal > FLOORS * **floor)
            .map(|((nominal, now), floor)| {
                let most = nominal - if to_floor { *floor } else { 0.0 };
                // What the sensors may be off by can go below the floor.
                ((nominal - now) / most).min(1.0)
            })
            .collect();
        if shares.is_empty() { 0.0 } else { shares.iter().sum::<f64>() / shares.len() as f64 }
    }
}

/// The part of the shrink that each effect of a machine has, beyond calibration: its Shapley value (Shapley, Contributions to the Theory of
/// Games II (1953)) over the machines with fewer of the effects, each fitted anew. Parts add up.
/// What none and all of them are worth is known.
pub(crate) fn attributed<A: SimulatedAxis>(
    problem: &Problem<'_>,
    held_out: &HeldOut<'_>,
    nominal: &[f64],
    (worth_of_none, worth_of_all): (f64, f64),
    calibrated: &Fit<A>,
    chosen: &Explanation<A>,
    iterations: usize,
) -> Vec<f64> {
    let count = chosen.effects.len();
    if count == 1 {
        return vec![worth_of_all - worth_of_none];
    }
    let all = (1usize << count) - 1;
    let machines: Vec<A> = (0..=all)
        .map(|subset| match subset {
            0 => calibrated.spec.clone(),
            _ if subset == all => chosen.fit.spec.clone(),
            _ => with_some(problem, chosen, subset, iterations),
        })
        .collect();
    let worth: Vec<f64> =
        held_out.gaps(&machines).iter().map(|gaps| held_out.shrink(nominal, gaps, true)).collect();
    (0..count)
        .map(|effect| {
            let without = (0..=all).filter(|subset| subset >> effect & 1 == 0);
            without.map(|subset| share(count, subset) * (worth[subset | 1 << effect] - worth[subset])).sum()
        })
        .collect()
}

/// How often, of all orders in which effects can be added, exactly this subset comes before a given other effect.
fn share(count: usize, subset: usize) -> f64 {
    let factorial = |n: usize| (1..=n).map(|k| k as f64).product::<f64>();
    let before = subset.count_ones() as usize;
    factorial(before) * factorial(count - before - 1) / factorial(count)
}

/// The machine with some of the chosen effects, fitted anew.
fn with_some<A: SimulatedAxis>(
    problem: &Problem<'_>,
    chosen: &Explanation<A>,
    subset: usize,
    iterations: usize,
) -> A {
    let mut spec = chosen.fit.spec.clone();
    let dropped: Vec<&str> = chosen
        .effects
        .iter()
        .enumerate()
        .filter(|(index, _)| subset >> index & 1 == 0)
        .map(|(_, effect)| effect.key)
        .collect();
    for key in &dropped {
        spec.effects_mut().remove(*key);
    }
    let free = chosen.fit.free.iter().filter(|free| !free.is_of(&dropped)).cloned().collect();
    Fit::at(problem, &spec, free).fitted(problem, iterations).spec
}

#[cfg(test)]
mod tests {
    use super::share;

    #[test]
    fn the_orders_of_adding_effects_are_shares_of_a_whole() {
        for count in 1..5usize {
            let sum: f64 = (0..1 << (count - 1)).map(|subset| share(count, subset)).sum();
            assert!((sum - 1.0).abs() < 1e-12);
        }
    }
}
