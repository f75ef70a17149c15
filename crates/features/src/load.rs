//! The load over a cycle, where the samples tell it: from its own signal, or from the two chambers' pressures.

use seepd_signals::{Sample, Signal};

use crate::segment::{CycleDefinition, MAX_CYCLE_BINS, Span};

/// A cycle's load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadSummary {
    /// Mean over the cycle, N, positive in the extending direction.
    pub mean_n: f64,
    /// Smallest and largest mean of a bin, N.
    pub extremes_n: (f64, f64),
}

impl LoadSummary {
    /// Whether the load did not change by a bit over the whole cycle, as the signal of a dead sensor does not.
    pub fn is_frozen(&self) -> bool {
        self.extremes_n.0 == self.extremes_n.1
    }
}

/// Areas of the piston, m²: cap side and annulus.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PistonAreas {
    /// Cap side, m².
    pub cap_m2: f64,
    /// Rod side, m².
    pub annulus_m2: f64,
}

/// Bins that are kept: a cycle, what it may stretch, and the time until it is closed.
const KEPT_BINS: usize = 2 * MAX_CYCLE_BINS;
/// Share of a cycle's bins that must have a load.
const LEAST_SHARE: f64 = 0.9;

/// The load in bins, the newest [`KEPT_BINS`] of them.
#[derive(Debug, Clone)]
pub(crate) struct LoadState {
    means_n: [f32; KEPT_BINS],
    /// Number of the bin that is being filled.
    bin: i64,
    sum_n: f64,
    count: f64,
    /// Whether any sample has had a load since the last restart.
    heard: bool,
}

impl Default for LoadState {
    fn default() -> Self {
        LoadState { means_n: [f32::NAN; KEPT_BINS], bin: 0, sum_n: 0.0, count: 0.0, heard: false }
    }
}

impl LoadState {
    /// Takes a sample's load, if it has one; `number` is the newest command's.
    #[inline]
    pub(crate) fn take(
        &mut self,
        definition: &CycleDefinition<'_>,
        areas: Option<PistonAreas>,
        number: i64,
        sample: &Sample,
    ) {
        let Some(load_n) = load_of(sample, areas) else { return };
        self.heard = true;
        let bin = number.max(0) / definition.bin_samples.max(1) as i64;
        if bin != self.bin {
            self.move_to(bin);
        }
        self.sum_n += load_n;
        self.count += 1.0;
    }

    #[cold]
    fn move_to(&mut self, bin: i64) {
        let mean_n = if self.count > 0.0 { (self.sum_n / self.count) as f32 } else { f32::NAN };
        self.put(self.bin, mean_n);
        for skipped in (self.bin + 1..bin).take(KEPT_BINS) {
            self.put(skipped, f32::NAN);
        }
        (self.bin, self.sum_n, self.count) = (bin, 0.0, 0.0);
    }

    fn put(&mut self, bin: i64, mean_n: f32) {
        if let Some(slot) = self.means_n.get_mut(bin as usize % KEPT_BINS) {
            *slot = mean_n;
        }
    }

    /// The load over a cycle; `None` where too little of it is known.
    pub(crate) fn summary(&self, definition: &CycleDefinition<'_>, span: &Span) -> Option<LoadSummary> {
        if !self.heard {
            return None;
        }
        let size = definition.bin_samples.max(1) as i64;
        let (from, to) = (span.start.max(0) / size, (span.end / size).min(self.bin));
        let (mut sum, mut count, mut extremes_n) = (0.0, 0.0, (f64::INFINITY, f64::NEG_INFINITY));
        let from = from.max(self.bin - KEPT_BINS as i64 + 1);
        for bin in from..to {
            let mean_n = f64::from(*self.means_n.get(bin as usize % KEPT_BINS)?);
            if !mean_n.is_nan() {
                sum += mean_n;
                count += 1.0;
                extremes_n = (extremes_n.0.min(mean_n), extremes_n.1.max(mean_n));
            }
        }
        let enough = count > 0.0 && count >= LEAST_SHARE * (to - from) as f64;
        enough.then(|| LoadSummary { mean_n: sum / count, extremes_n })
    }
}

/// The load that a sample tells, N. Over a whole cycle friction and inertia cancel in the pressures' force.
fn load_of(sample: &Sample, areas: Option<PistonAreas>) -> Option<f64> {
    let finite = |signal| sample.get(signal).filter(|value| value.is_finite());
    finite(Signal::Load).or_else(|| {
        let areas = areas?;
        Some(areas.annulus_m2 * finite(Signal::PRod)? - areas.cap_m2 * finite(Signal::PCap)?)
    })
}
