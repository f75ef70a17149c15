//! Many machines at once: SIMD lanes within a core, lanes spread over cores.
//!
//! The instruction set (AVX-512, AVX2, or the platform's baseline) is picked when the program runs, so that
//! one binary serves every gateway. Lanes do not touch each other: a machine gives the same bits here and in
//! [`Machine<f64>`](crate::Machine).

use rayon::prelude::*;

use crate::cycle::{CycleRun, DriveSample, RunStart, Schedule};
use crate::integration::{Stepping, Steps};
use crate::machine::{Input, Machine, MachineState, SimulatedSignals};
use crate::real::{LANES, Lanes, Real};
use crate::simd::widest;
use crate::spec::MachineSpec;

/// One machine of a batch and what it is asked to do.
#[derive(Debug, Clone)]
pub struct Job {
    /// The machine.
    pub spec: MachineSpec,
    /// Its runs; see [`Schedule::new`].
    pub runs: Vec<CycleRun>,
    /// Tick of the first run at which the simulation begins: the machine is at rest there, under the load of that run.
    pub start_tick: u64,
    /// How many ticks to simulate before recording.
    pub skip_ticks: u64,
    /// How many ticks to signals after that.
    pub record_ticks: u64,
}

/// Runs the jobs and hands each one's recorded commands, in shares of full command, to `reduce` with the
/// job's index; results come in the jobs' order.
pub fn commands<R: Send>(jobs: &[Job], steps: Steps, reduce: impl Fn(usize, &[f64]) -> R + Sync) -> Vec<R> {
    jobs.par_chunks(LANES)
        .enumerate()
        .flat_map_iter(|(chunk, jobs)| {
            let mut commands: Vec<Vec<f64>> =
                jobs.iter().map(|job| Vec::with_capacity(job.record_ticks as usize)).collect();
            run_lanes(jobs, steps, |lane, signals| commands[lane].push(signals.command.0[lane]));
            let reduced: Vec<R> =
                commands.iter().enumerate().map(|(lane, c)| reduce(chunk * LANES + lane, c)).collect();
            reduced
        })
        .collect()
}

/// Runs at most [`LANES`] jobs side by side and hands each recorded tick of each job to `sink` with its lane.
///
/// Jobs beyond the lanes are not run; callers pass chunks of [`LANES`].
///
/// # Panics
/// Where `jobs` is empty.
pub fn run_lanes(jobs: &[Job], steps: Steps, mut sink: impl FnMut(usize, &SimulatedSignals<Lanes>)) {
    let specs: Vec<&MachineSpec> = jobs.iter().map(|job| &job.spec).collect();
    let machine = Machine::<Lanes>::with_stepping(&specs, Stepping::of(&specs, steps));
    let mut schedules: Vec<Schedule> = jobs
        .iter()
        .map(|job| {
            Schedule::new(&job.spec.cycle, job.spec.controller.period_s, job.runs.clone())
                .starting_at(job.start_tick)
        })
        .collect();
    let end = jobs.iter().map(|job| job.skip_ticks + job.record_ticks).max().unwrap_or(0);
    let mut samples: Vec<DriveSample> =
        schedules.iter().filter_map(|schedule| schedule.clone().next()).collect();
    let mut state = machine.start_at(&Input::gather(&samples));
    // A block of ticks at a time; the sink is called outside of the widest instructions.
    let mut block: Vec<SimulatedSignals<Lanes>> = Vec::with_capacity(BLOCK_TICKS);
    let mut inputs: Vec<Input<Lanes>> = Vec::with_capacity(BLOCK_TICKS);
    let mut tick = 0;
    while tick < end {
        let ticks = BLOCK_TICKS.min((end - tick) as usize);
        inputs.clear();
        for _ in 0..ticks {
            for (sample, next) in samples.iter_mut().zip(schedules.iter_mut().filter_map(Iterator::next)) {
                *sample = next;
            }
            inputs.push(Input::gather(&samples));
        }
        tick_block(&machine, &mut state, &inputs, &mut block);
        for (offset, signals) in block.iter().enumerate() {
            let at = tick + offset as u64;
            for (lane, job) in jobs.iter().enumerate().take(LANES) {
                if at >= job.skip_ticks && at < job.skip_ticks + job.record_ticks {
                    sink(lane, signals);
                }
            }
        }
        tick += ticks as u64;
    }
}

/// Runs at most [`LANES`] machines side by side along the same drive, each with its own leak, and hands each tick to `sink` with its
/// number.
///
/// Machines beyond the lanes are not run; callers pass chunks of [`LANES`].
///
/// `start` is where they begin; without one, at rest at the first demand under the first load.
///
/// # Panics
/// Where `machines` is empty.
pub fn follow(
    machines: &[MachineSpec],
    drive: &[DriveSample],
    start: Option<&RunStart>,
    steps: Steps,
    mut sink: impl FnMut(usize, &SimulatedSignals<Lanes>),
) {
    let specs: Vec<&MachineSpec> = machines.iter().collect();
    let machine = Machine::<Lanes>::with_stepping(&specs, Stepping::of(&specs, steps));
    let a_leak = Lanes::from_lanes(|lane| specs[lane.min(specs.len() - 1)].plant.leak_area_m2);
    let Some(first) = drive.first().map(|first| Input::from(*first)) else { return };
    let mut state = start.map_or_else(|| machine.start_at(&first), |start| machine.start_from(start, &first));
    let mut block: Vec<SimulatedSignals<Lanes>> = Vec::with_capacity(BLOCK_TICKS);
    let mut inputs: Vec<Input<Lanes>> = Vec::with_capacity(BLOCK_TICKS);
    for (number, samples) in drive.chunks(BLOCK_TICKS).enumerate() {
        inputs.clear();
        inputs.extend(samples.iter().map(|sample| Input { a_leak, ..Input::from(*sample) }));
        tick_block(&machine, &mut state, &inputs, &mut block);
        for (offset, signals) in block.iter().enumerate() {
            sink(number * BLOCK_TICKS + offset, signals);
        }
    }
}

/// Runs a block of ticks under the widest instructions into `block`. Not generic, so that it is compiled here, once for each instruction
/// set, and not again for every sink of every crate.
fn tick_block(
    machine: &Machine<Lanes>,
    state: &mut MachineState<Lanes>,
    inputs: &[Input<Lanes>],
    block: &mut Vec<SimulatedSignals<Lanes>>,
) {
    block.clear();
    widest(
        #[inline(always)]
        || {
            for input in inputs {
                block.push(machine.tick_inlined(state, input));
            }
        },
    );
}

/// Ticks that are run between two calls of the sink.
const BLOCK_TICKS: usize = 256;
