//! `seepd simulate`: the log of a simulated machine.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use clap::Args;
use seepd_settings::side_file;
use seepd_sim::cycle::CycleRun;
use seepd_sim::electric::ElectricAxis;
use seepd_sim::noise::Noise;
use seepd_sim::oil::NOMINAL_TEMPERATURE_C;
use seepd_sim::series::{self, Tolerances};
use seepd_sim::{Input, Machine, MachineSpec, Schedule, SimulatedSignals};
use serde::Serialize;

use crate::cli::Outcome;
use crate::failure::{Code, Failure};
use crate::output::{Output, OutputFile, Outputs, OverwriteArguments};
use crate::progress::{progress_bar, warn};
use crate::sink::mcap::{ChunkCompression, McapSink, schema};
use crate::sink::terminal::print;

/// Write the log of a simulated machine (MCAP)
///
/// Signals are on /axis/signals, the truth on /axis/truth. Without options: the nominal press, 24 cycles, no leak, noise of the command
/// 0.001, seed 1. A warm-up cycle is simulated first and not written.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  seepd simulate --out healthy.mcap\n  \
                        seepd simulate --out worn.mcap --cycles 100 --leak-area 5e-8 --leak-growth 1e-6 --seed 7\n  \
                        seepd simulate --out sticky.mcap --with valve_deadband.half_width=0.04 --with coulomb_friction.force_n=800")]
pub struct SimulateArguments {
    /// Log to write
    #[arg(long, value_name = "FILE", required_unless_present = "list_effects")]
    pub out: Option<PathBuf>,
    /// Print every effect with its law, parameters, ranges and sources (Markdown), and simulate nothing
    #[arg(long)]
    pub list_effects: bool,
    /// Duty cycles to write
    #[arg(long, default_value_t = 24, value_name = "N")]
    pub cycles: usize,
    /// Leak area past the piston seal, m² (1e-6 m² is 1 mm²) [default: that of the plant file]
    #[arg(long, value_name = "M2")]
    pub leak_area: Option<f64>,
    /// Leak area from a cycle on, m², such as 2e-7@12
    #[arg(long, value_name = "M2@CYCLE", conflicts_with = "leak_growth")]
    pub leak_step: Option<String>,
    /// Leak area at the last cycle, m²; it grows exponentially from --leak-area, or from 1e-8 m²
    #[arg(long, value_name = "M2")]
    pub leak_growth: Option<f64>,
    /// Standard deviation of the measurement noise on the command, share of full command
    #[arg(long, default_value_t = 0.001, value_name = "SIGMA")]
    pub noise: f64,
    /// Share (±) by which the load varies from cycle to cycle
    #[arg(long, default_value_t = 0.0, value_name = "SHARE")]
    pub load_variation: f64,
    /// Share (±) by which the period varies from cycle to cycle
    #[arg(long, default_value_t = 0.0, value_name = "SHARE")]
    pub period_variation: f64,
    /// Longest pause between cycles, s; pauses are uniform from 0
    #[arg(long, default_value_t = 0.0, value_name = "S")]
    pub pause: f64,
    /// Oil temperature, °C (ISO VG 46), at the first and at the last cycle, evenly in between; nominal is 45
    #[arg(long, value_name = "C[..C]", value_parser = parse_range)]
    pub oil_temperature: Option<(f64, f64)>,
    /// Drift of the supply's relief pressure, evenly from this share below its value to this share above it
    #[arg(long, default_value_t = 0.0, value_name = "SHARE", allow_negative_numbers = true)]
    pub supply_drift: f64,
    /// Simulate another machine of the series: plant parameters and load differ within ± this share, by the seed
    #[arg(long, default_value_t = 0.0, value_name = "SHARE")]
    pub parameter_spread: f64,
    /// Number of the machine in the series; the same number is the same machine [default: the seed]
    #[arg(long, value_name = "N")]
    pub machine: Option<u64>,
    /// Add an effect to the nominal plant; may be repeated
    #[arg(long = "with", value_name = "EFFECT.PARAMETER=VALUE")]
    pub with: Vec<String>,
    /// Plant file instead of the nominal press
    #[arg(long, value_name = "FILE")]
    pub plant: Option<PathBuf>,
    /// Seed of noise and variation
    #[arg(long, default_value_t = 1, value_name = "S")]
    pub seed: u64,
    /// Begin the log this long after the start of a cycle, s
    #[arg(long, default_value_t = 0.0, value_name = "S")]
    pub start_at: f64,
    /// Write only the command
    #[arg(long)]
    pub command_only: bool,
    /// Leave the truth out of the log
    #[arg(long)]
    pub no_truth: bool,
    /// Compression of the log
    #[arg(long, value_enum, default_value_t)]
    pub compression: ChunkCompression,
    /// Prefix of the topics
    #[arg(long, default_value = "/axis", value_name = "PREFIX")]
    pub topic_prefix: String,
    /// What becomes of a log that is there already
    #[command(flatten)]
    pub overwrite: OverwriteArguments,
}

impl Default for SimulateArguments {
    fn default() -> Self {
        SimulateArguments {
            out: None,
            list_effects: false,
            cycles: 24,
            leak_area: None,
            leak_step: None,
            leak_growth: None,
            noise: 0.001,
            load_variation: 0.0,
            period_variation: 0.0,
            pause: 0.0,
            oil_temperature: None,
            supply_drift: 0.0,
            parameter_spread: 0.0,
            machine: None,
            with: Vec::new(),
            plant: None,
            seed: 1,
            start_at: 0.0,
            command_only: false,
            no_truth: false,
            compression: ChunkCompression::default(),
            topic_prefix: "/axis".into(),
            overwrite: OverwriteArguments::default(),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] for arguments, plant file or output.
pub fn run(arguments: &SimulateArguments) -> Result<Outcome, Failure> {
    if arguments.list_effects {
        print(seepd_sim::effects::reference().as_bytes())?;
        return Ok(Outcome::Good);
    }
    let spec = machine(arguments)?;
    let runs = runs(arguments, &spec)?;
    let Some(out) = &arguments.out else {
        return Err(Failure::new(Code::Usage, "there is no log to write: name one with --out FILE"));
    };
    let out = Outputs::new(arguments.overwrite, arguments.plant.as_deref()).claim(out)?;
    write_log(&out, arguments, &spec, &runs)?;
    Ok(Outcome::Good)
}

/// Reads a plant file, or takes the nominal press.
///
/// # Errors
/// [`Failure`] with file, line and key.
pub fn read_plant(path: Option<&Path>) -> Result<MachineSpec, Failure> {
    let spec = read_any_plant(path)?;
    match path {
        Some(path) if spec.controller.is_none() => {
            let what = "this machine has no controller, and hence no demand and no duty cycle; only `gap`, `gap predict` and `check` work with one";
            Err(Failure::configuration(path, what))
        }
        _ => Ok(spec),
    }
}

/// As [`read_plant`], also of a machine without a controller.
///
/// # Errors
/// [`Failure`] with file, line and key.
pub fn read_any_plant(path: Option<&Path>) -> Result<MachineSpec, Failure> {
    let Some(path) = path else { return Ok(MachineSpec::default()) };
    let text = side_file::read_text(path).map_err(|error| Failure::reading(path, &error))?;
    if ElectricAxis::is_kind(&text) {
        let what = "this is an electric axis; only `gap` works with one";
        return Err(Failure::configuration(path, what));
    }
    MachineSpec::from_toml(&text).map_err(|error| Failure::configuration(path, error))
}

/// The machine that is asked for.
///
/// # Errors
/// [`Failure`] of the plant file or an argument.
pub fn machine(arguments: &SimulateArguments) -> Result<MachineSpec, Failure> {
    let mut spec = read_plant(arguments.plant.as_deref())?;
    for assignment in &arguments.with {
        spec.set_effect(assignment)
            .map_err(|error| Failure::new(Code::Usage, format!("--with {assignment}: {error}")))?;
    }
    let share = check("--parameter-spread", arguments.parameter_spread, 0.0, 0.3)?;
    if share > 0.0 {
        let mut noise = Noise::new(arguments.machine.unwrap_or(arguments.seed), MACHINES);
        spec = series::vary(&spec, &Tolerances::even(share), &mut noise);
        spec.plant.load_scale *= noise.factor(share);
    }
    check("--supply-drift", arguments.supply_drift, -0.2, 0.2)?;
    for celsius in arguments.oil_temperature.map(|(from, to)| [from, to]).into_iter().flatten() {
        check("--oil-temperature", celsius, 10.0, 90.0)?;
    }
    // Effects and warm oil may make the plant stiffer.
    let steps = [0.0, 1.0].map(|share| day(&spec, arguments, share).stable_steps());
    spec.controller.steps_per_period = steps[0].max(steps[1]).max(spec.stable_steps());
    Ok(spec)
}

/// Stream of the machines of a series.
const MACHINES: u64 = 3;

/// The machine at a share of the log's cycles: with that day's oil and supply.
fn day(spec: &MachineSpec, arguments: &SimulateArguments, share: f64) -> MachineSpec {
    let oil_c = arguments.oil_temperature.map(|(from, to)| from + share * (to - from));
    let supply = 1.0 + arguments.supply_drift * (2.0 * share - 1.0);
    seepd_sim::series::on_a_day(spec, oil_c.unwrap_or(NOMINAL_TEMPERATURE_C), supply)
}

fn parse_range(text: &str) -> Result<(f64, f64), String> {
    let (from, to) = text.split_once("..").unwrap_or((text, text));
    let number = |text: &str| text.trim().parse::<f64>().map_err(|_| format!("`{text}` is not a number"));
    Ok((number(from)?, number(to)?))
}

fn check(name: &str, value: f64, low: f64, high: f64) -> Result<f64, Failure> {
    if (low..=high).contains(&value) {
        return Ok(value);
    }
    Err(Failure::new(Code::Usage, format!("{name} is {value}; it must lie in {low} … {high}")))
}

/// Largest leak area that is simulated, m²: ten times the article's.
const LARGEST_LEAK_M2: f64 = 1e-4;
/// Where growth from nothing begins, m².
const GROWTH_FROM_M2: f64 = 1e-8;

/// What it is asked to do: a warm-up cycle, then those that are logged.
///
/// # Errors
/// [`Failure`] of an argument.
pub fn runs(arguments: &SimulateArguments, spec: &MachineSpec) -> Result<Vec<CycleRun>, Failure> {
    let start =
        check("--leak-area", arguments.leak_area.unwrap_or(spec.plant.leak_area_m2), 0.0, LARGEST_LEAK_M2)?;
    let load = check("--load-variation", arguments.load_variation, 0.0, 1.0)?;
    let period = check("--period-variation", arguments.period_variation, 0.0, 0.2)?;
    let pause = check("--pause", arguments.pause, 0.0, 86_400.0)?;
    check("--noise", arguments.noise, 0.0, 1.0)?;
    check("--cycles", arguments.cycles as f64, 1.0, 1e7)?;
    let step = arguments.leak_step.as_deref().map(parse_step).transpose()?;
    let growth =
        arguments.leak_growth.map(|end| check("--leak-growth", end, 0.0, LARGEST_LEAK_M2)).transpose()?;
    let mut noise = Noise::new(arguments.seed, 1);
    let run = |cycle: usize, noise: &mut Noise| {
        let leak_area_m2 = match (step, growth) {
            (Some((area, from)), _) if cycle >= from => area,
            (None, Some(end)) => {
                let from = if start > 0.0 { start } else { GROWTH_FROM_M2 };
                let share = cycle as f64 / (arguments.cycles.max(2) - 1) as f64;
                from * (end.max(f64::MIN_POSITIVE) / from).powf(share)
            }
            _ => start,
        };
        CycleRun {
            leak_area_m2,
            load_factor: noise.factor(load),
            stretch: noise.factor(period),
            pause_s: noise.uniform(0.0, pause),
        }
    };
    // The warm-up is as planned, with the first cycle's leak.
    let mut runs = vec![CycleRun::with_leak(run(0, &mut noise.clone()).leak_area_m2)];
    runs.extend((0..arguments.cycles).map(|cycle| run(cycle, &mut noise)));
    Ok(runs)
}

fn parse_step(text: &str) -> Result<(f64, usize), Failure> {
    let wrong = || {
        Failure::new(
            Code::Usage,
            format!("--leak-step `{text}` is not of the form AREA@CYCLE, such as 2e-7@12"),
        )
    };
    let (area, cycle) = text.split_once('@').ok_or_else(wrong)?;
    let area = check("--leak-step", area.parse().map_err(|_| wrong())?, 0.0, LARGEST_LEAK_M2)?;
    Ok((area, cycle.parse().map_err(|_| wrong())?))
}

/// A message of `/axis/signals`. Pressures to 1 Pa, the rest to 1e-8, far below what a sensor tells.
#[derive(Serialize)]
pub struct SignalsMessage {
    /// Valve command with the measurement's noise, share of full command.
    pub command: f64,
    /// The rest, unless only the command is asked for.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub others: Option<OtherSignals>,
}

/// The signals beside the command, SI.
#[derive(Serialize)]
pub struct OtherSignals {
    /// Position demand, m.
    pub demand: f64,
    /// Position, m.
    pub position: f64,
    /// Supply pressure, Pa.
    pub p_supply: f64,
    /// Pressure at the valve's inlet, Pa.
    pub p_inlet: f64,
    /// Pressure in the cap chamber, Pa.
    pub p_cap: f64,
    /// Pressure in the rod chamber, Pa.
    pub p_rod: f64,
    /// Load force, N.
    pub load: f64,
}

/// A message of `/axis/truth`.
#[derive(Serialize)]
pub struct TruthMessage {
    /// Leak area, m².
    pub leak_area: f64,
    /// Flow through it, m³/s.
    pub leak_flow: f64,
}

fn rounded(value: f64) -> f64 {
    (value * 1e8).round() / 1e8
}

impl SignalsMessage {
    fn of(record: &SimulatedSignals<f64>, command: f64, command_only: bool) -> Self {
        let others = (!command_only).then(|| OtherSignals {
            demand: rounded(record.demand),
            position: rounded(record.position),
            p_supply: record.p_supply.round(),
            p_inlet: record.p_inlet.round(),
            p_cap: record.p_cap.round(),
            p_rod: record.p_rod.round(),
            load: (record.load * 1e3).round() / 1e3,
        });
        SignalsMessage { command: rounded(command), others }
    }
}

/// Simulates and writes the log.
///
/// # Errors
/// [`Failure`] where the log cannot be written or the simulation went out of bounds.
pub fn write_log(
    out: &Output,
    arguments: &SimulateArguments,
    spec: &MachineSpec,
    runs: &[CycleRun],
) -> Result<(), Failure> {
    let writing = |error: io::Error| Failure::writing(out.path(), error);
    let mut sink = McapSink::new(out.create()?, arguments.compression).map_err(writing)?;
    let prefix = &arguments.topic_prefix;
    let signals =
        sink.add_channel(&format!("{prefix}/signals"), "seepd.Signals", schema::SIGNALS).map_err(writing)?;
    let truth = (!arguments.no_truth)
        .then(|| sink.add_channel(&format!("{prefix}/truth"), "seepd.Truth", schema::TRUTH))
        .transpose()
        .map_err(writing)?;
    write_provenance(&mut sink, arguments, spec).map_err(writing)?;

    let bar = progress_bar(runs.len() as u64 - 1, "simulating");
    let mut line = Vec::with_capacity(256);
    let clamped_pressures = each_message(arguments, spec, runs, |time_ns, cycle, message, of_leak| {
        write_message(&mut sink, signals, time_ns, &mut line, message).map_err(writing)?;
        if let Some(truth) = truth {
            write_message(&mut sink, truth, time_ns, &mut line, of_leak).map_err(writing)?;
        }
        bar.set_position(cycle as u64);
        Ok(())
    })?;
    bar.finish_and_clear();
    sink.finish().map_err(writing)?;
    sink.into_inner().finish()?;
    warn_of_cavitation(clamped_pressures);
    Ok(())
}

/// Says where pressures were held at 0.
pub fn warn_of_cavitation(clamped_pressures: u64) {
    if clamped_pressures > 0 {
        warn(&format!(
            "a pressure was held at 0 in {clamped_pressures} plant steps: cavitation is not modelled"
        ));
    }
}

/// Simulates, and hands on what the log holds: time, ns, number of the cycle, signals and truth. Gives the plant steps in which a pressure
/// was held at 0.
///
/// # Errors
/// [`Failure`] where the simulation went out of bounds, and what `take` gives.
pub fn each_message(
    arguments: &SimulateArguments,
    spec: &MachineSpec,
    runs: &[CycleRun],
    mut take: impl FnMut(i64, usize, &SignalsMessage, &TruthMessage) -> Result<(), Failure>,
) -> Result<u64, Failure> {
    let changes = arguments.oil_temperature.is_some() || arguments.supply_drift != 0.0;
    let at_run = |run: usize| {
        let share = run.saturating_sub(1) as f64 / runs.len().saturating_sub(2).max(1) as f64;
        Machine::<f64>::new(&[&day(spec, arguments, share.min(1.0))])
    };
    let mut machine = if changes { at_run(0) } else { Machine::<f64>::new(&[spec]) };
    let mut state = machine.start();
    let mut run = 0;
    let period_s = spec.controller.period_s;
    let log_every = spec.controller.log_every as u64;
    let schedule = Schedule::new(&spec.cycle, period_s, runs.to_vec());
    let warm_up = schedule.ticks_of(0);
    let start_at = check("--start-at", arguments.start_at, 0.0, spec.cycle.period_s)?;
    let skipped = warm_up + (start_at / period_s).round() as u64;
    let end: u64 = (0..runs.len()).map(|run| schedule.ticks_of(run)).sum();
    let mut noise = Noise::new(arguments.seed, 2);
    for (tick, sample) in (0..end).zip(schedule) {
        if changes && sample.run != run {
            run = sample.run;
            machine = at_run(run);
        }
        let record = machine.tick(&mut state, &Input::gather(&[sample]));
        let noisy = record.command + noise.normal(arguments.noise);
        if tick < skipped || !(tick - skipped).is_multiple_of(log_every) {
            continue;
        }
        if !record.position.is_finite() {
            return Err(Failure::data(
                "the simulation went out of bounds; check the values of the plant file".to_owned(),
            ));
        }
        let time_ns = ((tick - skipped) as f64 * period_s * 1e9).round() as i64;
        let message = SignalsMessage::of(&record, noisy, arguments.command_only);
        let of_leak = TruthMessage { leak_area: record.leak_area, leak_flow: record.leak_flow };
        take(time_ns, sample.run.saturating_sub(1), &message, &of_leak)?;
    }
    Ok(state.clamped_pressures)
}

pub(super) fn write_message(
    sink: &mut McapSink<OutputFile>,
    channel: u16,
    time_ns: i64,
    line: &mut Vec<u8>,
    message: &impl Serialize,
) -> io::Result<()> {
    line.clear();
    serde_json::to_writer(&mut *line, message)?;
    sink.write(channel, time_ns, line)
}

/// Plant, seed and version go with the log.
fn write_provenance(
    sink: &mut McapSink<OutputFile>,
    arguments: &SimulateArguments,
    spec: &MachineSpec,
) -> io::Result<()> {
    let plant = spec.to_toml().map_err(|error| io::Error::other(error.to_string()))?;
    let facts = BTreeMap::from([
        ("software".to_owned(), concat!("seepd ", env!("CARGO_PKG_VERSION")).to_owned()),
        ("seed".to_owned(), arguments.seed.to_string()),
        ("noise".to_owned(), arguments.noise.to_string()),
        (
            "plant".to_owned(),
            arguments.plant.as_ref().map_or("nominal".to_owned(), |path| path.display().to_string()),
        ),
        ("effects".to_owned(), arguments.with.join(" ")),
    ]);
    sink.write_metadata("seepd.simulation", facts)?;
    sink.attach("plant.toml", "application/toml", plant.as_bytes())
}
