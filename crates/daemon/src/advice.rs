//! What to tell somebody whose cycles have no estimate: what was seen in the command, and the next command to type.

use seepd_monitor::event::Summary;
use seepd_monitor::pipeline::observer::Observation;
use seepd_monitor::pipeline::{DutyCycle, LEAST_ESTIMATES};
use seepd_monitor::reason::{
    LEARNING_BASELINE, NO_CYCLE_FOUND, NO_PLANT_MODEL, UNLIKE_BASELINE, UNLIKE_TRAINING,
};

use crate::reasons::explanation;
use crate::sink::terminal::listed;

/// Largest command that is a share of full command: 5 % for noise.
const FULL_COMMAND: f64 = 1.05;
/// From this share of samples out of range on the scale is wrong; fewer are single faults.
const MANY_OUT_OF_RANGE: f64 = 0.02;
/// Periods that differ by less than this share are the same duty cycle's.
const SAME_PERIOD: f64 = 0.03;

/// Where the command comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct CommandSource {
    /// The log, as it would be typed; `LOG` where there is none.
    pub log: String,
    /// Scale of the command's mapping.
    pub scale: f64,
    /// Offset of the command's mapping.
    pub offset: f64,
}

/// The advice in a line: how many cycles have an estimate, what was seen, what to do.
pub fn advice(
    summary: &Summary,
    observed: &Observation,
    duty_cycles: &[DutyCycle],
    source: &CommandSource,
) -> String {
    let situation = Situation { summary, observed, duty_cycles, source };
    if summary.size_withheld == Some(NO_PLANT_MODEL) {
        return situation.without_a_model();
    }
    let explain = situation.reason().map(|reason| format!("`seepd explain {reason}` says more."));
    let parts = [Some(situation.tally()), situation.next_step(), explain];
    parts.into_iter().flatten().collect::<Vec<_>>().join(" ")
}

struct Situation<'a> {
    summary: &'a Summary,
    observed: &'a Observation,
    duty_cycles: &'a [DutyCycle],
    source: &'a CommandSource,
}

impl Situation<'_> {
    /// There is a size only with a model; without cycles to compare there is not even a comparison.
    fn without_a_model(&self) -> String {
        let gain = format!("Without a plant model there is no L/min: {} gives sizes.", self.adopt());
        let Summary { cycles, rejected, .. } = self.summary;
        let learned = rejected.get(LEARNING_BASELINE).copied().unwrap_or(0);
        if *cycles > 0 {
            return gain;
        }
        let seen = match (learned, self.observed.period_s) {
            _ if self.is_out_of_range() => {
                self.observed.command_range.map_or(String::new(), |range| self.misscaled(range))
            }
            (0, None) => self.without_a_pattern(),
            (0, Some(period_s)) => format!(
                "The command repeats every {} s, but no cycle could be used: a longer log shows its strokes better.",
                three_digits(period_s)
            ),
            (learned, _) => format!(
                "{learned} cycles were read as healthy ones, and there were none to compare with them: learn from one log, and compare another."
            ),
        };
        format!("{seen} {gain}")
    }

    /// Why most of the cycles have no estimate, or why there are no cycles.
    fn reason(&self) -> Option<&'static str> {
        let most = self.summary.rejected.iter().max_by_key(|(_, count)| **count).map(|(reason, _)| *reason);
        most.or(self.summary.reason.filter(|_| self.summary.cycles == 0))
    }

    fn tally(&self) -> String {
        let Summary { cycles, rejected, duration_s, .. } = self.summary;
        let all = cycles + rejected.values().sum::<u64>();
        match (*cycles, all) {
            (_, 0) => format!("No duty cycle was found in {} s of the command.", three_digits(*duration_s)),
            (0, _) => format!("None of {all} cycles has an estimate: {}.", listed(rejected)),
            (cycles, all) if cycles == all => {
                format!("A size takes {LEAST_ESTIMATES} cycles, and there are {cycles}: read a longer log.")
            }
            (cycles, all) => format!(
                "Only {cycles} of {all} cycles have an estimate, too few for a size; the others have none: {}.",
                listed(rejected)
            ),
        }
    }

    fn next_step(&self) -> Option<String> {
        if let Some(rate_hz) = self.observed.wrong_rate_hz {
            return Some(self.at_another_rate(rate_hz));
        }
        if let Some(range) = self.observed.command_range.filter(|_| self.is_out_of_range()) {
            return Some(self.misscaled(range));
        }
        match self.reason()? {
            UNLIKE_BASELINE => Some(
                "The machine is another one than at its baseline; if its seal is good, learn a new one: `seepd learn-baseline \
                 --seal-replaced`."
                    .to_owned(),
            ),
            reason @ ("incomplete" | NO_CYCLE_FOUND | UNLIKE_TRAINING) => Some(self.of_another_cycle(reason)),
            reason => explanation(reason).map(|reason| reason.cure.to_owned()),
        }
    }

    fn at_another_rate(&self, rate_hz: f64) -> String {
        let model_hz = self.duty_cycles.first().map_or(0.0, |first| first.model.file().sample_rate_hz);
        format!(
            "The samples come at {rate_hz:.1} Hz, the model reads {model_hz} Hz. Make a model for this rate: {}.",
            self.adopt()
        )
    }

    fn is_out_of_range(&self) -> bool {
        self.observed.command_range.is_some_and(|range| self.is_misscaled(range))
    }

    fn is_misscaled(&self, [low, high]: [f64; 2]) -> bool {
        let outside = self.summary.samples_rejected.get("out_of_range").copied().unwrap_or(0);
        low.abs().max(high.abs()) > FULL_COMMAND
            && outside as f64 > MANY_OUT_OF_RANGE * self.summary.samples as f64
    }

    /// What unit such a range may be in; the keys are those that bring it within −1 … 1.
    fn misscaled(&self, [low, high]: [f64; 2]) -> String {
        let largest = low.abs().max(high.abs());
        let (unit, factor, shift) = match largest {
            _ if low >= 3.5 && high <= 21.0 => ("milliamperes around 12 mA", 0.125, -1.5),
            largest if largest <= 10.5 => ("volts of ±10 V", 0.1, 0.0),
            largest if largest <= 105.0 => ("per cent", 0.01, 0.0),
            _ => ("counts of a 16-bit converter", 1.0 / 32768.0, 0.0),
        };
        let (scale, offset) = (self.source.scale * factor, self.source.offset * factor + shift);
        let offset = if offset == 0.0 { String::new() } else { format!(" and `offset = {offset}`") };
        format!(
            "The command lies within {} … {}, but full command is −1 … 1: if these are {unit}, set `scale = {scale}`{offset} for \
             signals.command (`seepd inspect {} > seepd.toml` writes the mapping).",
            three_digits(low),
            three_digits(high),
            self.source.log
        )
    }

    /// The model knows another duty cycle, or another machine.
    fn of_another_cycle(&self, reason: &str) -> String {
        let Some(period_s) = self.observed.period_s else { return self.without_a_pattern() };
        let known: Vec<f64> =
            self.duty_cycles.iter().map(|duty_cycle| duty_cycle.model.file().cycle.period_s).collect();
        let repeats = format!("The command repeats every {} s", three_digits(period_s));
        if !known.iter().any(|known_s| (period_s / known_s - 1.0).abs() < SAME_PERIOD) {
            let known: Vec<String> = known.into_iter().map(three_digits).collect();
            return format!(
                "{repeats}; the model knows cycles of {} s. Describe this machine: {}.",
                known.join(" and "),
                self.adopt()
            );
        }
        if reason == UNLIKE_TRAINING {
            return format!(
                "{repeats}, as the model's cycle does, but the machine is like none of training. Describe it: {}; or, if its seal is good \
                 and it differs a little: `seepd learn-baseline --out press.baseline.json {}`.",
                self.adopt(),
                self.source.log
            );
        }
        format!(
            "{repeats}, as the model's cycle does, but its strokes are others. Describe this machine: {}.",
            self.adopt()
        )
    }

    fn without_a_pattern(&self) -> String {
        let longest_s = DutyCycle::longest_period_s(self.duty_cycles);
        if longest_s > 0.0 && self.summary.duration_s < 2.0 * longest_s {
            return format!(
                "The record has {} s, and a cycle of the model {} s: read a longer log.",
                three_digits(self.summary.duration_s),
                three_digits(longest_s)
            );
        }
        format!(
            "No pattern repeats in the last {} s of the command: does the machine run in cycles, and is `signals.command` its valve command? \
             `seepd inspect {}` shows what the log has.",
            three_digits(self.observed.looked_s),
            self.source.log
        )
    }

    fn adopt(&self) -> String {
        format!("`seepd adopt {} --out FOLDER`", self.source.log)
    }
}

/// A number in three digits: `7.02`, `10.0`, `−9.80`, `1640`.
fn three_digits(value: f64) -> String {
    let magnitude = if value == 0.0 { 0.0 } else { value.abs().log10().floor() };
    let decimals = (2.0 - magnitude).clamp(0.0, 4.0) as usize;
    format!("{value:.decimals$}").replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    use seepd_model::Model;
    use seepd_monitor::pipeline::{MonitorConfig, Pipeline};

    const SEEN: Observation = Observation {
        command_range: Some([-0.278, 0.268]),
        period_s: Some(10.01),
        likeness: Some(0.98),
        looked_s: 81.9,
        wrong_rate_hz: None,
    };

    fn told(observed: Observation, change: impl FnOnce(&mut Summary)) -> String {
        let model = Arc::new(Model::from_json(crate::EMBEDDED_MODEL).unwrap());
        let pipeline = Pipeline::new(MonitorConfig::new("axis", Arc::clone(&model))).unwrap();
        let mut summary = pipeline.summary();
        (summary.samples, summary.duration_s) = (300_000, 300.0);
        change(&mut summary);
        let source = CommandSource { log: "press.mcap".into(), scale: 1.0, offset: 0.0 };
        advice(&summary, &observed, &[DutyCycle::only(model)], &source)
    }

    #[test]
    fn units_are_guessed_from_the_range() {
        let scaled = |range: [f64; 2]| {
            told(Observation { command_range: Some(range), ..SEEN }, |summary| {
                summary.samples_rejected.insert("out_of_range", 100_000);
                summary.rejected.insert("out_of_range", 30);
            })
        };
        for (range, expected) in [
            (
                [-2.78, 2.68],
                "within −2.78 … 2.68, but full command is −1 … 1: if these are volts of ±10 V, set `scale = 0.1` for signals.command",
            ),
            ([-27.8, 26.8], "if these are per cent, set `scale = 0.01` for"),
            (
                [9.77, 14.1],
                "if these are milliamperes around 12 mA, set `scale = 0.125` and `offset = -1.5` for",
            ),
            (
                [-9100.0, 8790.0],
                "within −9100 … 8790, but full command is −1 … 1: if these are counts of a 16-bit converter",
            ),
        ] {
            assert!(scaled(range).contains(expected), "{}", scaled(range));
        }
    }

    #[test]
    fn what_was_seen_leads_to_the_next_command() {
        let because = |reason: &'static str, observed: Observation| {
            told(observed, |summary| {
                summary.cycles = 6;
                summary.rejected.insert(reason, 24);
            })
        };
        assert_eq!(
            because("incomplete", Observation { period_s: Some(7.018), ..SEEN }),
            "Only 6 of 30 cycles have an estimate, too few for a size; the others have none: 24 incomplete. The command repeats every 7.02 s; \
             the model knows cycles of 10.0 s. Describe this machine: `seepd adopt press.mcap --out FOLDER`. `seepd explain incomplete` \
             says more."
        );
        assert!(
            because("incomplete", SEEN).contains("as the model's cycle does, but its strokes are others.")
        );
        assert!(
            because(UNLIKE_TRAINING, SEEN)
                .contains("`seepd learn-baseline --out press.baseline.json press.mcap`")
        );
        assert!(
            because("incomplete", Observation { period_s: None, ..SEEN })
                .contains("No pattern repeats in the last 81.9 s")
        );
        assert!(
            because("wrong_rate", Observation { wrong_rate_hz: Some(500.0), ..SEEN })
                .contains("The samples come at 500.0 Hz, the model reads 1000 Hz.")
        );
        assert!(because("gap", SEEN).contains("name the frame's counter in `source.counter`"));
        assert_eq!(
            told(SEEN, |summary| summary.cycles = 2),
            "A size takes 3 cycles, and there are 2: read a longer log."
        );
    }
}
