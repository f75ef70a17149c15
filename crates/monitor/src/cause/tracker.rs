//! Gathers the cycles since the last change.

use seepd_features::ValidCycle;
use seepd_model::causes::{Causes, Change, ChangeVerdict, Explanation, MAX_NUMBERS};

use crate::baseline::Baseline;

/// Cycles whose mean is explained, at most: from there on the mean forgets.
const MOST_CYCLES: u64 = 16;
/// Squared distance over the number of coordinates of a cycle from the mean of those before it at which it begins anew: of 1e5 cycles that
/// only noise and ordinary variation tell apart, one is as far with eight phases.
const ANEW_FROM: f64 = 3.0;

/// What the cycles since the last change come to.
#[derive(Debug, Clone)]
pub struct Tracker {
    /// Cycles since the last change.
    cycles: u64,
    /// Mean change of these, of means and rises.
    mean: [f64; MAX_NUMBERS],
    /// Cycles in a row with the verdict.
    agreeing: u64,
    verdict: ChangeVerdict,
    /// Cycles in a row in which something has changed.
    changed: u64,
}

impl Default for Tracker {
    fn default() -> Self {
        Tracker {
            cycles: 0,
            mean: [0.0; MAX_NUMBERS],
            agreeing: 0,
            verdict: ChangeVerdict::Nothing,
            changed: 0,
        }
    }
}

/// An explanation of the cycles so far.
#[derive(Debug, Clone, Copy)]
pub struct Explained {
    /// The explanation.
    pub explanation: Explanation,
    /// Cycles in a row that are explained so.
    pub agreeing: u64,
    /// Cycles in a row in which something has changed.
    pub changed: u64,
    /// Cycles whose mean was explained.
    pub mean_of: u64,
}

impl Tracker {
    /// The machine may be another one from the next cycle on: their mean begins anew. What is known to have changed is not forgotten.
    pub fn begin_anew(&mut self) {
        self.cycles = 0;
    }

    /// Takes a cycle's change since the baseline; `None` where the baseline does not know what a phase rises by.
    pub fn take(
        &mut self,
        causes: &Causes,
        baseline: &Baseline,
        cycle: &ValidCycle<'_>,
    ) -> Option<Explained> {
        let phases = baseline.mean.len();
        if baseline.rise.len() != phases || causes.numbers() != 2 * phases {
            return None;
        }
        let (means, rises) = (cycle.statistics.phase_means(), cycle.statistics.phase_rises());
        let now = means.iter().take(phases).chain(rises.iter().take(phases));
        let before = baseline.mean.iter().chain(&baseline.rise);
        let mut numbers = [0.0; MAX_NUMBERS];
        for (slot, (now, before)) in numbers.iter_mut().zip(now.zip(before)) {
            *slot = now - before;
        }
        let noise = cycle.statistics.noise.max(causes.noise_of(&baseline.deviation));
        self.gather(causes, &numbers, noise);
        let averaged = 1.0 / self.cycles.min(MOST_CYCLES) as f64 + 1.0 / baseline.cycles.max(1) as f64;
        let explanation = causes.explain(&Change { numbers: &self.mean, noise: noise * averaged.sqrt() });
        self.agreeing = if explanation.verdict == self.verdict { self.agreeing + 1 } else { 1 };
        self.verdict = explanation.verdict;
        self.changed = if explanation.verdict == ChangeVerdict::Nothing { 0 } else { self.changed + 1 };
        let mean_of = self.cycles.min(MOST_CYCLES);
        Some(Explained { explanation, agreeing: self.agreeing, changed: self.changed, mean_of })
    }

    /// Mean change of the phases' means over the cycles since the last change, in the phases' order; beyond these, of their rises.
    pub fn mean_change(&self) -> &[f64] {
        &self.mean
    }

    fn gather(&mut self, causes: &Causes, numbers: &[f64; MAX_NUMBERS], noise: f64) {
        let mut difference = *numbers;
        for (value, mean) in difference.iter_mut().zip(&self.mean) {
            *value -= mean;
        }
        let of_mean = 1.0 / self.cycles.clamp(1, MOST_CYCLES) as f64;
        let change = Change { numbers: &difference, noise: noise * (1.0 + of_mean).sqrt() };
        if self.cycles > 0 && causes.distance(&change) > ANEW_FROM {
            self.cycles = 0;
        }
        self.cycles += 1;
        let share = 1.0 / self.cycles.min(MOST_CYCLES) as f64;
        for (mean, number) in self.mean.iter_mut().zip(numbers) {
            *mean += share * (number - *mean);
        }
    }
}
