//! A press that is simulated while it is watched: its seal wears until somebody replaces it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use seepd_logs::{LogError, Source};
use seepd_signals::Sample;
use seepd_sim::MachineSpec;
use seepd_sim::cycle::{CycleRun, Schedule};
use seepd_sim::machine::{Input, Machine, MachineState};
use seepd_sim::noise::Noise;

/// Cycles in which a seal is as new: 20 for the baseline, and some more.
const HEALTHY_CYCLES: usize = 40;
/// Cycles over which it wears.
const WEARING_CYCLES: usize = 160;
/// Cycles that are run with the worn seal before it is given up.
const WORN_CYCLES: usize = 20;
/// Leak area as wear begins and at the end, m²: 0.05 and 4.3 L/min at 7 MPa.
const WEAR_M2: (f64, f64) = (1e-8, 8e-7);
/// Load varies by this share from cycle to cycle.
const LOAD_VARIATION: f64 = 0.05;
/// Noise of the measured command, share of full command.
const COMMAND_NOISE: f64 = 0.001;

/// What the press and whoever looks after it tell each other.
#[derive(Debug, Default)]
pub(super) struct Seal {
    /// Seals that were fitted because the one before had worn out.
    pub(super) renewed: AtomicU64,
    /// Seals that somebody asked for.
    pub(super) asked_for: AtomicU64,
}

/// See the [module](self).
pub(super) struct SimulatedPress {
    spec: MachineSpec,
    machine: Machine<f64>,
    state: MachineState<f64>,
    schedule: Schedule,
    run: usize,
    tick: u64,
    noise: Noise,
    seal: Arc<Seal>,
    /// Of the seals that were asked for, those that it has got.
    has_got: u64,
}

impl SimulatedPress {
    /// The nominal press with a new seal.
    pub(super) fn new(seed: u64, seal: Arc<Seal>) -> Self {
        let spec = MachineSpec::default();
        let machine = Machine::<f64>::new(&[&spec]);
        let mut noise = Noise::new(seed, 4);
        SimulatedPress {
            state: machine.start(),
            schedule: life_of_a_seal(&spec, &mut noise),
            spec,
            machine,
            run: 0,
            tick: 0,
            noise,
            seal,
            has_got: 0,
        }
    }

    fn is_asked_for_seal(&self) -> bool {
        self.seal.asked_for.load(Ordering::Relaxed) > self.has_got
    }

    /// Between two cycles: a new seal, where the old one has worn out or one has been asked for.
    fn look_at_seal(&mut self) {
        let is_worn_out = self.run >= HEALTHY_CYCLES + WEARING_CYCLES + WORN_CYCLES;
        if is_worn_out {
            self.seal.renewed.fetch_add(1, Ordering::Relaxed);
        }
        if is_worn_out || self.is_asked_for_seal() {
            self.has_got = self.seal.asked_for.load(Ordering::Relaxed);
            self.schedule = life_of_a_seal(&self.spec, &mut self.noise);
            self.run = 0;
        }
    }
}

/// The cycles of a seal, from new to worn out.
fn life_of_a_seal(spec: &MachineSpec, noise: &mut Noise) -> Schedule {
    let run = |cycle: usize| {
        let leak_area_m2 = match cycle.checked_sub(HEALTHY_CYCLES) {
            None => 0.0,
            Some(worn) => {
                let share = worn.min(WEARING_CYCLES) as f64 / WEARING_CYCLES as f64;
                WEAR_M2.0 * (WEAR_M2.1 / WEAR_M2.0).powf(share)
            }
        };
        CycleRun { load_factor: noise.factor(LOAD_VARIATION), ..CycleRun::with_leak(leak_area_m2) }
    };
    let runs = (0..HEALTHY_CYCLES + WEARING_CYCLES + WORN_CYCLES).map(run).collect();
    Schedule::new(&spec.cycle, spec.controller.period_s, runs)
}

impl Source for SimulatedPress {
    fn next_sample(&mut self) -> Result<Option<Sample>, LogError> {
        let mut drive = self.schedule.next();
        if let Some(begun) = drive.filter(|drive| drive.run != self.run) {
            self.run = begun.run;
            self.look_at_seal();
            if self.run == 0 {
                drive = self.schedule.next();
            }
        }
        let Some(mut drive) = drive else { return Ok(None) };
        if self.is_asked_for_seal() {
            // What is left of the cycle in which it is fitted.
            drive.leak_area_m2 = 0.0;
        }
        let record = self.machine.tick(&mut self.state, &Input::gather(&[drive]));
        let time_ns = (self.tick as f64 * self.spec.controller.period_s * 1e9).round() as i64;
        self.tick += 1;
        Ok(Some(Sample::command(time_ns, record.command + self.noise.normal(COMMAND_NOISE))))
    }

    fn notes(&self) -> Vec<String> {
        Vec::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seepd_signals::Signal;

    /// Root mean square of the command in a cycle of 10 s, at a kilohertz.
    fn effort(press: &mut SimulatedPress) -> f64 {
        let square = |press: &mut SimulatedPress| {
            let sample = press.next_sample().unwrap().unwrap();
            sample.get(Signal::Command).unwrap().powi(2)
        };
        ((0..10_000).map(|_| square(press)).sum::<f64>() / 1e4).sqrt()
    }

    #[test]
    fn the_seal_wears_and_is_as_new_once_it_is_worn_out_or_one_is_asked_for() {
        let seal = Arc::new(Seal::default());
        let mut press = SimulatedPress::new(1, Arc::clone(&seal));
        effort(&mut press);
        let new = effort(&mut press);
        let life = HEALTHY_CYCLES + WEARING_CYCLES + WORN_CYCLES;
        let worn = (2..life).map(|_| effort(&mut press)).last().unwrap();
        assert!(seal.renewed.load(Ordering::Relaxed) == 0 && worn > 1.02 * new, "{new} {worn}");
        effort(&mut press);
        let renewed = effort(&mut press);
        assert_eq!(seal.renewed.load(Ordering::Relaxed), 1);
        assert!((renewed / new - 1.0).abs() < 0.01, "{new} {renewed}");
        // Somebody asks for one halfway.
        for _ in 2..life / 2 + HEALTHY_CYCLES {
            effort(&mut press);
        }
        seal.asked_for.store(1, Ordering::Relaxed);
        effort(&mut press);
        let asked = effort(&mut press);
        assert!((asked / new - 1.0).abs() < 0.01, "{new} {asked}");
        assert_eq!(seal.renewed.load(Ordering::Relaxed), 1);
        // Time goes on: it is one machine.
        let before_ns = press.next_sample().unwrap().unwrap().time_ns;
        assert_eq!(press.next_sample().unwrap().unwrap().time_ns - before_ns, 1_000_000);
    }
}
