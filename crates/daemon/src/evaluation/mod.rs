//! What estimates and flags are worth on logs that know the truth.
//!
//! [`record`] lays each machine's cycles beside the truth, [`sizes`] judges the estimates, [`detection`] the alarms and
//! their delay, [`roc`] every threshold that they could have.

#[cfg(feature = "train")]
pub mod causes;
pub mod detection;
pub mod record;
pub mod roc;
pub mod sizes;

use std::collections::BTreeMap;

use serde::Serialize;

use detection::{Detection, Detector};
use record::{CycleRecord, MachineRecord};
use roc::Roc;
use sizes::{Method, Sizes};

/// What counts as a leak, and as found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Conditions {
    /// Pressure difference at which leaks are given as flows, Pa.
    pub reference_dp_pa: f64,
    /// Flow of a leak of 1 m² there, L/min.
    #[serde(skip)]
    pub lpm_per_m2: f64,
    /// A machine leaks from the cycle on in which the truth is above this, L/min.
    pub onset_lpm: f64,
    /// A leak counts as found within so many cycles from its onset.
    pub within_cycles: usize,
}

impl Conditions {
    /// Whether the machine leaked while its baseline was learned.
    pub fn leaked_while_learning(&self, record: &MachineRecord) -> bool {
        record.leak_while_learning_m2().is_some_and(|leak_m2| leak_m2 * self.lpm_per_m2 > self.onset_lpm)
    }
}

/// `seepd.evaluation/1`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evaluation {
    /// `seepd.evaluation/1`.
    pub schema: &'static str,
    /// Conditions.
    #[serde(flatten)]
    pub conditions: Conditions,
    /// Machines.
    pub machines: usize,
    /// Cycles, with an estimate or not.
    pub cycles: usize,
    /// Cycles of which the truth is not known: they are in none of the figures.
    pub without_truth: usize,
    /// Machines whose baseline was learned from cycles that the truth calls leaking: their estimates count from there.
    pub learned_while_leaking: usize,
    /// Cycles without an estimate, by reason.
    pub rejected: BTreeMap<&'static str, u64>,
    /// Sizes, by method.
    pub sizes: Vec<Sizes>,
    /// Alarms, by detector.
    pub detection: Vec<Detection>,
    /// Receiver operating curves, by score.
    pub roc: Vec<Roc>,
}

impl Evaluation {
    /// Judges machines' records.
    pub fn of(records: &[MachineRecord], conditions: Conditions) -> Self {
        let cycles = || records.iter().flat_map(|record| &record.cycles);
        let mut rejected = BTreeMap::new();
        for reason in cycles().filter_map(|cycle| cycle.reason) {
            *rejected.entry(reason).or_default() += 1;
        }
        Evaluation {
            schema: "seepd.evaluation/1",
            conditions,
            machines: records.len(),
            cycles: cycles().count(),
            without_truth: cycles().filter(|cycle| cycle.truth_m2().is_none()).count(),
            learned_while_leaking: records
                .iter()
                .filter(|record| conditions.leaked_while_learning(record))
                .count(),
            rejected,
            sizes: Method::ALL.iter().filter_map(|method| Sizes::of(records, *method, &conditions)).collect(),
            detection: Detector::ALL
                .iter()
                .filter_map(|detector| Detection::of(records, *detector, &conditions))
                .collect(),
            roc: roc::Score::ALL.iter().filter_map(|score| Roc::of(records, *score, &conditions)).collect(),
        }
    }
}

/// Upper ends of the classes of leaks, L/min; the last class has none.
const CLASS_ENDS_LPM: [f64; 9] = [0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0];

/// Ends of a class of leaks, L/min.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Class {
    /// Lower end, which belongs to it.
    pub from_lpm: f64,
    /// Upper end; none for the last one.
    pub to_lpm: Option<f64>,
}

impl Class {
    /// All classes, from small to large.
    fn all() -> impl Iterator<Item = Class> {
        let starts = std::iter::once(0.0).chain(CLASS_ENDS_LPM);
        let ends = CLASS_ENDS_LPM.into_iter().map(Some).chain([None]);
        starts.zip(ends).map(|(from_lpm, to_lpm)| Class { from_lpm, to_lpm })
    }

    /// Whether a leak belongs to it. What a leak's area loses by rounding does not move it to another class.
    fn holds(&self, leak_lpm: f64) -> bool {
        let leak_lpm = leak_lpm * (1.0 + 1e-6);
        leak_lpm >= self.from_lpm && self.to_lpm.is_none_or(|to| leak_lpm < to)
    }
}

impl std::fmt::Display for Class {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.to_lpm {
            Some(to) if self.from_lpm == 0.0 => write!(f, "below {to}"),
            Some(to) => write!(f, "{} … {to}", self.from_lpm),
            None => write!(f, "from {}", self.from_lpm),
        }
    }
}

/// Whether a cycle of that truth leaks.
fn leaks(truth_m2: f64, conditions: &Conditions) -> bool {
    truth_m2 * conditions.lpm_per_m2 > conditions.onset_lpm
}

/// Cycles with their truth, in the records' order.
fn judged(records: &[MachineRecord]) -> impl Iterator<Item = (f64, &CycleRecord)> {
    records.iter().flat_map(|record| &record.cycles).filter_map(|cycle| Some((cycle.truth_m2()?, cycle)))
}

#[cfg(test)]
mod tests {
    use super::record::tests::{cycle, machine};
    use super::*;
    use seepd_monitor::event::Flag;

    pub(super) const CONDITIONS: Conditions =
        Conditions { reference_dp_pa: 7e6, lpm_per_m2: 5e6, onset_lpm: 0.005, within_cycles: 3 };

    #[test]
    fn every_leak_has_its_class() {
        for leak_lpm in [0.0, 0.019, 0.02, 0.1, 0.099_999_999, 3.0, 500.0] {
            assert_eq!(Class::all().filter(|class| class.holds(leak_lpm)).count(), 1, "{leak_lpm}");
        }
        let class = Class::all().find(|class| class.holds(0.099_999_999)).map(|class| class.to_string());
        assert_eq!(class.as_deref(), Some("0.1 … 0.2"));
        assert_eq!(Class::all().last().map(|class| class.to_string()).as_deref(), Some("from 10"));
    }

    #[test]
    fn cycles_without_truth_or_estimate_are_counted_and_judged_nowhere() {
        let mut lost = cycle(None, 1e-6, Flag::Leak);
        lost.reason = Some("gap");
        let records =
            [machine(vec![cycle(Some(1e-6), 1.1e-6, Flag::Leak), lost, cycle(None, 3e-6, Flag::Leak)])];
        let evaluation = Evaluation::of(&records, CONDITIONS);
        assert_eq!((evaluation.cycles, evaluation.without_truth), (3, 2));
        assert_eq!(evaluation.rejected, BTreeMap::from([("gap", 1)]));
        assert_eq!(evaluation.sizes.iter().map(|sizes| sizes.cycles).collect::<Vec<_>>(), [1]);
    }
}
