//! Cycles of few strokes: found by two of them at a planned distance.
//!
//! A maximum of the last stroke's correlation looks back for the first stroke's at the planned distance.

use super::{CycleDefinition, MAX_ANCHORS, Match, Orphan, SegmentEvent};

/// First strokes that are remembered until a last stroke looks back for its own.
const REMEMBERED: usize = 8;

/// The two strokes' matches.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Pair {
    first: [Option<Match>; REMEMBERED],
    last: Option<Match>,
}

impl Pair {
    /// Start of the cycle whose first stroke has been seen and whose last one may still come, at sample `now`, and how
    /// well that stroke matches.
    pub(super) fn cycle_under_way(&self, definition: &CycleDefinition<'_>, now: i64) -> Option<(i64, f64)> {
        let longest =
            definition.planned_distance() + definition.tolerance_samples() + definition.confirm_samples();
        let mut best: Option<&Match> = None;
        for first in self.first.iter().flatten().filter(|first| now as f64 - first.end < longest) {
            if best.is_none_or(|best| first.correlation > best.correlation) {
                best = Some(first);
            }
        }
        best.map(|first| (definition.start_of(first.end), first.correlation))
    }

    /// Start of the cycle whose last stroke still waits for a better match.
    pub(super) fn unconfirmed(&self, definition: &CycleDefinition<'_>) -> Option<i64> {
        let rate = definition.sample_rate_hz;
        self.last.map(|last| libm::round(last.end - definition.anchors.last().end_s * rate) as i64)
    }

    /// Notes a match; of two that are close together the better one counts.
    pub(super) fn matched(&mut self, which: usize, new: Match, close: f64) {
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

    /// What is sure at sample `now`.
    pub(super) fn confirmed(&mut self, definition: &CycleDefinition<'_>, now: i64) -> Option<SegmentEvent> {
        let last = self.last?;
        let sure = last.correlation >= definition.anchors.last().sure_correlation;
        let wait = if sure { definition.confirm_samples() } else { definition.waiting_samples() };
        if (now as f64 - last.end) < wait {
            return None;
        }
        self.flush(definition)
    }

    /// The last stroke that was waiting for a better one is the best that there is.
    pub(super) fn flush(&mut self, definition: &CycleDefinition<'_>) -> Option<SegmentEvent> {
        let last = self.last.take()?;
        Some(self.cycle_ending_with(definition, last))
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
        let mut anchors = [last.end; MAX_ANCHORS];
        anchors[0] = first.end;
        SegmentEvent::Cycle(definition.span_of(anchors))
    }
}
