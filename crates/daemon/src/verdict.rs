//! What a condition means for whoever stands before the machine, with what to do. Report and page say it in these words.

use seepd_monitor::event::Flag;
use seepd_monitor::reason::UNCONFIRMED;
use serde::Serialize;

use crate::reasons::{explanation, meaning};

/// A condition in words.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Verdict {
    /// Whether the machine is well, in a sentence.
    pub verdict: String,
    /// What to do, in a sentence; commands stand between backticks.
    pub to_do: &'static str,
}

impl Verdict {
    /// Of a flag, the reason of one without an estimate, and whether cycles are compared with the machine's own healthy ones alone.
    pub fn of(flag: Flag, reason: Option<&str>, is_relative: bool) -> Self {
        let (verdict, to_do) = match flag {
            Flag::NoEstimate => {
                let reason = reason.unwrap_or_default();
                let cure = explanation(reason).map_or("See what the events below say.", |reason| reason.cure);
                return Verdict { verdict: no_estimate(reason), to_do: cure };
            }
            Flag::Healthy if is_relative => {
                ("The machine is as it was at its baseline.", "Nothing needs to be done.")
            }
            Flag::Healthy => ("There is no leak that matters.", "Nothing needs to be done."),
            _ if is_relative => (
                "The machine is not as it was at its baseline.",
                "Look what has changed at that time: seal, valve, load, oil or program. If it was on purpose, learn a new baseline.",
            ),
            Flag::Watch => (
                "There is a leak to keep an eye on.",
                "Have a seal kit ready, and look again in the next days. The machine can go on.",
            ),
            Flag::Leak => (
                "There is a leak: plan to replace the seal.",
                "Replace the seal at the next planned stop, and note the repair.",
            ),
            Flag::Severe => (
                "There is a severe leak: the machine should not run with it.",
                "Stop the machine as soon as it can be stopped, replace the seal, and note the repair.",
            ),
        };
        Verdict { verdict: verdict.into(), to_do }
    }
}

/// Why there is no estimate, as a sentence.
fn no_estimate(reason: &str) -> String {
    if reason == UNCONFIRMED {
        return "Too few estimates in a row lie above a threshold to raise a flag.".into();
    }
    match meaning(reason) {
        "" => "There is no estimate.".into(),
        meaning => format!("There is no estimate: {meaning}."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reasons::ALL;

    #[test]
    fn every_condition_has_a_sentence_and_something_to_do() {
        for flag in [Flag::Healthy, Flag::Watch, Flag::Leak, Flag::Severe] {
            for is_relative in [false, true] {
                let Verdict { verdict, to_do } = Verdict::of(flag, None, is_relative);
                assert!(verdict.ends_with('.') && to_do.ends_with('.'), "{flag:?}: {verdict} {to_do}");
            }
        }
        for reason in ALL {
            let Verdict { verdict, to_do } = Verdict::of(Flag::NoEstimate, Some(reason.name), false);
            assert!(verdict.ends_with('.') && !verdict.contains('_'), "{verdict}");
            assert_eq!(to_do, reason.cure);
        }
        let unknown = Verdict::of(Flag::NoEstimate, Some("of a later version"), false);
        assert_eq!(unknown.verdict, "There is no estimate.");
    }
}
