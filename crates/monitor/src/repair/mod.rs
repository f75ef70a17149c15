//! What was done to the machine: entries of its repair log, and whether the data bear them out.
//!
//! A repair is told by a person and changes what the cycles after it are measured against: a new seal's leak is not the old one's. Nobody's
//! word is taken for the data, though: each entry is held against the cycles that follow, and one that they contradict is told.

mod aftercare;

use seepd_model::causes::Cause;
use serde::{Deserialize, Serialize};

pub use aftercare::{Aftercare, JUDGED_AFTER, Judgement};

/// Times before this are of a clock that began at the machine's or the log's start, and no dates: 1973, ns.
pub const FIRST_DATE_NS: i64 = 100_000_000_000_000_000;

/// What was done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RepairKind {
    /// The piston seal was replaced.
    SealReplaced,
    /// The valve was replaced.
    ValveReplaced,
    /// The valve's null was adjusted.
    ValveAdjusted,
    /// The oil was changed.
    OilChanged,
    /// The position sensor was replaced.
    SensorReplaced,
    /// The controller or its gains were changed.
    ControllerChanged,
    /// Something else, which the note says.
    Other,
}

impl RepairKind {
    /// Every kind, in the order in which a person is offered them.
    pub const ALL: [RepairKind; 7] = [
        RepairKind::SealReplaced,
        RepairKind::ValveReplaced,
        RepairKind::ValveAdjusted,
        RepairKind::OilChanged,
        RepairKind::SensorReplaced,
        RepairKind::ControllerChanged,
        RepairKind::Other,
    ];

    /// Its name in files and messages.
    pub const fn name(self) -> &'static str {
        match self {
            RepairKind::SealReplaced => "seal_replaced",
            RepairKind::ValveReplaced => "valve_replaced",
            RepairKind::ValveAdjusted => "valve_adjusted",
            RepairKind::OilChanged => "oil_changed",
            RepairKind::SensorReplaced => "sensor_replaced",
            RepairKind::ControllerChanged => "controller_changed",
            RepairKind::Other => "other",
        }
    }

    /// The kind of that name.
    pub fn of_name(name: &str) -> Option<Self> {
        RepairKind::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// The same as a clause.
    pub const fn words(self) -> &'static str {
        match self {
            RepairKind::SealReplaced => "the seal was replaced",
            RepairKind::ValveReplaced => "the valve was replaced",
            RepairKind::ValveAdjusted => "the valve was adjusted",
            RepairKind::OilChanged => "the oil was changed",
            RepairKind::SensorReplaced => "the position sensor was replaced",
            RepairKind::ControllerChanged => "the controller was changed",
            RepairKind::Other => "something was done",
        }
    }

    /// Whether it is meant to change what that cause is about.
    pub const fn is_about(self, cause: Cause) -> bool {
        matches!(
            (self, cause),
            (RepairKind::SealReplaced, Cause::PistonSeal)
                | (
                    RepairKind::ValveReplaced,
                    Cause::ValveNull | Cause::ValveLands | Cause::ValveHysteresis | Cause::ValveDeadBand
                )
                | (RepairKind::ValveAdjusted, Cause::ValveNull)
                | (RepairKind::OilChanged, Cause::OilViscosity)
                | (RepairKind::SensorReplaced, Cause::PositionScale)
                | (RepairKind::ControllerChanged, Cause::Controller)
        )
    }

    /// What follows from it, as the end of a sentence.
    pub(crate) const fn consequence(self) -> &'static str {
        match self {
            RepairKind::SealReplaced => {
                "CUSUM, trend and flags of the leak begin anew; the baseline is kept, since a new seal is a healthy one, and a leak that \
                 stands would be learned into a new baseline"
            }
            RepairKind::ValveReplaced => "a change of the valve is to be expected, and told as such",
            RepairKind::ValveAdjusted => "a shift of the valve's null is to be expected, and told as such",
            RepairKind::OilChanged => "a change of the oil is to be expected, and told as such",
            RepairKind::SensorReplaced => {
                "a change of the sensor's scale is to be expected, and told as such"
            }
            RepairKind::ControllerChanged => "a change of the controller is to be expected, and told as such",
            RepairKind::Other => "noted",
        }
    }
}

/// An entry of the repair log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Repair {
    /// When it was done, ns in the samples' time.
    #[serde(rename = "t_ns")]
    pub at_ns: i64,
    /// What was done.
    pub what: RepairKind,
    /// Who did it.
    pub who: Option<String>,
    /// What else there is to say.
    pub note: Option<String>,
}

impl Repair {
    /// Whether two entries tell of the same thing done: notes may have been edited since.
    pub fn is_same(&self, other: &Repair) -> bool {
        (self.at_ns, self.what) == (other.at_ns, other.what)
    }

    /// Whether it lies before another time, where both are dates: a log without a date tells no order.
    pub(crate) fn is_before(&self, other_ns: i64) -> bool {
        self.at_ns >= FIRST_DATE_NS && other_ns >= FIRST_DATE_NS && self.at_ns < other_ns
    }

    /// What was done, by whom, with the note.
    pub(crate) fn in_words(&self) -> String {
        let words = self.what.words();
        match (self.who.as_deref(), self.note.as_deref()) {
            (None, None) => words.to_owned(),
            (Some(text), None) | (None, Some(text)) => format!("{words} ({text})"),
            (Some(who), Some(note)) => format!("{words} ({who}: {note})"),
        }
    }
}

/// What the data say of an entry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RepairVerdict {
    /// There was nothing that the data could show, or they show nothing of it.
    NotSeen,
    /// They bear it out.
    BorneOut,
    /// They contradict it.
    Contradicted,
}

/// An entry that the monitoring has heeded.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Repaired {
    /// The entry.
    #[serde(flatten)]
    pub repair: Repair,
    /// Number of the cycle during which it was heeded.
    pub cycle: u64,
    /// What the data say of it; null until there are enough cycles.
    pub verdict: Option<RepairVerdict>,
    /// The same in words.
    pub text: Option<String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_names_lead_back_to_their_kinds() {
        for kind in RepairKind::ALL {
            assert_eq!(RepairKind::of_name(kind.name()), Some(kind));
            assert_eq!(serde_json::to_value(kind).unwrap(), kind.name());
        }
        assert_eq!(RepairKind::of_name("seal"), None);
    }

    #[test]
    fn entries_of_a_clock_without_dates_are_before_nothing() {
        let repair = |at_ns| Repair { at_ns, what: RepairKind::Other, who: None, note: None };
        let date = 1_750_000_000_000_000_000;
        assert!(repair(date - 1).is_before(date) && !repair(date).is_before(date));
        assert!(!repair(5).is_before(date) && !repair(5).is_before(6));
    }
}
