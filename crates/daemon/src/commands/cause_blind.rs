//! `seepd cause-blind`: named causes checked on machines that another simulator has changed.
//!
//! The monitor sees samples only; what was planted comes beside its answers once they are given.

use std::path::PathBuf;

use clap::Args;
use rayon::prelude::*;
use seepd_blind::change::score::{Answer, Answered, Scores, Share, score};
use seepd_blind::change::{self, NOISE, Watched};
use seepd_model::Model;
use seepd_monitor::event::{CycleLine, Event, Flag};
use seepd_monitor::{MonitorConfig, Pipeline};
use seepd_signals::Sample;
use seepd_sim::noise::Noise;
use serde::Serialize;

use super::blind::tell_or_write;
use crate::cli::Outcome;
use crate::failure::{Code, Failure};
use crate::output::{Outputs, OverwriteArguments};
use crate::progress::{Steps, warn};
use crate::quantity::percent;

/// Checks named causes on machines of another simulator: each has a baseline, then a step or a drift of a cause that is withheld from the
/// monitor.
#[derive(Debug, Args)]
#[command(after_help = "Example: seepd cause-blind --machines 200 --seed 7")]
pub struct CauseBlindArguments {
    /// Machines
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u16).range(4..=10_000))]
    machines: u16,
    /// Seed of everything that is drawn
    #[arg(long, value_name = "S")]
    seed: u64,
    /// Write scores and answers as JSON; `-`: to standard output, instead of the table
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// List the wrong answers
    #[arg(long)]
    wrong: bool,
    #[command(flatten)]
    overwrite: OverwriteArguments,
}

#[derive(Serialize)]
struct Told<'a> {
    scores: &'a Scores,
    answers: &'a [Answered],
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] for files.
pub fn run(arguments: &CauseBlindArguments) -> Result<Outcome, Failure> {
    let file = arguments.json.as_ref().filter(|path| *path != std::path::Path::new("-"));
    let file = Outputs::new(arguments.overwrite, []).claim_any(file)?;
    let model = std::sync::Arc::new(Model::from_json(crate::EMBEDDED_MODEL).map_err(internal)?);
    let machines = change::draw(arguments.seed, arguments.machines.into());
    let steps = Steps::begin(machines.len() as u64, "watching");
    let answers: Vec<Option<Answered>> = machines
        .par_iter()
        .enumerate()
        .map(|(index, watched)| {
            let answer = watch(&model, watched, arguments.seed ^ index as u64)?;
            steps.one_more();
            Ok(answer.map(|answer| Answered { change: watched.change.clone(), answer }))
        })
        .collect::<Result<_, Failure>>()?;
    drop(steps);
    let answers: Vec<Answered> = answers.into_iter().flatten().collect();
    if answers.len() < machines.len() {
        let left_out = machines.len() - answers.len();
        warn(&format!("{left_out} machines went out of bounds as they were simulated, and are left out"));
    }
    let scores = score(&answers);
    let told = Told { scores: &scores, answers: &answers };
    tell_or_write(arguments.json.is_some(), file.as_ref(), &told, || table(&scores, arguments.wrong))
}

fn internal(error: impl std::fmt::Display) -> Failure {
    Failure::new(Code::Internal, error.to_string())
}

/// What a monitor says of a machine; `None` of one that went out of bounds.
fn watch(model: &std::sync::Arc<Model>, watched: &Watched, seed: u64) -> Result<Option<Answer>, Failure> {
    let config = MonitorConfig::new("machine", std::sync::Arc::clone(model));
    let mut pipeline = Pipeline::new(config).map_err(internal)?;
    // The first and the last cycle of each half are not whole.
    pipeline.learn("commissioning", change::BASELINE_CYCLES - 4).map_err(internal)?;
    let mut noise = Noise::new(seed, 11);
    let mut answer = Answer {
        cycles: 0,
        silent: 0,
        flagged: false,
        flagged_at_end: false,
        cause: "none".into(),
        also: None,
        probability: 0.0,
        candidates: Vec::new(),
        leak_lpm: None,
    };
    let mut time_ns = 0;
    let finite = watched.run(|stage, sample| {
        let command = (sample.command + noise.normal(NOISE)).clamp(-1.0, 1.0);
        pipeline.push(&Sample::command(time_ns, command), &mut |event| {
            if let Event::Cycle(line) = event
                && stage > 0
            {
                answer.hear(line);
            }
        });
        time_ns += 1_000_000;
    });
    Ok(finite.then_some(answer))
}

/// Hears what a monitor says of cycles.
trait Hear {
    fn hear(&mut self, line: &CycleLine<'_>);
}

impl Hear for Answer {
    fn hear(&mut self, line: &CycleLine<'_>) {
        // Where one run ends and the next begins, the machine does not follow its cycle.
        let Some(cause) = &line.cause else { return };
        self.cycles += 1;
        self.silent += usize::from(line.leak_area_m2.is_none());
        self.flagged_at_end = line.flag >= Flag::Watch;
        self.flagged |= self.flagged_at_end;
        self.cause = cause.cause.to_owned();
        self.also = cause.cause_also.map(str::to_owned);
        self.probability = cause.cause_probability;
        let candidates = cause.cause_candidates.0.iter();
        self.candidates = candidates.map(|one| (one.kind.cause.name().to_owned(), one.probability)).collect();
        let lpm = line.leak_flow_lpm.zip(line.leak_area_m2).zip(line.interval90_m2);
        self.leak_lpm = lpm.map(|((flow, area), interval)| {
            // A leak of nothing has no ratio.
            let per_m2 = if area > 0.0 { flow / area } else { LPM_PER_M2 };
            (flow, interval.map(|end| end * per_m2))
        });
    }
}

/// Flow of 1 m² at 7 MPa on the nominal press, L/min.
const LPM_PER_M2: f64 = 5.3e6;

fn table(scores: &Scores, wrong: bool) -> String {
    let share = |share: Share| format!("{:.3} ({} of {})", share.value(), share.count, share.of);
    let two = |[alone, beside]: [Share; 2]| format!("{}, {}", share(alone), share(beside));
    let error = |[median, ninth]: [f64; 2]| format!("{}, {}", percent(median, 1), percent(ninth, 1));
    let rows = [
        ("machines", scores.machines.to_string()),
        ("flag on a machine without a leak", share(scores.false_flags)),
        ("leaks from 0.3 L/min on missed: alone, beside another cause", two(scores.missed)),
        ("cause right within classes, of all", share(scores.right[0])),
        ("  under the library's laws, under others", two([scores.right[1], scores.right[2]])),
        ("decided, and right of these", two(scores.decided)),
        ("probability said less share right", format!("{:+.3}", scores.overconfidence)),
        ("causes without a name not named", share(scores.outside)),
        ("cycles without an estimate after a change with a name", share(scores.silent)),
        ("error of leaks from 0.3 L/min on, alone: median, 90th percentile", error(scores.leak_error[0])),
        ("  beside another cause", error(scores.leak_error[1])),
        ("intervals that hold these: alone, beside", two(scores.held)),
    ];
    let mut text: String = rows.iter().map(|(name, value)| format!("{name:<66} {value}\n")).collect();
    if wrong {
        scores.wrong.iter().for_each(|line| text += &format!("{line}\n"));
    }
    text
}
