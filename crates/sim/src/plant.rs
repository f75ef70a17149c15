//! The hydraulic plant: pump, relief valve, line, 4/3 proportional valve, single-rod cylinder, load mass.
//!
//! Source: the article's equations (1)–(5). What its print has wrong, and what stands here instead:
//! 1. (2), (3): the rod chamber's flow is printed as k_v √(2 (P2 − P1)/ρ); it goes to the return line, P2 → Pr.
//! 2. (3): printed with −(A_p − A_rod) v_p; extension *compresses* the rod chamber, so + A_ann v.
//! 3. (1)–(5) know extension only; the retract direction follows by symmetry of the 4/3 valve.
//! 4. The chamber volumes are printed as one constant; they depend on the position.
//! 5. (1): P_prv, a pressure, stands where a flow belongs: it is the relief *flow*.
//! 6. The square roots have no sign and an infinite slope at 0: regularised below `dp_t`.
//! 7. (3) and (4) give one R_vlv for two different paths: two parameters here.
//! 8. The text's "maximum leakage 0.6 lpm" cannot go with areas up to 1e-5 m²: at 7 MPa that area passes
//!    about 53 L/min, and 0.6 L/min is 1.1e-7 m². Area and flow at a stated pressure are always given together.
//! 9. The filter's Q = 0.001, R = 5 give a steady gain of 0.01404: a low-pass of about 70 ms at 1 kHz.
//!
//! With the default supply the relief valve never closes, so the pump's flow and the relief valve's two
//! parameters act as one number.

use nalgebra::{Complex, Matrix6, Schur, Vector6};
use serde::{Deserialize, Serialize};

use crate::cycle::RunStart;
use crate::effects::{Law, Moment, Openings, Softening, Terms};
use crate::integration::Method;
use crate::real::Real;

/// Iterations within which the eigenvalues of six states are found: some dozen are usual.
const MOST_ITERATIONS: usize = 10_000;
/// Share of the stroke within which a standing piston stands at its end.
const AT_ITS_END: f64 = 0.01;

/// What a plant parameter is: for files, reports, calibration and the variation of simulated machines.
#[derive(Debug, Clone, Copy)]
pub struct ParameterInfo {
    /// Key in `plant.toml` and field of [`PlantParameters`].
    pub key: &'static str,
    /// Symbol in the equations; accepted as a key as well.
    pub symbol: &'static str,
    /// SI unit; "1" for shares.
    pub unit: &'static str,
    /// What it is, in a phrase with its unit.
    pub description: &'static str,
    /// Smallest admitted value.
    pub minimum: f64,
}

macro_rules! plant_parameters {
    ($(#[doc = $doc:literal] $key:ident, $symbol:literal, $unit:literal, $default:expr, min $minimum:expr;)*) => {
        /// The plant's parameters: the `[plant]` table of `plant.toml`. A field's symbol is an alias of its key.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct PlantParameters {
            $(#[doc = $doc] #[serde(alias = $symbol)] pub $key: f64,)*
        }

        impl Default for PlantParameters {
            fn default() -> Self {
                PlantParameters { $($key: $default,)* }
            }
        }

        impl PlantParameters {
            /// Every parameter, in the order of the file.
            pub const ALL: &'static [ParameterInfo] = &[
                $(ParameterInfo {
                    key: stringify!($key),
                    symbol: $symbol,
                    unit: $unit,
                    description: $doc.trim_ascii(),
                    minimum: $minimum,
                },)*
            ];

            /// The parameter of that key or symbol.
            pub fn get(&self, name: &str) -> Option<f64> {
                $(if name == stringify!($key) || name == $symbol { return Some(self.$key); })*
                None
            }

            /// Access for change to the parameter of that key or symbol.
            pub fn get_mut(&mut self, name: &str) -> Option<&mut f64> {
                $(if name == stringify!($key) || name == $symbol { return Some(&mut self.$key); })*
                None
            }
        }
    };
}

/// Smallest value of a parameter that must be positive.
const POSITIVE: f64 = f64::MIN_POSITIVE;

plant_parameters! {
    /// Oil density, kg/m³.
    density_kg_per_m3, "rho", "kg/m3", 870.0, min POSITIVE;
    /// Effective bulk modulus, Pa.
    bulk_modulus_pa, "beta", "Pa", 1.2e9, min POSITIVE;
    /// Pump flow, m³/s.
    pump_flow_m3_per_s, "Q_pump", "m3/s", 1.5e-3, min 0.0;
    /// Volume of the supply node, m³.
    supply_volume_m3, "V_s", "m3", 2e-3, min POSITIVE;
    /// Volume between line and valve, m³.
    inlet_volume_m3, "V_3", "m3", 4e-4, min POSITIVE;
    /// Relief valve's opening pressure, Pa.
    relief_pressure_pa, "p_prv", "Pa", 16e6, min 0.0;
    /// Relief valve's slope, Pa s/m³.
    relief_resistance_pa_s_per_m3, "R_prv", "Pa s/m3", 5e8, min POSITIVE;
    /// Return line's pressure, Pa.
    return_pressure_pa, "p_r", "Pa", 1e5, min 0.0;
    /// Line coefficient, m³/s/√Pa.
    line_m3_per_s_sqrt_pa, "k_line", "m3/s/sqrt(Pa)", 6e-5 * (2.0f64 / 870.0).sqrt(), min POSITIVE;
    /// Valve coefficient at full command, m³/s/√Pa.
    valve_m3_per_s_sqrt_pa, "k_v", "m3/s/sqrt(Pa)", 1.6e-3 / 3.5e6f64.sqrt(), min POSITIVE;
    /// Piston area on the cap side, m².
    cap_area_m2, "A_cap", "m2", 3.117e-3, min POSITIVE;
    /// Annulus area on the rod side, m².
    annulus_area_m2, "A_ann", "m2", 2.099e-3, min POSITIVE;
    /// Stroke, m.
    stroke_m, "L", "m", 0.5, min POSITIVE;
    /// Cap chamber's volume at position 0, m³.
    cap_dead_volume_m3, "V_01", "m3", 2e-4, min POSITIVE;
    /// Rod chamber's volume at full stroke, m³.
    rod_dead_volume_m3, "V_02", "m3", 2e-4, min POSITIVE;
    /// Moved mass, kg.
    mass_kg, "M", "kg", 250.0, min POSITIVE;
    /// Viscous friction, N s/m.
    viscous_friction_n_s_per_m, "b_v", "N s/m", 6000.0, min 0.0;
    /// Laminar resistance of a healthy piston seal, Pa s/m³.
    seal_resistance_pa_s_per_m3, "R_cyl", "Pa s/m3", 1e13, min POSITIVE;
    /// Laminar resistance valve inlet → return, Pa s/m³.
    valve_return_resistance_pa_s_per_m3, "R_vlv", "Pa s/m3", 1e12, min POSITIVE;
    /// Laminar resistance valve inlet → rod port, Pa s/m³.
    valve_rod_resistance_pa_s_per_m3, "R_vlv2", "Pa s/m3", 1e12, min POSITIVE;
    /// Discharge coefficient of the leak, 1.
    discharge_coefficient, "C_d", "1", 0.7, min POSITIVE;
    /// Pressure difference below which the square-root law is linear, Pa.
    transition_pressure_pa, "dp_t", "Pa", 2e5, min POSITIVE;
    /// Leak area past the piston seal, m².
    leak_area_m2, "A_leak", "m2", 0.0, min 0.0;
    /// True force over recorded load, 1.
    load_scale, "load_scale", "1", 1.0, min 0.0;
}

impl PlantParameters {
    /// Flow of a sharp-edged orifice of that area, m³/s: `C_d A √(2 Δp / ρ)` (article, equation (6)).
    /// Reported leak flows are this at a reference pressure difference.
    pub fn orifice_flow_m3_per_s(&self, area_m2: f64, pressure_difference_pa: f64) -> f64 {
        self.discharge_coefficient * area_m2 * (2.0 * pressure_difference_pa / self.density_kg_per_m3).sqrt()
    }

    /// The fastest eigenvalue at standstill, 1/s: of the linearised plant with no flow and the piston at
    /// either end, where the line's small volume meets the square-root law's steepest slope.
    pub fn fastest_eigenvalue_per_s(&self) -> f64 {
        Plant::<f64>::new(&[self]).motion().fastest_per_s
    }
}

/// The plant with its derived coefficients, of one machine or of several in lanes.
#[derive(Debug, Clone)]
pub struct Plant<T> {
    pub(crate) beta: T,
    pub(crate) q_pump: T,
    pub(crate) beta_over_v_s: T,
    pub(crate) beta_over_v_3: T,
    pub(crate) p_prv: T,
    pub(crate) g_prv: T,
    pub(crate) p_r: T,
    pub(crate) k_line: T,
    pub(crate) k_v: T,
    pub(crate) a_cap: T,
    pub(crate) a_ann: T,
    pub(crate) stroke: T,
    pub(crate) v_01: T,
    pub(crate) v_02: T,
    pub(crate) mass_inverse: T,
    pub(crate) b_v: T,
    pub(crate) g_cyl: T,
    pub(crate) g_vlv: T,
    pub(crate) g_vlv2: T,
    pub(crate) dp_t_squared: T,
    pub(crate) k_leak_per_area: T,
    pub(crate) load_scale: T,
}

/// The plant's states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State<T> {
    /// Supply pressure, Pa.
    pub p_s: T,
    /// Valve inlet pressure, Pa.
    pub p_3: T,
    /// Cap chamber's pressure, Pa.
    pub p_1: T,
    /// Rod chamber's pressure, Pa.
    pub p_2: T,
    /// Position, m; 0 is fully retracted.
    pub x: T,
    /// Velocity, m/s.
    pub v: T,
}

impl<T: Real> State<T> {
    /// `self + rate · h`, state by state.
    #[inline(always)]
    pub(crate) fn advanced(&self, rate: &State<T>, h: T) -> State<T> {
        State {
            p_s: self.p_s + rate.p_s * h,
            p_3: self.p_3 + rate.p_3 * h,
            p_1: self.p_1 + rate.p_1 * h,
            p_2: self.p_2 + rate.p_2 * h,
            x: self.x + rate.x * h,
            v: self.v + rate.v * h,
        }
    }

    /// Every state that many times.
    #[inline(always)]
    pub(crate) fn times(&self, factor: T) -> State<T> {
        State {
            p_s: self.p_s * factor,
            p_3: self.p_3 * factor,
            p_1: self.p_1 * factor,
            p_2: self.p_2 * factor,
            x: self.x * factor,
            v: self.v * factor,
        }
    }

    /// Pressures, position and velocity as an array, in the order of the fields.
    pub fn to_array(self) -> [T; 6] {
        [self.p_s, self.p_3, self.p_1, self.p_2, self.x, self.v]
    }

    /// The inverse of [`State::to_array`].
    pub fn from_array([p_s, p_3, p_1, p_2, x, v]: [T; 6]) -> Self {
        State { p_s, p_3, p_1, p_2, x, v }
    }
}

/// What acts on the plant from outside during one step.
#[derive(Debug, Clone, Copy)]
pub struct Drive<T> {
    /// Spool position, share of full opening, −1 … 1.
    pub u: T,
    /// Load force at the step's start, N.
    pub load: T,
    /// Load force at the step's end, N; linear between.
    pub load_end: T,
    /// Leak area, m².
    pub a_leak: T,
    /// Time in the duty cycle, s.
    pub at: T,
}

impl<T: Real> Drive<T> {
    /// The load at a share of the step.
    #[inline(always)]
    pub(crate) fn load_at(&self, share: f64) -> T {
        self.load + (self.load_end - self.load) * T::splat(share)
    }

    /// The plant in that state under this drive.
    #[inline(always)]
    fn moment<'a>(&self, plant: &'a Plant<T>, state: &'a State<T>, load: T) -> Moment<'a, T> {
        Moment { state, plant, spool: self.u, load, a_leak: self.a_leak, at: self.at }
    }
}

/// The laws that act within the plant's equations, with their memories.
pub(crate) struct ActingLaws<'a, T: Real> {
    pub(crate) laws: &'a [Box<dyn Law<T>>],
    pub(crate) memory: &'a [Vec<T>],
    /// Whether one of them softens volumes.
    pub(crate) soften: bool,
}

impl<T: Real> ActingLaws<'_, T> {
    /// Those of a plant without any.
    pub(crate) const NONE: Self = ActingLaws { laws: &[], memory: &[], soften: false };
}

/// `k · dp / (dp² + dp_t²)^¼`: the signed square-root law, linear below `dp_t`.
#[inline(always)]
pub(crate) fn sq<T: Real>(k: T, dp: T, dp_t_squared: T) -> T {
    k * dp * (dp * dp + dp_t_squared).reciprocal_fourth_root()
}

impl<T: Real> Plant<T> {
    /// Gathers one machine a lane.
    ///
    /// `machines` has one entry for each lane; a shorter slice repeats its last entry.
    ///
    /// # Panics
    /// Where `machines` is empty.
    pub fn new(machines: &[&PlantParameters]) -> Self {
        let each = |value: &dyn Fn(&PlantParameters) -> f64| {
            T::from_lanes(|lane| value(machines[lane.min(machines.len() - 1)]))
        };
        Plant {
            beta: each(&|p| p.bulk_modulus_pa),
            q_pump: each(&|p| p.pump_flow_m3_per_s),
            beta_over_v_s: each(&|p| p.bulk_modulus_pa / p.supply_volume_m3),
            beta_over_v_3: each(&|p| p.bulk_modulus_pa / p.inlet_volume_m3),
            p_prv: each(&|p| p.relief_pressure_pa),
            g_prv: each(&|p| 1.0 / p.relief_resistance_pa_s_per_m3),
            p_r: each(&|p| p.return_pressure_pa),
            k_line: each(&|p| p.line_m3_per_s_sqrt_pa),
            k_v: each(&|p| p.valve_m3_per_s_sqrt_pa),
            a_cap: each(&|p| p.cap_area_m2),
            a_ann: each(&|p| p.annulus_area_m2),
            stroke: each(&|p| p.stroke_m),
            v_01: each(&|p| p.cap_dead_volume_m3),
            v_02: each(&|p| p.rod_dead_volume_m3),
            mass_inverse: each(&|p| 1.0 / p.mass_kg),
            b_v: each(&|p| p.viscous_friction_n_s_per_m),
            g_cyl: each(&|p| 1.0 / p.seal_resistance_pa_s_per_m3),
            g_vlv: each(&|p| 1.0 / p.valve_return_resistance_pa_s_per_m3),
            g_vlv2: each(&|p| 1.0 / p.valve_rod_resistance_pa_s_per_m3),
            dp_t_squared: each(&|p| p.transition_pressure_pa * p.transition_pressure_pa),
            k_leak_per_area: each(&|p| p.discharge_coefficient * (2.0 / p.density_kg_per_m3).sqrt()),
            load_scale: each(&|p| p.load_scale),
        }
    }

    /// The state in which a machine is switched on: at rest at `x`, supply at the relief pressure, rod
    /// chamber at half of it, cap chamber in balance with the load.
    pub fn rest(&self, x: T, load: T) -> State<T> {
        let p_2 = self.p_prv * T::splat(0.5);
        let p_1 = (self.a_ann * p_2 - load * self.load_scale) / self.a_cap;
        State { p_s: self.p_prv, p_3: self.p_prv, p_1, p_2, x, v: T::splat(0.0) }
    }

    /// The state in which a recorded run begins, with the supply at the relief pressure. A pressure that nobody recorded is that of a
    /// piston which the valve has held against its end, or else what balances the other and the load.
    pub(crate) fn standing(&self, start: &RunStart, load: T) -> State<T> {
        let x = T::splat(start.position_m).max(T::splat(0.0)).min(self.stroke);
        let rest = self.rest(x, load);
        let near_end = self.stroke * T::splat(AT_ITS_END);
        let (from_low, from_high) = (near_end - x, x - (self.stroke - near_end));
        let load = load * self.load_scale;
        let at_ends = |low: T, high: T, between: T| {
            from_low.where_positive(low, from_high.where_positive(high, between))
        };
        let of_cap = |p_rod: T| at_ends(self.p_r, self.p_prv, (self.a_ann * p_rod - load) / self.a_cap);
        let of_rod = |p_cap: T| at_ends(self.p_prv, self.p_r, (self.a_cap * p_cap + load) / self.a_ann);
        let [p_cap, p_rod] = [start.p_cap_pa, start.p_rod_pa].map(|pressure| pressure.map(T::splat));
        let p_1 = p_cap.unwrap_or_else(|| of_cap(p_rod.unwrap_or(rest.p_2)));
        State { p_1, p_2: p_rod.unwrap_or_else(|| of_rod(p_1)), ..rest }
    }

    /// Flow past the piston, cap → rod, m³/s: leak orifice plus the healthy seal's laminar gap.
    #[inline(always)]
    pub fn leak_flow(&self, state: &State<T>, a_leak: T) -> T {
        let dp = state.p_1 - state.p_2;
        sq(self.k_leak_per_area * a_leak, dp, self.dp_t_squared) + dp * self.g_cyl
    }

    /// The valve's coefficient at both ports, without laws, m³/s/√Pa.
    #[inline(always)]
    fn planned_openings(&self, spool: T) -> Openings<T> {
        let opening = self.k_v * spool.abs();
        Openings { cap: opening, rod: opening }
    }

    /// The balances of the nominal plant: net flows into the four volumes, net force on the mass.
    #[inline(always)]
    fn balances(&self, moment: &Moment<'_, T>, openings: &Openings<T>) -> Terms<T> {
        let State { p_s, p_3, p_1, p_2, v, .. } = *moment.state;
        let u = moment.spool;
        let zero = T::splat(0.0);

        let q_line = sq(self.k_line, p_s - p_3, self.dp_t_squared);
        let q_prv = ((p_s - self.p_prv) * self.g_prv).max(zero);

        // Extending, the cap port meets the inlet and the rod port the return; retracting the other way.
        // The law is odd in dp, so that flow out is flow in at the negated difference.
        let q_1 = sq(openings.cap, u.where_positive(p_3 - p_1, self.p_r - p_1), self.dp_t_squared);
        let q_2 = sq(openings.rod, u.where_positive(self.p_r - p_2, p_3 - p_2), self.dp_t_squared);
        let q_in = u.where_positive(q_1, q_2);

        let q_leak = self.leak_flow(moment.state, moment.a_leak);
        let q_32 = (p_3 - p_2) * self.g_vlv2;
        let q_3r = (p_3 - self.p_r) * self.g_vlv;

        Terms {
            supply_flow: self.q_pump - q_line - q_prv,
            inlet_flow: q_line - q_in - q_3r - q_32,
            cap_flow: q_1 - self.a_cap * v - q_leak,
            rod_flow: q_2 + self.a_ann * v + q_leak + q_32,
            force: self.a_cap * p_1 - self.a_ann * p_2 - self.b_v * v + moment.load * self.load_scale,
        }
    }

    /// The balances with what the laws change.
    #[inline(always)]
    fn balances_with(&self, moment: &Moment<'_, T>, acting: &ActingLaws<'_, T>) -> Terms<T> {
        let mut openings = self.planned_openings(moment.spool);
        for law in acting.laws {
            law.open(moment, &mut openings);
        }
        let mut terms = self.balances(moment, &openings);
        for (law, memory) in acting.laws.iter().zip(acting.memory) {
            law.act(memory, moment, &mut terms);
        }
        terms
    }

    /// Rates of the six states from the balances.
    #[inline(always)]
    fn rates_of(&self, state: &State<T>, terms: &Terms<T>) -> State<T> {
        // One division for both chambers.
        let v_1 = self.v_01 + self.a_cap * state.x;
        let v_2 = self.v_02 + self.a_ann * (self.stroke - state.x);
        let beta_over_both = self.beta / (v_1 * v_2);
        State {
            p_s: self.beta_over_v_s * terms.supply_flow,
            p_3: self.beta_over_v_3 * terms.inlet_flow,
            p_1: beta_over_both * v_2 * terms.cap_flow,
            p_2: beta_over_both * v_1 * terms.rod_flow,
            x: state.v,
            v: self.held_by_stops(state.x, self.mass_inverse * terms.force),
        }
    }

    /// The acceleration with what an end stop takes of it: a piston that is pressed against its end stands, and displaces no oil.
    #[inline(always)]
    fn held_by_stops(&self, x: T, acceleration: T) -> T {
        let zero = T::splat(0.0);
        let outwards = x.where_positive(acceleration, acceleration.max(zero));
        (self.stroke - x).where_positive(outwards, outwards.min(zero))
    }

    /// The equations: rates of the six states.
    #[inline(always)]
    fn rates(&self, moment: &Moment<'_, T>, acting: &ActingLaws<'_, T>) -> State<T> {
        if acting.laws.is_empty() {
            // Nothing here is handed to a law by reference, so that all of it stays in registers.
            return self.rates_of(moment.state, &self.balances(moment, &self.planned_openings(moment.spool)));
        }
        let rates = self.rates_of(moment.state, &self.balances_with(moment, acting));
        if !acting.soften {
            return rates;
        }
        let one = T::splat(1.0);
        let mut softening = Softening { supply: one, inlet: one, cap: one, rod: one };
        for law in acting.laws {
            law.soften(moment, &mut softening);
        }
        State {
            p_s: rates.p_s / softening.supply,
            p_3: rates.p_3 / softening.inlet,
            p_1: rates.p_1 / softening.cap,
            p_2: rates.p_2 / softening.rod,
            ..rates
        }
    }

    /// Advances the laws' own states over a step that begins at `state`.
    #[inline(always)]
    pub(crate) fn advance_laws(
        &self,
        state: &State<T>,
        drive: &Drive<T>,
        dt: T,
        laws: &[Box<dyn Law<T>>],
        memory: &mut [Vec<T>],
    ) {
        let moment = drive.moment(self, state, drive.load);
        let terms = self.balances_with(&moment, &ActingLaws { laws, memory, soften: false });
        for (law, memory) in laws.iter().zip(memory) {
            law.advance(memory, &moment, &terms, dt);
        }
    }

    /// Rates at a state under a load. No closure: only a function can be asked into the lanes' loop, whose instructions it must have.
    #[inline(always)]
    pub(crate) fn rates_at(
        &self,
        at: &State<T>,
        load: T,
        drive: &Drive<T>,
        acting: &ActingLaws<'_, T>,
    ) -> State<T> {
        self.rates(&drive.moment(self, at, load), acting)
    }

    /// One RK4 step of the plant alone, without effects; for tests and benches of the equations.
    pub fn step(&self, state: &State<T>, drive: &Drive<T>, dt: T) -> State<T> {
        self.stepped(&Method::RungeKutta4, state, drive, dt, &ActingLaws::NONE)
    }

    /// The inelastic end stops: driven into one, the piston stands there.
    #[inline(always)]
    pub(crate) fn stopped(&self, state: &State<T>) -> State<T> {
        let zero = T::splat(0.0);
        let beyond = state.x - self.stroke;
        let v = (-state.x).where_positive(state.v.max(zero), state.v);
        State { x: state.x.max(zero).min(self.stroke), v: beyond.where_positive(v.min(zero), v), ..*state }
    }
}

/// How a plant moves by itself at standstill, with the piston at either end; infinite where the plant's numbers overflow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Motion {
    /// Largest magnitude of an eigenvalue, 1/s.
    pub(crate) fastest_per_s: f64,
    /// Largest angular frequency, 1/s.
    pub(crate) oscillation_per_s: f64,
}

impl Plant<f64> {
    pub(crate) fn motion(&self) -> Motion {
        let mut motion = Motion { fastest_per_s: 0.0, oscillation_per_s: 0.0 };
        for x in [0.0, self.stroke] {
            let Some(eigenvalues) = self.eigenvalues_at_standstill(x) else {
                return Motion { fastest_per_s: f64::INFINITY, oscillation_per_s: f64::INFINITY };
            };
            for value in &eigenvalues {
                motion.fastest_per_s = motion.fastest_per_s.max(value.norm());
                motion.oscillation_per_s = motion.oscillation_per_s.max(value.im);
            }
        }
        motion
    }

    /// Of the plant linearised at standstill with the valve closed and no flow (every pressure the return's); none where its numbers
    /// overflow.
    fn eigenvalues_at_standstill(&self, x: f64) -> Option<Vector6<Complex<f64>>> {
        let at = State { p_s: self.p_r, p_3: self.p_r, p_1: self.p_r, p_2: self.p_r, x, v: 0.0 }.to_array();
        // Differences small against dp_t, so that the law is at its steepest; exact for the linear terms.
        let step = [1e2, 1e2, 1e2, 1e2, 1e-6, 1e-6];
        let jacobian = Matrix6::from_fn(|row, column| {
            let rate = |sign: f64| {
                let mut moved = at;
                moved[column] += sign * step[column];
                let drive = Drive { u: 0.0, load: 0.0, load_end: 0.0, a_leak: 0.0, at: 0.0 };
                let state = State::from_array(moved);
                self.rates(&drive.moment(self, &state, 0.0), &ActingLaws::NONE).to_array()[row]
            };
            (rate(1.0) - rate(-1.0)) / (2.0 * step[column])
        });
        // The iteration has no end of its own where numbers overflow.
        let schur = Some(jacobian).filter(|jacobian| jacobian.iter().all(|rate| rate.is_finite()));
        Some(Schur::try_new(schur?, f64::EPSILON, MOST_ITERATIONS)?.complex_eigenvalues())
    }
}
