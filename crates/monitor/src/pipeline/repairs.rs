//! What the repair log's entries change, and what the cycles after them say.

use seepd_features::{Reason, RejectedCycle, ValidCycle};
use seepd_model::causes::{ChangeVerdict, Explanation};

use super::monitor::{CycleEstimator, Heeded};
use super::progress::Progress;
use super::{MonitorConfig, Pipeline};
use crate::baseline::CusumFinding;
use crate::event::{Event, Flag, NoticeKind};
use crate::repair::{Judgement, Repair, RepairKind, RepairVerdict, Repaired};

/// Entries that are remembered: the log itself has all of them.
const REMEMBERED: usize = 200;

impl Pipeline {
    /// Heeds an entry of the repair log from the next cycle on. `false` where cycles do not count anew for it: it was heeded before, or
    /// lies before the end of the baseline.
    pub fn repaired(&mut self, repair: &Repair, sink: &mut impl FnMut(&Event<'_>)) -> bool {
        if self.progress.repairs.iter().any(|known| known.repair.is_same(repair)) {
            return false;
        }
        let has_leak = self.finding() == CusumFinding::Leak || self.progress.alarm.level() >= Flag::Watch;
        let leak_before_m2 = self.progress.recent_area_m2().filter(|_| has_leak);
        let heeded = self.monitors.iter_mut().map(|monitor| monitor.estimator.heed(repair, leak_before_m2));
        let heeded = heeded.reduce(worse).unwrap_or(Heeded::Anew);
        if let Some(relative) = self.relative.as_mut().filter(|_| repair.what != RepairKind::Other) {
            relative.begin_anew();
        }
        self.progress.note_repair(&self.config, repair, heeded, sink);
        heeded == Heeded::Anew
    }

    /// The entries that were heeded, in their order.
    pub fn repairs(&self) -> &[Repaired] {
        &self.progress.repairs
    }

    /// Takes them up where an earlier run left them.
    pub fn restore_repairs(&mut self, repairs: Vec<Repaired>) {
        self.progress.repairs = repairs;
    }
}

/// Of two duty cycles the one whose baseline needs a person counts, then the one for which cycles count anew.
fn worse(a: Heeded, b: Heeded) -> Heeded {
    match (a, b) {
        (Heeded::Within, _) | (_, Heeded::Within) => Heeded::Within,
        (Heeded::Anew, _) | (_, Heeded::Anew) => Heeded::Anew,
        (Heeded::Known, Heeded::Known) => Heeded::Known,
    }
}

/// A cycle during which something was done to the machine.
pub(super) fn of_two_machines(cycle: &ValidCycle<'_>) -> RejectedCycle {
    RejectedCycle { start_ns: cycle.start_ns, end_ns: cycle.end_ns, reason: Reason::Incomplete }
}

impl Progress {
    /// Whether a cycle began before the last repair: it is of no one machine.
    pub(super) fn was_repaired_within(&self, cycle: &ValidCycle<'_>) -> bool {
        self.anew_from_ns.is_some_and(|from_ns| cycle.start_ns < from_ns)
    }

    fn note_repair(
        &mut self,
        config: &MonitorConfig,
        repair: &Repair,
        heeded: Heeded,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        let done = repair.in_words();
        // Before the first sample there is no other time.
        let now_ns = self.first_ns.map_or(repair.at_ns, |_| self.newest_ns);
        let (notice, text, verdict) = match heeded {
            Heeded::Anew => {
                let text = format!("{done}: {}", repair.what.consequence());
                let is_judged = repair.what != RepairKind::Other;
                (NoticeKind::RepairNoted, text, (!is_judged).then_some(RepairVerdict::NotSeen))
            }
            Heeded::Known => {
                let text = format!("{done} before the baseline was learned, which knows it");
                (NoticeKind::RepairNoted, text, Some(RepairVerdict::NotSeen))
            }
            Heeded::Within => {
                let text = format!(
                    "{done} while the baseline was being learned, which so is of two machines: learn a new one"
                );
                (NoticeKind::RepairContradicted, text, Some(RepairVerdict::Contradicted))
            }
        };
        if self.repairs.len() >= REMEMBERED {
            self.repairs.remove(0);
        }
        let told = verdict.map(|_| text.clone());
        let cycle = self.cycle;
        self.repairs.push(Repaired { repair: repair.clone(), cycle, verdict, text: told });
        if heeded != Heeded::Known {
            self.tell(config, None, (notice, text), now_ns, sink);
        }
        if heeded == Heeded::Anew && repair.what != RepairKind::Other {
            self.anew_from_ns = Some(now_ns);
        }
        if heeded == Heeded::Anew && repair.what == RepairKind::SealReplaced {
            self.recent = 0;
            if let Some(change) = self.alarm.begin_anew() {
                sink(&self.flag_event(config, change, now_ns));
            }
        }
    }

    /// Holds the entries that have no verdict yet against a cycle with an estimate.
    pub(super) fn judge_repairs(
        &mut self,
        config: &MonitorConfig,
        estimator: &mut CycleEstimator,
        at_ns: i64,
        leak_m2: f64,
        sink: &mut impl FnMut(&Event<'_>),
    ) {
        if estimator.aftercare.is_empty() {
            return;
        }
        let (explained, lpm_per_m2) = (estimator.explained.as_ref(), config.flow_lpm(1.0));
        let mut judged: Vec<Judgement> = Vec::new();
        estimator.aftercare.retain_mut(|care| match care.take(leak_m2, explained, lpm_per_m2) {
            Some(judgement) => {
                judged.push(judgement);
                false
            }
            None => true,
        });
        for Judgement { repair, verdict, text } in judged {
            if let Some(known) = self.repairs.iter_mut().find(|known| known.repair.is_same(&repair))
                && known.verdict.is_none_or(|before| before < verdict)
            {
                (known.verdict, known.text) = (Some(verdict), Some(text.clone()));
            }
            let notice = match verdict {
                RepairVerdict::Contradicted => NoticeKind::RepairContradicted,
                RepairVerdict::BorneOut | RepairVerdict::NotSeen => NoticeKind::RepairJudged,
            };
            self.tell(config, estimator.name.as_deref(), (notice, text), at_ns, sink);
        }
    }
}

impl CycleEstimator {
    /// The repair that has brought what is named, while its verdict is due.
    pub(super) fn repair_behind(&self, explanation: &Explanation) -> Option<RepairKind> {
        let ChangeVerdict::Named(first, second) = explanation.verdict else { return None };
        let kind = explanation.candidate(second.unwrap_or(first))?.kind;
        let care = self.aftercare.iter().rev().find(|care| care.brought(kind))?;
        Some(care.repair().what).filter(|what| *what != RepairKind::SealReplaced)
    }
}
