//! Whose a cycle is, where an axis has several duty cycles.
//!
//! Each monitor's reader finds cycles of its own shape; one duty cycle's strokes may look like another's, so that two find the same
//! stretch of the command, or one finds half a cycle in another's. A finding waits until no other reader has a cycle under way that
//! began before its end; of those that overlap one counts.

use seepd_features::reader::MAX_FEATURES;
use seepd_features::statistics::CycleStatistics;
use seepd_features::{Outcome, Reason, RejectedCycle, ValidCycle};

use super::monitor::CycleEstimator;

/// Two findings are about the same stretch where they share this part of the shorter one.
const SHARED: f64 = 0.25;
/// Of two cycles one that is longer by this factor explains more of the command than chance would.
const LONGER: f64 = 1.25;
/// Findings that wait, for each monitor, in ordinary times; more only where the input is damaged.
const WAITING_EACH: usize = 8;

/// What a reader has found.
pub(super) struct CycleCandidate {
    pub(super) which: usize,
    start_ns: i64,
    end_ns: i64,
    content: Content,
}

#[expect(
    clippy::large_enum_variant,
    reason = "the list of findings is allocated once, and its cycles must not be"
)]
enum Content {
    Valid { claim: Claim, features: [f64; MAX_FEATURES], count: usize, statistics: CycleStatistics },
    Rejected(Reason),
}

/// How well a monitor knows a cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Claim {
    /// Distance over its limit; above 1 it does not know it.
    out_of_distribution: f64,
    /// Whether it compares with a baseline, which tells more than training.
    by_baseline: bool,
}

impl CycleCandidate {
    /// As the reader told it.
    pub(super) fn outcome(&self) -> Outcome<'_> {
        match &self.content {
            Content::Valid { features, count, statistics, .. } => Outcome::Valid(ValidCycle {
                start_ns: self.start_ns,
                end_ns: self.end_ns,
                features: features.get(..*count).unwrap_or_default(),
                statistics,
            }),
            Content::Rejected(reason) => Outcome::Rejected(RejectedCycle {
                start_ns: self.start_ns,
                end_ns: self.end_ns,
                reason: *reason,
            }),
        }
    }

    fn claim(&self) -> Option<Claim> {
        match &self.content {
            Content::Valid { claim, .. } => Some(*claim),
            Content::Rejected(_) => None,
        }
    }

    fn length_ns(&self) -> f64 {
        self.end_ns.saturating_sub(self.start_ns).max(1) as f64
    }

    fn overlaps(&self, span_ns: (i64, i64)) -> bool {
        let shared_ns = self.end_ns.min(span_ns.1).saturating_sub(self.start_ns.max(span_ns.0));
        let other_ns = span_ns.1.saturating_sub(span_ns.0).max(1) as f64;
        shared_ns as f64 >= SHARED * self.length_ns().min(other_ns)
    }

    /// Whether this rather than the other is what the command shows.
    fn is_better_than(&self, other: &CycleCandidate) -> bool {
        let (Some(own), Some(others)) = (self.claim(), other.claim()) else {
            return self.claim().is_some();
        };
        let known = (own.out_of_distribution <= 1.0, others.out_of_distribution <= 1.0);
        if known.0 != known.1 {
            return known.0;
        }
        if known.0 && own.by_baseline != others.by_baseline {
            return own.by_baseline;
        }
        let ratio = self.length_ns() / other.length_ns();
        if known.0 && !(1.0 / LONGER..=LONGER).contains(&ratio) {
            return ratio > 1.0;
        }
        own.out_of_distribution < others.out_of_distribution
    }
}

/// What has been found and not been told yet.
pub(super) struct Arbiter {
    monitors: usize,
    waiting: Vec<CycleCandidate>,
    /// The last cycle that was told, and whether it was valid.
    told: Option<((i64, i64), bool)>,
}

impl Arbiter {
    pub(super) fn new(monitors: usize) -> Self {
        let capacity = if monitors > 1 { WAITING_EACH * monitors } else { 0 };
        Arbiter { monitors, waiting: Vec::with_capacity(capacity), told: None }
    }

    /// Takes a reader's finding.
    pub(super) fn hear(&mut self, which: usize, estimator: &CycleEstimator, outcome: &Outcome<'_>) {
        let candidate = match outcome {
            Outcome::Valid(valid) => {
                let claim = Claim {
                    out_of_distribution: estimator.out_of_distribution(valid),
                    by_baseline: estimator.is_comparing(),
                };
                let mut features = [0.0; MAX_FEATURES];
                features.iter_mut().zip(valid.features).for_each(|(slot, value)| *slot = *value);
                let count = valid.features.len().min(MAX_FEATURES);
                let content = Content::Valid { claim, features, count, statistics: *valid.statistics };
                CycleCandidate { which, start_ns: valid.start_ns, end_ns: valid.end_ns, content }
            }
            Outcome::Rejected(rejected) => CycleCandidate {
                which,
                start_ns: rejected.start_ns,
                end_ns: rejected.end_ns,
                content: Content::Rejected(rejected.reason),
            },
        };
        let is_known = self.told.is_some_and(|(span_ns, was_valid)| {
            candidate.overlaps(span_ns) && (was_valid || candidate.claim().is_none())
        });
        if !is_known {
            self.waiting.push(candidate);
        }
    }

    pub(super) fn is_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// The next finding of which it is certain that no other counts in its place; the others about the same stretch are forgotten.
    /// `begun_ns` tells when the cycle began that a monitor's reader has under way.
    pub(super) fn settled(
        &mut self,
        begun_ns: impl Fn(usize) -> Option<i64>,
        now_ns: i64,
        patience_ns: i64,
    ) -> Option<CycleCandidate> {
        let is_settled = |candidate: &CycleCandidate| {
            let late_ns = candidate.end_ns.saturating_sub((SHARED * candidate.length_ns()) as i64);
            let is_disputed = (0..self.monitors)
                .filter(|which| *which != candidate.which)
                .any(|which| begun_ns(which).is_some_and(|begun_ns| begun_ns < late_ns));
            !is_disputed || now_ns > candidate.end_ns.saturating_add(patience_ns)
        };
        let first = self.waiting.iter().position(is_settled)?;
        let best =
            (0..self.waiting.len())
                .filter(|index| {
                    let span_ns = (self.waiting[first].start_ns, self.waiting[first].end_ns);
                    *index == first || self.waiting[*index].overlaps(span_ns)
                })
                .fold(first, |best, index| {
                    if self.waiting[index].is_better_than(&self.waiting[best]) { index } else { best }
                });
        let told = self.waiting.remove(best);
        let span_ns = (told.start_ns, told.end_ns);
        self.waiting.retain(|candidate| !candidate.overlaps(span_ns));
        self.told = Some((span_ns, told.claim().is_some()));
        Some(told)
    }
}
