//! Which column of a log is which signal: names and units say what to look at first, physics decides.
//!
//! A valve command is bounded and leads the speed; a position is smooth, and its slope goes with the command; a demand leads the position
//! and is without noise; pressures and loads go with each other. What physics cannot tell apart is asked, and never guessed with
//! confidence.

mod circuit;
mod correlation;
mod cycle_start;
mod full_scale;
mod length;
mod load;
mod motion;
mod names;
mod smooth;
#[cfg(test)]
mod test_logs;
#[cfg(test)]
mod tests;
mod trace;
mod units;

use std::collections::BTreeMap;

use seepd_logs::columns::{Column, Columns};
use seepd_logs::{LogMapping, SignalMapping};
use seepd_signals::Signal;

use circuit::Drive;
use motion::Motion;
use trace::Trace;

/// What is known beside the log.
#[derive(Debug, Clone, Default)]
pub struct Hints {
    /// Stroke of the cylinder, m.
    pub stroke_m: Option<f64>,
    /// Pressure of the supply, Pa.
    pub supply_pa: Option<f64>,
    /// What the user has said: these signals are not looked for, the others beside them.
    pub given: BTreeMap<Signal, SignalMapping>,
}

/// Which column is which signal, as far as it can be told.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SignalProposal {
    /// Signals that were found.
    pub assigned: BTreeMap<Signal, Assigned>,
    /// What the user must say.
    pub questions: Vec<Question>,
    /// Why no column can be a valve command, in one sentence, where none can.
    pub refusal: Option<String>,
}

/// A signal's column, and why it is the one.
#[derive(Debug, Clone, PartialEq)]
pub struct Assigned {
    /// Where it is in the columns.
    pub column: usize,
    /// Where it is in the log, and its way to SI.
    pub mapping: SignalMapping,
    /// How sure that is, 0–1.
    pub confidence: f64,
    /// What speaks for it, in whole sentences.
    pub evidence: Vec<String>,
    /// Others that might have been it.
    pub rivals: Vec<Rival>,
}

/// A column that might have been a signal and is not.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// Where it is in the columns.
    pub column: usize,
    /// Why it is not the one, in one sentence.
    pub why_not: String,
}

/// What only the user can say.
#[derive(Debug, Clone, PartialEq)]
pub struct Question {
    /// Signal that it is about.
    pub signal: Signal,
    /// Possible answers, the likeliest first.
    pub candidates: Vec<Candidate>,
    /// Why the log does not tell, in one sentence.
    pub why: String,
}

/// A possible answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Where it is in the columns.
    pub column: usize,
    /// The mapping that it means.
    pub mapping: SignalMapping,
    /// What it means, in words: `±10 V`, `values in mm`.
    pub what: String,
}

impl SignalProposal {
    /// The mapping with which the log can be opened; `None` without a command.
    pub fn mapping(&self, columns: &Columns) -> Option<LogMapping> {
        self.assigned.get(&Signal::Command)?;
        let signals =
            self.assigned.iter().map(|(signal, assigned)| (*signal, assigned.mapping.clone())).collect();
        let mut mapping = LogMapping { signals, ..LogMapping::default() };
        if let Some(time) = &columns.time {
            mapping.time_column.clone_from(&time.column);
            mapping.time_unit = Some(time.unit);
        }
        Some(mapping)
    }

    /// The column of a signal with its way to SI, or the likeliest where that alone is open.
    fn mapping_of(&self, signal: Signal) -> Option<(usize, &SignalMapping)> {
        if let Some(Assigned { column, mapping, .. }) = self.assigned.get(&signal) {
            return Some((*column, mapping));
        }
        let question = self.questions.iter().find(|question| question.signal == signal)?;
        let first = question.candidates.first()?;
        let one_column = question.candidates.iter().all(|candidate| candidate.column == first.column);
        one_column.then_some((first.column, &first.mapping))
    }

    /// Takes a column as a signal, or the question that there is about it.
    fn settle(&mut self, signal: Signal, outcome: Outcome) {
        match outcome {
            Outcome::Assigned(assigned) => {
                self.assigned.insert(signal, assigned);
            }
            Outcome::Asked(question) => self.questions.push(question),
        }
    }
}

/// What was made out about a signal.
enum Outcome {
    Assigned(Assigned),
    Asked(Question),
}

/// Proposes which column is which signal.
pub fn propose(columns: &Columns, hints: &Hints) -> SignalProposal {
    let traces: Vec<Trace<'_>> =
        columns.columns.iter().enumerate().map(|(index, column)| Trace::of(index, column)).collect();
    let samples = columns.columns.first().map_or(0, |column| column.values.len());
    let rate_hz = columns.rate_hz / trace::block(samples) as f64;
    let mut proposal = SignalProposal::default();
    for (signal, mapping) in &hints.given {
        if let Some(trace) = traces.iter().find(|trace| is_at(trace.column, mapping)) {
            proposal.assigned.insert(*signal, given(trace, mapping));
        }
    }
    Motion::new(&traces, rate_hz, hints).propose(&mut proposal);
    // Nothing more can be told of an axis whose command is not known.
    let Some(command) = proposal.mapping_of(Signal::Command) else { return proposal };
    let in_si = |(column, mapping): (usize, &SignalMapping)| {
        traces[column].values.iter().map(|value| value * mapping.scale + mapping.offset).collect()
    };
    let position = proposal.mapping_of(Signal::Position).map(in_si);
    let drive = Drive { command: in_si(command), position, rate_hz, hints };
    circuit::propose(&traces, &drive, &mut proposal);
    load::propose(&traces, &drive, &mut proposal);
    cycle_start::propose(&traces, &drive, &mut proposal);
    proposal
}

fn is_at(column: &Column, mapping: &SignalMapping) -> bool {
    column.field == mapping.field && (mapping.topic.is_empty() || column.topic == mapping.topic)
}

fn given(trace: &Trace<'_>, mapping: &SignalMapping) -> Assigned {
    Assigned {
        column: trace.index,
        mapping: mapping.clone(),
        confidence: 1.0,
        evidence: vec![format!("You said that it is {}.", shown(trace))],
        rivals: Vec::new(),
    }
}

/// A column's name for people.
fn shown(trace: &Trace<'_>) -> String {
    let Column { topic, field, .. } = trace.column;
    if topic.is_empty() { format!("`{field}`") } else { format!("`{field}` of {topic}") }
}

/// The mapping to a column.
fn mapping_to(trace: &Trace<'_>, scale: f64, offset: f64) -> SignalMapping {
    let Column { topic, field, .. } = trace.column;
    SignalMapping { topic: topic.clone(), field: field.clone(), scale, offset, ..SignalMapping::default() }
}
