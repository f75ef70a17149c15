//! What named causes are worth on simulated machines of the series: who is taken for whom, and after how many cycles.

use std::collections::BTreeMap;
use std::sync::Arc;

use rayon::prelude::*;
use seepd_model::Model;
use seepd_model::causes::Cause;
use seepd_monitor::baseline::CusumFinding;
use seepd_monitor::event::{CycleLine, Event, Flag};
use seepd_monitor::pipeline::{MonitorConfig, Pipeline};
use seepd_signals::Sample;
use seepd_sim::Steps;
use seepd_sim::batch::{Job, run_lanes};
use seepd_sim::cycle::CycleRun;
use seepd_sim::noise::Noise;
use seepd_sim::real::LANES;
use seepd_train::PlantedCause;
use serde::Serialize;

use crate::failure::{Code, Failure};

/// Cycles of the baseline.
pub const BASELINE_CYCLES: usize = 50;
/// Cycles after the change.
pub const WATCHED_CYCLES: usize = 24;
/// Noise of the command, share of full command, and variation of the load from cycle to cycle.
pub const NOISE: f64 = 0.003;
/// See [`NOISE`].
pub const LOAD_VARIATION: f64 = 0.02;

/// Causes that a command alone can hardly tell apart.
const CLASSES: [&[&str]; 2] = [&["valve_null", "external_leak"], &["friction", "load", "spring"]];

/// `seepd.cause-evaluation/1`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CauseEvaluation {
    /// `seepd.cause-evaluation/1`.
    pub schema: &'static str,
    /// Seed of machines, sizes and noise.
    pub seed: u64,
    /// Machines in all.
    pub machines: usize,
    /// Cycles watched after the change.
    pub watched_cycles: usize,
    /// Share of all machines whose last cycle names what was planted.
    pub right: f64,
    /// The same where causes that look alike count as one.
    pub right_within_class: f64,
    /// Share of the machines without a leak on which a flag rose.
    pub flags_without_leak: f64,
    /// Share of the machines that stayed as they were on which a condition was found.
    pub conditions_without_change: f64,
    /// By what was planted, `none` last.
    pub planted: Vec<PlantedRow>,
}

/// What came of machines with one cause.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlantedRow {
    /// What was planted.
    pub cause: &'static str,
    /// How many machines.
    pub machines: usize,
    /// What their last cycle says, and on how many of them: a row of the confusion matrix.
    pub named: BTreeMap<&'static str, usize>,
    /// Machines on which cycles have found it: its sum, or the leak's CUSUM.
    pub found: usize,
    /// Cycles from the change until then: median, and the slowest.
    pub median_cycles: Option<usize>,
    /// See `median_cycles`.
    pub slowest_cycles: Option<usize>,
}

/// What a monitor said of a machine after the change.
#[derive(Debug, Clone, Default)]
struct Answer {
    cycles: usize,
    named: Option<&'static str>,
    also: Option<&'static str>,
    found_after: Option<usize>,
    flagged: bool,
    has_condition: bool,
}

impl Answer {
    fn hear(&mut self, line: &CycleLine<'_>, planted: Option<Cause>) {
        self.cycles += 1;
        self.flagged |= line.flag >= Flag::Watch;
        let Some(cause) = &line.cause else { return };
        (self.named, self.also) = (Some(cause.cause), cause.cause_also);
        self.has_condition |= !cause.conditions.is_empty();
        let is_found = match planted {
            None => false,
            Some(Cause::PistonSeal) => {
                line.comparison.as_ref().is_some_and(|comparison| comparison.finding == CusumFinding::Leak)
            }
            Some(planted) => cause.conditions.iter().any(|one| one.kind.cause == planted),
        };
        if is_found {
            self.found_after.get_or_insert(self.cycles);
        }
    }

    fn verdict(&self) -> &'static str {
        self.named.unwrap_or("no_baseline")
    }
}

/// Watches machines before and after a change, and judges what the monitor names. `tell` hears of machines that are done.
///
/// # Errors
/// [`Failure`] of a model that names no causes, or that the reader has no room for.
pub fn evaluate(
    model: &Arc<Model>,
    planted: &[PlantedCause],
    seed: u64,
    tell: impl Fn(usize) + Sync,
) -> Result<CauseEvaluation, Failure> {
    if model.causes().is_none() {
        let text = "the model names no causes; train it again: seepd train";
        return Err(Failure::new(Code::Configuration, text));
    }
    let answers: Vec<Vec<Answer>> = planted
        .par_chunks(LANES)
        .enumerate()
        .map(|(chunk, machines)| {
            let answers = watch(model, machines, seed ^ ((chunk as u64) << 20));
            tell(machines.len());
            answers
        })
        .collect::<Result<_, Failure>>()?;
    Ok(judge(planted, &answers.concat(), seed))
}

/// Runs a few machines side by side, first as they are healthy, then changed.
fn watch(model: &Arc<Model>, machines: &[PlantedCause], seed: u64) -> Result<Vec<Answer>, Failure> {
    let config = MonitorConfig::new("machine", Arc::clone(model));
    let mut lanes: Vec<(Pipeline, Noise, i64, Answer)> = Vec::with_capacity(machines.len());
    for lane in 0..machines.len() {
        let mut pipeline = Pipeline::new(config.clone())?;
        pipeline
            .learn("commissioning", BASELINE_CYCLES)
            .map_err(|error| Failure::new(Code::Configuration, error.to_string()))?;
        lanes.push((pipeline, Noise::new(seed, lane as u64), 0, Answer::default()));
    }
    let file = model.file();
    let sample_ns = (1e9 / file.sample_rate_hz) as i64;
    let ticks = (file.cycle.period_s * file.sample_rate_hz) as u64;
    for (stage, cycles) in [BASELINE_CYCLES + 2, WATCHED_CYCLES + 1].into_iter().enumerate() {
        let mut jobs: Vec<Job> = machines
            .iter()
            .enumerate()
            .map(|(lane, machine)| {
                let now = if stage == 0 { &machine.healthy } else { &machine.changed };
                let mut loads = Noise::new(seed ^ 0x6c6f_6164, (stage * LANES + lane) as u64);
                let run = |_| CycleRun {
                    load_factor: now.load_factor * loads.factor(LOAD_VARIATION),
                    ..CycleRun::with_leak(now.leak_area_m2)
                };
                let runs = (0..cycles + 1).map(run).collect();
                // The first cycle settles.
                Job {
                    spec: now.spec.clone(),
                    runs,
                    start_tick: 0,
                    skip_ticks: ticks,
                    record_ticks: cycles as u64 * ticks,
                }
            })
            .collect();
        let steps = jobs.iter().map(|job| job.spec.stable_steps()).max().unwrap_or(1);
        jobs.iter_mut().for_each(|job| job.spec.controller.steps_per_period = steps);
        run_lanes(&jobs, Steps::Own, |lane, signals| {
            let (Some((pipeline, noise, time_ns, answer)), Some(machine)) =
                (lanes.get_mut(lane), machines.get(lane))
            else {
                return;
            };
            let command = (signals.command.0[lane] + noise.normal(NOISE)).clamp(-1.0, 1.0);
            let cause = machine.kind.map(|kind| kind.cause);
            pipeline.push(&Sample::command(*time_ns, command), &mut |event| {
                if let Event::Cycle(line) = event
                    && stage > 0
                {
                    answer.hear(line, cause);
                }
            });
            *time_ns += sample_ns;
        });
    }
    Ok(lanes.into_iter().map(|(.., answer)| answer).collect())
}

fn judge(planted: &[PlantedCause], answers: &[Answer], seed: u64) -> CauseEvaluation {
    let name = |one: &PlantedCause| one.kind.map_or("none", |kind| kind.cause.name());
    let pairs = || planted.iter().zip(answers);
    let share = |count: usize, of: usize| count as f64 / of.max(1) as f64;
    let is_right = |planted: &str, answer: &Answer| {
        // The seal beside another cause names two, of which one was planted.
        answer.verdict() == planted && answer.also.is_none()
    };
    let is_within = |planted: &str, answer: &Answer| {
        let is_class = |class: &&&[&str]| class.contains(&planted) && class.contains(&answer.verdict());
        is_right(planted, answer) || (answer.also.is_none() && CLASSES.iter().any(|class| is_class(&class)))
    };
    let without_leak: Vec<&Answer> =
        pairs().filter(|(one, _)| name(one) != Cause::PistonSeal.name()).map(|(_, answer)| answer).collect();
    let unchanged: Vec<&Answer> =
        pairs().filter(|(one, _)| one.kind.is_none()).map(|(_, answer)| answer).collect();
    let count = |answers: &[&Answer], is: fn(&Answer) -> bool| answers.iter().filter(|one| is(one)).count();
    let names = Cause::ALL.into_iter().map(Cause::name).chain(["none"]);
    let row = |cause: &'static str| {
        let of: Vec<&Answer> =
            pairs().filter(|(one, _)| name(one) == cause).map(|(_, answer)| answer).collect();
        let mut named = BTreeMap::new();
        of.iter().for_each(|answer| *named.entry(answer.verdict()).or_default() += 1);
        let mut delays: Vec<usize> = of.iter().filter_map(|answer| answer.found_after).collect();
        delays.sort_unstable();
        PlantedRow {
            cause,
            machines: of.len(),
            named,
            found: delays.len(),
            median_cycles: delays.get(delays.len() / 2).copied(),
            slowest_cycles: delays.last().copied(),
        }
    };
    CauseEvaluation {
        schema: "seepd.cause-evaluation/1",
        seed,
        machines: planted.len(),
        watched_cycles: WATCHED_CYCLES,
        right: share(pairs().filter(|(one, answer)| is_right(name(one), answer)).count(), planted.len()),
        right_within_class: share(
            pairs().filter(|(one, answer)| is_within(name(one), answer)).count(),
            planted.len(),
        ),
        flags_without_leak: share(count(&without_leak, |one| one.flagged), without_leak.len()),
        conditions_without_change: share(count(&unchanged, |one| one.has_condition), unchanged.len()),
        planted: names.map(row).filter(|row| row.machines > 0).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seepd_model::causes::{Kind, SizeUnit};
    use seepd_sim::MachineSpec;
    use seepd_train::dataset::Observation;

    fn planted(cause: Option<Cause>) -> PlantedCause {
        let healthy = Observation {
            spec: MachineSpec::default(),
            load_factor: 1.0,
            stretch: 1.0,
            leak_area_m2: 0.0,
            laminar_share: 0.0,
            null_deviation: 0.0,
            extra_deadband: 0.0,
            stream: 0,
        };
        let kind = cause.map(|cause| Kind { cause, side: None, unit: SizeUnit::Share });
        PlantedCause { kind, size: 0.01, changed: healthy.clone(), healthy }
    }

    fn answer(named: &'static str, found_after: Option<usize>) -> Answer {
        let has_condition = found_after.is_some();
        Answer { cycles: 20, named: Some(named), found_after, has_condition, ..Answer::default() }
    }

    #[test]
    fn a_matrix_has_every_machine_once_and_delays_are_of_those_found() {
        let machines = [Cause::ValveNull, Cause::ValveNull, Cause::ValveNull, Cause::Friction].map(Some);
        let machines: Vec<PlantedCause> = machines.into_iter().chain([None; 2]).map(planted).collect();
        let answers = [
            answer("valve_null", Some(3)),
            answer("external_leak", None),
            answer("valve_null", Some(9)),
            answer("cannot_tell", None),
            answer("none", None),
            Answer { flagged: true, ..answer("unknown", Some(2)) },
        ];
        let judged = judge(&machines, &answers, 1);
        assert_eq!((judged.right, judged.right_within_class), (0.5, 4.0 / 6.0));
        assert_eq!((judged.flags_without_leak, judged.conditions_without_change), (1.0 / 6.0, 0.5));
        let rows: Vec<(&str, usize)> = judged.planted.iter().map(|row| (row.cause, row.machines)).collect();
        assert_eq!(rows, [("valve_null", 3), ("friction", 1), ("none", 2)]);
        let null = &judged.planted[0];
        assert_eq!(null.named, BTreeMap::from([("external_leak", 1), ("valve_null", 2)]));
        assert_eq!((null.found, null.median_cycles, null.slowest_cycles), (2, Some(9), Some(9)));
    }
}
