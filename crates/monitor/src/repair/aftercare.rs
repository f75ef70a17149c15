//! Holds an entry of the repair log against the cycles before and after it.

use seepd_model::causes::{Candidate, Explanation, Kind};
use serde::{Deserialize, Serialize};

use super::{Repair, RepairKind, RepairVerdict};
use crate::cause::condition::{size_of, words_of};

/// Cycles with an estimate after which the data have their say: the mean of so many has a third of one cycle's noise, and the CUSUM finds
/// what is to be seen in fewer.
pub const JUDGED_AFTER: u32 = 12;
/// From this probability on a cause counts as seen: one of two that look alike does.
const SEEN_FROM: f64 = 0.3;
/// A leak of this share of that before the repair stands as before.
const STANDS_FROM: f64 = 0.7;
/// A leak of this share of that before the repair is still there.
const GONE_BELOW: f64 = 0.3;
/// Sizes that differ by less than this share are the same.
const SAME_SHARE: f64 = 0.3;

/// A cause that a repair is about, as the data show it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Seen {
    kind: Kind,
    size: f64,
    interval90: [f64; 2],
}

impl Seen {
    fn of(what: RepairKind, explanation: &Explanation) -> Option<Self> {
        let is_it = |one: &&Candidate| what.is_about(one.kind.cause) && one.probability >= SEEN_FROM;
        let Candidate { kind, size, interval90, .. } = *explanation.candidates().iter().find(is_it)?;
        Some(Seen { kind, size, interval90 })
    }

    fn words(&self) -> &'static str {
        words_of(self.kind.cause, self.kind.side)
    }

    fn told_size(&self) -> String {
        let Seen { kind, size, interval90 } = *self;
        size_of(&Candidate { kind, probability: 1.0, size, interval90 })
    }

    /// Whether it is the same as before: within a share, or within what the sizes leave open.
    fn stands_as(&self, before: &Seen) -> bool {
        let half = |seen: &Seen| 0.5 * (seen.interval90[1] - seen.interval90[0]);
        let open = half(self).hypot(half(before)).max(SAME_SHARE * before.size.abs());
        // A size within what is open of 0 would stand as anything.
        self.kind == before.kind && (self.size - before.size).abs() <= open.min(0.5 * before.size.abs())
    }
}

/// An entry on the way to its verdict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Aftercare {
    repair: Repair,
    /// The leak before, where one was found, m².
    leak_before_m2: Option<f64>,
    cause_before: Option<Seen>,
    /// Cycles with an estimate since.
    cycles: u32,
    /// Their mean, m².
    leak_after_m2: f64,
}

/// What the data say of an entry.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Judgement {
    /// The entry.
    pub repair: Repair,
    /// The verdict.
    pub verdict: RepairVerdict,
    /// The same in words.
    pub text: String,
}

impl Aftercare {
    /// Begins with what is known before the repair: the leak where one was found, and the last explanation.
    pub(crate) fn begin(
        repair: &Repair,
        leak_before_m2: Option<f64>,
        explained: Option<&Explanation>,
    ) -> Self {
        Aftercare {
            repair: repair.clone(),
            leak_before_m2: leak_before_m2.filter(|_| repair.what == RepairKind::SealReplaced),
            cause_before: explained.and_then(|explanation| Seen::of(repair.what, explanation)),
            cycles: 0,
            leak_after_m2: 0.0,
        }
    }

    /// The entry.
    pub fn repair(&self) -> &Repair {
        &self.repair
    }

    /// Whether it is meant to change what has just been found, and that was not there before.
    pub(crate) fn brought(&self, kind: Kind) -> bool {
        self.repair.what.is_about(kind.cause) && self.cause_before.is_none_or(|before| before.kind != kind)
    }

    /// Takes a cycle after the repair; the verdict once there are enough.
    pub(crate) fn take(
        &mut self,
        leak_m2: f64,
        explained: Option<&Explanation>,
        lpm_per_m2: f64,
    ) -> Option<Judgement> {
        self.cycles += 1;
        self.leak_after_m2 += (leak_m2 - self.leak_after_m2) / f64::from(self.cycles);
        if self.cycles < JUDGED_AFTER {
            return None;
        }
        let (verdict, text) = match self.repair.what {
            RepairKind::SealReplaced => self.of_seal(lpm_per_m2),
            what => self.of_cause(explained.and_then(|explanation| Seen::of(what, explanation)), explained),
        };
        let text = format!("{}{text}", self.repair.what.words());
        Some(Judgement { repair: self.repair.clone(), verdict, text })
    }

    fn of_seal(&self, lpm_per_m2: f64) -> (RepairVerdict, String) {
        let now = lpm_per_m2 * self.leak_after_m2;
        let Some(before_m2) = self.leak_before_m2 else {
            let text = format!(": no leak had been found before, and there is {now:.3} L/min now");
            return (RepairVerdict::NotSeen, text);
        };
        let before = lpm_per_m2 * before_m2;
        let told = format!("{now:.3} L/min now, {before:.3} L/min before");
        match self.leak_after_m2 / before_m2 {
            share if share >= STANDS_FROM => (
                RepairVerdict::Contradicted,
                format!(
                    ", but the leak stands as before ({told}): was it this cylinder's seal, and is it the seal that leaks?"
                ),
            ),
            share if share >= GONE_BELOW => (
                RepairVerdict::Contradicted,
                format!(", but there is still a leak ({told}): was the new seal damaged as it was mounted?"),
            ),
            _ => (RepairVerdict::BorneOut, format!(", and the leak is gone ({told})")),
        }
    }

    fn of_cause(&self, after: Option<Seen>, explained: Option<&Explanation>) -> (RepairVerdict, String) {
        let not_seen = |text: &str| (RepairVerdict::NotSeen, text.to_owned());
        match (self.cause_before, after) {
            _ if explained.is_none() => not_seen(
                "; whether it has changed anything cannot be told without a baseline that names causes",
            ),
            (None, None) => not_seen(", but the command shows no change"),
            (Some(before), None) => (
                RepairVerdict::BorneOut,
                format!(", and what was there before is gone ({}, {})", before.words(), before.told_size()),
            ),
            (None, Some(after)) => (
                RepairVerdict::BorneOut,
                format!(
                    ", and has brought a change ({}, {}): leaks are sized beside it",
                    after.words(),
                    after.told_size()
                ),
            ),
            (Some(before), Some(after)) if after.stands_as(&before) => (
                RepairVerdict::Contradicted,
                format!(
                    ", but what was there stands as before ({}, {} now, {} before): was it this axis?",
                    after.words(),
                    after.told_size(),
                    before.told_size()
                ),
            ),
            (Some(before), Some(after)) => (
                RepairVerdict::BorneOut,
                format!(
                    ", and has changed what was there ({}, {} now; {}, {} before)",
                    after.words(),
                    after.told_size(),
                    before.words(),
                    before.told_size()
                ),
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seepd_model::causes::{Cause, SizeUnit};

    const LPM_PER_M2: f64 = 5.3e6;

    fn repair(what: RepairKind) -> Repair {
        Repair { at_ns: 0, what, who: None, note: None }
    }

    fn of_seal(before_m2: Option<f64>, after_m2: f64) -> (u32, Judgement) {
        let mut care = Aftercare::begin(&repair(RepairKind::SealReplaced), before_m2, None);
        let mut cycles = 0;
        loop {
            cycles += 1;
            if let Some(judgement) = care.take(after_m2, None, LPM_PER_M2) {
                return (cycles, judgement);
            }
        }
    }

    #[test]
    fn a_new_seal_is_believed_by_what_leaks_after_it() {
        let (cycles, stands) = of_seal(Some(1e-7), 0.9e-7);
        assert_eq!((cycles, stands.verdict), (JUDGED_AFTER, RepairVerdict::Contradicted));
        assert!(
            stands.text.contains("but the leak stands as before (0.477 L/min now, 0.530"),
            "{}",
            stands.text
        );
        let (_, still) = of_seal(Some(1e-7), 0.5e-7);
        assert!(
            still.verdict == RepairVerdict::Contradicted && still.text.contains("still a leak"),
            "{still:?}"
        );
        assert_eq!(of_seal(Some(1e-7), 1e-9).1.verdict, RepairVerdict::BorneOut);
        assert_eq!(of_seal(None, 1e-9).1.verdict, RepairVerdict::NotSeen);
    }

    #[test]
    fn a_null_that_stands_contradicts_and_one_that_moved_does_not() {
        let kind = Kind { cause: Cause::ValveNull, side: None, unit: SizeUnit::Share };
        let seen = |size: f64| Seen { kind, size, interval90: [size - 2e-4, size + 2e-4] };
        assert!(seen(0.0081).stands_as(&seen(0.008)));
        assert!(!seen(0.003).stands_as(&seen(0.008)) && !seen(-0.008).stands_as(&seen(0.008)));
        // However wide the intervals are, a null at 0 does not stand as one that is off.
        let wide = Seen { interval90: [-0.02, 0.02], ..seen(0.0) };
        assert!(!wide.stands_as(&seen(0.008)));
        let other = Seen { kind: Kind { cause: Cause::ValveHysteresis, ..kind }, ..seen(0.008) };
        assert!(!other.stands_as(&seen(0.008)));
    }
}
