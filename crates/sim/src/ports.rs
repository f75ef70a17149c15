//! The loop around a plant that somebody else simulates, tick by tick: our controller where the plant has none, and the laws of the
//! catalogue that act at its ports.
//!
//! A port is where a signal goes in or comes out: the command, the load, the measured position. A law between controller and spool acts on
//! the command, a force on the load, an error of the sensor on what the controller sees. With the controller inside of the plant, what it
//! sees is reached through its demand: an error e of the position is a demand that is smaller by e, exactly so where the controller knows
//! the control error alone. Laws in the balances of oil have no port.

use seepd_signals::Signal;

use crate::controller::{Controller, Pid, PidState};
use crate::cycle::DriveSample;
use crate::effects::{self, Constants, Effect, Law, Moment, Sensing, Substep, Terms};
use crate::plant::{Plant, PlantParameters, State};

/// Where a law meets a plant that is not ours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Port {
    /// Between the controller and the plant's command.
    Command,
    /// In the controller.
    Controller,
    /// Between the plant's position and the controller.
    Position,
    /// On the plant's load.
    Load,
}

impl Port {
    /// What is missing where it is not there, in words that follow "since".
    pub const fn wanted(self) -> &'static str {
        match self {
            Port::Command => {
                "the simulator takes no command (give it one, with the controller in the plant file)"
            }
            Port::Controller => "the controller is inside of the simulator",
            Port::Position => "the simulator does not go tick by tick",
            Port::Load => "the simulator takes no load tick by tick",
        }
    }
}

/// Effects that act at a port, with it.
const AT_PORTS: [(&str, Port); 18] = [
    ("command_quantisation", Port::Command),
    ("command_delay", Port::Command),
    ("valve_hysteresis", Port::Command),
    ("valve_rate_limit", Port::Command),
    ("valve_lag", Port::Command),
    ("valve_bias", Port::Command),
    ("valve_deadband", Port::Command),
    ("valve_flow_shape", Port::Command),
    ("controller_gains", Port::Controller),
    ("controller_clock", Port::Controller),
    ("position_scale", Port::Position),
    ("position_lag", Port::Position),
    ("position_quantisation", Port::Position),
    ("position_sine", Port::Position),
    ("coulomb_friction", Port::Load),
    ("stribeck_friction", Port::Load),
    ("spring_load", Port::Load),
    ("load_bias", Port::Load),
];

/// The port at which an effect of the catalogue acts; `None` for those within the balances.
pub fn port_of(effect: &str) -> Option<Port> {
    AT_PORTS.iter().find(|(key, _)| *key == effect).map(|(_, port)| *port)
}

/// What goes into a plant over a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PortInput {
    /// Command, share of full command; with the loop inside the demand, m.
    pub reference: f64,
    /// Load, N, positive in the extending direction.
    pub load_n: f64,
    /// Length of the tick, s.
    pub dt_s: f64,
}

/// What a plant shows at a tick, SI; NaN for what it does not show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PortOutput {
    /// By [`Signal`]'s number.
    pub values: [f64; Signal::ALL.len()],
    /// Velocity, m/s.
    pub velocity_m_per_s: f64,
}

impl PortOutput {
    /// Of a plant that shows nothing.
    pub const NOTHING: Self =
        PortOutput { values: [f64::NAN; Signal::ALL.len()], velocity_m_per_s: f64::NAN };

    /// A signal.
    pub fn get(&self, signal: Signal) -> f64 {
        self.values[signal as usize]
    }

    fn set(&mut self, signal: Signal, value: f64) {
        self.values[signal as usize] = value;
    }
}

/// A plant that is advanced from outside.
pub trait SteppedPlant {
    /// Why it cannot go on.
    type Error;
    /// Puts it at its start, where the drive begins, and tells what it shows.
    ///
    /// # Errors
    /// Its own.
    fn start(&mut self, first: &DriveSample) -> Result<PortOutput, Self::Error>;
    /// Takes it over a tick under inputs that are held, and tells what it shows at the end.
    ///
    /// # Errors
    /// Its own.
    fn step(&mut self, input: &PortInput) -> Result<PortOutput, Self::Error>;
}

/// Parts of a tick in which laws between controller and spool are advanced: lags and delays are no multiples of a tick.
const PARTS: usize = 10;

/// A loop: controller and laws, without the plant.
pub struct PortLoop {
    /// `None` where the plant has the controller inside.
    pid: Option<Pid<f64>>,
    laws: Vec<Box<dyn Law<f64>>>,
    /// What laws are handed for a plant that is not theirs.
    nominal: Plant<f64>,
    period_s: f64,
    dt_s: f64,
}

struct LoopState {
    pid: Option<PidState<f64>>,
    memory: Vec<Vec<f64>>,
    tick: u64,
    last: PortOutput,
}

impl PortLoop {
    /// A loop with effects by their values in the catalogue's order. Effects without a port are left out.
    ///
    /// `controller` is `None` where the plant has one inside; its period is then `period_s`.
    pub fn new(
        controller: Option<&Controller>,
        period_s: f64,
        values: impl Fn(&dyn Effect) -> Vec<f64>,
    ) -> Self {
        let with_port = effects::ALL.iter().filter(|effect| port_of(effect.key()).is_some());
        let laws: Vec<Box<dyn Law<f64>>> = with_port
            .filter_map(|effect| {
                let values = values(*effect);
                (!effect.is_neutral(&values)).then(|| effect.scalar(&values))
            })
            .collect();
        let period_s = controller.map_or(period_s, |controller| controller.period_s);
        let mut nominal = Plant::new(&[&PlantParameters::default()]);
        let default = Controller::default();
        let mut pid = Pid::new(&[controller.unwrap_or(&default)]);
        let mut dt_s = period_s;
        for law in &laws {
            law.adjust(&mut Constants {
                plant: &mut nominal,
                pid: &mut pid,
                dt: &mut dt_s,
                corrects_errors: &mut false,
            });
        }
        PortLoop { pid: controller.map(|_| pid), laws, nominal, period_s, dt_s }
    }

    /// Runs a plant along a drive and hands what a logger would see at each tick to `sink`.
    ///
    /// The command is logged at the tick at which it was computed. With the loop inside it is what the plant shows after the step that had
    /// that tick's demand, or `latency` steps later for a plant that shows what it did so late.
    ///
    /// # Errors
    /// The plant's.
    pub fn run<P: SteppedPlant>(
        &self,
        plant: &mut P,
        drive: &[DriveSample],
        latency: usize,
        mut sink: impl FnMut(usize, &PortOutput),
    ) -> Result<(), P::Error> {
        let Some(first) = drive.first() else { return Ok(()) };
        let start = plant.start(first)?;
        let mut state = LoopState {
            pid: self.pid.as_ref().map(|pid| pid.start(start.get(Signal::Position))),
            memory: self.laws.iter().map(|law| vec![0.0; law.memory()]).collect(),
            tick: 0,
            last: start,
        };
        let mut waiting = std::collections::VecDeque::with_capacity(latency + 1);
        let after_the_end = drive.last().into_iter().cycle().take(latency);
        for (tick, sample) in drive.iter().chain(after_the_end).enumerate() {
            let (seen, command) = self.tick(&mut state, plant, sample)?;
            waiting.push_back(seen);
            if tick >= latency
                && let Some(mut shown) = waiting.pop_front()
            {
                if self.pid.is_none() {
                    shown.set(Signal::Command, command);
                }
                sink(tick - latency, &shown);
            }
        }
        Ok(())
    }

    /// One tick: what is seen at its beginning, and the command over it.
    fn tick<P: SteppedPlant>(
        &self,
        state: &mut LoopState,
        plant: &mut P,
        sample: &DriveSample,
    ) -> Result<(PortOutput, f64), P::Error> {
        let there = state.last;
        let position = there.get(Signal::Position);
        let seen = self.sensed(&mut state.memory, position);
        let computed = match (&self.pid, &mut state.pid) {
            (Some(pid), Some(memory)) => Some(pid.tick(memory, sample.demand_m, seen)),
            _ => None,
        };
        let reference = match computed {
            Some(command) => self.spool(state, command),
            None => sample.demand_m - (seen - position),
        };
        // A held load: its mean over the tick.
        let load_n = 0.5 * (sample.load_n + sample.load_end_n) + self.force_n(state, &there, sample);
        let mut next = plant.step(&PortInput { reference, load_n, dt_s: self.dt_s })?;
        if next.velocity_m_per_s.is_nan() {
            next.velocity_m_per_s = (next.get(Signal::Position) - position) / self.dt_s;
        }
        state.last = next;
        state.tick += 1;
        let mut shown = there;
        shown.set(Signal::Position, seen);
        if let Some(command) = computed {
            shown.set(Signal::Command, command);
        }
        Ok((shown, computed.unwrap_or(next.get(Signal::Command))))
    }

    fn sensed(&self, memory: &mut [Vec<f64>], position: f64) -> f64 {
        let sensing = Sensing { period: self.period_s };
        let each = self.laws.iter().zip(memory);
        each.fold(position, |position, (law, memory)| law.sense(memory, position, &sensing))
    }

    /// The spool's mean position over a tick.
    fn spool(&self, state: &mut LoopState, command: f64) -> f64 {
        let dt = self.dt_s / PARTS as f64;
        let mut sum = 0.0;
        for index in 0..PARTS {
            let substep = Substep { tick: state.tick, index, steps: PARTS, dt, period: self.period_s };
            let each = self.laws.iter().zip(&mut state.memory);
            sum += each.fold(command, |command, (law, memory)| law.spool(memory, command, &substep));
        }
        sum / PARTS as f64
    }

    /// What the laws add to the load, N.
    fn force_n(&self, state: &LoopState, there: &PortOutput, sample: &DriveSample) -> f64 {
        let v = there.velocity_m_per_s;
        let of = |signal| there.get(signal);
        let plant_state = State {
            p_s: of(Signal::PSupply),
            p_3: of(Signal::PInlet),
            p_1: of(Signal::PCap),
            p_2: of(Signal::PRod),
            x: of(Signal::Position),
            v: if v.is_nan() { 0.0 } else { v },
        };
        let moment = Moment {
            state: &plant_state,
            plant: &self.nominal,
            spool: 0.0,
            load: sample.load_n,
            a_leak: 0.0,
            at: sample.at_s,
        };
        let none = Terms { supply_flow: 0.0, inlet_flow: 0.0, cap_flow: 0.0, rod_flow: 0.0, force: 0.0 };
        let mut terms = none;
        for (law, memory) in self.laws.iter().zip(&state.memory) {
            law.act(memory, &moment, &mut terms);
        }
        terms.force
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cycle::{CycleRun, Schedule};
    use crate::machine::{Input, Machine};
    use crate::spec::MachineSpec;

    /// Our own press, advanced as somebody else's.
    struct OwnPress {
        machine: Machine<f64>,
        state: Option<crate::machine::MachineState<f64>>,
    }

    impl OwnPress {
        fn shown(&self) -> PortOutput {
            let mut output = PortOutput::NOTHING;
            if let Some(state) = &self.state {
                output.set(Signal::Position, state.plant.x);
                output.set(Signal::PCap, state.plant.p_1);
                output.velocity_m_per_s = state.plant.v;
            }
            output
        }
    }

    impl SteppedPlant for OwnPress {
        type Error = std::convert::Infallible;

        fn start(&mut self, first: &DriveSample) -> Result<PortOutput, Self::Error> {
            self.state = Some(self.machine.start_at(&Input::from(*first)));
            Ok(self.shown())
        }

        fn step(&mut self, input: &PortInput) -> Result<PortOutput, Self::Error> {
            // What is asked for is the reference of the run itself.
            let held = Input::from(DriveSample::new(0.0, f64::NAN, input.load_n));
            if let Some(state) = &mut self.state {
                self.machine.run(state, input.reference, &held);
            }
            Ok(self.shown())
        }
    }

    /// Largest difference of commands, over their range, between an effect inside of our press and at its ports.
    fn apart(effect: &str) -> f64 {
        let nominal = MachineSpec::default();
        let mut planted = nominal.clone();
        if effect != "none" {
            planted.set_effect(effect).unwrap();
        }
        let drive: Vec<DriveSample> =
            Schedule::new(&nominal.cycle, 1e-3, vec![CycleRun::with_leak(0.0)]).take(10_000).collect();
        let native = Machine::<f64>::new(&[&planted]);
        let mut state = native.start_at(&Input::gather(&drive[..1]));
        let native: Vec<f64> =
            drive.iter().map(|sample| native.tick(&mut state, &Input::from(*sample)).command).collect();
        let around = PortLoop::new(Some(&nominal.controller), 1e-3, |effect| planted.effect_values(effect));
        // One whose ticks are as long as the loop makes them.
        let mut ticks = nominal.clone();
        ticks.controller.period_s = around.dt_s;
        let mut plant = OwnPress { machine: Machine::new(&[&ticks]), state: None };
        let mut outside = Vec::new();
        let Ok(()) = around.run(&mut plant, &drive, 0, |_, seen| outside.push(seen.get(Signal::Command)));
        let (low, high) = native.iter().fold((0.0f64, 0.0f64), |(low, high), u| (low.min(*u), high.max(*u)));
        let squares: f64 = native.iter().zip(&outside).map(|(a, b)| (a - b).powi(2)).sum();
        (squares / native.len() as f64).sqrt() / (high - low)
    }

    /// The loop alone is ours to the bit but for the load, which is held over a tick; laws at ports are the laws inside to parts of a
    /// thousand (a force that is held over a tick lags by half of it). What each of them does is ten times more.
    #[test]
    fn laws_at_the_ports_are_the_laws_inside() {
        assert!(apart("none") < 1e-5, "{}", apart("none"));
        for (effect, most) in [
            ("command_delay.delay_s=0.0065", 1e-4),
            ("valve_deadband.half_width=0.03", 1e-3),
            ("valve_bias.offset=0.02", 1e-5),
            ("valve_lag.natural_frequency_hz=30", 1e-3),
            ("position_scale.factor=0.97", 1e-5),
            ("position_lag.time_constant_s=0.01", 1e-5),
            ("controller_gains.kp=1.2", 1e-5),
            ("controller_clock.period_s=0.00105", 1e-5),
            ("coulomb_friction.force_n=1500", 1e-3),
            ("spring_load.stiffness_n_per_m=20000", 1e-4),
            ("load_bias.force_n=2000", 1e-5),
        ] {
            let difference = apart(effect);
            assert!(difference < most, "{effect}: {difference}");
        }
    }

    #[test]
    fn effects_with_a_port_are_in_the_catalogue() {
        for (key, port) in AT_PORTS {
            assert!(effects::find(key).is_some(), "{key} at {port:?}");
        }
        assert_eq!(port_of("external_leak"), None);
    }
}
