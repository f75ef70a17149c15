//! A machine: plant, controller and effects, advanced one controller tick at a time.

use crate::controller::{Pid, PidState};
use crate::cycle::{DriveSample, OpenLoopTick, RunStart};
use crate::effects::{self, Constants, Law, Sensing, Substep};
use crate::integration::{Method, Stepping};
use crate::plant::{ActingLaws, Drive, Plant, State};
use crate::real::Real;
use crate::spec::MachineSpec;

/// The drive of a tick, of one machine or of several in lanes.
#[derive(Debug, Clone, Copy)]
pub struct Input<T> {
    /// Position demand, m.
    pub demand: T,
    /// Load at the tick, N.
    pub load: T,
    /// Load at the next tick, N; linear between.
    pub load_end: T,
    /// Leak area, m².
    pub a_leak: T,
    /// Time in the duty cycle, s.
    pub at: T,
    /// Command of a machine without a controller, share of full command.
    pub command: T,
    /// Who makes the command of a machine with one.
    pub open_loop: OpenLoopTick<T>,
}

impl<T: Real> Input<T> {
    /// Gathers one drive sample for each lane; a shorter slice repeats its last entry.
    ///
    /// # Panics
    /// Where `samples` is empty.
    #[inline(always)]
    pub fn gather(samples: &[DriveSample]) -> Self {
        let at = |lane: usize| &samples[lane.min(samples.len() - 1)];
        Input {
            demand: T::from_lanes(|lane| at(lane).demand_m),
            load: T::from_lanes(|lane| at(lane).load_n),
            load_end: T::from_lanes(|lane| at(lane).load_end_n),
            a_leak: T::from_lanes(|lane| at(lane).leak_area_m2),
            at: T::from_lanes(|lane| at(lane).at_s),
            command: T::from_lanes(|lane| at(lane).command.clamp(-1.0, 1.0)),
            open_loop: OpenLoopTick {
                is_open: T::from_lanes(|lane| at(lane).open_loop.is_open),
                command: T::from_lanes(|lane| at(lane).open_loop.command),
                carried: T::from_lanes(|lane| at(lane).open_loop.carried),
            },
        }
    }
}

impl<T: Real> From<DriveSample> for Input<T> {
    /// The same drive for each lane.
    #[inline(always)]
    fn from(sample: DriveSample) -> Self {
        Input::gather(&[sample])
    }
}

/// The signals that a logger would see at a tick: the state there with the command just computed.
#[derive(Debug, Clone, Copy)]
pub struct SimulatedSignals<T> {
    /// PID valve command, share of full command.
    pub command: T,
    /// Position demand, m.
    pub demand: T,
    /// Measured position, m.
    pub position: T,
    /// Supply pressure, Pa.
    pub p_supply: T,
    /// Valve inlet pressure, Pa.
    pub p_inlet: T,
    /// Cap chamber's pressure, Pa.
    pub p_cap: T,
    /// Rod chamber's pressure, Pa.
    pub p_rod: T,
    /// Load, N.
    pub load: T,
    /// Truth: flow past the piston, cap → rod, m³/s.
    pub leak_flow: T,
    /// Truth: leak area, m².
    pub leak_area: T,
}

/// One machine (`f64`) or several in lanes: parameters only, what changes is in a [`MachineState`].
///
/// The [crate's page](crate) has an example.
pub struct Machine<T: Real> {
    plant: Plant<T>,
    pid: Pid<T>,
    laws: Vec<Box<dyn Law<T>>>,
    /// Whether a law acts within the balances.
    in_balances: bool,
    /// Whether a law softens volumes.
    softens: bool,
    /// Whether a law has states of its own.
    has_states: bool,
    /// Whether a law changes the control error.
    corrects_errors: bool,
    steps: usize,
    method: Method,
    period: T,
    dt: T,
    start: (T, T),
    /// Whether a controller makes the command.
    is_controlled: bool,
    /// Whether a move of any machine begins open loop.
    has_open_loop: bool,
}

/// What changes while a machine runs.
#[derive(Debug, Clone)]
pub struct MachineState<T> {
    /// The plant's state at the tick.
    pub plant: State<T>,
    pid: PidState<T>,
    memory: Vec<Vec<T>>,
    /// How far the position at which an open-loop part ended was from the planned one, m.
    beside_plan: T,
    tick: u64,
    /// How many times a pressure was held at 0, each an instance of cavitation that is not modelled.
    pub clamped_pressures: u64,
}

impl<T: Real> Machine<T> {
    /// Gathers one machine a lane; a shorter slice repeats its last entry. All machines of a batch take the
    /// number of steps in a period from the first one; see [`MachineSpec::with_stable_steps`].
    ///
    /// # Panics
    /// Where `specs` is empty.
    pub fn new(specs: &[&MachineSpec]) -> Self {
        Self::with_stepping(specs, Stepping::own(specs))
    }

    /// The same with steps of any kind.
    ///
    /// # Panics
    /// Where `specs` is empty.
    pub(crate) fn with_stepping(specs: &[&MachineSpec], Stepping { steps, method }: Stepping) -> Self {
        let of = |lane: usize| specs[lane.min(specs.len() - 1)];
        let plants: Vec<_> = specs.iter().map(|spec| &spec.plant).collect();
        let controllers: Vec<_> = specs.iter().map(|spec| &spec.controller).collect();
        let period = T::from_lanes(|lane| of(lane).controller.period_s);
        let laws: Vec<Box<dyn Law<T>>> = effects::every()
            .filter(|effect| specs.iter().any(|spec| spec.effects.contains_key(effect.key())))
            .filter_map(|effect| {
                let by_lane: Vec<Vec<f64>> =
                    (0..T::WIDTH).map(|lane| of(lane).effect_values(effect)).collect();
                let values: Vec<T> = (0..effect.parameters().len())
                    .map(|parameter| T::from_lanes(|lane| by_lane[lane][parameter]))
                    .collect();
                T::law(effect, &values)
            })
            .collect();
        let (mut plant, mut pid) = (Plant::new(&plants), Pid::new(&controllers));
        let mut dt = period / T::splat(steps as f64);
        let mut corrects_errors = false;
        for law in &laws {
            law.adjust(&mut Constants {
                plant: &mut plant,
                pid: &mut pid,
                dt: &mut dt,
                corrects_errors: &mut corrects_errors,
            });
        }
        Machine {
            plant,
            pid,
            in_balances: laws.iter().any(|law| law.is_in_balances()),
            softens: laws.iter().any(|law| law.softens()),
            has_states: laws.iter().any(|law| law.has_states()),
            corrects_errors,
            laws,
            steps,
            method,
            period,
            dt,
            is_controlled: !specs[0].controller.is_none(),
            has_open_loop: specs.iter().any(|spec| spec.cycle.has_open_loop()),
            start: (
                T::from_lanes(|lane| of(lane).cycle.start_position_m()),
                T::from_lanes(|lane| of(lane).cycle.load_n(0.0)),
            ),
        }
    }

    /// The machine at rest where its duty cycle begins.
    pub fn start(&self) -> MachineState<T> {
        self.at_rest(self.start.0, self.start.1)
    }

    /// The machine at rest where a drive begins.
    pub fn start_at(&self, first: &Input<T>) -> MachineState<T> {
        self.at_rest(first.demand, first.load)
    }

    /// The machine at rest where a run begins.
    pub fn start_from(&self, start: &RunStart, first: &Input<T>) -> MachineState<T> {
        self.at(self.plant.standing(start, first.load))
    }

    fn at_rest(&self, x: T, load: T) -> MachineState<T> {
        self.at(self.plant.rest(x, load))
    }

    fn at(&self, plant: State<T>) -> MachineState<T> {
        MachineState {
            plant,
            pid: self.pid.start(plant.x),
            memory: self.laws.iter().map(|law| vec![T::splat(0.0); law.memory()]).collect(),
            beside_plan: T::splat(0.0),
            tick: 0,
            clamped_pressures: 0,
        }
    }

    /// As [`tick`](Machine::tick), inlined into its caller, where the widest instructions are.
    #[inline(always)]
    pub(crate) fn tick_inlined(&self, state: &mut MachineState<T>, input: &Input<T>) -> SimulatedSignals<T> {
        let position = self.sense_inlined(state, self.period);
        let (command, demand) = if self.is_controlled {
            self.controlled(state, position, input)
        } else {
            (input.command, input.demand)
        };
        let signals = SimulatedSignals {
            command,
            demand,
            position,
            p_supply: state.plant.p_s,
            p_inlet: state.plant.p_3,
            p_cap: state.plant.p_1,
            p_rod: state.plant.p_2,
            load: input.load,
            leak_flow: self.plant.leak_flow(&state.plant, input.a_leak),
            leak_area: input.a_leak,
        };
        self.advance(state, command, input, (self.steps, self.dt, self.period));
        signals
    }

    /// The command of a tick where a controller makes it, and the demand that it follows.
    #[inline(always)]
    fn controlled(&self, state: &mut MachineState<T>, position: T, input: &Input<T>) -> (T, T) {
        if !self.has_open_loop {
            return (self.command_inlined(state, input.demand, position), input.demand);
        }
        let demand = self.asked(state, position, input);
        let before = state.pid;
        let command = self.command_inlined(state, demand, position);
        (self.own_or(state, command, &before, position, &input.open_loop), demand)
    }

    /// The demand of a tick where moves may begin open loop: the measured position then, and later the plan with what is left of the
    /// distance between the two.
    fn asked(&self, state: &mut MachineState<T>, position: T, input: &Input<T>) -> T {
        let OpenLoopTick { is_open, carried, .. } = input.open_loop;
        state.beside_plan = is_open.where_positive(position - input.demand, state.beside_plan);
        is_open.where_positive(position, input.demand + carried * state.beside_plan)
    }

    /// The move's own command in its open-loop part, which the controller follows, and else the controller's.
    fn own_or(
        &self,
        state: &mut MachineState<T>,
        controlled: T,
        before: &PidState<T>,
        position: T,
        open_loop: &OpenLoopTick<T>,
    ) -> T {
        let OpenLoopTick { is_open, command: own, .. } = *open_loop;
        let tracking = self.pid.tracking(before, own, position);
        state.pid = state.pid.or_where_positive(is_open, &tracking);
        let one = T::splat(1.0);
        is_open.where_positive(own.max(-one).min(one), controlled)
    }

    /// The demand at which a controller makes what laws have it make of the control error.
    fn corrected(&self, demand: T, position: T) -> T {
        position + self.laws.iter().fold(demand - position, |error, law| law.correct(error))
    }

    #[inline(always)]
    fn sense_inlined(&self, state: &mut MachineState<T>, period: T) -> T {
        let sensing = Sensing { period };
        let laws = self.laws.iter().zip(&mut state.memory);
        laws.fold(state.plant.x, |position, (law, memory)| law.sense(memory, position, &sensing))
    }

    #[inline(always)]
    fn command_inlined(&self, state: &mut MachineState<T>, demand: T, position: T) -> T {
        let asked = if self.corrects_errors { self.corrected(demand, position) } else { demand };
        self.pid.tick(&mut state.pid, asked, position)
    }

    /// The plant under a held command, in a number of steps, of a length in s, in a period, s.
    #[inline(always)]
    fn advance(
        &self,
        state: &mut MachineState<T>,
        command: T,
        input: &Input<T>,
        (steps, dt, period): (usize, T, T),
    ) {
        let load_step = (input.load_end - input.load) * T::splat(1.0 / steps as f64);
        let mut load = input.load;
        for index in 0..steps {
            let mut u = command;
            let substep = Substep { tick: state.tick, index, steps, dt, period };
            for (law, memory) in self.laws.iter().zip(&mut state.memory) {
                u = law.spool(memory, u, &substep);
            }
            let load_end = load + load_step;
            let drive = Drive { u, load, load_end, a_leak: input.a_leak, at: input.at };
            let acting = if self.in_balances {
                ActingLaws { laws: &self.laws, memory: &state.memory, soften: self.softens }
            } else {
                ActingLaws::NONE
            };
            let next = self.plant.stepped(&self.method, &state.plant, &drive, dt, &acting);
            if self.has_states {
                self.plant.advance_laws(&state.plant, &drive, dt, &self.laws, &mut state.memory);
            }
            state.plant = cavitation_held(&next, &mut state.clamped_pressures);
            load = load_end;
        }
        state.tick += 1;
    }
}

/// Share of a period by which a step may differ from it and be meant as one: sums of decimal fractions are off by some bits.
const SAME_PERIOD: f64 = 1e-9;

/// One machine, for other crates: compiled here, and not again where it is called.
impl Machine<f64> {
    /// One controller tick: measure, compute the command, record, and run the plant to the next tick.
    pub fn tick(&self, state: &mut MachineState<f64>, input: &Input<f64>) -> SimulatedSignals<f64> {
        self.tick_inlined(state, input)
    }

    /// The measured position at a tick: once a tick, as sensors remember.
    pub fn sense(&self, state: &mut MachineState<f64>) -> f64 {
        self.sense_inlined(state, self.period)
    }

    /// As [`sense`](Self::sense), a time after the last measurement, s.
    pub fn sense_after(&self, state: &mut MachineState<f64>, period_s: f64) -> f64 {
        self.sense_inlined(state, period_s)
    }

    /// The controller's command of a tick, for a demand and a measured position, m: once a tick.
    pub fn command(&self, state: &mut MachineState<f64>, demand_m: f64, position_m: f64) -> f64 {
        self.command_inlined(state, demand_m, position_m)
    }

    /// Flow past the piston, cap → rod, m³/s.
    pub fn leak_flow(&self, state: &MachineState<f64>, leak_area_m2: f64) -> f64 {
        self.plant.leak_flow(&state.plant, leak_area_m2)
    }

    /// The plant from one tick to the next under a held command.
    pub fn run(&self, state: &mut MachineState<f64>, command: f64, input: &Input<f64>) {
        self.advance(state, command, input, (self.steps, self.dt, self.period));
    }

    /// The plant over any time, s, under a held command, in steps that are no longer than its own: for whoever steps it from outside. One
    /// period gives the bits of [`run`](Self::run).
    pub fn run_for(&self, state: &mut MachineState<f64>, command: f64, input: &Input<f64>, over_s: f64) {
        if (over_s - self.period).abs() <= SAME_PERIOD * self.period {
            return self.run(state, command, input);
        }
        let steps = (over_s / self.dt * (1.0 - SAME_PERIOD)).ceil().max(1.0);
        self.advance(state, command, input, (steps as usize, over_s / steps, over_s));
    }
}

/// Holds each pressure at 0 or above and counts where it had to: cavitation is not modelled.
#[inline(always)]
fn cavitation_held<T: Real>(state: &State<T>, clamped: &mut u64) -> State<T> {
    let zero = T::splat(0.0);
    let lowest = state.p_s.min(state.p_3).min(state.p_1).min(state.p_2);
    let mut any = 0;
    for lane in 0..T::WIDTH {
        any += u64::from(lowest.lane(lane) < 0.0);
    }
    if any == 0 {
        return *state;
    }
    *clamped += any;
    State {
        p_s: state.p_s.max(zero),
        p_3: state.p_3.max(zero),
        p_1: state.p_1.max(zero),
        p_2: state.p_2.max(zero),
        ..*state
    }
}
