//! The equations: flows over four round edges, oil that gives, a piston, and friction that comes out of its seals.

use super::machine::{Leak, Machine, Oil, Pump, RATED_DENSITY_KG_PER_M3, REFERENCE_PA};

/// Supply, cap and rod pressure, position, speed, spool and its rate.
pub(super) const STATES: usize = 7;
pub(super) type State = [f64; STATES];
pub(super) const P_S: usize = 0;
pub(super) const P_1: usize = 1;
pub(super) const P_2: usize = 2;
pub(super) const X: usize = 3;
pub(super) const V: usize = 4;
pub(super) const SPOOL: usize = 5;
pub(super) const SPOOL_RATE: usize = 6;

/// Errors of a step that are let pass: pressures in Pa, m, m/s, and shares of full command.
pub(super) const TOLERANCE: State = [500.0, 500.0, 500.0, 1e-8, 1e-5, 1e-5, 1e-2];

/// Atmospheric pressure, Pa.
const ATMOSPHERE_PA: f64 = 101_325.0;
/// Pressure difference below which an orifice's flow is laminar, Pa.
const LAMINAR_PA: f64 = 1e5;
/// Speed over which friction changes sign, m/s.
const SLOW_M_PER_S: f64 = 2e-3;
/// Speed at which most of the breakaway friction is gone, m/s.
const STRIBECK_M_PER_S: f64 = 2e-2;
/// Natural frequency and damping with which the moved mass meets an end stop, rad/s.
const STOP: (f64, f64) = (1500.0, 0.7);
/// Friction factor of a hose with turbulent flow.
const HOSE_FRICTION: f64 = 0.03;
/// Exponent of the accumulator's gas.
const GAS_EXPONENT: f64 = 1.3;

/// A machine's equations on a certain day.
pub(super) struct Hydraulics<'a> {
    machine: &'a Machine,
    cap_area: f64,
    annulus_area: f64,
    fixed_volume: f64,
    /// Of an edge at full command, and of a hose (infinite where there is none), m³/s/√Pa.
    edge: f64,
    hose: f64,
    viscous: f64,
    leak: Leak,
}

impl<'a> Hydraulics<'a> {
    pub(super) fn new(machine: &'a Machine, leak: Leak, temperature_c: f64) -> Self {
        let cylinder = &machine.cylinder;
        let density = Oil::density_kg_per_m3(temperature_c);
        let thickness = machine.oil.viscosity_mm2_per_s(temperature_c)
            / machine.oil.viscosity_mm2_per_s(machine.oil.temperature_c);
        let hose_area = std::f64::consts::FRAC_PI_4 * cylinder.hose_bore_m * cylinder.hose_bore_m;
        // Darcy and Weisbach: dp = f (l/d) rho/2 (q/a)².
        let hose_drop = HOSE_FRICTION * cylinder.hose_length_m / cylinder.hose_bore_m * density / 2.0;
        // What is laminar of the leak thins out with the oil.
        let laminar = 2.0 * leak.exponent - 1.0;
        Hydraulics {
            machine,
            cap_area: cylinder.cap_area_m2(),
            annulus_area: cylinder.annulus_area_m2(),
            fixed_volume: cylinder.fixed_volume_m3(),
            edge: machine.valve.coefficient * (RATED_DENSITY_KG_PER_M3 / density).sqrt(),
            hose: hose_area / hose_drop.sqrt(),
            viscous: cylinder.viscous_n_s_per_m * thickness,
            leak: Leak { flow_m3_per_s: leak.flow_m3_per_s * thickness.powf(-laminar), ..leak },
        }
    }

    /// Rates of all states for a held command and an outer force.
    pub(super) fn rates(&self, state: &State, command: f64, force_n: f64) -> State {
        let [p_s, p_1, p_2, x, v, spool, spool_rate] = *state;
        let Machine { valve, supply, cylinder, .. } = self.machine;
        let p_r = supply.return_pa;
        let extending = self.path(spool - valve.null_offset);
        let retracting = self.path(valve.null_offset - spool);
        let (q_pa, q_pb) = (extending * root(p_s - p_1), retracting * root(p_s - p_2));
        let (q_at, q_bt) = (retracting * root(p_1 - p_r), extending * root(p_2 - p_r));
        let q_leak = self.leak_flow(p_1 - p_2);
        let stiff = |volume: f64, p: f64| volume * self.compliance(p);
        let cap = stiff(self.fixed_volume + self.cap_area * x, p_1);
        let rod = stiff(self.fixed_volume + self.annulus_area * (cylinder.stroke_m - x), p_2);
        let force = self.cap_area * p_1 - self.annulus_area * p_2 + cylinder.weight_n + force_n
            - self.friction(v)
            - self.contact(x)
            - self.stop(x, v);
        let omega = valve.natural_rad_per_s;
        let mut rates = [0.0; STATES];
        rates[P_S] = (self.pump(p_s) - q_pa - q_pb) / (stiff(supply.volume_m3, p_s) + self.accumulator(p_s));
        rates[P_1] = (q_pa - q_at - q_leak - self.cap_area * v) / cap;
        rates[P_2] = (q_pb - q_bt + q_leak + self.annulus_area * v) / rod;
        rates[X] = v;
        rates[V] = force / cylinder.mass_kg;
        rates[SPOOL] = spool_rate;
        rates[SPOOL_RATE] = omega * omega * (command - spool) - 2.0 * valve.damping * omega * spool_rate;
        rates
    }

    /// Coefficient of an edge and the hose behind it at a spool position that opens it, m³/s/√Pa.
    fn path(&self, spool: f64) -> f64 {
        let valve = &self.machine.valve;
        let beyond = spool - valve.overlap;
        let opening = 0.5 * (beyond + (beyond * beyond + valve.rounding * valve.rounding).sqrt());
        // Full command gives the rated flow.
        let edge = self.edge * valve.curve.flow(opening / (1.0 - valve.overlap));
        let ratio = edge / self.hose;
        edge / (1.0 + ratio * ratio).sqrt()
    }

    fn leak_flow(&self, dp: f64) -> f64 {
        let Leak { flow_m3_per_s, exponent } = self.leak;
        if exponent == 0.5 {
            return flow_m3_per_s * root(dp) / REFERENCE_PA.sqrt();
        }
        let size = (dp * dp + LAMINAR_PA * LAMINAR_PA).sqrt() / REFERENCE_PA;
        flow_m3_per_s * dp / REFERENCE_PA * size.powf(exponent - 1.0)
    }

    /// What the pump gives less what the relief valve takes, m³/s.
    fn pump(&self, p_s: f64) -> f64 {
        let supply = &self.machine.supply;
        let over = (p_s - supply.pressure_pa) / supply.band_pa;
        supply.flow_m3_per_s
            * match supply.pump {
                Pump::Fixed => 1.0 - over.max(0.0),
                Pump::Regulated => (-over).clamp(0.0, 1.0),
            }
    }

    /// Oil that the accumulator takes, m³/Pa.
    fn accumulator(&self, p_s: f64) -> f64 {
        let Some(accumulator) = self.machine.supply.accumulator else { return 0.0 };
        let (p, precharge) = (p_s + ATMOSPHERE_PA, accumulator.precharge_pa + ATMOSPHERE_PA);
        if p <= precharge {
            return 0.0;
        }
        accumulator.volume_m3 * (precharge / p).powf(1.0 / GAS_EXPONENT) / (GAS_EXPONENT * p)
    }

    /// Of oil with free air, 1/Pa: it grows without limit towards vacuum, below which no pressure falls.
    fn compliance(&self, p: f64) -> f64 {
        let oil = &self.machine.oil;
        let absolute = (p + ATMOSPHERE_PA).max(1e3);
        1.0 / oil.bulk_modulus_pa + oil.air * ATMOSPHERE_PA / (absolute * absolute)
    }

    fn friction(&self, v: f64) -> f64 {
        let cylinder = &self.machine.cylinder;
        let fall = v / STRIBECK_M_PER_S;
        let dry = cylinder.coulomb_n + cylinder.breakaway_n * (-fall * fall).exp();
        self.viscous * v + dry * (v / SLOW_M_PER_S).tanh()
    }

    fn contact(&self, x: f64) -> f64 {
        let contact = self.machine.cylinder.contact;
        contact.map_or(0.0, |contact| contact.stiffness_n_per_m * (x - contact.at_m).max(0.0))
    }

    fn stop(&self, x: f64, v: f64) -> f64 {
        let stroke_m = self.machine.cylinder.stroke_m;
        let beyond = if x < 0.0 { x } else { (x - stroke_m).max(0.0) };
        if beyond == 0.0 {
            return 0.0;
        }
        let (omega, damping) = STOP;
        self.machine.cylinder.mass_kg * (omega * omega * beyond + 2.0 * damping * omega * v)
    }
}

/// Root of a pressure difference with its sign, by Ellman and Piché's polynomial where flow is laminar (Journal of Dynamic Systems,
/// Measurement and Control 121 (1999)).
fn root(dp: f64) -> f64 {
    let size = dp.abs();
    if size >= LAMINAR_PA {
        return size.sqrt().copysign(dp);
    }
    let share = size / LAMINAR_PA;
    (0.5 * LAMINAR_PA.sqrt() * share * (3.0 - share)).copysign(dp)
}

#[cfg(test)]
mod tests {
    use super::super::integrator::Integrator;
    use super::super::machine::tests::example;
    use super::*;

    fn leak(flow_m3_per_s: f64) -> Leak {
        Leak { flow_m3_per_s, exponent: 0.5 }
    }

    /// A state in the middle of a stroke.
    fn under_way(spool: f64, v: f64) -> State {
        let mut state = [0.0; STATES];
        (state[P_S], state[P_1], state[P_2]) = (15.7e6, 9e6, 6e6);
        (state[X], state[V], state[SPOOL]) = (0.2, v, spool);
        state
    }

    /// After long enough under a held command and force.
    fn settled(hydraulics: &Hydraulics, mut state: State, command: f64, force_n: f64) -> State {
        let mut integrator = Integrator::new(TOLERANCE.map(|tolerance| tolerance * 1e-3));
        integrator.advance(&mut state, 0.5, |state| hydraulics.rates(state, command, force_n));
        state
    }

    #[test]
    fn property_oil_comes_from_the_pump_and_goes_to_the_return() {
        let machine = example();
        let hydraulics = Hydraulics::new(&machine, leak(5e-5), 50.0);
        for (spool, v) in [(0.4, 0.2), (-0.3, -0.1), (0.0, 0.0), (0.002, 0.001)] {
            let state = under_way(spool, v);
            let rates = hydraulics.rates(&state, spool, 0.0);
            let [p_s, p_1, p_2, x, ..] = state;
            let volume = |area: f64, way_m: f64| hydraulics.fixed_volume + area * way_m;
            let pressed = machine.supply.volume_m3 * hydraulics.compliance(p_s) * rates[P_S]
                + volume(hydraulics.cap_area, x) * hydraulics.compliance(p_1) * rates[P_1]
                + volume(hydraulics.annulus_area, machine.cylinder.stroke_m - x)
                    * hydraulics.compliance(p_2)
                    * rates[P_2];
            let p_r = machine.supply.return_pa;
            let returned =
                hydraulics.path(-spool) * (p_1 - p_r).sqrt() + hydraulics.path(spool) * (p_2 - p_r).sqrt();
            let rod = (hydraulics.cap_area - hydraulics.annulus_area) * v;
            let balance = hydraulics.pump(p_s) - returned - rod - pressed;
            assert!(balance.abs() < 1e-15, "spool {spool}: {balance:e} m³/s are made or lost");
        }
    }

    #[test]
    fn property_the_mass_takes_what_pressures_and_loads_leave() {
        let mut machine = example();
        machine.cylinder.weight_n = -2000.0;
        machine.cylinder.coulomb_n = 300.0;
        let rates = Hydraulics::new(&machine, leak(0.0), 50.0).rates(&under_way(0.4, 0.2), 0.4, -1500.0);
        let (cap, annulus) = (machine.cylinder.cap_area_m2(), machine.cylinder.annulus_area_m2());
        let force_n = cap * 9e6 - annulus * 6e6 - 2000.0 - 1500.0 - 5000.0 * 0.2 - 300.0;
        assert!((rates[V] * machine.cylinder.mass_kg / force_n - 1.0).abs() < 1e-9, "{}", rates[V]);
    }

    #[test]
    fn analytic_speed_under_a_held_command() {
        let machine = example();
        let hydraulics = Hydraulics::new(&machine, leak(0.0), 50.0);
        let (cap, annulus) = (machine.cylinder.cap_area_m2(), machine.cylinder.annulus_area_m2());
        let (command, force_n) = (0.3, -5000.0);
        let mut state = under_way(command, 0.1);
        state[X] = 0.05;
        let end = settled(&hydraulics, state, command, force_n);
        // Both edges pass what the piston displaces: A_1 p_1 - A_2 p_2 = resistance with p_1 = p_s - (A_1 v/k)², p_2 = p_r + (A_2 v/k)².
        let k = hydraulics.edge * command;
        let forces = |v: f64| {
            let (p_1, p_2) = (end[P_S] - (cap * v / k).powi(2), 2e5 + (annulus * v / k).powi(2));
            cap * p_1 - annulus * p_2 + force_n - 5000.0 * v
        };
        let (mut low, mut high): (f64, f64) = (0.0, 2.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if forces(middle) > 0.0 { low = middle } else { high = middle }
        }
        // Round edges and what they pass beside are 1e-4 of the flow at this opening.
        assert!((end[V] / low - 1.0).abs() < 1e-3, "{} m/s, closed form {low}", end[V]);
    }

    #[test]
    fn analytic_command_that_holds_against_a_leak() {
        let mut machine = example();
        machine.valve.rounding = 1e-6;
        let (cap, annulus) = (machine.cylinder.cap_area_m2(), machine.cylinder.annulus_area_m2());
        for (share, force_n) in [(0.02, 0.0), (0.05, -8000.0), (0.1, 5000.0)] {
            let flow = share * 1e-3;
            let hydraulics = Hydraulics::new(&machine, leak(flow), machine.oil.temperature_c);
            // Both edges pass the leak: the two that are open share p_s - p_r - |p_1 - p_2|, which with the balance of forces gives the
            // pressures. The pump's droop follows the leak.
            let (mut p_s, mut p_1, mut p_2, mut leak) = (16e6, 0.0, 0.0, 0.0_f64);
            for _ in 0..20 {
                p_s = 16e6 - 5e5 * leak.abs() / 2e-3;
                p_2 = (cap * (p_s + 2e5) + force_n) / (cap + annulus);
                p_1 = p_s + 2e5 - p_2;
                leak = (flow * ((p_1 - p_2).abs() / REFERENCE_PA).sqrt()).copysign(p_1 - p_2);
            }
            let expected = leak / (hydraulics.edge * (0.5 * (p_s - 2e5 - (p_1 - p_2).abs())).sqrt());
            let mut state = under_way(expected, 0.0);
            (state[P_S], state[P_1], state[P_2]) = (p_s, p_1, p_2);
            let end = settled(&hydraulics, state, expected, force_n);
            // It does not move: 1e-5 m/s are 5e-8 m³/s, a two-hundredth of the smallest leak.
            assert!(expected.abs() > 1e-3 && end[V].abs() < 1e-5, "leak {share}: {expected}, {} m/s", end[V]);
        }
    }
}
