//! What only the user can say, asked on the terminal.

use std::io::{self, BufRead, IsTerminal, Write};

use seepd_adopt::machine_data::{Datum, FlowCurve, MachineData, Orientation};
use seepd_adopt::signals::{Assigned, Question, SignalProposal};
use seepd_logs::columns::Columns;

use crate::failure::{Code, Failure};
use crate::sink::plain;

/// Answers a proposal's questions: asked on a terminal, refused where there is none.
pub(super) fn answered(mut proposal: SignalProposal, columns: &Columns) -> Result<SignalProposal, Failure> {
    let questions = std::mem::take(&mut proposal.questions);
    for question in questions {
        let chosen = if is_terminal() { ask(&question, columns)? } else { None };
        match chosen {
            Some(index) => {
                let candidate = question.candidates[index].clone();
                proposal.assigned.insert(
                    question.signal,
                    Assigned {
                        column: candidate.column,
                        mapping: candidate.mapping,
                        confidence: 1.0,
                        evidence: vec!["You said so.".into()],
                        rivals: Vec::new(),
                    },
                );
            }
            // Without the command there is nothing; any other signal may stay away.
            None if question.signal == seepd_signals::Signal::Command => {
                return Err(unanswered(&question, columns));
            }
            None => crate::progress::warn(&format!(
                "{} is left out, since it is not sure: {} (map it in a configuration and name that with --config)",
                question.signal.name(),
                question.why
            )),
        }
    }
    Ok(proposal)
}

fn unanswered(question: &Question, columns: &Columns) -> Failure {
    let listed: Vec<String> = question
        .candidates
        .iter()
        .map(|candidate| {
            let field = columns.columns.get(candidate.column).map_or("", |column| column.field.as_str());
            format!(
                "`{field}` as {}: field = \"{field}\", scale = {:?}, offset = {:?}",
                candidate.what, candidate.mapping.scale, candidate.mapping.offset
            )
        })
        .collect();
    Failure::data(format!(
        "the {} is not sure: {} Say which in a configuration (--config): {}",
        question.signal.name(),
        question.why,
        listed.join("; ")
    ))
}

fn is_terminal() -> bool {
    io::stdin().is_terminal() && io::stderr().is_terminal()
}

fn ask(question: &Question, columns: &Columns) -> Result<Option<usize>, Failure> {
    let mut text = format!("\n{}: {}\n", question.signal.name(), question.why);
    for (index, candidate) in question.candidates.iter().enumerate() {
        let field = columns.columns.get(candidate.column).map_or("", |column| column.field.as_str());
        text += &format!("  {}  {field}: {}\n", index + 1, candidate.what);
    }
    text += "  0  none of these\n";
    loop {
        let Some(answer) = line(&format!("{text}Which one? "))? else { return Ok(None) };
        match answer.parse::<usize>() {
            Ok(0) => return Ok(None),
            Ok(number) if number <= question.candidates.len() => return Ok(Some(number - 1)),
            _ => text = format!("Please answer with a number from 0 to {}.\n", question.candidates.len()),
        }
    }
}

/// One line of an answer; `None` at the end of input.
fn line(prompt: &str) -> Result<Option<String>, Failure> {
    let failed = |error: io::Error| Failure::new(Code::Io, format!("asking on the terminal: {error}"));
    let mut out = plain::stderr();
    out.write_all(prompt.as_bytes()).and_then(|()| out.flush()).map_err(failed)?;
    let mut answer = String::new();
    let read = io::stdin().lock().read_line(&mut answer).map_err(failed)?;
    Ok((read > 0).then(|| answer.trim().to_owned()))
}

/// Asks for the machine's data one by one; an empty answer is "I do not know".
pub(super) fn machine() -> Result<MachineData, Failure> {
    let mut data = MachineData::default();
    let mut out = plain::stderr();
    let _ =
        writeln!(out, "\nWhat do you know of the machine? Leave an answer empty where you do not know.\n");
    let cylinder = &mut data.cylinder;
    cylinder.bore_mm = number("Bore of the cylinder, mm (usual: 63; it turns speeds into flows)")?;
    cylinder.rod_mm = number("Diameter of the rod, mm (usual: 36 for a bore of 63)")?;
    cylinder.stroke_mm = number("Stroke, mm (positions are checked against it)")?;
    cylinder.moved_mass_kg = number("Moved mass with rod and tool, kg (usual: 250 for a bore of 63)")?;
    let orientation =
        line("Does extending lift the mass (u), lower it (d), or neither (empty)? ")?.unwrap_or_default();
    cylinder.orientation = match orientation.to_lowercase().as_str() {
        "u" | "up" => Orientation::RodUp,
        "d" | "down" => Orientation::RodDown,
        _ => Orientation::Horizontal,
    };
    data.valve.rated_flow_lpm =
        number("Rated flow of the valve, L/min (order code; leaks are sized against it)")?;
    data.valve.rated_at_bar = number(
        "Pressure drop of that rating over both lands, bar (70 for servo, 10 for proportional valves)",
    )?
    .map(Datum::value);
    let curve = line("Is its flow over the command a line (l), progressive (p), or fine up to a knee (k)? ")?;
    data.valve.curve = match curve.unwrap_or_default().to_lowercase().as_str() {
        "l" | "line" | "linear" => Some(FlowCurve::Linear),
        "p" | "progressive" => Some(FlowCurve::Progressive),
        "k" | "knee" => Some(FlowCurve::DoubleGain),
        _ => None,
    };
    data.supply.pump_flow_lpm = number("Flow of the pump, L/min")?;
    data.supply.relief_bar = number("Pressure of the relief valve or the regulated pump, bar (usual: 160)")?;
    data.controller.task_period_ms = number("Period of the controller's task, ms (usual: 1)")?;
    Ok(data)
}

fn number(what: &str) -> Result<Option<Datum>, Failure> {
    let mut prompt = format!("{what}: ");
    loop {
        let Some(answer) = line(&prompt)?.filter(|answer| !answer.is_empty()) else { return Ok(None) };
        match answer.replace(',', ".").parse::<f64>() {
            Ok(value) if value.is_finite() && value > 0.0 => return Ok(Some(Datum::Bare(value))),
            _ => prompt = "Please answer with a positive number, or leave it empty: ".into(),
        }
    }
}
