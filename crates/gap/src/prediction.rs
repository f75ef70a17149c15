//! What a machine without a controller does under a recorded command, beside what it did: nothing is fitted.

use seepd_signals::Signal;
use seepd_sim::batch::follow;
use seepd_sim::cycle::{DriveSample, OpenLoopTick, RunStart};
use seepd_sim::{MachineSpec, Steps};

use crate::press::of;
use crate::record::{RecordError, bridged};
use crate::runs::{Run, checked, moving, speeds};
use crate::simulated_axis::SimulatedAxis;

/// A run beside its simulation, from where the run begins to its end.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// The run's name.
    pub name: String,
    /// Ticks, s.
    pub tick_s: f64,
    /// Command, share of full.
    pub command: Vec<f64>,
    /// Every signal with what the machine shows, and what was recorded of it, if it was.
    pub signals: Vec<PredictedSignal>,
    /// Whether the recorded piston moves or has just begun or ended to, tick by tick: where predictions are worth a comparison.
    pub moves: Vec<bool>,
}

/// A signal tick by tick.
#[derive(Debug, Clone)]
pub struct PredictedSignal {
    /// Which one; a speed has that of its position, and no signal of its own.
    pub name: &'static str,
    /// Simulated.
    pub simulated: Vec<f64>,
    /// Recorded, where it was.
    pub recorded: Option<Vec<f64>>,
}

impl PredictedSignal {
    /// RMS of recorded less simulated, over the ticks in which the piston moves.
    pub fn error(&self, moves: &[bool]) -> Option<f64> {
        rms(self.recorded.as_ref()?, &self.simulated, moves)
    }

    /// Mean of recorded less simulated, alike.
    pub fn bias(&self, moves: &[bool]) -> Option<f64> {
        let differences = differences(self.recorded.as_ref()?, &self.simulated, moves);
        let (sum, count) = differences.fold((0.0, 0.0), |(sum, n), difference| (sum + difference, n + 1.0));
        (count > 0.0).then_some(sum / count)
    }
}

/// Time over which a speed is taken, to either side, s.
const SPEED_OVER_S: f64 = 0.05;

fn differences<'v>(a: &'v [f64], b: &'v [f64], moves: &'v [bool]) -> impl Iterator<Item = f64> + 'v {
    let pairs = a.iter().zip(b).zip(moves).filter(|(_, moves)| **moves);
    pairs.map(|((a, b), _)| a - b).filter(|difference| difference.is_finite())
}

/// RMS difference over the ticks in which the piston moves.
pub fn rms(a: &[f64], b: &[f64], moves: &[bool]) -> Option<f64> {
    let (sum, count) = differences(a, b, moves).fold((0.0, 0.0), |(sum, n), d| (sum + d * d, n + 1.0));
    (count > 0.0).then(|| f64::sqrt(sum / count))
}

/// Simulates a run's command from where the run begins, and shows pressures as the machine's transducers do.
///
/// # Errors
/// [`RecordError`] for what is wrong with the run.
pub fn predict(run: &Run, machine: &MachineSpec) -> Result<Prediction, RecordError> {
    let (run, _) = checked(run, machine)?;
    let machine = machine.with_stable_steps();
    let recorded = |signal: Signal| run.log.get(signal).and_then(bridged);
    let command = recorded(Signal::Command).ok_or(RecordError::Missing(Signal::Command.name()))?;
    let load = recorded(Signal::Load);
    let load_at = |tick: usize| {
        load.as_ref().and_then(|load| load.get(tick.min(load.len() - 1))).copied().unwrap_or(0.0)
    };
    let tick_s = machine.controller.period_s;
    let drive: Vec<DriveSample> = command
        .iter()
        .enumerate()
        .map(|(tick, command)| DriveSample {
            run: 0,
            at_s: tick as f64 * tick_s,
            demand_m: f64::NAN,
            command: *command,
            load_n: load_at(tick),
            load_end_n: load_at(tick + 1),
            leak_area_m2: 0.0,
            open_loop: OpenLoopTick::default(),
        })
        .collect();
    let sensor = |signal: Signal| machine.sensors.get(signal.name());
    let begins = |signal: Signal| {
        let shown = run.begins(signal, tick_s)?;
        Some(sensor(signal).map_or(shown, |error| error.there(shown)))
    };
    let start = RunStart {
        position_m: begins(Signal::Position).unwrap_or(0.0),
        p_cap_pa: begins(Signal::PCap),
        p_rod_pa: begins(Signal::PRod),
    };
    let shown: Vec<Signal> =
        machine.signals().into_iter().filter(|signal| *signal != Signal::Command).collect();
    let mut simulated = vec![Vec::with_capacity(drive.len()); shown.len()];
    follow(std::slice::from_ref(&machine), &drive, Some(&start), Steps::Own, |_, record| {
        for (values, signal) in simulated.iter_mut().zip(&shown) {
            values.push(of(record, *signal).0[0]);
        }
    });
    let mut signals = Vec::new();
    for (signal, mut simulated) in shown.iter().zip(simulated) {
        if let Some(error) = sensor(*signal) {
            simulated.iter_mut().for_each(|value| *value = error.shown(*value));
        }
        let recorded = recorded(*signal);
        let speed = (*signal == Signal::Position).then(|| PredictedSignal {
            name: "speed",
            simulated: speeds(&simulated, SPEED_OVER_S, tick_s),
            recorded: recorded.as_ref().map(|position| speeds(position, SPEED_OVER_S, tick_s)),
        });
        signals.push(PredictedSignal { name: signal.name(), simulated, recorded });
        signals.extend(speed);
    }
    let mut moves = vec![false; drive.len()];
    moving(&run, &machine).into_iter().for_each(|piece| moves[piece].fill(true));
    Ok(Prediction { name: run.name, tick_s, command, signals, moves })
}
