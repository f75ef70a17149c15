//! `seepd adopt-blind score`: what was said of the machines, against the truth.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use clap::Args;
use seepd_blind::axis::score::{Answer, Answered, CycleAnswer, Scores, score};
use seepd_blind::axis::{HEALTHY, LoggedSignals, Truth};
use seepd_monitor::event::Flag;
use serde::Deserialize;

use super::{Ended, TRUTH};
use crate::cli::Outcome;
use crate::commands::blind::{read_json, tell_or_write};
use crate::failure::Failure;
use crate::output::{Outputs, OverwriteArguments};
use crate::quantity;

#[derive(Debug, Args)]
pub(super) struct ScoreArguments {
    /// Folder with the truth
    #[arg(long, value_name = "DIR")]
    truth: PathBuf,
    /// Folder with what was said
    #[arg(long, value_name = "DIR")]
    adopted: PathBuf,
    /// Write the scores as JSON; `-`: to standard output, instead of the tables
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    #[command(flatten)]
    overwrite: OverwriteArguments,
}

/// What is scored of a line of `seepd replay --json`.
#[derive(Debug, Deserialize)]
struct ReplayLine {
    schema: String,
    leak_flow_lpm: Option<f64>,
    leak_area_m2: Option<f64>,
    interval90_m2: Option<[f64; 2]>,
    flag: Option<Flag>,
}

/// Schema of a cycle's line.
const CYCLE_SCHEMA: &str = "seepd.cycle/1";

pub(super) fn run(arguments: &ScoreArguments) -> Result<Outcome, Failure> {
    let truth = arguments.truth.join(TRUTH);
    let file = arguments.json.as_ref().filter(|path| *path != Path::new("-"));
    let file = Outputs::new(arguments.overwrite, [truth.as_path()]).claim_any(file)?;
    let truths: BTreeMap<String, Truth> = read_json(&truth)?;
    let mut answers: BTreeMap<&String, Answer> = BTreeMap::new();
    for (name, truth) in &truths {
        if arguments.adopted.join(format!("{name}.json")).exists() {
            answers.insert(name, read_answer(&arguments.adopted, name, truth)?);
        }
    }
    let mut scores: BTreeMap<&str, Scores> = BTreeMap::new();
    for (signals, named) in [(LoggedSignals::Command, "command"), (LoggedSignals::Position, "position")] {
        let cases: Vec<Answered> = answers
            .iter()
            .filter_map(|(name, answer)| {
                let truth = truths.get(name.as_str())?;
                let is_of_set = truth.format.signals == signals;
                is_of_set.then_some(Answered { name, truth, answer })
            })
            .collect();
        if !cases.is_empty() {
            scores.insert(named, score(&cases));
        }
    }
    if scores.is_empty() {
        return Err(Failure::data(format!(
            "{}: the folder has no answers to this truth",
            arguments.adopted.display()
        )));
    }
    tell_or_write(arguments.json.is_some(), file.as_ref(), &scores, || tables(&scores))
}

fn read_answer(adopted: &Path, name: &str, truth: &Truth) -> Result<Answer, Failure> {
    let Ended { outcome, seconds } = read_json(&adopted.join(format!("{name}.json")))?;
    let mut logs = BTreeMap::new();
    for log in truth.logs.keys().filter(|log| *log != HEALTHY) {
        let path = adopted.join(name).join(format!("{log}.jsonl"));
        match fs::read_to_string(&path) {
            Ok(text) => {
                let cycles = cycles_of(&text)
                    .map_err(|error| Failure::data(format!("{}: {error}", path.display())))?;
                logs.insert(log.clone(), cycles);
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(Failure::reading(&path, &error)),
        }
    }
    Ok(Answer { outcome, seconds, logs })
}

/// The cycles of what `seepd replay --json` printed. Intervals are areas there; sizes tell how much flow an area is.
fn cycles_of(text: &str) -> Result<Vec<CycleAnswer>, serde_json::Error> {
    let mut lines: Vec<ReplayLine> = text.lines().map(serde_json::from_str).collect::<Result<_, _>>()?;
    lines.retain(|line| line.schema == CYCLE_SCHEMA);
    let lpm_per_m2 = lines.iter().find_map(|line| {
        let (flow, area) = line.leak_flow_lpm.zip(line.leak_area_m2)?;
        (area > 0.0).then_some(flow / area)
    });
    let of = |line: &ReplayLine| CycleAnswer {
        leak_lpm: line.leak_flow_lpm,
        interval90_lpm: line.interval90_m2.zip(lpm_per_m2).map(|(ends, factor)| ends.map(|end| end * factor)),
        flagged: line.flag.is_some_and(|flag| flag >= Flag::Watch),
    };
    Ok(lines.iter().map(of).collect())
}

fn tables(scores: &BTreeMap<&str, Scores>) -> String {
    let percent = |share: Option<f64>| quantity::percent(share.unwrap_or(f64::NAN), 1);
    let of = |[count, all]: [usize; 2]| format!("{count} of {all}");
    type Cell<'a> = &'a dyn Fn(&Scores) -> String;
    let rows: [(&str, Cell); 10] = [
        ("adopted without an edit", &|s| of([s.adopted, s.cases])),
        ("cycles of the later logs with an estimate", &|s| percent(s.estimated)),
        ("median size error above 1 % of the rated flow", &|s| {
            let (count, error) = s.sizes;
            format!("{} ({count} leaks)", percent(error))
        }),
        ("90 % intervals that hold the truth", &|s| percent(s.coverage)),
        ("leaks above 1 % of the rated flow that were found", &|s| of([s.found[1], s.found[0]])),
        ("predictions of the smallest leak that hold within 1.5 times", &|s| {
            of([s.predictions[1], s.predictions[0]])
        }),
        ("of these with a leak found and one not", &|s| s.predictions[2].to_string()),
        ("flags that rose in healthy cycles", &|s| of([s.false_alarms[1], s.false_alarms[0]])),
        ("logs with a shifted null in which a leak was flagged", &|s| {
            of([s.null_shifts[1], s.null_shifts[0]])
        }),
        ("seconds of an adoption: median, largest", &|s| {
            s.seconds.map_or("–".into(), |[median, largest]| format!("{median:.0}, {largest:.0}"))
        }),
    ];
    let mut text = String::from("| score |");
    scores.keys().for_each(|set| text += &format!(" {set} |"));
    text += "\n|---|";
    scores.keys().for_each(|_| text += "---|");
    text += "\n";
    for (name, cell) in rows {
        text += &format!("| {name} |");
        scores.values().for_each(|scores| text += &format!(" {} |", cell(scores)));
        text += "\n";
    }
    text += "\n| machine | with an estimate | size errors, by leak over rated flow | intervals that hold | \
             smallest leak: predicted, missed, found | false alarms | s |\n|---|---|---|---|---|---|---|\n";
    for case in scores.values().flat_map(|scores| &scores.by_case) {
        let errors: Vec<String> = case
            .size_errors
            .iter()
            .map(|(leak, error)| format!("{:.1} % at {:.2} %", 100.0 * error, 100.0 * leak))
            .collect();
        text += &format!(
            "| {} | {} | {} | {} | {} | {} | {:.0} |\n",
            case.name,
            percent(case.estimated),
            errors.join(", "),
            percent(case.coverage),
            case.smallest.map(percent).join(", "),
            case.false_alarms,
            case.seconds
        );
    }
    let not_adopted: Vec<String> = scores
        .values()
        .flat_map(|scores| &scores.not_adopted)
        .map(|(name, reason)| format!("- {name}: {reason}\n"))
        .collect();
    if !not_adopted.is_empty() {
        text += &format!("\nNot adopted:\n\n{}", not_adopted.concat());
    }
    text
}

#[cfg(test)]
mod tests {
    use seepd_blind::axis::score::Outcome as Adoption;

    use super::*;

    #[test]
    fn cycles_are_read_from_what_replay_prints() {
        let text = [
            r#"{"schema":"seepd.cycle/1","leak_area_m2":0.0,"leak_flow_lpm":0.0,"interval90_m2":[0.0,1e-7],"flag":"healthy"}"#,
            r#"{"schema":"seepd.cycle/1","leak_area_m2":2e-7,"leak_flow_lpm":1.0,"interval90_m2":[1e-7,4e-7],"flag":"leak"}"#,
            r#"{"schema":"seepd.cycle/1","leak_area_m2":null,"leak_flow_lpm":null,"interval90_m2":null,"flag":"no_estimate"}"#,
            r#"{"schema":"seepd.summary/1","cycles":3}"#,
        ];
        let cycles = cycles_of(&text.join("\n")).unwrap();
        let answer = |leak_lpm, interval90_lpm, flagged| CycleAnswer { leak_lpm, interval90_lpm, flagged };
        assert_eq!(cycles[0], answer(Some(0.0), Some([0.0, 0.5]), false));
        assert_eq!(cycles[1], answer(Some(1.0), Some([0.5, 2.0]), true));
        assert_eq!(cycles[2], answer(None, None, false));
        assert_eq!(cycles.len(), 3);
    }

    #[test]
    fn an_ended_adoption_reads() {
        let read = |text: &str| serde_json::from_str::<Ended>(text).unwrap();
        let adopted = read(r#"{"adopted":{"smallest_leak_lpm":0.4},"seconds":100.5}"#);
        assert_eq!(adopted.outcome, Adoption::Adopted { smallest_leak_lpm: Some(0.4) });
        assert_eq!(adopted.seconds, 100.5);
        let refused = read(r#"{"refused":{"reason":"no cycle"},"seconds":2}"#);
        assert_eq!(refused.outcome, Adoption::Refused { reason: "no cycle".into() });
    }
}
