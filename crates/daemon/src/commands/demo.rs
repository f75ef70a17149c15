//! `seepd demo`: the main job in one command.

use std::fs;
use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};

use clap::Args;
use seepd_logs::open;
use seepd_monitor::event::{Event, Flag, FlagEvent};
use seepd_monitor::pipeline::Pipeline;
use seepd_signals::Signal;
use seepd_sim::MachineSpec;
use seepd_sim::cycle::CycleRun;
use seepd_sim::noise::Noise;

#[cfg(feature = "live")]
use super::live_demo::{self, LiveDemoArguments};
use super::simulate::{SimulateArguments, write_log};
use crate::cli::Outcome;
use crate::config::AxisConfig;
use crate::failure::Failure;
use crate::html::demo::{DemoPage, FlagChange, Point};
use crate::output::{Outputs, OverwriteArguments};
use crate::sink::terminal::{self, Colour};

/// Simulate a press whose seal wears, replay its log, and leave the log and a page with plots
///
/// Simulates a press, writes its log, replays that log with the embedded model, compares the estimate with the truth, says when the flags
/// rose, and leaves the log and a page with plots. With --live the press is watched by the daemon instead, on its dashboard.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  seepd demo --folder /tmp/demo\n  seepd demo --live")]
pub struct DemoArguments {
    /// Folder for the log and the page; made if it does not exist
    #[arg(long, default_value = "seepd-demo", value_name = "FOLDER")]
    folder: PathBuf,
    /// Duty cycles
    #[arg(long, default_value_t = 150, value_parser = clap::value_parser!(u32).range(40..=10_000), value_name = "N")]
    cycles: u32,
    /// Seed of noise and load
    #[arg(long, default_value_t = 1, value_name = "S")]
    seed: u64,
    #[command(flatten)]
    overwrite: OverwriteArguments,
    #[cfg(feature = "live")]
    #[command(flatten)]
    live: LiveDemoArguments,
}

/// Share of the cycles before the seal begins to wear.
const HEALTHY_SHARE: f64 = 0.15;
/// Leak area as wear begins and at the end, m²: 0.05 and 4.3 L/min at 7 MPa.
const WEAR_M2: (f64, f64) = (1e-8, 8e-7);
/// Load varies by this share from cycle to cycle.
const LOAD_VARIATION: f64 = 0.05;
/// The healthy cycle that the page shows.
const SHOWN_CYCLE: usize = 3;
/// Every so many samples make a point of the command's plot.
const SHOWN_EVERY: u64 = 10;

/// Runs the command.
///
/// # Errors
/// [`Failure`] where the folder cannot be written.
pub fn run(arguments: &DemoArguments) -> Result<Outcome, Failure> {
    #[cfg(feature = "live")]
    if arguments.live.live {
        return live_demo::run(&arguments.live, arguments.seed);
    }
    fs::create_dir_all(&arguments.folder).map_err(|error| Failure::writing(&arguments.folder, error))?;
    let mut outputs = Outputs::new(arguments.overwrite, []);
    let log = outputs.claim(&arguments.folder.join("press.mcap"))?;
    let html = outputs.claim(&arguments.folder.join("demo.html"))?;
    let runs = wear(arguments);
    let spec = MachineSpec::default();
    say(&format!("simulating {} cycles of a press whose seal wears …", arguments.cycles))?;
    let simulate =
        SimulateArguments { seed: arguments.seed, command_only: true, ..SimulateArguments::default() };
    write_log(&log, &simulate, &spec, &runs)?;
    say(&format!("replaying {} with the embedded model …\n", log.path().display()))?;
    let page = replay(log.path(), &spec, &runs[1..])?;
    print(&page)?;
    html.write(page.render())?;
    say(&format!("\nlog:  {}\npage: {}", log.path().display(), html.path().display()))?;
    Ok(Outcome::Good)
}

/// The leak by run, the warm-up first.
fn wear(arguments: &DemoArguments) -> Vec<CycleRun> {
    let cycles = arguments.cycles as usize;
    let healthy = (HEALTHY_SHARE * cycles as f64) as usize;
    let mut noise = Noise::new(arguments.seed, 3);
    let run = |cycle: usize, noise: &mut Noise| {
        let leak_area_m2 = match cycle.checked_sub(healthy) {
            Some(worn) => {
                WEAR_M2.0 * (WEAR_M2.1 / WEAR_M2.0).powf(worn as f64 / (cycles - healthy - 1) as f64)
            }
            None => 0.0,
        };
        CycleRun { load_factor: noise.factor(LOAD_VARIATION), ..CycleRun::with_leak(leak_area_m2) }
    };
    std::iter::once(CycleRun::with_leak(0.0)).chain((0..cycles).map(|cycle| run(cycle, &mut noise))).collect()
}

/// Reads the log as any other; the truth is laid beside the estimates afterwards.
fn replay(log: &Path, spec: &MachineSpec, runs: &[CycleRun]) -> Result<DemoPage, Failure> {
    let config = AxisConfig { axis: "demo press".into(), ..AxisConfig::default() };
    let monitor = config.monitor(config.load_models()?);
    let mut pipeline = Pipeline::new(monitor.clone())?;
    let truth = Truth { runs, period_s: spec.cycle.period_s, flow_lpm: &|area| monitor.flow_lpm(area) };
    let mut page = DemoPage {
        log: log.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        reference_dp_pa: config.reference_dp_pa,
        alarm: config.alarm.clone(),
        healthy: Vec::new(),
        worn: Vec::new(),
        points: Vec::new(),
        changes: Vec::new(),
        median_error: 0.0,
        duration_s: runs.len() as f64 * spec.cycle.period_s,
    };
    let mut source = open(log, &config.log_mapping())?;
    let mut number = 0;
    while let Some(sample) = source.next_sample()? {
        let t_s = sample.time_ns as f64 / 1e9;
        let in_cycle = |cycle: usize| t_s - cycle as f64 * spec.cycle.period_s;
        let shown = number % SHOWN_EVERY == 0;
        if let Some(command) = sample.get(Signal::Command).filter(|_| shown) {
            for (cycle, curve) in [(SHOWN_CYCLE, &mut page.healthy), (runs.len() - 1, &mut page.worn)] {
                let at = in_cycle(cycle);
                if (0.0..spec.cycle.period_s).contains(&at) {
                    curve.push((at, command));
                }
            }
        }
        number += 1;
        pipeline.push(&sample, &mut |event| take(&mut page, &truth, event));
    }
    pipeline.finish(&mut |event| take(&mut page, &truth, event));
    page.median_error = median_error(&page);
    Ok(page)
}

/// What the simulator knows and the monitor does not.
struct Truth<'a> {
    runs: &'a [CycleRun],
    period_s: f64,
    flow_lpm: &'a dyn Fn(f64) -> f64,
}

impl Truth<'_> {
    fn lpm_at(&self, t_s: f64) -> f64 {
        let run = ((t_s / self.period_s).max(0.0) as usize).min(self.runs.len() - 1);
        (self.flow_lpm)(self.runs[run].leak_area_m2)
    }

    /// When the truth first reached a flow.
    fn passed_s(&self, threshold_lpm: f64) -> Option<f64> {
        let reached = |run: &CycleRun| (self.flow_lpm)(run.leak_area_m2) >= threshold_lpm;
        self.runs.iter().position(reached).map(|run| run as f64 * self.period_s)
    }
}

fn take(page: &mut DemoPage, truth: &Truth<'_>, event: &Event<'_>) {
    match event {
        Event::Cycle(line) => {
            if let (Some(interval), Some(estimate_lpm)) = (line.interval90_m2, line.leak_flow_lpm) {
                let t_s = 0.5 * (line.t_start_s + line.t_end_s);
                page.points.push(Point {
                    t_s,
                    truth_lpm: truth.lpm_at(t_s),
                    estimate_lpm,
                    interval_lpm: interval.map(truth.flow_lpm),
                    flag: line.flag,
                });
            }
        }
        Event::Flag(flag) => page.changes.push(change(truth, flag)),
        Event::Notice(_) => {}
    }
}

fn change(truth: &Truth<'_>, event: &FlagEvent<'_>) -> FlagChange {
    let threshold = event.evidence.threshold_lpm.filter(|_| event.flag_to > event.flag_from);
    FlagChange {
        t_s: event.t_s,
        cycle: event.cycle,
        from: event.flag_from,
        to: event.flag_to,
        // Just before its end, within the deciding cycle.
        truth_lpm: truth.lpm_at(event.t_s - 0.1 * truth.period_s),
        truth_passed_s: threshold.and_then(|threshold| truth.passed_s(threshold)),
    }
}

fn median_error(page: &DemoPage) -> f64 {
    let mut errors: Vec<f64> = page
        .points
        .iter()
        .filter(|point| point.truth_lpm >= page.alarm.watch_lpm)
        .map(|point| (point.estimate_lpm - point.truth_lpm).abs() / point.truth_lpm)
        .collect();
    errors.sort_by(f64::total_cmp);
    errors.get(errors.len() / 2).copied().unwrap_or(0.0)
}

/// A dozen estimates beside the truth, and the flags.
fn print(page: &DemoPage) -> Result<(), Failure> {
    let plain = Colour::detect(io::stdout().is_terminal());
    let mut text = format!(
        "{:>7} {:>13} {:>16} {:>22}  flag\n",
        "cycle", "truth L/min", "estimate L/min", "90 % interval"
    );
    let step = (page.points.len() / 12).max(1);
    for (cycle, point) in page.points.iter().enumerate().step_by(step) {
        let interval = format!("{:.3} … {:.3}", point.interval_lpm[0], point.interval_lpm[1]);
        text += &format!(
            "{cycle:>7} {:>13.3} {:>16.3} {interval:>22}  {}\n",
            point.truth_lpm,
            point.estimate_lpm,
            plain.paint(point.flag, point.flag.name())
        );
    }
    text += "\n";
    for change in page.changes.iter().filter(|change| change.to > Flag::Healthy) {
        let delay = change.truth_passed_s.map_or(String::new(), |passed| {
            format!(", {:.0} s after the truth passed the threshold", change.t_s - passed)
        });
        text +=
            &format!("{} rose in cycle {} at {:.0} s{delay}\n", change.to.name(), change.cycle, change.t_s);
    }
    text += &format!("median error above the watch threshold: {:.1} %", 100.0 * page.median_error);
    say(&text)
}

fn say(text: &str) -> Result<(), Failure> {
    terminal::print(format!("{text}\n").as_bytes())
}
