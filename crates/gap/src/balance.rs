//! The press's equations with a cycle's signals put into them, in bins: what is left over says where simulator and machine part.

use seepd_signals::Signal;
use seepd_sim::{MachineSpec, PlantParameters};

use crate::record::BINS;
use crate::simulate::{BinnedSignals, bins_of};
use crate::simulated_axis::{Imbalances, SimulatedAxis};

/// What is left of each equation whose signals were recorded, as a share of what the machine can at most.
pub(crate) fn imbalances(spec: &MachineSpec, signals: &[Signal], view: &BinnedSignals) -> Imbalances {
    let signal = |signal: Signal| bins_of(signals, signal, view).map(Vec::as_slice);
    let (Some(command), Some(position_m)) = (signal(Signal::Command), signal(Signal::Position)) else {
        return Vec::new();
    };
    let bin_s = spec.cycle.period_s / BINS as f64;
    let balance = Balance { spec, plant: &spec.plant, bin_s, command, position_m };
    let mut all = match (signal(Signal::PCap), signal(Signal::PRod)) {
        (Some(p_cap), Some(p_rod)) => {
            let chambers = Chambers { p_cap, p_rod };
            balance.of_chambers(&chambers, signal(Signal::PInlet), signal(Signal::PSupply))
        }
        _ => Vec::new(),
    };
    if !all.iter().any(|(equation, _)| *equation == "cap") {
        all.push(("flow", each_bin(|bin| balance.flow(bin))));
    }
    if !spec.is_open_loop() {
        all.push(("controller", each_bin(|bin| balance.controller(bin))));
    }
    all
}

/// A machine with what was recorded of its valve and piston in a cycle.
struct Balance<'a> {
    spec: &'a MachineSpec,
    plant: &'a PlantParameters,
    bin_s: f64,
    command: &'a [f64],
    position_m: &'a [f64],
}

/// Pressures of the cylinder's chambers, Pa.
struct Chambers<'a> {
    p_cap: &'a [f64],
    p_rod: &'a [f64],
}

fn each_bin(of: impl Fn(usize) -> f64) -> Vec<f64> {
    (0..BINS).map(of).collect()
}

impl Balance<'_> {
    fn of_chambers(
        &self,
        chambers: &Chambers<'_>,
        p_inlet: Option<&[f64]>,
        p_supply: Option<&[f64]>,
    ) -> Imbalances {
        let mut all = vec![("force", each_bin(|bin| self.force(chambers, bin)))];
        let Some(p_inlet) = p_inlet else { return all };
        all.push(("cap", each_bin(|bin| self.cap(chambers, p_inlet, bin))));
        all.push(("rod", each_bin(|bin| self.rod(chambers, p_inlet, bin))));
        let Some(p_supply) = p_supply else { return all };
        all.push(("inlet", each_bin(|bin| self.inlet(chambers, p_inlet, p_supply, bin))));
        all.push(("supply", each_bin(|bin| self.supply(p_inlet, p_supply, bin))));
        all
    }

    /// Newton's law of the piston, as a share of the cap side's largest force.
    fn force(&self, Chambers { p_cap, p_rod }: &Chambers<'_>, bin: usize) -> f64 {
        let (p, x, dt) = (self.plant, self.position_m, self.bin_s);
        let v = self.slope(x, bin);
        let acceleration = (x[(bin + 1) % BINS] - 2.0 * x[bin] + x[(bin + BINS - 1) % BINS]) / (dt * dt);
        let load = self.spec.cycle.load_n(self.middle_s(bin)) * p.load_scale;
        (p.cap_area_m2 * p_cap[bin] - p.annulus_area_m2 * p_rod[bin] - p.viscous_friction_n_s_per_m * v
            + load
            - p.mass_kg * acceleration)
            / (p.cap_area_m2 * p.relief_pressure_pa)
    }

    /// Oil of the cap side's chamber, as a share of the pump's flow.
    fn cap(&self, chambers: &Chambers<'_>, p_inlet: &[f64], bin: usize) -> f64 {
        let (p, p_cap) = (self.plant, chambers.p_cap);
        let volume = p.cap_dead_volume_m3 + p.cap_area_m2 * self.position_m[bin];
        (self.flow_to_cap(chambers, p_inlet, bin)
            - p.cap_area_m2 * self.slope(self.position_m, bin)
            - self.leak(chambers, bin)
            - volume / p.bulk_modulus_pa * self.slope(p_cap, bin))
            / p.pump_flow_m3_per_s
    }

    /// Oil of the rod side's chamber, as a share of the pump's flow.
    fn rod(&self, chambers: &Chambers<'_>, p_inlet: &[f64], bin: usize) -> f64 {
        let (p, p_rod) = (self.plant, chambers.p_rod);
        let volume = p.rod_dead_volume_m3 + p.annulus_area_m2 * (p.stroke_m - self.position_m[bin]);
        (self.flow_to_rod(chambers, p_inlet, bin)
            + p.annulus_area_m2 * self.slope(self.position_m, bin)
            + self.leak(chambers, bin)
            - volume / p.bulk_modulus_pa * self.slope(p_rod, bin))
            / p.pump_flow_m3_per_s
    }

    /// Oil at the valve's inlet, as a share of the pump's flow.
    fn inlet(&self, chambers: &Chambers<'_>, p_inlet: &[f64], p_supply: &[f64], bin: usize) -> f64 {
        let p = self.plant;
        let drawn = if self.command[bin] > 0.0 {
            self.flow_to_cap(chambers, p_inlet, bin)
        } else {
            self.flow_to_rod(chambers, p_inlet, bin)
        };
        (self.line_flow(p_inlet, p_supply, bin)
            - drawn
            - p.inlet_volume_m3 / p.bulk_modulus_pa * self.slope(p_inlet, bin))
            / p.pump_flow_m3_per_s
    }

    /// Oil between pump and line, as a share of the pump's flow.
    fn supply(&self, p_inlet: &[f64], p_supply: &[f64], bin: usize) -> f64 {
        let p = self.plant;
        let relief = ((p_supply[bin] - p.relief_pressure_pa) / p.relief_resistance_pa_s_per_m3).max(0.0);
        (p.pump_flow_m3_per_s
            - self.line_flow(p_inlet, p_supply, bin)
            - relief
            - p.supply_volume_m3 / p.bulk_modulus_pa * self.slope(p_supply, bin))
            / p.pump_flow_m3_per_s
    }

    /// Without all pressures: the speed that the command gives against the speed that there is, as a share of the pump's flow.
    fn flow(&self, bin: usize) -> f64 {
        let p = self.plant;
        let fastest = p.valve_m3_per_s_sqrt_pa * (0.5 * p.relief_pressure_pa).sqrt();
        (self.command[bin] * fastest - p.cap_area_m2 * self.slope(self.position_m, bin))
            / p.pump_flow_m3_per_s
    }

    /// The command's rate against what the controller makes of demand and position: the integrator's start does not count.
    fn controller(&self, bin: usize) -> f64 {
        let (c, u, cycle) = (&self.spec.controller, self.command, &self.spec.cycle);
        let (next, before) = (bin + 1, bin + BINS - 1);
        let is_open = |bin: usize| cycle.open_loop_at(self.middle_s(bin % BINS)).is_open > 0.0;
        // There the controller makes nothing.
        if [before, bin, next].into_iter().any(is_open) {
            return 0.0;
        }
        let error = |bin: usize| cycle.demand_m(self.middle_s(bin % BINS)) - self.position_m[bin % BINS];
        self.slope(u, bin) - c.kp * (error(next) - error(before)) / (2.0 * self.bin_s) - c.ki * error(bin)
    }

    /// Through the valve into the cap side, m³/s.
    fn flow_to_cap(&self, Chambers { p_cap, .. }: &Chambers<'_>, p_inlet: &[f64], bin: usize) -> f64 {
        let source = if self.command[bin] > 0.0 { p_inlet[bin] } else { self.plant.return_pressure_pa };
        self.through(self.opening(bin), source - p_cap[bin])
    }

    /// Through the valve into the rod side, m³/s.
    fn flow_to_rod(&self, Chambers { p_rod, .. }: &Chambers<'_>, p_inlet: &[f64], bin: usize) -> f64 {
        let source = if self.command[bin] > 0.0 { self.plant.return_pressure_pa } else { p_inlet[bin] };
        self.through(self.opening(bin), source - p_rod[bin])
    }

    /// From the pump through the line to the valve, m³/s.
    fn line_flow(&self, p_inlet: &[f64], p_supply: &[f64], bin: usize) -> f64 {
        self.through(self.plant.line_m3_per_s_sqrt_pa, p_supply[bin] - p_inlet[bin])
    }

    /// Past the piston from cap to rod side, m³/s.
    fn leak(&self, Chambers { p_cap, p_rod }: &Chambers<'_>, bin: usize) -> f64 {
        let p = self.plant;
        let dp = p_cap[bin] - p_rod[bin];
        let orifice = p.discharge_coefficient * p.leak_area_m2 * (2.0 / p.density_kg_per_m3).sqrt();
        self.through(orifice, dp) + dp / p.seal_resistance_pa_s_per_m3
    }

    fn opening(&self, bin: usize) -> f64 {
        self.plant.valve_m3_per_s_sqrt_pa * self.command[bin].abs()
    }

    /// The square-root law of an orifice, smooth through zero.
    fn through(&self, k: f64, dp_pa: f64) -> f64 {
        k * dp_pa / (dp_pa * dp_pa + self.plant.transition_pressure_pa.powi(2)).powf(0.25)
    }

    /// Rate of change at a bin, by its neighbours in the ring of a cycle.
    fn slope(&self, values: &[f64], bin: usize) -> f64 {
        (values[(bin + 1) % BINS] - values[(bin + BINS - 1) % BINS]) / (2.0 * self.bin_s)
    }

    /// The time in the cycle at a bin's middle, s.
    fn middle_s(&self, bin: usize) -> f64 {
        (bin as f64 + 0.5) * self.bin_s
    }
}
