//! The planter's press: written apart from the simulator that diagnoses, so that nobody marks their own homework.
//!
//! One vector of states for plant, spool, sensor, friction and structure; Bogacki and Shampine's third-order formula (Applied Mathematics
//! Letters 2 (1989)) at 16 steps a controller period, more where thin oil makes the line between pump and valve stiff.

use std::collections::BTreeMap;

use seepd_sim::noise::Noise;
use seepd_sim::{Controller, DutyCycle, PlantParameters};

use crate::foreign::Foreign;

/// Fewest steps in a controller period; the diagnosing simulator takes 10 of fourth order.
const STEPS: usize = 16;
/// Longest step, times the fastest eigenvalue: the formula is stable to 2.51.
const STABLE: f64 = 2.2;
/// Atmospheric pressure, Pa.
const ATMOSPHERE_PA: f64 = 101_325.0;
/// Pressure difference at which flows of worn edges and leaks are stated, Pa.
const REFERENCE_PA: f64 = 7e6;
/// Speed over which friction changes sign, m/s.
const SLOW_M_PER_S: f64 = 3e-3;
/// Stiffness of the bristles of the dynamic friction law, N/m, over the friction force: they bend by 20 µm.
const BRISTLE_PER_M: f64 = 5e4;

/// Values of planted effects by effect and parameter.
pub type EffectValues = BTreeMap<String, BTreeMap<String, f64>>;

/// A machine with planted causes.
pub struct Press {
    /// Plant parameters, with the leak.
    pub plant: PlantParameters,
    /// Controller.
    pub controller: Controller,
    /// Duty cycle.
    pub cycle: DutyCycle,
    /// Planted effects.
    pub planted: EffectValues,
    /// Whether planted effects follow another law than the catalogue's, where there is one.
    pub other_law: bool,
    /// A cause without a name in the catalogue.
    pub foreign: Option<Foreign>,
}

/// What is logged at a tick, without noise.
#[derive(Debug, Clone, Copy)]
pub struct PressSample {
    /// PID valve command.
    pub command: f64,
    /// Position demand, m.
    pub demand_m: f64,
    /// Measured position, m.
    pub position_m: f64,
    /// Supply, inlet, cap and rod pressure, Pa.
    pub pressures_pa: [f64; 4],
    /// Load as recorded, N.
    pub load_n: f64,
}

/// States: four pressures, position, speed, spool and its rate, sensor, bristle, structure's deflection and its rate.
const STATES: usize = 12;
type State = [f64; STATES];
const P_S: usize = 0;
const P_3: usize = 1;
const P_1: usize = 2;
const P_2: usize = 3;
const X: usize = 4;
const V: usize = 5;
const SPOOL: usize = 6;
const SPOOL_RATE: usize = 7;
const SENSED: usize = 8;
const BRISTLE: usize = 9;
const BEND: usize = 10;
const BEND_RATE: usize = 11;

/// Cycle-to-cycle variation of a case.
#[derive(Debug, Clone, Copy, Default)]
pub struct Variation {
    /// Share by which the load varies from cycle to cycle.
    pub load: f64,
    /// Standard deviation of the time by which a cycle's strokes and loads are late or early, s.
    pub jitter_s: f64,
    /// Seed of it.
    pub seed: u64,
}

impl Press {
    /// Runs a warm-up cycle and `cycles` more and hands each logged tick to `sink`; whether all stayed finite.
    pub fn run(&self, cycles: usize, variation: Variation, mut sink: impl FnMut(PressSample)) -> bool {
        let laws = Laws::new(self);
        let planned_s = self.controller.period_s;
        let ticks = (self.cycle.period_s / planned_s).round() as usize;
        let mut noise = Noise::new(variation.seed, 7);
        let mut state = self.rest();
        let mut controller = Controlling { integral: 0.0, position: state[X] };
        let mut commands = vec![0.0; (0.05 / planned_s) as usize + 2];
        let mut play = Play { last: 0.0, offset: 0.0 };
        for cycle in 0..=cycles {
            let factor = if cycle == 0 { 1.0 } else { noise.factor(variation.load) };
            let late_s =
                if cycle == 0 || variation.jitter_s == 0.0 { 0.0 } else { noise.normal(variation.jitter_s) };
            let asked_s = |tick: usize| (tick as f64 * planned_s - late_s).max(0.0);
            let load = |tick: usize| self.cycle.load_n(asked_s(tick)) * factor;
            for tick in 0..ticks {
                let at_s = tick as f64 * planned_s;
                let demand_m = self.cycle.demand_m(asked_s(tick));
                let position_m = laws.measured(&state);
                let aim = self
                    .foreign
                    .map_or(demand_m, |foreign| foreign.demand(demand_m, self.slope(asked_s(tick))));
                let command = controller.tick(self, &laws, aim, position_m);
                if cycle > 0 {
                    let pressures_pa = [state[P_S], state[P_3], state[P_1], state[P_2]];
                    sink(PressSample { command, demand_m, position_m, pressures_pa, load_n: load(tick) });
                }
                commands.rotate_right(1);
                commands[0] = command;
                let drive = Span { at_s, load: load(tick), load_end: load(tick + 1) };
                self.advance(&mut state, &laws, &commands, &mut play, &drive);
            }
            if !state.iter().all(|value| value.is_finite()) {
                return false;
            }
        }
        true
    }

    fn slope(&self, at_s: f64) -> f64 {
        (self.cycle.demand_m(at_s + 1e-3) - self.cycle.demand_m((at_s - 1e-3).max(0.0))) / 2e-3
    }

    fn rest(&self) -> State {
        let p = &self.plant;
        let mut state = [0.0; STATES];
        let p_2 = 0.5 * p.relief_pressure_pa;
        state[P_S] = p.relief_pressure_pa;
        state[P_3] = p.relief_pressure_pa;
        state[P_2] = p_2;
        state[P_1] = (p.annulus_area_m2 * p_2 - self.cycle.load_n(0.0) * p.load_scale) / p.cap_area_m2;
        state[X] = self.cycle.start_position_m();
        state[SENSED] = state[X];
        state
    }

    /// Steps in a controller period by the fastest eigenvalue, that of supply and inlet over the line between them at rest.
    fn steps(&self, viscosity: &Viscosity, clock: f64) -> usize {
        let p = &self.plant;
        let steepest = p.line_m3_per_s_sqrt_pa / (p.transition_pressure_pa * viscosity.transition).sqrt();
        let stiffness = p.bulk_modulus_pa * (p.supply_volume_m3.recip() + p.inlet_volume_m3.recip());
        let period_s = self.controller.period_s * clock;
        STEPS.max((steepest * stiffness * period_s / STABLE).ceil() as usize)
    }

    /// The plant from a tick to the next.
    fn advance(&self, state: &mut State, laws: &Laws, commands: &[f64], play: &mut Play, drive: &Span) {
        let period_s = self.controller.period_s * laws.clock;
        let h = period_s / laws.steps as f64;
        for step in 0..laws.steps {
            let share = step as f64 / laws.steps as f64;
            // The command as it was a delay ago.
            let ago = ((laws.delay_s / period_s - share).ceil().max(0.0) as usize).min(commands.len() - 1);
            let command = play.follow(laws.quantised(commands[ago]), laws, self.other_law);
            let load_at = |share: f64| drive.load + (drive.load_end - drive.load) * share;
            let rates = |state: &State, ahead: f64| {
                let share = share + ahead / laws.steps as f64;
                let at_s = drive.at_s + share * self.controller.period_s;
                self.rates(state, laws, command, load_at(share), at_s)
            };
            let moved = |rate: &State, by: f64| -> State {
                std::array::from_fn(|index| state[index] + rate[index] * by)
            };
            let k_1 = rates(state, 0.0);
            let k_2 = rates(&moved(&k_1, 0.5 * h), 0.5);
            let k_3 = rates(&moved(&k_2, 0.75 * h), 0.75);
            let mean: State = std::array::from_fn(|i| (2.0 * k_1[i] + 3.0 * k_2[i] + 4.0 * k_3[i]) / 9.0);
            *state = moved(&mean, h);
            self.held_within(state);
        }
    }

    /// End stops, and pressures that do not fall below 0.
    fn held_within(&self, state: &mut State) {
        if (state[X] <= 0.0 && state[V] < 0.0) || (state[X] >= self.plant.stroke_m && state[V] > 0.0) {
            state[V] = 0.0;
        }
        state[X] = state[X].clamp(0.0, self.plant.stroke_m);
        for pressure in &mut state[..4] {
            *pressure = pressure.max(0.0);
        }
    }

    /// The right-hand sides.
    fn rates(&self, state: &State, laws: &Laws, command: f64, load: f64, at_s: f64) -> State {
        let p = &self.plant;
        let [p_s, p_3, p_1, p_2, x, v, ..] = *state;
        let dp_t = p.transition_pressure_pa * laws.viscosity.transition;
        let sq = |k: f64, dp: f64| k * dp / (dp * dp + dp_t * dp_t).powf(0.25);
        let (spool_rates, spool) = laws.spool(state, command, self.other_law);
        let u = spool + self.foreign.map_or(0.0, |foreign| foreign.spool(at_s));
        let u = laws.land(u, self.other_law);
        let opening = p.valve_m3_per_s_sqrt_pa * u.abs();
        let line = sq(p.line_m3_per_s_sqrt_pa, p_s - p_3);
        let relief = ((p_s - p.relief_pressure_pa) / p.relief_resistance_pa_s_per_m3).max(0.0);
        let back = self.foreign.map_or(0.0, |foreign| foreign.rod_back_pressure());
        // Flows into the chambers.
        let (into_cap, into_rod, drawn) = if u > 0.0 {
            let into = sq(opening, p_3 - p_1);
            let share = laws.cushion(p.stroke_m - x, self.other_law);
            let out = opening * share * laws.b_side * laws.return_side;
            let rod = -laws.returned(out, (p_2 - p.return_pressure_pa - back).max(0.0), self.other_law, &sq);
            (into, rod, into)
        } else {
            let into = sq(opening * laws.b_side, p_3 - p_2);
            let share = laws.cushion(x, self.other_law);
            let out = opening * share * laws.return_side;
            (-laws.returned(out, p_1 - p.return_pressure_pa, self.other_law, &sq), into, into)
        };
        let worn = laws.worn_land(u, self.other_law);
        let land = |dp: f64| sq(worn, dp);
        let thin = 1.0 / laws.viscosity.laminar;
        let seal = laws.piston_leak(p, p_1 - p_2, &sq) + (p_1 - p_2) / p.seal_resistance_pa_s_per_m3 * thin;
        let to_rod = (p_3 - p_2) / p.valve_rod_resistance_pa_s_per_m3 * thin;
        let to_return = (p_3 - p.return_pressure_pa) / p.valve_return_resistance_pa_s_per_m3 * thin;
        let supply = p.pump_flow_m3_per_s
            - line
            - relief
            - laws.pump_slip * p_s
            - laws.consumer(at_s)
            - self.foreign.map_or(0.0, |foreign| foreign.pump_loss(p_s));
        let inlet = line - drawn - to_rod - to_return - land(p_3 - p_1) - land(p_3 - p_2);
        let cap = into_cap - p.cap_area_m2 * v - seal + land(p_3 - p_1)
            - land(p_1 - p.return_pressure_pa)
            - laws.outer_leak(laws.external_cap, p_1, self.other_law);
        let rod = into_rod + p.annulus_area_m2 * v + seal + to_rod + land(p_3 - p_2)
            - land(p_2 - p.return_pressure_pa)
            - laws.outer_leak(laws.external_rod, p_2, self.other_law);
        let (friction, bristle_rate) =
            laws.friction(state, (p_1 - p_2).abs() * p.cap_area_m2, self.other_law);
        let outer = load * p.load_scale + laws.load_bias + self.foreign.map_or(0.0, |f| f.force(x, v, at_s));
        let inner = p.cap_area_m2 * p_1
            - p.annulus_area_m2 * p_2
            - p.viscous_friction_n_s_per_m * laws.viscosity.laminar * v
            - friction
            - laws.spring(x, self.other_law);
        let (acceleration, bend_acceleration) = laws.masses(state, p.mass_kg, inner, outer);
        let compliance = |volume: f64, pressure: f64| {
            volume * (1.0 / p.bulk_modulus_pa + laws.air(pressure, self.other_law))
        };
        let mut rates = [0.0; STATES];
        rates[P_S] = supply / (compliance(p.supply_volume_m3, p_s) + laws.accumulator(p_s, self.other_law));
        rates[P_3] = inlet / compliance(p.inlet_volume_m3, p_3);
        rates[P_1] = cap / compliance(p.cap_dead_volume_m3 + laws.hose_a + p.cap_area_m2 * x, p_1);
        rates[P_2] =
            rod / compliance(p.rod_dead_volume_m3 + laws.hose_b + p.annulus_area_m2 * (p.stroke_m - x), p_2);
        rates[X] = v;
        rates[V] = acceleration;
        [rates[SPOOL], rates[SPOOL_RATE]] = spool_rates;
        rates[SENSED] = laws.sensor_rate(state);
        rates[BRISTLE] = bristle_rate;
        rates[BEND] = state[BEND_RATE];
        rates[BEND_RATE] = bend_acceleration;
        rates
    }
}

/// A controller period.
struct Span {
    at_s: f64,
    load: f64,
    load_end: f64,
}

/// The PID controller's memory.
struct Controlling {
    integral: f64,
    position: f64,
}

impl Controlling {
    fn tick(&mut self, press: &Press, laws: &Laws, demand_m: f64, position_m: f64) -> f64 {
        let c = &press.controller;
        let error = demand_m - position_m;
        let increment = c.ki * laws.ki * error * c.period_s;
        let gain = press.foreign.map_or(1.0, |foreign| foreign.gain(error));
        let others =
            gain * c.kp * laws.kp * error - c.kd * laws.kd * (position_m - self.position) / c.period_s;
        self.position = position_m;
        let raw = others + self.integral + increment;
        if !(raw.abs() > 1.0 && raw * error > 0.0) {
            self.integral += increment;
        }
        if let Some(foreign) = press.foreign {
            self.integral = foreign.integral(self.integral);
        }
        (others + self.integral).clamp(-1.0, 1.0)
    }
}

/// Play between command and spool.
struct Play {
    last: f64,
    offset: f64,
}

impl Play {
    /// The command behind the play. Other law: the offset approaches the play's end exponentially (Dahl's law in the command), and at most as
    /// fast as the command goes: the spool never runs against it.
    fn follow(&mut self, command: f64, laws: &Laws, other_law: bool) -> f64 {
        let half = 0.5 * laws.hysteresis;
        let change = command - self.last;
        self.last = command;
        self.offset = if half <= 0.0 {
            0.0
        } else if other_law {
            let end = half * change.signum();
            if change == 0.0 {
                self.offset
            } else {
                end + (self.offset - end) * (-change.abs() / laws.hysteresis).exp()
            }
        } else {
            (self.offset + change).clamp(-half, half)
        };
        command - self.offset
    }
}

/// What viscosity changes.
struct Viscosity {
    laminar: f64,
    transition: f64,
}

/// The planted effects' numbers, neutral where nothing is planted.
struct Laws {
    quantum: f64,
    delay_s: f64,
    hysteresis: f64,
    rate_limit: f64,
    lag: Option<(f64, f64)>,
    bias: f64,
    deadband: f64,
    shape: f64,
    b_side: f64,
    return_side: f64,
    wear: f64,
    wear_decay: f64,
    cushion_m: f64,
    cushion_ratio: f64,
    back_pressure: f64,
    coulomb_n: f64,
    static_n: f64,
    stribeck_speed: f64,
    pressure_friction: f64,
    spring: f64,
    spring_from_m: f64,
    load_bias: f64,
    compliance: Option<(f64, f64)>,
    external_cap: f64,
    external_rod: f64,
    leak_exponent: f64,
    air: f64,
    hose_a: f64,
    hose_b: f64,
    viscosity: Viscosity,
    pump_slip: f64,
    gas: Option<(f64, f64)>,
    consumer: Option<(f64, f64, f64)>,
    scale: f64,
    sine: Option<(f64, f64)>,
    sensor_s: f64,
    sensor_step: f64,
    kp: f64,
    ki: f64,
    kd: f64,
    clock: f64,
    /// Steps in a controller period.
    steps: usize,
    orifice: f64,
}

impl Laws {
    fn new(press: &Press) -> Self {
        let given = |effect: &str, parameter: &str| {
            press.planted.get(effect).and_then(|values| values.get(parameter)).copied()
        };
        let of = |effect: &str, parameter: &str| given(effect, parameter).unwrap_or(0.0);
        let factor = |effect: &str, parameter: &str| given(effect, parameter).unwrap_or(1.0);
        let pair = |effect: &str, a: &str, b: &str| given(effect, a).zip(given(effect, b));
        let thick = factor("oil_viscosity", "factor");
        let viscosity = Viscosity {
            laminar: thick,
            // Other law: orifices stay as they are.
            transition: if press.other_law { 1.0 } else { thick * thick },
        };
        let clock = given("controller_clock", "period_s").map_or(1.0, |period| period / 1e-3);
        let steps = press.steps(&viscosity, clock);
        let p = &press.plant;
        Laws {
            quantum: of("command_quantisation", "step"),
            delay_s: of("command_delay", "delay_s"),
            hysteresis: of("valve_hysteresis", "width"),
            rate_limit: given("valve_rate_limit", "rate_per_s").unwrap_or(f64::INFINITY),
            lag: pair("valve_lag", "natural_frequency_hz", "damping"),
            bias: of("valve_bias", "offset"),
            deadband: of("valve_deadband", "half_width"),
            shape: factor("valve_flow_shape", "exponent"),
            b_side: factor("valve_asymmetry", "b_side_ratio"),
            return_side: factor("valve_asymmetry", "return_ratio"),
            wear: of("valve_wear", "land_flow_m3_per_s") / REFERENCE_PA.sqrt(),
            wear_decay: given("valve_wear", "decay_command").unwrap_or(0.05),
            cushion_m: of("cushioning", "length_m"),
            cushion_ratio: factor("cushioning", "flow_ratio"),
            back_pressure: of("return_back_pressure", "k_pa_s2_per_m6"),
            coulomb_n: of("coulomb_friction", "force_n") + of("stribeck_friction", "force_n"),
            static_n: of("stribeck_friction", "static_force_n"),
            stribeck_speed: given("stribeck_friction", "stribeck_speed_m_per_s").unwrap_or(0.05),
            pressure_friction: of("pressure_friction", "coefficient"),
            spring: of("spring_load", "stiffness_n_per_m"),
            spring_from_m: of("spring_load", "neutral_position_m"),
            load_bias: of("load_bias", "force_n"),
            compliance: pair("structure_compliance", "stiffness_n_per_m", "mass_fraction"),
            external_cap: of("external_leak", "cap_m3_per_s_pa"),
            external_rod: of("external_leak", "rod_m3_per_s_pa"),
            leak_exponent: given("turbulent_leak", "exponent").unwrap_or(0.5),
            air: of("entrained_air", "fraction"),
            hose_a: of("hose_volume", "a_m3"),
            hose_b: of("hose_volume", "b_m3"),
            viscosity,
            pump_slip: of("pump_slip", "leakage_m3_per_s_pa"),
            gas: pair("accumulator", "volume_m3", "precharge_pa"),
            consumer: pair("shared_supply", "flow_m3_per_s", "start_s")
                .map(|(flow, start)| (flow, start, of("shared_supply", "duration_s"))),
            scale: factor("position_scale", "factor"),
            sine: pair("position_sine", "amplitude_m", "pitch_m"),
            sensor_s: of("position_lag", "time_constant_s"),
            sensor_step: of("position_quantisation", "step_m"),
            kp: factor("controller_gains", "kp"),
            ki: factor("controller_gains", "ki"),
            kd: factor("controller_gains", "kd"),
            clock,
            steps,
            orifice: p.discharge_coefficient * p.leak_area_m2 * (2.0 / p.density_kg_per_m3).sqrt(),
        }
    }

    fn quantised(&self, command: f64) -> f64 {
        if self.quantum > 0.0 { (command / self.quantum).round() * self.quantum } else { command }
    }

    /// Rates of spool position and speed, and the spool's position. Other law of the lag: first order, of the same delay.
    fn spool(&self, state: &State, command: f64, other_law: bool) -> ([f64; 2], f64) {
        if let Some((hz, damping)) = self.lag {
            let omega = std::f64::consts::TAU * hz;
            if other_law {
                return ([(command - state[SPOOL]) * omega / (2.0 * damping), 0.0], state[SPOOL]);
            }
            let pull = omega * omega * (command - state[SPOOL]) - 2.0 * damping * omega * state[SPOOL_RATE];
            return ([state[SPOOL_RATE], pull], state[SPOOL]);
        }
        if self.rate_limit.is_finite() {
            // A stiff follower within the limit.
            let rate = ((command - state[SPOOL]) * 5e3).clamp(-self.rate_limit, self.rate_limit);
            return ([rate, 0.0], state[SPOOL]);
        }
        ([0.0, 0.0], command)
    }

    /// What the lands make of a spool position. Other laws: a dead band with soft edges; a quadratic characteristic.
    fn land(&self, spool: f64, other_law: bool) -> f64 {
        let biased = spool + self.bias;
        let size = biased.abs();
        let beyond = if self.deadband <= 0.0 {
            size
        } else if other_law {
            let soft = 0.2 * self.deadband;
            let edge = |at: f64| soft * ((at / soft).exp().ln_1p());
            (edge(size - self.deadband) - edge(-self.deadband)).max(0.0)
        } else {
            (size - self.deadband).max(0.0)
        };
        let shaped = if other_law {
            beyond * (1.0 + (self.shape - 1.0) * (beyond - 1.0))
        } else if beyond > 1e-4 {
            beyond.powf(self.shape)
        } else {
            beyond * 1e-4_f64.powf(self.shape - 1.0)
        };
        shaped * biased.signum()
    }

    /// Share of the outlet that a cushion leaves. Other law: a taper that closes with the square.
    fn cushion(&self, distance_m: f64, other_law: bool) -> f64 {
        if self.cushion_m <= 0.0 {
            return 1.0;
        }
        let way = (distance_m / self.cushion_m).clamp(0.0, 1.0);
        self.cushion_ratio + (1.0 - self.cushion_ratio) * if other_law { way * way } else { way }
    }

    /// Flow through the outlet with the return line behind it. Other law: a line whose pressure goes with the flow.
    fn returned(&self, k: f64, dp: f64, other_law: bool, sq: &dyn Fn(f64, f64) -> f64) -> f64 {
        if self.back_pressure <= 0.0 {
            return sq(k, dp);
        }
        if other_law {
            let line = self.back_pressure * 5e-4;
            let k_2 = k * k;
            let root = (k_2 * k_2 * line * line + 4.0 * k_2 * dp.abs()).sqrt();
            return dp.signum() * 0.5 * (root - k_2 * line);
        }
        sq(k / (1.0 + self.back_pressure * k * k).sqrt(), dp)
    }

    /// Coefficient of the worn lands. Other law: it decays with the square of the spool's position.
    fn worn_land(&self, spool: f64, other_law: bool) -> f64 {
        let at = spool.abs() / self.wear_decay;
        self.wear * if other_law { (-at * at).exp() } else { (-at).exp() }
    }

    /// Flow past the piston.
    fn piston_leak(&self, p: &PlantParameters, dp: f64, sq: &dyn Fn(f64, f64) -> f64) -> f64 {
        if self.leak_exponent == 0.5 {
            return sq(self.orifice, dp);
        }
        let ratio = (dp * dp + p.transition_pressure_pa.powi(2)).sqrt() / REFERENCE_PA;
        self.orifice * REFERENCE_PA.sqrt() * ratio.powf(self.leak_exponent - 1.0) * dp / REFERENCE_PA
    }

    /// Leak to ambient. Other law: an orifice of the same flow at 7 MPa.
    fn outer_leak(&self, coefficient: f64, pressure: f64, other_law: bool) -> f64 {
        let pressure = pressure.max(0.0);
        if other_law { coefficient * (pressure * REFERENCE_PA).sqrt() } else { coefficient * pressure }
    }

    /// Friction force and the bristle's rate. Other law: bristles that bend (Canudas de Wit et al., IEEE Transactions on Automatic Control
    /// 40 (1995)), with static friction that falls with the speed instead of its square.
    fn friction(&self, state: &State, pressure_force: f64, other_law: bool) -> (f64, f64) {
        let v = state[V];
        let fall = (v / self.stribeck_speed).abs();
        let peak = (self.static_n - self.coulomb_n).max(0.0);
        let by_pressure = self.pressure_friction * pressure_force;
        let size = self.coulomb_n + peak * (-if other_law { fall } else { fall * fall }).exp() + by_pressure;
        if !other_law {
            return (size * (v / SLOW_M_PER_S).tanh(), 0.0);
        }
        // In units of the friction force, so that it needs no division where nothing is planted.
        let rate = BRISTLE_PER_M * (v - v.abs() * state[BRISTLE]);
        (size * (state[BRISTLE] + 2e-3 * rate / (1.0 + v.abs() / SLOW_M_PER_S)), rate)
    }

    /// Other law: a spring that hardens.
    fn spring(&self, x: f64, other_law: bool) -> f64 {
        let way = x - self.spring_from_m;
        self.spring * way * if other_law { 1.0 + (way / 0.4).powi(2) } else { 1.0 }
    }

    /// Accelerations of the piston and of the load beyond it.
    fn masses(&self, state: &State, mass_kg: f64, inner: f64, outer: f64) -> (f64, f64) {
        let Some((stiffness, fraction)) = self.compliance else { return ((inner + outer) / mass_kg, 0.0) };
        let (near, far) = (mass_kg * (1.0 - fraction), mass_kg * fraction);
        let held = stiffness * state[BEND] + 0.1 * (stiffness * far).sqrt() * state[BEND_RATE];
        let piston = (inner + held) / near;
        (piston, (outer - held) / far - piston)
    }

    /// Compliance of free air, 1/Pa. Other law: isothermal.
    fn air(&self, pressure: f64, other_law: bool) -> f64 {
        let p = pressure + ATMOSPHERE_PA;
        self.air * ATMOSPHERE_PA / (p * p) / if other_law { 1.0 } else { 1.2 }
    }

    /// Compliance of the accumulator, m³/Pa. Other law: isothermal.
    fn accumulator(&self, pressure: f64, other_law: bool) -> f64 {
        let Some((volume, precharge)) = self.gas.filter(|(volume, _)| *volume > 0.0) else { return 0.0 };
        let (p, p_0) = (pressure + ATMOSPHERE_PA, precharge + ATMOSPHERE_PA);
        let exponent = if other_law { 1.0 } else { 1.3 };
        if p > p_0 { volume * (p_0 / p).powf(1.0 / exponent) / (exponent * p) } else { 0.0 }
    }

    /// Flow of another consumer, with soft ramps of 50 ms.
    fn consumer(&self, at_s: f64) -> f64 {
        let Some((flow, start, duration)) = self.consumer else { return 0.0 };
        let ramp = |since: f64| 0.5 - 0.5 * (std::f64::consts::PI * (since / 0.05).clamp(0.0, 1.0)).cos();
        flow * ramp(at_s - start) * (1.0 - ramp(at_s - start - duration))
    }

    /// What the position sensor's electronics see.
    fn scaled(&self, x: f64) -> f64 {
        let ripple =
            self.sine.map_or(0.0, |(amplitude, pitch)| amplitude * (std::f64::consts::TAU * x / pitch).sin());
        self.scale * x + ripple
    }

    fn sensor_rate(&self, state: &State) -> f64 {
        if self.sensor_s > 0.0 { (self.scaled(state[X]) - state[SENSED]) / self.sensor_s } else { 0.0 }
    }

    fn measured(&self, state: &State) -> f64 {
        let seen = if self.sensor_s > 0.0 { state[SENSED] } else { self.scaled(state[X]) };
        if self.sensor_step > 0.0 { (seen / self.sensor_step).round() * self.sensor_step } else { seen }
    }
}
