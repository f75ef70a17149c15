//! Every reason for which there is no estimate, once: what it means, where it comes from, how to make sure, and what helps. The pages,
//! `seepd explain` and docs/reasons.md say it in these words.

use std::fmt;

use serde::Serialize;

/// Reason of an axis that could not be started.
pub const UNUSABLE_CONFIGURATION: &str = "unusable_configuration";

/// A reason, explained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Explanation {
    /// Its name in messages, files and metrics.
    pub name: &'static str,
    /// What it means, in a line that goes on from "no estimate:".
    pub meaning: &'static str,
    /// What brings it about, whole sentences.
    pub cause: &'static str,
    /// How to make sure, with commands.
    pub check: &'static str,
    /// What helps, with the next command.
    pub cure: &'static str,
}

/// Of a reason, if it is one.
pub fn explanation(name: &str) -> Option<&'static Explanation> {
    ALL.iter().find(|reason| reason.name == name)
}

/// What a reason means, in a line; nothing for one that is unknown.
pub fn meaning(name: &str) -> &'static str {
    explanation(name).map_or("", |reason| reason.meaning)
}

impl fmt::Display for Explanation {
    /// As a section of a Markdown page.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "## `{}`\n\nNo estimate: {}.\n", self.name, self.meaning)?;
        writeln!(f, "- **Cause**: {}", self.cause)?;
        writeln!(f, "- **Check**: {}", self.check)?;
        writeln!(f, "- **Cure**: {}", self.cure)
    }
}

/// The page of all reasons, docs/reasons.md.
pub fn page() -> String {
    let sections: Vec<String> = ALL.iter().map(Explanation::to_string).collect();
    format!("{HEAD}\n{}", sections.join("\n"))
}

const HEAD: &str = "# Why there is no estimate

A cycle, or a whole record, without an estimate has a reason: `reason` in JSON and CSV, a label in the metrics, words on pages. `seepd
explain REASON` prints a section of this page, `seepd explain` the page. Where most cycles of a record have no estimate, `seepd replay`
ends with what it saw in the command and with the next command.
";

/// Every reason, in the order of a sample's way: input, cycle, model, flag.
pub const ALL: [Explanation; 18] = [
    Explanation {
        name: "stale",
        meaning: "no command comes",
        cause: "The bus is silent or down, the controller is off, or the mapping reads a frame that is not sent any more.",
        check: "`seepd inspect can0` shows what is on the bus and how often; the page's source panel says when the last frame came.",
        cure: "Bring the bus back, or set the mapping right: `seepd init can0 --dbc press.dbc` proposes one. The estimate comes back by itself.",
    },
    Explanation {
        name: "unusable_configuration",
        meaning: "this axis cannot be started",
        cause: "A file that the configuration names (model, baseline, DBC file) is missing, or is of another version or another machine.",
        check: "`seepd check /etc/seepd/seepd.toml` names the file and what is wrong with it.",
        cure: "Set it right and `systemctl reload seepd`; the other axes go on meanwhile.",
    },
    Explanation {
        name: "wrong_rate",
        meaning: "samples come at another rate than the model's",
        cause: "A model reads the command at the rate at which it was trained; the controller, the logger or a resampling tool has another one.",
        check: "`seepd inspect LOG` shows each signal's rate, `seepd check model.json` the model's.",
        cure: "Log at the model's rate, or make a model for this rate: `seepd adopt LOG --out FOLDER`.",
    },
    Explanation {
        name: "not_a_number",
        meaning: "the command was no number",
        cause: "The logger writes NaN or nothing where it has no value, or the mapping reads a float at the wrong place of a frame.",
        check: "`seepd inspect LOG` shows the range of each field; look into the log at the time of the cycle.",
        cure: "Correct the field in `[signals.command]`, or have the logger leave such samples out.",
    },
    Explanation {
        name: "out_of_range",
        meaning: "the command lay outside of −1 … 1, all the time or among other values",
        cause: "The log has the command in volts, per cent, milliamperes or counts and the mapping does not scale it; more rarely, a frame was read at the wrong place.",
        check: "`seepd inspect LOG` shows the range of each field.",
        cure: "Set `scale` (and `offset`) in `[signals.command]`: ±10 V `scale = 0.1`; per cent `scale = 0.01`; 4 … 20 mA around 12 mA `scale = 0.125` and `offset = -1.5`.",
    },
    Explanation {
        name: "stuck",
        meaning: "the command stood still while the machine had to move",
        cause: "The machine is off or in manual mode, the controller holds its output, or the logger repeats the last value when the connection is lost.",
        check: "Look at the command around the cycle: `seepd replay --html report.html LOG`. Does the machine run at that time?",
        cure: "Nothing, where the machine rests: the estimate comes back with its cycles. Else see to the connection between controller and logger.",
    },
    Explanation {
        name: "out_of_order",
        meaning: "time went backwards in it",
        cause: "The clock of the logger was set, or files were joined in the wrong order.",
        check: "`seepd inspect LOG` says where time goes backwards.",
        cure: "Give the logs one by one in their order: `seepd replay first.mcap second.mcap`; let the logger's clock be set slowly.",
    },
    Explanation {
        name: "duplicate",
        meaning: "the same cycle came once more",
        cause: "Two logs overlap, a file was named twice, or two senders use one CAN identifier.",
        check: "Compare the start times of the cycles: `seepd replay --json LOG`.",
        cure: "Nothing needs to be done: the first one counts. For a bus with two senders, filter by identifier in `[signals.command]`.",
    },
    Explanation {
        name: "gap",
        meaning: "samples are missing in it",
        cause: "Frames were lost (a full socket buffer, an overloaded logger), or the recording paused; up to 10 samples in a row are bridged.",
        check: "The summary counts `missing` and `bridged` samples; on a gateway the metrics `seepd_frames_dropped_in_socket` and `seepd_frames_missing` tell where they were lost.",
        cure: "Record with fewer signals or a larger buffer (`source.receive_buffer_bytes`); name the frame's counter in `source.counter`.",
    },
    Explanation {
        name: "incomplete",
        meaning: "it begins before the log or ends after it, or a stroke is missing",
        cause: "At the ends of a log it is ordinary, and for the cycle during which a repair was noted. For most cycles of a log it means that the model knows another duty cycle: other strokes, or another period.",
        check: "The summary says at what period the command repeats and which cycles the model knows; `seepd check model.json` has the latter too.",
        cure: "Describe this machine: `seepd adopt LOG --out FOLDER`. Several duty cycles of one machine: docs/baseline.md.",
    },
    Explanation {
        name: "no_cycle_yet",
        meaning: "no complete cycle has come yet",
        cause: "The program has just been started, or the log is shorter than a cycle.",
        check: "Wait for two periods, or read a longer log.",
        cure: "Wait: it comes by itself. If it does not, this becomes `no_cycle_found`.",
    },
    Explanation {
        name: "no_cycle_found",
        meaning: "no duty cycle is found in the command",
        cause: "The machine runs by hand or rests, the mapped field is not the valve command, or the model knows another duty cycle.",
        check: "`seepd inspect LOG` shows the fields with their ranges; the summary says whether the command repeats, and at what period.",
        cure: "Map the right field; for another duty cycle, describe this machine: `seepd adopt LOG --out FOLDER`.",
    },
    Explanation {
        name: "unlike_training",
        meaning: "it is like no machine that the model was trained on, and there is no baseline",
        cause: "The machine has another bore, valve, load or controller than those of training, the command's scale is wrong, or the leak is larger than any of training.",
        check: "`absolute_novelty` says how far it is (1 is the limit); the notice after five cycles names the phase that differs most.",
        cure: "Describe this machine: `seepd adopt LOG --out FOLDER`. If it differs a little and its seal is good: `seepd learn-baseline --out press.baseline.json LOG`.",
    },
    Explanation {
        name: "unlike_baseline",
        meaning: "it differs from the baseline in a way that no leak, load, oil or supply of the training explains, nor any other known cause",
        cause: "A valve, a sensor or the duty cycle has been changed since the baseline was learned.",
        check: "`novelty` says how far it is (1 is the limit); the notice after five cycles names the phase that differs most. Ask what was changed at that time.",
        cure: "If the seal is good, learn a new baseline: `seepd learn-baseline --seal-replaced --out press.baseline.json LOG`, or the button of the page.",
    },
    Explanation {
        name: "unconfirmed",
        meaning: "too few estimates in a row lie above a threshold to raise a flag",
        cause: "The first estimates, or the first after a loss, lie above a threshold; a flag needs several in a row, and `healthy` would be wrong.",
        check: "The lines of the cycles have the estimates: `seepd replay LOG`.",
        cure: "Wait for the next cycles, or read a longer log (`alarm.raise_cycles`).",
    },
    Explanation {
        name: "too_few_estimates",
        meaning: "too few of the record's cycles have an estimate for a size",
        cause: "A summary gives a size where at least 3 cycles, and half of all, have an estimate: what a few odd cycles say is no size of the machine's leak.",
        check: "The summary lists the reasons of the others.",
        cure: "What helps for the most frequent of these; the summary's last line has the next command. Or read a longer log.",
    },
    Explanation {
        name: "learning_baseline",
        meaning: "the machine's healthy cycles are being learned",
        cause: "An axis without a model (`monitor.kind = \"relative\"`) first learns what it is like: five periods of the command show the duty cycle, and the next cycles what is healthy.",
        check: "The page and the status say how many cycles there are, and how many are wanted.",
        cure: "Wait, or learn from a log: `seepd learn-baseline --config seepd.toml --out press.baseline.json LOG`.",
    },
    Explanation {
        name: "no_plant_model",
        meaning: "the axis has no model, which alone can tell sizes",
        cause: "`monitor.kind` is `relative`: cycles are compared with the machine's own healthy ones, which tells that something has changed, in which phases and since when.",
        check: "`seepd check seepd.toml` says so of the axis.",
        cure: "Describe this machine: `seepd adopt LOG --out FOLDER`. A model gives L/min, and tells a leak from load, oil and supply.",
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    /// Both ways: what the monitor says is explained, and what is explained is said.
    #[test]
    fn every_reason_is_explained_once() {
        let mut explained: Vec<&str> = ALL.iter().map(|reason| reason.name).collect();
        let mut given: Vec<&str> =
            seepd_monitor::reason::ALL.into_iter().chain([UNUSABLE_CONFIGURATION]).collect();
        explained.sort_unstable();
        given.sort_unstable();
        assert_eq!(explained, given);
    }

    #[test]
    fn explanations_are_whole_sentences() {
        for reason in ALL {
            for text in [reason.cause, reason.check, reason.cure] {
                assert!(
                    text.ends_with(['.', '?']) && text.starts_with(|c: char| c.is_uppercase() || c == '`'),
                    "{text}"
                );
            }
            assert!(!reason.meaning.ends_with('.') && !reason.meaning.is_empty(), "{}", reason.meaning);
        }
    }
}
