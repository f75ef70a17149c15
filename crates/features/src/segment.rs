//! Where the duty cycles are: found from the command alone, by the shape of two of its strokes.
//!
//! The filtered command is averaged into bins of 50 ms (configurable) and compared with two templates, the cycle's
//! first and last large stroke, by normalised cross-correlation: independent of offset and scale, which leaks,
//! loads and valves change. A maximum of the last stroke's correlation looks back for the first stroke's at
//! the planned distance; the two anchor the cycle. Standstill between cycles does not matter.

use serde::{Deserialize, Serialize};

/// A stroke by whose shape cycles are found; `T` holds the template's bins, borrowed by a reader, owned by a model's file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Anchor<T> {
    /// Time in the cycle at which the template ends, s.
    pub end_s: f64,
    /// Least normalised correlation, −1 … 1, that counts as this stroke.
    pub least_correlation: f64,
    /// Normalised correlation that no other part of a cycle reaches: the match need not wait for a better one.
    pub sure_correlation: f64,
    /// Least standard deviation of the command over the stroke, share of full command.
    pub least_deviation: f64,
    /// Shape in bins, mean 0 and sum of squares 1.
    pub template: T,
}

impl<T: AsRef<[f32]>> Anchor<T> {
    /// The same, its template borrowed.
    pub fn borrowed(&self) -> Anchor<&[f32]> {
        Anchor {
            end_s: self.end_s,
            least_correlation: self.least_correlation,
            sure_correlation: self.sure_correlation,
            least_deviation: self.least_deviation,
            template: self.template.as_ref(),
        }
    }
}

/// What the machine is asked to do in a part of the cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PhaseKind {
    /// The demand moves.
    Stroke,
    /// The demand stands.
    Hold,
}

/// A part of the cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Phase {
    /// Start in the cycle, s.
    pub from_s: f64,
    /// End in the cycle, s.
    pub to_s: f64,
    /// Moving or standing.
    pub kind: PhaseKind,
}

/// A direction in the space of cycle-aligned bins, such as a principal component.
#[derive(Debug, Clone, Copy)]
pub struct Projection<'m> {
    /// Bin values to subtract.
    pub mean: &'m [f32],
    /// Direction.
    pub loading: &'m [f32],
}

/// Several of them in one piece of memory: of each the mean, then the loading.
#[derive(Debug, Clone, Copy)]
pub struct Projections<'m> {
    bins: usize,
    values: &'m [f32],
}

impl<'m> Projections<'m> {
    /// No projection at all; cycles are not binned then.
    pub const NONE: Projections<'static> = Projections { bins: 0, values: &[] };

    /// Those of cycles of so many bins; what does not fill a whole projection at the end is left out.
    pub const fn new(bins: usize, values: &'m [f32]) -> Self {
        Projections { bins, values }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.get(0).is_none()
    }

    /// The projection of that index.
    pub fn get(&self, index: usize) -> Option<Projection<'m>> {
        let (mean, loading) =
            self.values.chunks_exact((2 * self.bins).max(1)).nth(index)?.split_at_checked(self.bins)?;
        (self.bins > 0).then_some(Projection { mean, loading })
    }
}

/// A crossing of the demand that tells where cycles begin, for logs that have the demand.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DemandMark {
    /// Level that is crossed, m.
    pub level_m: f64,
    /// Time in the cycle of the crossing, s.
    pub at_s: f64,
    /// Upwards, or downwards.
    pub rising: bool,
}

/// A duty cycle as the monitor must know it.
#[derive(Debug, Clone, Copy)]
pub struct CycleDefinition<'m> {
    /// Samples a second.
    pub sample_rate_hz: f64,
    /// Period, s.
    pub period_s: f64,
    /// Samples in a bin.
    pub bin_samples: usize,
    /// First and last stroke.
    pub anchors: [Anchor<&'m [f32]>; 2],
    /// Where the demand tells the start of a cycle.
    pub demand_mark: Option<DemandMark>,
    /// How far the distance between the strokes may be off plan, share of the period.
    pub tolerance: f64,
    /// Parts of the cycle, at most [`MAX_PHASES`].
    pub phases: &'m [Phase],
    /// Projections of the cycle's bins.
    pub projections: Projections<'m>,
}

/// Most phases of a cycle.
pub const MAX_PHASES: usize = 16;
/// Most bins of a template.
pub const MAX_TEMPLATE_BINS: usize = 128;
/// Most bins of a cycle.
pub const MAX_CYCLE_BINS: usize = 512;
/// A sure match is confirmed after this time, in which a still better one may follow, share of the period.
const CONFIRM_SHARE: f64 = 0.05;
/// Of two matches closer than this the better one is the stroke; a match that is not sure waits that long.
const RIVAL_SHARE: f64 = 0.4;

impl CycleDefinition<'_> {
    /// Samples of a whole cycle.
    pub fn cycle_samples(&self) -> usize {
        (self.period_s * self.sample_rate_hz) as usize
    }

    /// Least length of the ring buffer that [`CycleState`](crate::CycleState) needs: a cycle, what the distance
    /// between the strokes may stretch, and the time until a stroke is confirmed.
    pub fn ring_samples(&self) -> usize {
        ((1.0 + 2.0 * self.tolerance + RIVAL_SHARE + CONFIRM_SHARE) * self.period_s * self.sample_rate_hz)
            as usize
            + 2 * self.bin_samples
    }

    /// Bins of a whole cycle.
    pub fn cycle_bins(&self) -> usize {
        self.cycle_samples().checked_div(self.bin_samples).unwrap_or(0)
    }

    /// Time from the last stroke's anchor to the cycle's end as planned, s.
    pub(crate) fn after_last_stroke_s(&self) -> f64 {
        self.period_s - self.anchors[1].end_s
    }

    /// Time between a cycle's strokes over the planned one: below 1 for a cycle that runs faster.
    pub(crate) fn pace_of(&self, span: &Span) -> f64 {
        (span.anchors[1] - span.anchors[0]) / self.planned_distance()
    }

    /// Samples between the two anchors as planned.
    fn planned_distance(&self) -> f64 {
        (self.anchors[1].end_s - self.anchors[0].end_s) * self.sample_rate_hz
    }

    fn tolerance_samples(&self) -> f64 {
        self.tolerance * self.period_s * self.sample_rate_hz
    }

    fn rival_samples(&self) -> f64 {
        RIVAL_SHARE * self.period_s * self.sample_rate_hz
    }

    fn confirm_samples(&self) -> f64 {
        CONFIRM_SHARE * self.period_s * self.sample_rate_hz
    }
}

/// A place where a stroke's template matches best.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Match {
    /// Sample number of the template's end.
    end: f64,
    /// Normalised correlation.
    correlation: f64,
}

/// A cycle's place in the stream of samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// Sample number at which the cycle begins.
    pub start: i64,
    /// Sample number just after the cycle.
    pub end: i64,
    /// Sample numbers of the two anchors.
    pub anchors: [f64; 2],
}

/// What a sample reveals about cycles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum SegmentEvent {
    /// A cycle, of which the last samples may be still to come.
    Cycle(Span),
    /// A last stroke without its first one at the planned distance.
    OrphanedLastStroke(Orphan),
}

/// A stroke without its counterpart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Orphan {
    /// Sample number of its end.
    pub(crate) end: i64,
    /// How well it matches.
    pub(crate) correlation: f64,
}

/// First strokes that are remembered until a last stroke looks back for its own.
const REMEMBERED: usize = 8;

/// What the segmentation remembers.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SegmentState {
    bins: [f32; MAX_TEMPLATE_BINS],
    bin_sum: f64,
    bin_fill: usize,
    bin_count: i64,
    /// The last two correlations of each anchor.
    correlations: [[f64; 2]; 2],
    first: [Option<Match>; REMEMBERED],
    last: Option<Match>,
}

impl Default for SegmentState {
    fn default() -> Self {
        SegmentState {
            bins: [0.0; MAX_TEMPLATE_BINS],
            bin_sum: 0.0,
            bin_fill: 0,
            bin_count: 0,
            correlations: [[-1.0; 2]; 2],
            first: [None; REMEMBERED],
            last: None,
        }
    }
}

impl SegmentState {
    /// Start of the cycle whose first stroke has been seen and whose last one may still come, at sample `now`, and how
    /// well that stroke matches.
    pub(crate) fn cycle_under_way(&self, definition: &CycleDefinition<'_>, now: i64) -> Option<(i64, f64)> {
        let longest =
            definition.planned_distance() + definition.tolerance_samples() + definition.confirm_samples();
        let mut best: Option<&Match> = None;
        for first in self.first.iter().flatten().filter(|first| now as f64 - first.end < longest) {
            if best.is_none_or(|best| first.correlation > best.correlation) {
                best = Some(first);
            }
        }
        let rate = definition.sample_rate_hz;
        best.map(|first| {
            let start = libm::round(first.end - definition.anchors[0].end_s * rate) as i64;
            (start, first.correlation)
        })
    }

    /// Start of the earliest cycle of which the strokes are not confirmed yet, at sample `now`.
    pub(crate) fn awaited(&self, definition: &CycleDefinition<'_>, now: i64) -> Option<i64> {
        let rate = definition.sample_rate_hz;
        let of_last = self.last.map(|last| libm::round(last.end - definition.anchors[1].end_s * rate) as i64);
        let of_first = self.cycle_under_way(definition, now).map(|(start, _)| start);
        of_last.into_iter().chain(of_first).min()
    }

    /// Takes sample number `now`.
    #[inline]
    pub(crate) fn push(
        &mut self,
        definition: &CycleDefinition<'_>,
        now: i64,
        command: f64,
    ) -> Option<SegmentEvent> {
        self.bin_sum += command;
        self.bin_fill += 1;
        if self.bin_fill < definition.bin_samples {
            return None;
        }
        let mean = self.bin_sum / self.bin_fill as f64;
        self.bin_sum = 0.0;
        self.bin_fill = 0;
        self.bins[(self.bin_count as usize) % MAX_TEMPLATE_BINS] = mean as f32;
        self.bin_count += 1;
        self.push_bin(definition, now)
    }

    fn push_bin(&mut self, definition: &CycleDefinition<'_>, now: i64) -> Option<SegmentEvent> {
        for which in 0..2 {
            let correlation = self.correlation(&definition.anchors[which]);
            let [before, peak] = self.correlations[which];
            self.correlations[which] = [peak, correlation];
            let is_maximum =
                peak >= definition.anchors[which].least_correlation && peak > before && peak >= correlation;
            if is_maximum {
                // The vertex of the parabola through the three correlations around the maximum.
                let curvature = before - 2.0 * peak + correlation;
                let shift = if curvature < 0.0 { 0.5 * (before - correlation) / curvature } else { 0.0 };
                let bin_samples = definition.bin_samples as f64;
                let end = (now + 1) as f64 - bin_samples * (1.0 - shift);
                self.matched(which, Match { end, correlation: peak }, definition.confirm_samples());
            }
        }
        let last = self.last?;
        let sure = last.correlation >= definition.anchors[1].sure_correlation;
        let wait = if sure { definition.confirm_samples() } else { definition.rival_samples() };
        if (now as f64 - last.end) < wait {
            return None;
        }
        self.last = None;
        Some(self.cycle_ending_with(definition, last))
    }

    /// The stream ends: the last stroke that was waiting for a better one is the best that there is.
    pub(crate) fn flush(&mut self, definition: &CycleDefinition<'_>) -> Option<SegmentEvent> {
        let last = self.last.take()?;
        Some(self.cycle_ending_with(definition, last))
    }

    /// Notes a match; of two that are close together the better one counts.
    fn matched(&mut self, which: usize, new: Match, close: f64) {
        if which == 1 {
            if self.last.is_none_or(|old| new.correlation > old.correlation) {
                self.last = Some(new);
            }
            return;
        }
        if let Some(old) = self.first.iter_mut().flatten().find(|old| new.end - old.end < close) {
            if new.correlation > old.correlation {
                *old = new;
            }
            return;
        }
        self.first.rotate_right(1);
        self.first[0] = Some(new);
    }

    fn cycle_ending_with(&mut self, definition: &CycleDefinition<'_>, last: Match) -> SegmentEvent {
        let planned = definition.planned_distance();
        let tolerance = definition.tolerance_samples();
        let mut best: Option<Match> = None;
        for first in self.first.iter().flatten() {
            let fits = libm::fabs(last.end - first.end - planned) <= tolerance;
            let is_rivalled = self.first.iter().flatten().any(|other| {
                other.correlation > first.correlation
                    && libm::fabs(other.end - first.end) < definition.rival_samples()
            });
            if fits && !is_rivalled && best.is_none_or(|best| first.correlation > best.correlation) {
                best = Some(*first);
            }
        }
        let Some(first) = best else {
            let end = libm::round(last.end) as i64;
            return SegmentEvent::OrphanedLastStroke(Orphan { end, correlation: last.correlation });
        };
        // What came after the cycle's last stroke is the next cycle's: a last stroke that waits for a better one is confirmed when that
        // cycle has long begun.
        for slot in &mut self.first {
            *slot = slot.filter(|first| first.end > last.end);
        }
        let rate = definition.sample_rate_hz;
        SegmentEvent::Cycle(Span {
            start: libm::round(first.end - definition.anchors[0].end_s * rate) as i64,
            end: libm::round(last.end + definition.after_last_stroke_s() * rate) as i64,
            anchors: [first.end, last.end],
        })
    }

    /// Normalised correlation of the newest bins with the template; −1 before there are enough bins, or
    /// where the command hardly moves.
    fn correlation(&self, anchor: &Anchor<&[f32]>) -> f64 {
        let n = anchor.template.len().min(MAX_TEMPLATE_BINS);
        if n == 0 || self.bin_count < n as i64 {
            return -1.0;
        }
        let oldest = (self.bin_count - n as i64) as usize;
        // Around the oldest bin, so that the sum of squares does not cancel.
        let pivot = self.bins[oldest % MAX_TEMPLATE_BINS];
        let (mut product, mut sum, mut squares) = (0.0f64, 0.0f64, 0.0f64);
        for (index, weight) in anchor.template.iter().take(n).enumerate() {
            let value = f64::from(self.bins[(oldest + index) % MAX_TEMPLATE_BINS] - pivot);
            product += f64::from(*weight) * value;
            sum += value;
            squares += value * value;
        }
        let n = n as f64;
        let deviation = squares - sum * sum / n;
        if deviation > n * anchor.least_deviation * anchor.least_deviation {
            product / libm::sqrt(deviation)
        } else {
            -1.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn projections_are_cut_out_of_one_piece_of_memory() {
        let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0];
        let projections = Projections::new(2, &values);
        let parts = |index| projections.get(index).map(|projection| (projection.mean, projection.loading));
        assert_eq!(parts(1), Some((&[5.0, 6.0][..], &[7.0, 8.0][..])));
        assert!(parts(2).is_none() && !projections.is_empty());
        assert!(Projections::NONE.is_empty() && Projections::new(0, &values).is_empty());
    }
}
