//! Where the duty cycles are: found from the command alone, by the shape of its strokes.
//!
//! The filtered command is averaged into bins of 50 ms (configurable) and compared with the strokes' templates by
//! normalised cross-correlation: independent of offset and scale, which leaks, loads and valves change. Two large strokes at
//! a planned distance anchor a cycle, or a row of all of them where two do not tell it. Standstill between cycles does not matter.

mod pair;
mod row;

use serde::{Deserialize, Serialize};

use pair::Pair;
use row::Row;

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
    /// How much longer than planned the machine may wait for an event between the anchor before and this one, s.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub wait_s: f64,
    /// Shape in bins, mean 0 and sum of squares 1.
    pub template: T,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl<T: AsRef<[f32]>> Anchor<T> {
    /// The same, its template borrowed.
    pub fn borrowed(&self) -> Anchor<&[f32]> {
        Anchor {
            end_s: self.end_s,
            least_correlation: self.least_correlation,
            sure_correlation: self.sure_correlation,
            least_deviation: self.least_deviation,
            wait_s: self.wait_s,
            template: self.template.as_ref(),
        }
    }
}

/// The strokes by which cycles are found, in time order: two, or a row of more where two do not tell a cycle.
#[derive(Debug, Clone, Copy)]
pub struct Anchors<'m> {
    strokes: [Anchor<&'m [f32]>; MAX_ANCHORS],
    count: usize,
    /// Which of them are the largest out and the largest back, in time order.
    largest: [usize; 2],
}

impl<'m> Anchors<'m> {
    /// The largest stroke out and the largest back, the earlier one first, and the others by which cycles are found, in any order; what a
    /// cycle has beyond [`MAX_ANCHORS`] is counted and makes [`CycleReader::new`](crate::CycleReader::new) refuse.
    pub fn new(largest: [Anchor<&'m [f32]>; 2], others: impl IntoIterator<Item = Anchor<&'m [f32]>>) -> Self {
        let [first, last] = largest;
        let mut anchors = Anchors { strokes: [first; MAX_ANCHORS], count: 1, largest: [0, 0] };
        anchors.insert(last);
        others.into_iter().for_each(|other| anchors.insert(other));
        let index_of = |one: Anchor<&[f32]>| {
            let strokes = anchors.as_slice();
            strokes.iter().position(|stroke| stroke.end_s >= one.end_s).unwrap_or_default()
        };
        anchors.largest = [index_of(first), index_of(last)];
        anchors
    }

    /// Keeps the time order.
    fn insert(&mut self, one: Anchor<&'m [f32]>) {
        let at = self.as_slice().iter().take_while(|stroke| stroke.end_s <= one.end_s).count();
        if let Some(later) = self.strokes.get_mut(at..) {
            later.rotate_right(1);
            if let Some(free) = later.first_mut() {
                *free = one;
            }
        }
        self.count += 1;
    }

    /// In time order.
    pub fn as_slice(&self) -> &[Anchor<&'m [f32]>] {
        self.strokes.get(..self.count).unwrap_or(&self.strokes)
    }

    /// How many there are, those without room included.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Whether cycles are found by a row of strokes and not by two.
    pub fn is_row(&self) -> bool {
        self.count > 2
    }

    /// The earliest.
    pub fn first(&self) -> &Anchor<&'m [f32]> {
        &self.strokes[0]
    }

    /// The latest.
    pub fn last(&self) -> &Anchor<&'m [f32]> {
        self.as_slice().last().unwrap_or(&self.strokes[0])
    }

    /// The largest stroke out and the largest back, in time order.
    pub fn largest(&self) -> [&Anchor<&'m [f32]>; 2] {
        self.largest.map(|index| self.strokes.get(index).unwrap_or(&self.strokes[0]))
    }

    /// How much longer than planned a cycle may last by waiting for events, s.
    fn waits_s(&self) -> f64 {
        self.as_slice().iter().skip(1).map(|stroke| stroke.wait_s).sum()
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
    /// The strokes by which it is found.
    pub anchors: Anchors<'m>,
    /// Where the demand tells the start of a cycle.
    pub demand_mark: Option<DemandMark>,
    /// How far the distance between two strokes may be off plan, share of the period; in a row, of that distance.
    pub tolerance: f64,
    /// Parts of the cycle, at most [`MAX_PHASES`].
    pub phases: &'m [Phase],
    /// Projections of the cycle's bins.
    pub projections: Projections<'m>,
}

/// Most phases of a cycle.
pub const MAX_PHASES: usize = 16;
/// Most strokes by which a cycle is found.
pub const MAX_ANCHORS: usize = 14;
/// Most bins of a template.
pub const MAX_TEMPLATE_BINS: usize = 128;
/// Most bins of a cycle.
pub const MAX_CYCLE_BINS: usize = 512;
/// A sure match is confirmed after this time, in which a still better one may follow, share of the period.
const CONFIRM_SHARE: f64 = 0.05;
/// Of two matches closer than this the better one is the stroke, share of the period.
const RIVAL_SHARE: f64 = 0.4;

impl CycleDefinition<'_> {
    /// Samples of a whole cycle.
    pub fn cycle_samples(&self) -> usize {
        (self.period_s * self.sample_rate_hz) as usize
    }

    /// Least length of the ring buffer that [`CycleState`](crate::CycleState) needs: a cycle, what the distance
    /// between the strokes may stretch, and the time until a stroke is confirmed.
    pub fn ring_samples(&self) -> usize {
        let shares = 1.0 + 2.0 * self.tolerance + self.waiting_share() + CONFIRM_SHARE;
        let longest_s = shares * self.period_s + 2.0 * self.anchors.waits_s();
        (longest_s * self.sample_rate_hz) as usize + 2 * self.bin_samples
    }

    /// Bins of a whole cycle.
    pub fn cycle_bins(&self) -> usize {
        self.cycle_samples().checked_div(self.bin_samples).unwrap_or(0)
    }

    /// Time from the last stroke's anchor to the cycle's end as planned, s.
    pub(crate) fn after_last_stroke_s(&self) -> f64 {
        self.period_s - self.anchors.last().end_s
    }

    /// Time between a cycle's strokes over the planned one: below 1 for a cycle that runs faster.
    pub(crate) fn pace_of(&self, span: &Span) -> f64 {
        let last = self.anchors.as_slice().len() - 1;
        (span.anchors[last] - span.anchors[0]) / self.planned_distance()
    }

    /// Samples between the first and the last anchor as planned.
    fn planned_distance(&self) -> f64 {
        (self.anchors.last().end_s - self.anchors.first().end_s) * self.sample_rate_hz
    }

    /// Where a cycle lies whose anchors are at these sample numbers.
    fn span_of(&self, anchors: [f64; MAX_ANCHORS]) -> Span {
        let last = anchors[self.anchors.as_slice().len() - 1];
        Span {
            start: self.start_of(anchors[0]),
            end: libm::round(last + self.after_last_stroke_s() * self.sample_rate_hz) as i64,
            anchors,
        }
    }

    /// Start of the cycle whose first anchor is at that sample number.
    fn start_of(&self, first: f64) -> i64 {
        libm::round(first - self.anchors.first().end_s * self.sample_rate_hz) as i64
    }

    fn tolerance_samples(&self) -> f64 {
        self.tolerance * self.period_s * self.sample_rate_hz
    }

    /// How long a match that is not sure waits for a better one, share of the period: as long as the stroke may still come.
    fn waiting_share(&self) -> f64 {
        if self.anchors.is_row() { row::WAITING_SHARE } else { RIVAL_SHARE.max(2.0 * self.tolerance) }
    }

    fn waiting_samples(&self) -> f64 {
        self.waiting_share() * self.period_s * self.sample_rate_hz
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
    /// Sample numbers of the anchors, in the definition's order; those beyond its number say nothing.
    pub anchors: [f64; MAX_ANCHORS],
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

/// What the segmentation remembers.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SegmentState {
    bins: [f32; MAX_TEMPLATE_BINS],
    bin_sum: f64,
    bin_fill: usize,
    bin_count: i64,
    /// The last two correlations of each anchor.
    correlations: [[f64; 2]; MAX_ANCHORS],
    pair: Pair,
    row: Row,
}

impl Default for SegmentState {
    fn default() -> Self {
        SegmentState {
            bins: [0.0; MAX_TEMPLATE_BINS],
            bin_sum: 0.0,
            bin_fill: 0,
            bin_count: 0,
            correlations: [[-1.0; 2]; MAX_ANCHORS],
            pair: Pair::default(),
            row: Row::default(),
        }
    }
}

impl SegmentState {
    /// Start of the cycle whose first stroke has been seen and whose last one may still come, at sample `now`, and how
    /// well that stroke matches.
    pub(crate) fn cycle_under_way(&self, definition: &CycleDefinition<'_>, now: i64) -> Option<(i64, f64)> {
        if definition.anchors.is_row() {
            self.row.cycle_under_way(definition, now)
        } else {
            self.pair.cycle_under_way(definition, now)
        }
    }

    /// Start of the earliest cycle of which the strokes are not confirmed yet, at sample `now`.
    pub(crate) fn awaited(&self, definition: &CycleDefinition<'_>, now: i64) -> Option<i64> {
        let unconfirmed = if definition.anchors.is_row() {
            self.row.unconfirmed(definition)
        } else {
            self.pair.unconfirmed(definition)
        };
        let under_way = self.cycle_under_way(definition, now).map(|(start, _)| start);
        unconfirmed.into_iter().chain(under_way).min()
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
        for (which, anchor) in definition.anchors.as_slice().iter().enumerate() {
            let correlation = self.correlation(anchor);
            let [before, peak] = self.correlations[which];
            self.correlations[which] = [peak, correlation];
            if peak >= anchor.least_correlation && peak > before && peak >= correlation {
                // The vertex of the parabola through the three correlations around the maximum.
                let curvature = before - 2.0 * peak + correlation;
                let shift = if curvature < 0.0 { 0.5 * (before - correlation) / curvature } else { 0.0 };
                let bin_samples = definition.bin_samples as f64;
                let end = (now + 1) as f64 - bin_samples * (1.0 - shift);
                let found = Match { end, correlation: peak };
                if definition.anchors.is_row() {
                    self.row.matched(definition, which, found);
                } else {
                    self.pair.matched(which, found, definition.confirm_samples());
                }
            }
        }
        if definition.anchors.is_row() {
            self.row.confirmed(definition, now)
        } else {
            self.pair.confirmed(definition, now)
        }
    }

    /// The stream ends: the last stroke that was waiting for a better one is the best that there is.
    pub(crate) fn flush(&mut self, definition: &CycleDefinition<'_>) -> Option<SegmentEvent> {
        if definition.anchors.is_row() { self.row.flush(definition) } else { self.pair.flush(definition) }
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
