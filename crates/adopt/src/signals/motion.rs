//! Command, demand and position, by how they move together.

use std::collections::BTreeMap;

use seepd_logs::SignalMapping;
use seepd_signals::Signal;

use super::correlation::partial;
use super::full_scale::{self, Found};
use super::length::{self, LengthScale};
use super::names::Role;
use super::smooth::{Drives, Follows, Smoothed, drives, follows};
use super::trace::{Character, Trace};
use super::units::Quantity;
use super::{Assigned, Candidate, Hints, Outcome, Question, Rival, SignalProposal, mapping_to, shown};

/// Stretches over which slopes are taken, s: noise asks for long ones, quick strokes for short ones.
const STRETCHES_S: [f64; 4] = [0.02, 0.06, 0.2, 0.6];
/// By how much a command may be ahead of the speed, s; what is behind it is none.
const LEADS_S: [f64; 15] =
    [-0.3, -0.15, -0.08, -0.04, -0.02, 0.0, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2, 0.3, 0.5];
/// By how much a position may be behind its demand, s.
const LONGEST_DELAY_S: f64 = 0.8;
/// Share of the speed's variance that a command explains at least.
const DRIVES_AT_LEAST: f64 = 0.5;
/// Two columns that explain the speed within this of each other cannot be told apart by it.
const TIED: f64 = 0.08;
/// What a name that says command is worth, share of the speed's variance.
const NAME_BONUS: f64 = 0.1;
/// Share of the slope's variance from which a column whose ratio to it is one of units is the slope itself.
const IS_SLOPE: f64 = 0.98;
/// Ratios of units of speed and length, besides powers of ten: per minute.
const PER_MINUTE: f64 = 60.0;
/// How exactly a ratio must be one of units.
const RATIO_TOLERANCE: f64 = 0.01;
/// Share of a length's range at its ends that may be its stops, where a cylinder stands whatever the command.
const END_STOPS: f64 = 0.015;
/// Share of a position's variance that its demand explains at least.
const FOLLOWS_AT_LEAST: f64 = 0.97;
/// Correlation of a command with what is called a demand, given the position, from which it is that axis' demand: one that stands where it
/// is while its controller does not act is not like the position at all times.
const ASKED_FOR: f64 = 0.3;
/// Share of the position's variance that such a demand explains at least.
const LIKE_AT_ALL: f64 = 0.5;
/// Delay from which one column is behind another, s.
const CLEAR_DELAY_S: f64 = 0.004;
/// Noise that a demand, which is computed, does not have, share of its range, and what it is worth, s of delay.
const LEAST_NOISE: f64 = 2e-5;
const NOISY_DELAY_S: f64 = 0.03;
/// By how much a valve's spool is behind its command at most, s.
const LONGEST_LAG_S: f64 = 0.06;
/// Share of the variance from which a column is the difference of two others.
const IS_DIFFERENCE: f64 = 0.99;
/// Share of the variance from which one column is a copy of another.
const IS_COPY: f64 = 0.999_999;

const SEVERAL_AXES: &str = "The log has several axes; name the command of the one to look at.";
const SEVERAL_COMMANDS: &str = "Several columns go with the speed equally well.";
const BARE_DIFFERENCE: &str = "It goes with the speed, but it is the difference of demand and position: the control error, if it is no command.";

/// See the [module](self).
pub(super) struct Motion<'a, 't> {
    traces: &'a [Trace<'t>],
    hints: &'a Hints,
    rate_hz: f64,
    commands: Vec<usize>,
    lengths: Vec<usize>,
    /// How each of `commands` drives each of `lengths`, where it does at all.
    drives: BTreeMap<(usize, usize), Drives>,
}

/// A demand and a position that follows it.
struct Loop {
    demand: Option<usize>,
    position: Option<usize>,
    follows: Option<Follows>,
    /// Others that are like them.
    rivals: Vec<Rival>,
    /// Positions that cannot be told apart.
    undecided: Vec<usize>,
}

impl<'a, 't> Motion<'a, 't> {
    pub(super) fn new(traces: &'a [Trace<'t>], rate_hz: f64, hints: &'a Hints) -> Self {
        let with = |is: fn(&Trace<'_>) -> bool| {
            let moving = traces.iter().filter(|trace| trace.character == Character::Moving);
            moving.filter(|trace| is(trace)).map(|trace| trace.index).collect::<Vec<_>>()
        };
        let (commands, lengths) = (with(may_be_command), with(may_be_length));
        let mut motion = Motion { traces, hints, rate_hz, commands, lengths, drives: BTreeMap::new() };
        motion.look();
        motion
    }

    /// Looks at every pair of a command and a length.
    fn look(&mut self) {
        let samples = self.traces.first().map_or(0, |trace| trace.values.len());
        let mut leads: Vec<isize> =
            LEADS_S.iter().map(|lead_s| (lead_s * self.rate_hz).round() as isize).collect();
        leads.dedup();
        let mut stretches: Vec<usize> = STRETCHES_S
            .iter()
            .map(|stretch_s| ((stretch_s * self.rate_hz).round() as usize).max(1))
            .collect();
        stretches.dedup();
        for stretch in stretches.into_iter().filter(|stretch| 20 * stretch <= samples) {
            let smoothed = |index: &usize| (*index, Smoothed::of(&self.traces[*index].values, stretch));
            let commands: Vec<_> = self.commands.iter().map(smoothed).collect();
            let lengths: Vec<_> = self.lengths.iter().map(smoothed).collect();
            for (command, driver) in &commands {
                for (length, driven) in lengths.iter().filter(|(length, _)| length != command) {
                    let trace = &self.traces[*length];
                    let stop = END_STOPS * trace.range();
                    let free = trace.least + stop..=trace.largest - stop;
                    for within in [f64::NEG_INFINITY..=f64::INFINITY, free] {
                        let found =
                            leads.iter().filter_map(|lead| drives(driver, driven, stretch, *lead, &within));
                        self.keep(*command, *length, found);
                        if self.explained(*command, *length) >= DRIVES_AT_LEAST {
                            break;
                        }
                    }
                }
            }
        }
    }

    /// Keeps the best way that a command drives a length.
    fn keep(&mut self, command: usize, length: usize, found: impl Iterator<Item = Drives>) {
        for found in found {
            let best = self.drives.entry((command, length)).or_insert(found);
            if found.explained > best.explained {
                *best = found;
            }
        }
    }

    /// Settles command, demand and position.
    pub(super) fn propose(&self, proposal: &mut SignalProposal) {
        if let Some(command) = proposal.assigned.get(&Signal::Command).map(|assigned| assigned.column) {
            if let Some(length) = self.driven_by(command) {
                self.settle_loop(command, length, proposal);
            }
            return;
        }
        let Some((best, length)) = self.best_pair() else { return self.settle_command_alone(proposal) };
        let axes = self.other_axes(best, length);
        if !axes.is_empty() {
            proposal.questions.push(self.ask_command(&[vec![(best, length)], axes].concat(), SEVERAL_AXES));
            return;
        }
        match self.equals(best, length).as_slice() {
            [command] if self.is_bare_difference(*command) => {
                proposal.questions.push(self.ask_command(&[(*command, length)], BARE_DIFFERENCE));
            }
            [command] => {
                let position = self.control_loop(*command, length).position.unwrap_or(length);
                proposal.settle(Signal::Command, self.settle_command(*command, position));
                self.settle_loop(*command, length, proposal);
            }
            several => {
                let pairs: Vec<(usize, usize)> = several.iter().map(|command| (*command, length)).collect();
                proposal.questions.push(self.ask_command(&pairs, SEVERAL_COMMANDS));
            }
        }
    }

    fn drive(&self, command: usize, length: usize) -> Option<&Drives> {
        self.drives.get(&(command, length))
    }

    fn explained(&self, command: usize, length: usize) -> f64 {
        self.drive(command, length).map_or(0.0, |drives| drives.explained)
    }

    fn says_command(&self, index: usize) -> bool {
        self.traces[index].name.role() == Role::Command
    }

    fn score(&self, command: usize, length: usize) -> f64 {
        let named = self.says_command(command);
        self.explained(command, length) + if named { NAME_BONUS } else { 0.0 }
    }

    /// The length that a command drives best, if it drives any.
    fn driven_by(&self, command: usize) -> Option<usize> {
        let best =
            |a: &&usize, b: &&usize| self.explained(command, **a).total_cmp(&self.explained(command, **b));
        let length = *self.lengths.iter().max_by(best)?;
        (self.explained(command, length) >= DRIVES_AT_LEAST).then_some(length)
    }

    /// The command and the length that go together best.
    fn best_pair(&self) -> Option<(usize, usize)> {
        let pairs = self.commands.iter().filter_map(|command| Some((*command, self.driven_by(*command)?)));
        pairs
            .filter(|(command, length)| self.why_not(*command, *length).is_none())
            .max_by(|a, b| self.score(a.0, a.1).total_cmp(&self.score(b.0, b.1)))
    }

    /// Why a column that goes with a length's slope is no command.
    fn why_not(&self, command: usize, length: usize) -> Option<String> {
        let drives = self.drive(command, length)?;
        let [name, of] = [command, length].map(|index| shown(&self.traces[index]));
        let is_slope = drives.straight >= IS_SLOPE && is_ratio_of_units(drives.gain * self.rate_hz);
        if is_slope && !self.says_command(command) {
            return Some(format!("{name} is the slope of {of} itself, a speed."));
        }
        (!turns(&self.traces[command])).then(|| format!("{name} has no middle about which it turns."))
    }

    /// Commands of other axes in the log: pairs that go together better than with this axis.
    fn other_axes(&self, command: usize, length: usize) -> Vec<(usize, usize)> {
        let alike = self.alike(command, length);
        let other = |rival: &usize| {
            let driven = self.driven_by(*rival)?;
            let of_axis = |index: usize| index == command || index == length || alike.contains_key(&index);
            let apart = !of_axis(*rival) && !of_axis(driven);
            let better = self.explained(*rival, driven) > self.explained(*rival, length) + NAME_BONUS;
            (apart && better && self.why_not(*rival, driven).is_none()).then_some((*rival, driven))
        };
        self.commands.iter().filter_map(other).collect()
    }

    /// The columns that drive a length as well as the best one does, which cannot be told apart: the best alone, where they can.
    fn equals(&self, best: usize, length: usize) -> Vec<usize> {
        let score = self.score(best, length);
        let tied = |rival: &usize| {
            let close = score - self.score(*rival, length) < TIED;
            // A name that says command is not passed over in silence.
            let named = self.says_command(*rival) && !self.says_command(best);
            (close || named)
                && self.explained(*rival, length) >= DRIVES_AT_LEAST
                && self.why_not(*rival, length).is_none()
                && !self.is_copy(best, *rival)
        };
        let rivals = self.commands.iter().copied().filter(|rival| *rival != best && tied(rival));
        let equals: Vec<usize> = std::iter::once(best).chain(rivals).collect();
        // What comes later is what the valve makes of the command; a difference of lengths is the error that it is made from.
        let is_first = |one: &usize| !equals.iter().any(|other| other != one && self.is_later(*one, *other));
        let first: Vec<usize> = equals.iter().copied().filter(is_first).collect();
        let whole: Vec<usize> = first.iter().copied().filter(|one| !self.is_bare_difference(*one)).collect();
        [whole, first, equals].into_iter().find(|left| !left.is_empty()).unwrap_or_default()
    }

    /// Whether a column is another once more, later.
    fn is_later(&self, one: usize, other: usize) -> bool {
        let most = (LONGEST_LAG_S * self.rate_hz) as isize;
        let delays: Vec<isize> = (-most..=most).collect();
        let found = follows(&self.traces[other].values, &self.traces[one].values, &delays);
        found.is_some_and(|found| {
            found.explained >= FOLLOWS_AT_LEAST && found.behind as f64 / self.rate_hz > CLEAR_DELAY_S
        })
    }

    /// Whether a column, which is not called a command, is the mere difference of two lengths, in a unit of theirs.
    fn is_bare_difference(&self, one: usize) -> bool {
        let values = |index: usize| &self.traces[index].values;
        let is_of = |(a, b): (usize, usize)| {
            let difference: Vec<f64> = values(a).iter().zip(values(b)).map(|(a, b)| a - b).collect();
            let found = follows(&difference, values(one), &[0]);
            found.is_some_and(|found| found.explained >= IS_DIFFERENCE && is_ratio_of_units(found.gain))
        };
        let pairs = self.lengths.iter().flat_map(|a| self.lengths.iter().map(move |b| (*a, *b)));
        !self.says_command(one) && pairs.filter(|(a, b)| a < b && *a != one && *b != one).any(is_of)
    }

    fn is_copy(&self, one: usize, other: usize) -> bool {
        let found = follows(&self.traces[one].values, &self.traces[other].values, &[0]);
        found.is_some_and(|found| found.explained >= IS_COPY)
    }

    fn ask_command(&self, pairs: &[(usize, usize)], why: &str) -> Question {
        let candidate = |(command, length): &(usize, usize)| {
            let (mapping, scale) = self.command_mapping(*command, *length);
            let share = self.explained(*command, *length);
            let what = format!(
                "the command of {}, of whose speed it explains {:.0} %{scale}",
                shown(&self.traces[*length]),
                100.0 * share
            );
            Candidate { column: *command, mapping, what }
        };
        let candidates: Vec<Candidate> = pairs.iter().map(candidate).collect();
        Question { signal: Signal::Command, candidates, why: why.into() }
    }

    /// A mapping of a command, and what is open about its scale.
    fn command_mapping(&self, command: usize, length: usize) -> (SignalMapping, String) {
        let trace = &self.traces[command];
        match self.full_scale(command, length) {
            Found::Sure(way, ..) => (mapping_to(trace, way.scale, way.offset), String::new()),
            Found::Open(ways, why) => {
                let (scale, offset) = ways.first().map_or((1.0, 0.0), |way| (way.scale, way.offset));
                (mapping_to(trace, scale, offset), format!("; {why}"))
            }
        }
    }

    fn full_scale(&self, command: usize, length: usize) -> Found {
        let drives = self.drive(command, length);
        let trace = &self.traces[command];
        let null = match drives.map(|drives| drives.null) {
            // What takes both signs stands at zero; a curve over a few levels crosses zero anywhere between them.
            _ if turns_about(trace, 0.0) => 0.0,
            Some(null) if null.is_finite() => null,
            _ => resting_value(trace),
        };
        full_scale::find(trace, null, drives.is_some_and(|drives| drives.falling))
    }

    fn settle_command(&self, command: usize, length: usize) -> Outcome {
        let trace = &self.traces[command];
        let Some(drives) = self.drive(command, length) else {
            return self.scaled(command, 0.5, Vec::new(), length);
        };
        let of = shown(&self.traces[length]);
        let mut evidence =
            vec![format!("It explains {:.0} % of the speed of {of}.", 100.0 * drives.explained)];
        if drives.falling {
            evidence.push(format!(
                "{of} falls where it is positive, so its sign is reversed: positive is to extend. If {of} counts from the extended end \
                 instead, turn the sign of both."
            ));
        }
        if self.says_command(command) {
            evidence.push(format!("Its name, {}, says so.", shown(trace)));
        }
        self.scaled(command, drives.explained.min(0.98), evidence, length)
    }

    /// A command with its way to shares of full command, or the question what that is.
    fn scaled(&self, command: usize, sure: f64, mut evidence: Vec<String>, length: usize) -> Outcome {
        let trace = &self.traces[command];
        match self.full_scale(command, length) {
            Found::Sure(way, scale_sure, why) => {
                evidence.push(why);
                Outcome::Assigned(Assigned {
                    column: command,
                    mapping: mapping_to(trace, way.scale, way.offset),
                    confidence: sure.min(scale_sure),
                    evidence,
                    rivals: self.beaten(command, length),
                })
            }
            Found::Open(ways, why) => {
                let candidate = |way: full_scale::FullScale| Candidate {
                    column: command,
                    mapping: mapping_to(trace, way.scale, way.offset),
                    what: way.what,
                };
                Outcome::Asked(Question {
                    signal: Signal::Command,
                    candidates: ways.into_iter().map(candidate).collect(),
                    why: format!("{} is the command, but {why}.", shown(trace)),
                })
            }
        }
    }

    /// Columns that go with the speed too, and why they are not the command.
    fn beaten(&self, command: usize, length: usize) -> Vec<Rival> {
        let goes_along =
            |rival: &&usize| **rival != command && self.explained(**rival, length) >= DRIVES_AT_LEAST;
        let rival = |rival: &usize| Rival {
            column: *rival,
            why_not: self.why_not(*rival, length).unwrap_or_else(|| {
                let name = shown(&self.traces[*rival]);
                let explained = 100.0 * self.explained(*rival, length);
                if self.is_bare_difference(*rival) {
                    format!("{name} is the difference of two lengths, a control error.")
                } else if self.is_later(*rival, command) {
                    format!("{name} is the command once more, later: what the valve makes of it.")
                } else {
                    format!("{name} explains {explained:.0} % of the speed, and is not called a command.")
                }
            }),
        };
        self.commands.iter().filter(goes_along).map(rival).collect()
    }

    /// Where no column moves a length: the command by its name, or as the only column that can be one.
    fn settle_command_alone(&self, proposal: &mut SignalProposal) {
        let may_be = |index: &usize| {
            let trace = &self.traces[*index];
            turns(trace) && trace.name.role() != Role::Demand
        };
        let usable: Vec<usize> = self.commands.iter().copied().filter(may_be).collect();
        let named: Vec<usize> = usable.iter().copied().filter(|index| self.says_command(*index)).collect();
        let chosen = if named.is_empty() { &usable } else { &named };
        match chosen.as_slice() {
            [] => proposal.refusal = Some(self.refusal()),
            [one] => {
                let name = shown(&self.traces[*one]);
                let evidence = vec![if named.is_empty() {
                    format!(
                        "{name} is the only column that can be one; without a position its sign cannot be checked."
                    )
                } else {
                    format!(
                        "Its name, {name}, says so; without a position that it moves, its sign cannot be checked."
                    )
                }];
                let sure = if named.is_empty() { 0.6 } else { 0.7 };
                proposal.settle(Signal::Command, self.scaled(*one, sure, evidence, *one));
            }
            several => proposal.questions.push(Question {
                signal: Signal::Command,
                candidates: several
                    .iter()
                    .map(|index| {
                        let (mapping, scale) = self.command_mapping(*index, *index);
                        let what = format!("a valve command{scale}");
                        Candidate { column: *index, mapping, what }
                    })
                    .collect(),
                why: "Several columns could be a valve command, and none moves a position in this log."
                    .into(),
            }),
        }
    }

    fn refusal(&self) -> String {
        const TOLD: usize = 8;
        let reason = |trace: &Trace<'_>| format!("{} {}", shown(trace), no_command(trace));
        let mut reasons: Vec<String> = self.traces.iter().take(TOLD).map(reason).collect();
        if self.traces.len() > TOLD {
            reasons.push(format!("and {} more are no commands either", self.traces.len() - TOLD));
        }
        format!("no column can be a valve command: {}", reasons.join("; "))
    }

    /// Columns that are like a length that a command drives, each with how it follows it.
    fn alike(&self, command: usize, length: usize) -> BTreeMap<usize, Follows> {
        let most = (LONGEST_DELAY_S * self.rate_hz) as isize;
        let step = (most / 80).max(1);
        let delays: Vec<isize> = (-most..=most).step_by(step as usize).collect();
        let others = self.lengths.iter().filter(|other| **other != length);
        let found: BTreeMap<usize, Follows> = others
            .filter_map(|other| {
                let found = follows(&self.traces[length].values, &self.traces[*other].values, &delays)?;
                (found.gain > 0.0).then_some((*other, found))
            })
            .collect();
        let most = found.values().map(|follows| follows.explained).fold(0.0, f64::max);
        let is_alike = |other: usize, explained: f64| {
            let is_demand = self.traces[other].name.role() == Role::Demand;
            let is_likeliest = is_demand && explained == most && explained >= LIKE_AT_ALL;
            explained >= FOLLOWS_AT_LEAST || (is_likeliest && self.is_asked_for(command, other, length))
        };
        found.into_iter().filter(|(other, follows)| is_alike(*other, follows.explained)).collect()
    }

    /// Whether a command goes with a demand beyond what it has in common with the position: a controller turns the one into the other.
    fn is_asked_for(&self, command: usize, demand: usize, position: usize) -> bool {
        let sign =
            if self.drive(command, position).is_some_and(|drives| drives.falling) { -1.0 } else { 1.0 };
        let [command, demand, position] = [command, demand, position].map(|index| &self.traces[index].values);
        let beyond = partial(command, demand, std::slice::from_ref(position));
        beyond.is_some_and(|beyond| sign * beyond >= ASKED_FOR)
    }

    /// Settles demand and position of the axis of a command.
    fn settle_loop(&self, command: usize, length: usize, proposal: &mut SignalProposal) {
        let found = self.control_loop(command, length);
        if let (Some(position), false) = (found.position, proposal.assigned.contains_key(&Signal::Position)) {
            let mut evidence = vec![format!(
                "Its slope follows the command, which explains {:.0} % of it.",
                100.0 * self.explained(command, position)
            )];
            if let (Some(demand), Some(follows)) = (found.demand, found.follows) {
                let delay_ms = 1e3 * follows.behind as f64 / self.rate_hz;
                evidence.push(format!("It follows {} by {delay_ms:.0} ms.", shown(&self.traces[demand])));
            }
            let outcome = self.settle_length(
                Signal::Position,
                position,
                self.explained(command, position),
                evidence,
                found.rivals,
            );
            proposal.settle(Signal::Position, outcome);
        }
        if let (Some(demand), false) = (found.demand, proposal.assigned.contains_key(&Signal::Demand)) {
            let evidence = vec![match found.position {
                Some(position) => format!("{} follows it.", shown(&self.traces[position])),
                None => "Its name says so, and its slope goes with the command.".into(),
            }];
            let sure = found.follows.map_or(0.7, |follows| follows.explained);
            proposal.settle(
                Signal::Demand,
                self.settle_length(Signal::Demand, demand, sure, evidence, Vec::new()),
            );
        }
        if !found.undecided.is_empty() {
            let candidate = |index: &usize| self.length_candidate(*index);
            proposal.questions.push(Question {
                signal: Signal::Position,
                candidates: found.undecided.iter().map(candidate).collect(),
                why: "Several columns move alike.".into(),
            });
        }
    }

    fn length_candidate(&self, index: usize) -> Candidate {
        let trace = &self.traces[index];
        let scale = match length::find(trace, self.hints) {
            LengthScale::Sure(scale, ..) => scale,
            LengthScale::Open(ways, _) => ways.first().map_or(1.0, |way| way.0),
        };
        let what = format!("the position, each of its units {} mm", full_scale::number(1e3 * scale));
        Candidate { column: index, mapping: mapping_to(trace, scale, 0.0), what }
    }

    fn settle_length(
        &self,
        signal: Signal,
        index: usize,
        sure: f64,
        mut evidence: Vec<String>,
        rivals: Vec<Rival>,
    ) -> Outcome {
        let trace = &self.traces[index];
        match length::find(trace, self.hints) {
            LengthScale::Sure(scale, scale_sure, why) => {
                evidence.push(why);
                let confidence = sure.min(scale_sure);
                let mapping = mapping_to(trace, scale, 0.0);
                Outcome::Assigned(Assigned { column: index, mapping, confidence, evidence, rivals })
            }
            LengthScale::Open(ways, why) => {
                let candidate = |(scale, what): (f64, String)| Candidate {
                    column: index,
                    mapping: mapping_to(trace, scale, 0.0),
                    what: format!("values in {what}"),
                };
                Outcome::Asked(Question {
                    signal,
                    candidates: ways.into_iter().map(candidate).collect(),
                    why: format!("{} is the {}, but {why}.", shown(trace), signal.name()),
                })
            }
        }
    }

    /// Which of the lengths that are alike is the demand, and which the position.
    fn control_loop(&self, command: usize, length: usize) -> Loop {
        let alike = self.alike(command, length);
        let alone = Loop {
            demand: None,
            position: Some(length),
            follows: None,
            rivals: Vec::new(),
            undecided: Vec::new(),
        };
        if alike.is_empty() {
            return self.single(command, length, alone);
        }
        // What is computed comes before what is measured, and has no noise.
        let delay_s = |index: usize| {
            let behind = alike.get(&index).map_or(0, |follows| follows.behind);
            let trace = &self.traces[index];
            let noisy = trace.noise > LEAST_NOISE * trace.range();
            behind as f64 / self.rate_hz + if noisy { NOISY_DELAY_S } else { 0.0 }
        };
        let role = |index: usize| self.traces[index].name.role();
        let mut members: Vec<usize> = std::iter::once(length).chain(alike.keys().copied()).collect();
        members.sort_by(|a, b| delay_s(*a).total_cmp(&delay_s(*b)));
        let (first, second) = (members[0], members[1]);
        let named = members.iter().copied().find(|member| role(*member) == Role::Demand);
        let leads = delay_s(second) - delay_s(first) > CLEAR_DELAY_S;
        let demand = named.or_else(|| (leads && role(first) != Role::Position).then_some(first));
        if let Some(demand) = demand.filter(|demand| delay_s(*demand) - delay_s(first) > CLEAR_DELAY_S)
            && role(first) == Role::Position
        {
            // The names say the reverse of what is seen.
            return Loop { position: None, undecided: vec![first, demand], ..alone };
        }
        let mut measured: Vec<usize> = members
            .into_iter()
            .filter(|member| Some(*member) != demand && role(*member) != Role::Demand)
            .collect();
        if measured.iter().any(|member| role(*member) == Role::Position) {
            measured.retain(|member| role(*member) == Role::Position);
        }
        let Some(position) = measured.first().copied() else {
            return Loop { demand, position: None, ..alone };
        };
        // What comes clearly later is the same once more, filtered.
        let tied = |other: &usize| {
            delay_s(*other) - delay_s(position) <= CLEAR_DELAY_S && !self.is_copy(position, *other)
        };
        let mut undecided: Vec<usize> = measured.iter().copied().skip(1).filter(tied).collect();
        if !undecided.is_empty() {
            undecided.insert(0, position);
            return Loop { demand, position: None, undecided, ..alone };
        }
        let later = |other: &usize| Rival {
            column: *other,
            why_not: format!("{} moves alike, no earlier.", shown(&self.traces[*other])),
        };
        let rivals = measured.iter().skip(1).map(later).collect();
        let follows = demand.and_then(|demand| {
            let delays: Vec<isize> = (0..=(LONGEST_DELAY_S * self.rate_hz) as isize).collect();
            follows(&self.traces[demand].values, &self.traces[position].values, &delays)
        });
        Loop { demand, position: Some(position), follows, rivals, ..alone }
    }

    /// A length without another that is like it.
    fn single(&self, command: usize, length: usize, alone: Loop) -> Loop {
        let behind = self.drive(command, length).is_some_and(|drives| drives.lead < 0);
        match self.traces[length].name.role() {
            Role::Demand => Loop { demand: Some(length), position: None, ..alone },
            // A command that only follows a slope follows a demand's.
            Role::Unknown if behind => Loop { position: None, undecided: vec![length], ..alone },
            _ => alone,
        }
    }
}

fn may_be_command(trace: &Trace<'_>) -> bool {
    let unit = trace.unit.is_none_or(|unit| {
        matches!(unit.quantity, Quantity::Share | Quantity::Voltage | Quantity::Current | Quantity::Count)
    });
    unit && matches!(trace.name.role(), Role::Command | Role::Unknown | Role::Demand)
}

fn may_be_length(trace: &Trace<'_>) -> bool {
    let role = trace.name.role();
    match trace.unit.map(|unit| unit.quantity) {
        Some(Quantity::Length) => role != Role::Error && role != Role::Other,
        None | Some(Quantity::Count | Quantity::Voltage | Quantity::Share | Quantity::Current) => {
            matches!(role, Role::Position | Role::Demand | Role::Unknown)
        }
        Some(_) => false,
    }
}

/// Why a column can be no command.
fn no_command(trace: &Trace<'_>) -> String {
    match trace.character {
        Character::Absent => return "has hardly a value".into(),
        Character::Constant => return "never changes".into(),
        Character::Switch => return "takes two values alone".into(),
        Character::Counter => return "only counts".into(),
        Character::Moving => {}
    }
    let unit = trace.column.unit.as_deref().unwrap_or_default();
    match (trace.unit.map(|unit| unit.quantity), trace.name.role()) {
        (Some(Quantity::Length), _) => format!("is a length ({unit})"),
        (Some(Quantity::Pressure), _) => format!("is a pressure ({unit})"),
        (Some(Quantity::Force), _) => format!("is a force ({unit})"),
        (Some(Quantity::Other), _) => format!("is in {unit}"),
        (_, Role::Error) => "is an error of control by its name".into(),
        (_, Role::Unknown | Role::Command | Role::Demand) => {
            "does not turn about a middle at which the machine stands".into()
        }
        (_, role) => format!(
            "is a {} by its name",
            match role {
                Role::Position => "position",
                Role::Pressure => "pressure",
                Role::Load => "force",
                Role::CycleStart => "mark",
                _ => "measured quantity",
            }
        ),
    }
}

/// Whether a trace goes to both sides of zero, or of where it rests, as a command does.
fn turns(trace: &Trace<'_>) -> bool {
    turns_about(trace, 0.0) || turns_about(trace, resting_value(trace))
}

fn turns_about(trace: &Trace<'_>, middle: f64) -> bool {
    let least_side = 0.02 * trace.range();
    trace.largest - middle > least_side && middle - trace.least > least_side
}

/// Whether a speed's ratio to a slope is that of their units: a power of ten, or that per minute.
fn is_ratio_of_units(ratio: f64) -> bool {
    let near_power = |ratio: f64| {
        let power = ratio.log10();
        (power - power.round()).abs() <= RATIO_TOLERANCE / std::f64::consts::LN_10
    };
    let ratio = ratio.abs();
    near_power(ratio) || near_power(ratio * PER_MINUTE) || near_power(ratio / PER_MINUTE)
}

/// The value that a trace has most of the time.
fn resting_value(trace: &Trace<'_>) -> f64 {
    const BINS: usize = 100;
    let width = trace.range() / BINS as f64;
    let mut counts = [0usize; BINS];
    for value in trace.values.iter().filter(|value| value.is_finite()) {
        let bin = ((value - trace.least) / width) as usize;
        counts[bin.min(BINS - 1)] += 1;
    }
    let fullest = counts.iter().enumerate().max_by_key(|(_, count)| **count).map_or(0, |(bin, _)| bin);
    trace.least + (fullest as f64 + 0.5) * width
}
