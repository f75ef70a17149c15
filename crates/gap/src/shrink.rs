//! How far the gap shrinks on cycles that nothing was fitted to, and which effect takes which part of it.

use seepd_sim::cycle::DriveSample;

use crate::fit::{Fit, Problem};
use crate::record::{BINS, Record};
use crate::search::Explanation;
use crate::simulate::{BinnedSignals, binned_signals};
use crate::simulated_axis::SimulatedAxis;

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
    /// RMS over range, by machine and signal, each cycle against its own simulation.
    pub(crate) fn gaps<A: SimulatedAxis>(&self, machines: &[A]) -> Vec<Vec<f64>> {
        let record = self.record;
        let mut sums = vec![vec![0.0; record.signals.len()]; machines.len()];
        let mut simulated: Option<(&[DriveSample], Vec<BinnedSignals>)> = None;
        for cycle in self.cycles {
            let cycle = &record.cycles[*cycle];
            // Cycles with the very same drive have the very same simulation.
            if simulated.as_ref().is_none_or(|(drive, _)| *drive != cycle.drive) {
                simulated = Some((&cycle.drive, binned_signals(machines, &cycle.drive, &record.signals)));
            }
            let Some((_, shown)) = &simulated else { continue };
            for (sums, view) in sums.iter_mut().zip(shown) {
                for (sum, (simulated, recorded)) in sums.iter_mut().zip(view.iter().zip(&cycle.bins)) {
                    *sum += simulated.iter().zip(recorded).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
                }
            }
        }
        let count = (self.cycles.len() * BINS) as f64;
        let rms = |(sum, range): (&f64, &f64)| (sum / count).sqrt() / range;
        sums.iter().map(|sums| sums.iter().zip(&record.range).map(rms).collect()).collect()
    }

    /// Mean over signals with a gap of what is gone of it; of what is above the floor, or of the whole.
    pub(crate) fn shrink(&self, nominal: &[f64], now: &[f64], to_floor: bool) -> f64 {
        let shares: Vec<f64> = nominal
            .iter()
            .zip(now)
            .zip(&self.record.floor)
            .filter(|((nominal, _), floor)| **nominal > FLOORS * **floor)
            .map(|((nominal, now), floor)| (nominal - now) / (nominal - if to_floor { *floor } else { 0.0 }))
            .collect();
        if shares.is_empty() { 0.0 } else { shares.iter().sum::<f64>() / shares.len() as f64 }
    }
}

/// The part of the shrink that each effect of a machine has, beyond calibration: its Shapley value (Shapley, Contributions to the Theory of
/// Games II (1953)) over the machines with fewer of the effects, each fitted anew. Parts add up.
pub(crate) fn attributed<A: SimulatedAxis>(
    problem: &Problem<'_>,
    held_out: &HeldOut<'_>,
    nominal: &[f64],
    calibrated: &Fit<A>,
    chosen: &Explanation<A>,
    iterations: usize,
) -> Vec<f64> {
    let count = chosen.effects.len();
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
    let free = chosen.fit.free.iter().filter(|free| !free.is_of(&dropped)).copied().collect();
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
