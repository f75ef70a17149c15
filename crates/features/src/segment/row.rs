//! Cycles of many strokes: found by the order of all of them.
//!
//! Where strokes look alike, or where events end the holds between them, two strokes at a planned distance do not tell a cycle. Here
//! every stroke has a template: what matches the first begins a row, what matches the next within its window goes on with it, and a row
//! that reaches the last stroke is a cycle. Of rows that overlap the one that matches best counts.

use super::{CycleDefinition, MAX_ANCHORS, Match, Orphan, SegmentEvent};

/// Rows that are remembered for each stroke that was their latest.
const REMEMBERED: usize = 6;
/// A row that is the first after a standstill or a gap waits that long for a better one that overlaps it, share of the period: one that
/// begins with a later stroke of the same shape ends before the right one does.
pub(super) const WAITING_SHARE: f64 = 1.0;
/// Rows with fewer strokes than this share of a cycle's are no cycle that broke off.
const TELLING_SHARE: f64 = 0.3;

/// A row of strokes so far.
#[derive(Debug, Clone, Copy)]
struct Begun {
    /// Sample numbers of its strokes' ends; the later ones repeat the latest.
    ends: [f64; MAX_ANCHORS],
    /// Sum of their correlations.
    correlations: f64,
}

impl Begun {
    /// Sample number of its latest stroke's end.
    fn end(&self) -> f64 {
        self.ends[MAX_ANCHORS - 1]
    }
}

/// The rows that are under way.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Row {
    /// By their latest stroke.
    begun: [[Option<Begun>; REMEMBERED]; MAX_ANCHORS],
    /// The best that has reached the last stroke.
    whole: Option<Begun>,
    /// One that was whole when a later cycle's was: no better one can come for it.
    settled: Option<Begun>,
    /// End of the last cycle's last stroke.
    last_end: Option<f64>,
}

impl Row {
    /// Start of the longest row that may still go on at sample `now`, and how well its strokes match.
    pub(super) fn cycle_under_way(&self, definition: &CycleDefinition<'_>, now: i64) -> Option<(i64, f64)> {
        let strokes = definition.anchors.as_slice().len();
        let (which, row) = self
            .rows()
            .filter(|(which, row)| {
                which + 1 < strokes && now as f64 - row.ends[*which] < definition.window(which + 1).1
            })
            .max_by(|(_, a), (_, b)| a.correlations.total_cmp(&b.correlations))?;
        Some((definition.start_of(row.ends[0]), row.correlations / (which + 1) as f64))
    }

    /// Start of the cycle that waits for a better row.
    pub(super) fn unconfirmed(&self, definition: &CycleDefinition<'_>) -> Option<i64> {
        self.whole.map(|row| definition.start_of(row.ends[0]))
    }

    /// Notes a match of a stroke: the best row that it continues is one stroke longer.
    pub(super) fn matched(&mut self, definition: &CycleDefinition<'_>, which: usize, new: Match) {
        let Some(before) = which.checked_sub(1) else {
            self.remember(0, Begun { ends: [new.end; MAX_ANCHORS], correlations: new.correlation });
            return;
        };
        let (shortest, longest) = definition.window(which);
        let continued = self.begun[before]
            .iter()
            .flatten()
            .filter(|row| (shortest..=longest).contains(&(new.end - row.ends[before])))
            .max_by(|a, b| a.correlations.total_cmp(&b.correlations));
        let Some(mut row) = continued.copied() else { return };
        row.ends[which..].fill(new.end);
        row.correlations += new.correlation;
        if which + 1 < definition.anchors.as_slice().len() {
            self.remember(which, row);
        } else {
            self.complete(row);
        }
    }

    /// Notes a row that has reached the last stroke: of the cycle that waits for a better one, or of the next.
    fn complete(&mut self, row: Begun) {
        match self.whole {
            Some(whole) if row.ends[0] > whole.end() => self.settled = self.whole.replace(row),
            Some(whole) if row.correlations <= whole.correlations => {}
            _ => self.whole = Some(row),
        }
    }

    fn remember(&mut self, which: usize, row: Begun) {
        self.begun[which].rotate_right(1);
        self.begun[which][0] = Some(row);
    }

    /// What is sure at sample `now`: a cycle that no better row has come for, or the loss of one whose row broke off.
    pub(super) fn confirmed(&mut self, definition: &CycleDefinition<'_>, now: i64) -> Option<SegmentEvent> {
        if let Some(row) = self.settled.take() {
            return Some(self.found(definition, &row));
        }
        if let Some(row) = self.whole {
            // Where a cycle has just ended, the next one begins: it cannot be out of step with the strokes. But not before its time: a row
            // that begins with what was left of the last stroke is a likeness.
            let coming = definition.shortest_repeat()..definition.period_samples();
            let in_step = self.last_end.is_some_and(|end| coming.contains(&(row.ends[0] - end)));
            let wait = if in_step { definition.confirm_samples() } else { definition.waiting_samples() };
            return if now as f64 - row.end() < wait { None } else { self.flush(definition) };
        }
        self.broken_off(definition, now)
    }

    /// The whole row that was waiting for a better one is the best that there is.
    pub(super) fn flush(&mut self, definition: &CycleDefinition<'_>) -> Option<SegmentEvent> {
        let row = self.whole.take()?;
        Some(self.found(definition, &row))
    }

    /// The cycle of a row; what overlaps it is none.
    fn found(&mut self, definition: &CycleDefinition<'_>, row: &Begun) -> SegmentEvent {
        let end = row.end();
        self.last_end = Some(end);
        for slot in self.begun.as_flattened_mut() {
            *slot = slot.filter(|begun| begun.ends[0] > end);
        }
        SegmentEvent::Cycle(definition.span_of(row.ends))
    }

    /// The longest of the rows that cannot go on any more, where it is no mere likeness of some strokes; all of those are forgotten.
    fn broken_off(&mut self, definition: &CycleDefinition<'_>, now: i64) -> Option<SegmentEvent> {
        let strokes = definition.anchors.as_slice().len();
        let mut longest: Option<(usize, Begun)> = None;
        for (which, slots) in self.begun.iter_mut().enumerate().take(strokes - 1) {
            let deadline = definition.window(which + 1).1 + definition.confirm_samples();
            for slot in slots {
                let Some(row) = slot.filter(|row| now as f64 - row.ends[which] > deadline) else { continue };
                *slot = None;
                if (which + 1) as f64 >= TELLING_SHARE * strokes as f64 {
                    longest = Some((which, row));
                }
            }
        }
        // A row that goes on was the same cycle.
        let (which, row) =
            longest.filter(|(_, row)| !self.rows().any(|(_, other)| other.ends[0] <= row.ends[0]))?;
        let end = libm::round(row.ends[0] + definition.planned_distance()) as i64;
        let correlation = row.correlations / (which + 1) as f64;
        Some(SegmentEvent::OrphanedLastStroke(Orphan { end, correlation }))
    }

    /// Every row with its latest stroke.
    fn rows(&self) -> impl Iterator<Item = (usize, &Begun)> {
        self.begun
            .iter()
            .enumerate()
            .flat_map(|(which, slots)| slots.iter().flatten().map(move |row| (which, row)))
    }
}

impl CycleDefinition<'_> {
    fn period_samples(&self) -> f64 {
        self.period_s * self.sample_rate_hz
    }

    /// Least samples between the last stroke of a cycle and the first of the next.
    fn shortest_repeat(&self) -> f64 {
        let planned = self.period_samples() - self.planned_distance();
        planned - self.tolerance * planned - 2.0 * self.bin_samples as f64
    }

    /// Least and most samples between the anchor before that one and itself.
    fn window(&self, which: usize) -> (f64, f64) {
        let strokes = self.anchors.as_slice();
        let (Some(before), Some(anchor)) = (strokes.get(which.wrapping_sub(1)), strokes.get(which)) else {
            return (0.0, 0.0);
        };
        let planned_s = anchor.end_s - before.end_s;
        // A bin to either side for the matches' places; events may come somewhat earlier or later than they did in the log.
        let room_s = self.tolerance * planned_s + 2.0 * self.bin_samples as f64 / self.sample_rate_hz;
        let (shortest_s, longest_s) =
            (planned_s - room_s - 0.5 * anchor.wait_s, planned_s + room_s + 1.5 * anchor.wait_s);
        (shortest_s.max(0.0) * self.sample_rate_hz, longest_s * self.sample_rate_hz)
    }
}
