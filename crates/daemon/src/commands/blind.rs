//! `seepd gap blind`: the diagnosis checked on logs whose cause is withheld from it.
//!
//! Three steps that share nothing but files: `plant` writes logs and, elsewhere, the truth; `diagnose` reads logs only; `score` compares.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use rayon::prelude::*;
use seepd_blind::cause::{Case, Truth};
use seepd_blind::score::{Answer, Answered, Scores, score};
use seepd_gap::{DiagnosisSettings, Log, Record, nominal_gap};
use seepd_settings::side_file;
use seepd_signals::Signal;
use seepd_sim::MachineSpec;
use seepd_sim::noise::Noise;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::gap::{answer, emitted, pool, read};
use super::simulate::{OtherSignals, SignalsMessage, write_message};
use crate::cli::Outcome;
use crate::config::AxisConfig;
use crate::failure::{Code, Failure};
use crate::output::{Output, Outputs, OverwriteArguments};
use crate::progress::Steps;
use crate::sink::mcap::{ChunkCompression, McapSink, schema};
use crate::sink::terminal::print;

/// Checks the diagnosis on logs whose cause is withheld from it: plants causes with a second simulator, diagnoses the logs, and scores
/// the answers.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  seepd gap blind plant --logs logs --truth truth --seed 7\n  \
                        seepd gap blind diagnose --logs logs --answers answers\n  \
                        seepd gap blind score --truth truth --answers answers --logs logs")]
pub struct BlindArguments {
    #[command(subcommand)]
    step: Step,
}

#[derive(Debug, Subcommand)]
enum Step {
    /// Write logs with planted causes, and the truth into another folder
    #[command(after_help = "Example: seepd gap blind plant --logs logs --truth truth --seed 7")]
    Plant(PlantArguments),
    /// Diagnose logs, with and without pressures
    #[command(after_help = "Example: seepd gap blind diagnose --logs logs --answers answers")]
    Diagnose(DiagnoseArguments),
    /// Score answers against the truth
    #[command(after_help = "Example: seepd gap blind score --truth truth --answers answers --logs logs")]
    Score(ScoreArguments),
}

#[derive(Debug, Args)]
struct PlantArguments {
    /// Folder for the logs; must be empty or not exist
    #[arg(long, value_name = "DIR")]
    logs: PathBuf,
    /// Folder for the truth; must be empty or not exist
    #[arg(long, value_name = "DIR")]
    truth: PathBuf,
    /// Seed of everything that is drawn
    #[arg(long, value_name = "S")]
    seed: u64,
    /// Cases of each set: exact machines, other parameters, pairs, effects that the catalogue lacks, causes without a name
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u16).range(1..=1000))]
    each: u16,
    /// Sizes at which each effect is planted alone
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=3))]
    sizes: u16,
    /// Keep only the first N cases
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
    /// Duty cycles of each log
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u16).range(3..=1000))]
    cycles: u16,
}

#[derive(Debug, Args)]
struct DiagnoseArguments {
    /// Folder with the logs
    #[arg(long, value_name = "DIR")]
    logs: PathBuf,
    /// Folder for the answers; answers that are there are kept
    #[arg(long, value_name = "DIR")]
    answers: PathBuf,
    /// Diagnose only with these signals
    #[arg(long, value_enum)]
    view: Option<View>,
    /// Threads [default: one a core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

#[derive(Debug, Args)]
struct ScoreArguments {
    /// Folder with the truth
    #[arg(long, value_name = "DIR")]
    truth: PathBuf,
    /// Folder with the answers
    #[arg(long, value_name = "DIR")]
    answers: PathBuf,
    /// Folder with the logs, to measure claimed gaps again with the emitted plants
    #[arg(long, value_name = "DIR")]
    logs: Option<PathBuf>,
    /// Folder with answers whose calibration says which causes are visible, so that methods can be compared [default: the answers
    /// themselves]
    #[arg(long, value_name = "DIR")]
    visible_by: Option<PathBuf>,
    /// Write the scores as JSON; `-`: to standard output, instead of the table
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// List the wrong answers
    #[arg(long)]
    wrong: bool,
    #[command(flatten)]
    overwrite: OverwriteArguments,
}

/// Which signals a diagnosis sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum View {
    /// All that are in the log.
    Pressures,
    /// Command and position.
    Command,
}

impl View {
    const ALL: [View; 2] = [View::Pressures, View::Command];

    fn name(self) -> &'static str {
        match self {
            View::Pressures => "pressures",
            View::Command => "command",
        }
    }

    fn of(self, log: &Log) -> Log {
        match self {
            View::Pressures => log.clone(),
            View::Command => log.clone().with_only(&[Signal::Command, Signal::Position]),
        }
    }
}

/// What the diagnoser is told beside the logs.
#[derive(Debug, Serialize, Deserialize)]
struct Task {
    /// Effect that its catalogue lacks, by log; each log has one.
    without: BTreeMap<String, String>,
}

/// What is recorded before anything is diagnosed.
#[derive(Debug, Serialize)]
struct Hashes {
    version: &'static str,
    tool_sha256: String,
    logs_sha256: BTreeMap<String, String>,
}

const TASK: &str = "task.json";
const TRUTH: &str = "truth.json";
const HASHES: &str = "hashes.json";

/// Runs the command.
///
/// # Errors
/// [`Failure`] for directories and files.
pub fn run(arguments: &BlindArguments) -> Result<Outcome, Failure> {
    match &arguments.step {
        Step::Plant(arguments) => plant(arguments),
        Step::Diagnose(arguments) => diagnose(arguments),
        Step::Score(arguments) => tell_scores(arguments),
    }
}

fn plant(arguments: &PlantArguments) -> Result<Outcome, Failure> {
    for directory in [&arguments.logs, &arguments.truth] {
        begin_folder(directory)?;
    }
    let mut cases = seepd_blind::draw(arguments.seed, arguments.each.into(), arguments.sizes.into());
    cases.truncate(arguments.limit.unwrap_or(cases.len()));
    let steps = Steps::begin(cases.len() as u64, "planting");
    cases.par_iter().try_for_each(|case| {
        let out = in_own_folder(&arguments.logs.join(format!("{}.mcap", case.name)))?;
        write_case(&out, case, arguments.cycles.into())?;
        steps.one_more();
        Ok::<(), Failure>(())
    })?;
    drop(steps);
    let task = Task { without: cases.iter().map(|c| (c.name.clone(), c.without.clone())).collect() };
    write_json(&in_own_folder(&arguments.logs.join(TASK))?, &task)?;
    let truths: BTreeMap<&str, &Truth> = cases.iter().map(|c| (c.name.as_str(), &c.truth)).collect();
    write_json(&in_own_folder(&arguments.truth.join(TRUTH))?, &truths)?;
    print(format!("{} logs\n", cases.len()).as_bytes())?;
    Ok(Outcome::Good)
}

/// Standard deviations of the sensors' noise: command as a share, position in m, pressures in Pa (0.1 % of 200 bar), load in N.
const NOISE: (f64, f64, f64, f64) = (1e-3, 1e-5, 2e4, 20.0);

fn write_case(out: &Output, case: &Case, cycles: usize) -> Result<(), Failure> {
    let writing = |error| Failure::writing(out.path(), error);
    let mut sink = McapSink::new(out.create()?, ChunkCompression::Zstd).map_err(writing)?;
    let channel = sink.add_channel("/axis/signals", "seepd.Signals", schema::SIGNALS).map_err(writing)?;
    let mut noise = Noise::new(case.truth.seed, 11);
    let press = case.truth.press();
    let (mut tick, mut line, mut result) = (0i64, Vec::with_capacity(256), Ok(()));
    let rounded = |value: f64| (value * 1e7).round() / 1e7;
    let finite = press.run(cycles, case.truth.variation(), |sample| {
        let mut pressure = |index: usize| {
            let shown_pa = case.truth.transducers[index].shown_pa(sample.pressures_pa[index]);
            (shown_pa + noise.normal(NOISE.2)).round()
        };
        let (p_supply, p_inlet, p_cap, p_rod) = (pressure(0), pressure(1), pressure(2), pressure(3));
        let command = rounded(sample.command + noise.normal(NOISE.0));
        let others = OtherSignals {
            demand: rounded(sample.demand_m),
            position: rounded(sample.position_m + noise.normal(NOISE.1)),
            p_supply,
            p_inlet,
            p_cap,
            p_rod,
            load: (sample.load_n + noise.normal(NOISE.3)).round(),
        };
        let message = SignalsMessage { command, others: Some(others) };
        let written = write_message(&mut sink, channel, tick * 1_000_000, &mut line, &message);
        if let Err(error) = written {
            result = Err(error);
        }
        tick += 1;
    });
    result.map_err(writing)?;
    if !finite {
        return Err(Failure::new(
            Code::Internal,
            format!("{}: the planted machine went out of bounds", case.name),
        ));
    }
    sink.finish().map_err(writing)?;
    sink.into_inner().finish()
}

#[expect(
    clippy::disallowed_methods,
    reason = "how long a diagnosis took is part of it; nothing else depends on it"
)]
fn diagnose(arguments: &DiagnoseArguments) -> Result<Outcome, Failure> {
    let task: Task = read_json(&arguments.logs.join(TASK))?;
    fs::create_dir_all(&arguments.answers).map_err(|error| Failure::writing(&arguments.answers, error))?;
    let log_of = |name: &str| arguments.logs.join(format!("{name}.mcap"));
    let mut logs_sha256 = BTreeMap::new();
    for name in task.without.keys() {
        logs_sha256.insert(name.clone(), hash(&log_of(name))?);
    }
    let tool = std::env::current_exe().map_err(|error| Failure::new(Code::Internal, error.to_string()))?;
    let hashes = Hashes { version: env!("CARGO_PKG_VERSION"), tool_sha256: hash(&tool)?, logs_sha256 };
    write_json(&in_own_folder(&arguments.answers.join(HASHES))?, &hashes)?;
    let views = arguments.view.map_or(View::ALL.to_vec(), |view| vec![view]);
    let spec = MachineSpec::default();
    let pool = pool(arguments.threads)?;
    let steps = Steps::begin((task.without.len() * views.len()) as u64, "diagnosing");
    for (name, without) in &task.without {
        let mut log = None;
        for view in &views {
            let path = arguments.answers.join(format!("{name}.{}.json", view.name()));
            steps.one_more();
            if path.exists() {
                continue;
            }
            if log.is_none() {
                log = Some(read(&log_of(name), &AxisConfig::default(), &spec)?.0);
            }
            let Some(log) = &log else { continue };
            let begin = std::time::Instant::now();
            let settings =
                DiagnosisSettings { without: vec![without.clone()], ..DiagnosisSettings::default() };
            let (mut diagnosis, machine) = pool
                .install(|| answer(Record::new(&view.of(log), &spec), &spec, &settings, &mut |_| ()))
                .map_err(|error| Failure::data(format!("{name}: {error}")))?;
            diagnosis.seconds = begin.elapsed().as_secs_f64();
            let plant = arguments.answers.join(format!("{name}.{}.toml", view.name()));
            in_own_folder(&plant)?.write(emitted(machine)?)?;
            write_json(&in_own_folder(&path)?, &diagnosis)?;
        }
    }
    drop(steps);
    Ok(Outcome::Good)
}

fn tell_scores(arguments: &ScoreArguments) -> Result<Outcome, Failure> {
    let truth = arguments.truth.join(TRUTH);
    let file = arguments.json.as_ref().filter(|path| *path != Path::new("-"));
    let file = Outputs::new(arguments.overwrite, [truth.as_path()]).claim_any(file)?;
    let truths: BTreeMap<String, Truth> = read_json(&truth)?;
    let mut scores = BTreeMap::new();
    for view in View::ALL {
        let mut answers = Vec::new();
        for (case, truth) in &truths {
            let file = format!("{case}.{}.json", view.name());
            let path = arguments.answers.join(&file);
            if !path.exists() {
                continue;
            }
            let answer: Answer = read_json(&path)?;
            let visible = match &arguments.visible_by {
                Some(others) => read_json::<Answer>(&others.join(&file))?.visible(),
                None => answer.visible(),
            };
            let plant = arguments.answers.join(format!("{case}.{}.toml", view.name()));
            let measured =
                arguments.logs.as_ref().map(|logs| measured(logs, case, view, &plant)).transpose()?.flatten();
            answers.push(Answered { case: case.clone(), truth: truth.clone(), answer, visible, measured });
        }
        if !answers.is_empty() {
            scores.insert(view.name(), score(&answers));
        }
    }
    if scores.is_empty() {
        return Err(Failure::data(format!(
            "{}: the folder has no answers to this truth",
            arguments.answers.display()
        )));
    }
    tell_or_write(arguments.json.is_some(), file.as_ref(), &scores, || table(&scores, arguments.wrong))
}

/// Scores as JSON into a file with their tables on standard output, or, where JSON is asked for without a file, alone there.
pub(super) fn tell_or_write(
    as_json: bool,
    file: Option<&Output>,
    scores: &impl Serialize,
    tables: impl FnOnce() -> String,
) -> Result<Outcome, Failure> {
    match file {
        Some(file) => write_json(file, scores)?,
        None if as_json => {
            print((json(scores)? + "\n").as_bytes())?;
            return Ok(Outcome::Good);
        }
        None => {}
    }
    print(tables().as_bytes())?;
    Ok(Outcome::Good)
}

/// The gap of an emitted plant, measured on the log itself.
fn measured(
    logs: &Path,
    case: &str,
    view: View,
    plant: &Path,
) -> Result<Option<BTreeMap<String, f64>>, Failure> {
    let text = side_file::read_text(plant).map_err(|error| Failure::reading(plant, &error))?;
    let spec = MachineSpec::from_toml(&text).map_err(|error| Failure::configuration(plant, error))?;
    let (log, _) = read(&logs.join(format!("{case}.mcap")), &AxisConfig::default(), &spec)?;
    let Ok(record) = Record::new(&view.of(&log), &spec) else { return Ok(None) };
    let gap = nominal_gap(&record, &spec);
    Ok(Some(gap.into_iter().map(|(signal, gap)| (signal.to_owned(), gap)).collect()))
}

fn table(scores: &BTreeMap<&str, Scores>, wrong: bool) -> String {
    type Cell = fn(&Scores) -> String;
    let rows: [(&str, Cell); 18] = [
        ("cases", |s| s.cases.to_string()),
        ("single effects visible after calibration", |s| format!("{} of {}", s.visible[0], s.visible[1])),
        ("top-1, visible, within classes", |s| format!("{:.2}", s.top_1)),
        ("top-1, visible, exact", |s| format!("{:.2}", s.top_1_exact)),
        ("top-2, visible, within classes", |s| format!("{:.2}", s.top_2)),
        ("named by the verdict, visible", |s| format!("{:.2}", s.named)),
        ("invisible ones not called", |s| format!("{:.2}", s.invisible_not_called)),
        ("pairs: both chosen, one of them", |s| format!("{:.2}, {:.2}", s.pairs[0], s.pairs[1])),
        ("pairs of which both are visible, both chosen", |s| {
            let (pairs, both) = s.pairs_both_visible;
            format!("{pairs}, {both:.2}")
        }),
        ("false alarms on exact machines", |s| format!("{:.2}", s.false_alarms[0])),
        ("false alarms on other parameters", |s| format!("{:.2}", s.false_alarms[1])),
        ("AUROC unknown against known", |s| format!("{:.2}", s.auroc_unknown)),
        ("calibration error, if calibrated, excess", |s| {
            let [measured, perfect, excess] = s.calibration_error;
            format!("{measured:.3}, {perfect:.3}, {excess:.3}")
        }),
        ("removable gap removed", |s| format!("{:.2}", s.shrink)),
        ("claimed gap against emitted plant's", |s| format!("{:.1e}", s.claimed_gap_error)),
        ("leak error, L/min: nominal, calibrated, chosen", |s| {
            let [nominal, calibrated, chosen] = s.leak_error_lpm;
            format!("{nominal:.3}, {calibrated:.3}, {chosen:.3}")
        }),
        ("leak error calibrated over chosen", |s| {
            format!("{:.1}", s.leak_error_lpm[1] / s.leak_error_lpm[2])
        }),
        ("seconds: median, largest", |s| format!("{:.1}, {:.1}", s.seconds[0], s.seconds[1])),
    ];
    let mut text = String::from("| score |");
    scores.keys().for_each(|view| text += &format!(" {view} |"));
    text += "\n|---|";
    scores.keys().for_each(|_| text += "---|");
    text += "\n";
    for (name, cell) in rows {
        text += &format!("| {name} |");
        scores.values().for_each(|scores| text += &format!(" {} |", cell(scores)));
        text += "\n";
    }
    text += "\n| effect: visible, ranked first, named |";
    scores.keys().for_each(|view| text += &format!(" {view} |"));
    text += "\n|---|";
    scores.keys().for_each(|_| text += "---|");
    text += "\n";
    for effect in seepd_sim::effects::ALL {
        text += &format!("| {} |", effect.key());
        for scores in scores.values() {
            let [visible, first, named] = scores.by_effect.get(effect.key()).copied().unwrap_or_default();
            text += &format!(" {visible}, {first}, {named} |");
        }
        text += "\n";
    }
    if wrong {
        for (view, scores) in scores {
            text += &format!("\n{view}:\n");
            scores.wrong.iter().for_each(|line| text += &format!("  {line}\n"));
        }
    }
    text
}

fn hash(path: &Path) -> Result<String, Failure> {
    let mut file = File::open(path).map_err(|error| Failure::reading(path, &error))?;
    let mut hasher = Sha256::new();
    std::io::copy(&mut file, &mut hasher).map_err(|error| Failure::reading(path, &error))?;
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

pub(super) fn json(value: &impl Serialize) -> Result<String, Failure> {
    serde_json::to_string_pretty(value).map_err(|error| Failure::new(Code::Internal, error.to_string()))
}

/// Makes a folder for what a command writes; one that is there must be empty.
pub(super) fn begin_folder(directory: &Path) -> Result<(), Failure> {
    fs::create_dir_all(directory).map_err(|error| Failure::writing(directory, error))?;
    let mut inside = fs::read_dir(directory).map_err(|error| Failure::reading(directory, &error))?;
    if inside.next().is_some() {
        let what = format!("{}: the folder is not empty; name a new one", directory.display());
        return Err(Failure::new(Code::Usage, what));
    }
    Ok(())
}

/// A file in a folder that is this command's own: new, or with answers that another run has left.
pub(super) fn in_own_folder(path: &Path) -> Result<Output, Failure> {
    Outputs::new(OverwriteArguments { force: true }, []).claim(path)
}

pub(super) fn write_json(file: &Output, value: &impl Serialize) -> Result<(), Failure> {
    file.write(json(value)? + "\n")
}

pub(super) fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, Failure> {
    let text = side_file::read_text(path).map_err(|error| Failure::reading(path, &error))?;
    serde_json::from_str(&text).map_err(|error| Failure::data(format!("{}: {error}", path.display())))
}
