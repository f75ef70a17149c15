//! The simulator against independent implementations.

use std::path::Path;

use ode_solvers::dop_shared::OutputType;
use ode_solvers::{Dop853, SVector, System};
use seepd_sim::cycle::CycleRun;
use seepd_sim::plant::{Drive, Plant};
use seepd_sim::{Input, Machine, MachineSpec, PlantParameters, Schedule, State};

/// `reference_`: cycles of an independent implementation of the plant (RK4, 40 steps a millisecond), met
/// within 1e-6 of each signal's range.
#[test]
fn reference_independent_cycles_within_1e_6_of_range() {
    for (leak_area_m2, file) in
        [(0.0, "nominal_leak_0.csv"), (1e-6, "nominal_leak_1e-6.csv"), (1e-5, "nominal_leak_1e-5.csv")]
    {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures").join(file);
        let rows: Vec<Vec<f64>> = csv::Reader::from_path(path)
            .unwrap()
            .records()
            .map(|row| row.unwrap().iter().map(|field| field.parse().unwrap()).collect())
            .collect();
        let ours = second_cycle(leak_area_m2);
        assert_eq!(rows.len(), ours.len());
        let names =
            ["command", "demand", "position", "p_supply", "p_inlet", "p_cap", "p_rod", "load", "leak_flow"];
        for (column, name) in names.iter().enumerate() {
            let theirs = rows.iter().map(|row| row[column + 1]);
            let range = theirs.clone().fold(f64::MIN, f64::max) - theirs.clone().fold(f64::MAX, f64::min);
            let worst = theirs.zip(&ours).map(|(a, b)| (a - b[column]).abs()).fold(0.0, f64::max);
            assert!(
                worst <= 1e-6 * range,
                "leak {leak_area_m2}: {name} differs by {} of its range",
                worst / range
            );
        }
    }
}

fn second_cycle(leak_area_m2: f64) -> Vec<[f64; 9]> {
    let spec = MachineSpec::default();
    let machine = Machine::<f64>::new(&[&spec]);
    let mut state = machine.start();
    Schedule::new(&spec.cycle, spec.controller.period_s, vec![CycleRun::with_leak(leak_area_m2)])
        .take(20_000)
        .map(|sample| {
            let r = machine.tick(&mut state, &Input::gather(&[sample]));
            [r.command, r.demand, r.position, r.p_supply, r.p_inlet, r.p_cap, r.p_rod, r.load, r.leak_flow]
        })
        .skip(10_000)
        .collect()
}

/// The plant's equations in units of its own, MPa and cm.
struct Again {
    plant: PlantParameters,
    opening: f64,
    leak_area_m2: f64,
    load_n: fn(f64) -> f64,
}

impl System<f64, SVector<f64, 6>> for Again {
    fn system(&self, t: f64, y: &SVector<f64, 6>, rates: &mut SVector<f64, 6>) {
        let (load, leak) = ((self.load_n)(t), self.leak_area_m2);
        *rates = rates_again(&self.plant, &(*y).into(), self.opening, load, leak, &SCALE).into();
    }
}

const SCALE: [f64; 6] = [1e6, 1e6, 1e6, 1e6, 1e-2, 1e-2];

/// A solver of another order and author (Dormand and Prince's of order 8, which keeps its own error, ode_solvers), with the equations
/// written out here once more: an open-loop extension with a load step, to 1e-5 of each state's range.
#[test]
fn reference_solver_of_order_8_within_1e_5_of_range() {
    let p = PlantParameters::default();
    let plant = Plant::<f64>::new(&[&p]);
    let (u, leak, dt) = (0.2, 1e-6, 1e-4);
    let load = |t: f64| -2e3 - 8e3 * t;
    // From a steady extension: the step into it from rest is sharper than a controller ever makes it.
    let steady = Drive { u, load: load(0.0), load_end: load(0.0), a_leak: leak, at: 0.0 };
    let start = (0..15_000)
        .fold(plant.rest(0.12, load(0.0)), |state, _| plant.step(&state, &steady, 1e-5))
        .to_array();

    let again = Again { plant: p.clone(), opening: u, leak_area_m2: leak, load_n: load };
    let scaled = SVector::from_fn(|i, _| start[i] / SCALE[i]);
    // A little further than it is compared: the solver's last value is an extrapolation.
    let (from_s, to_s, every_s, tolerance) = (0.0, 0.41, 0.01, 1e-10);
    // The factors of its own default, and never the word that an implicit solver would take longer steps: oil is stiff.
    let (safety, beta, least, most, first_s) = (0.9, 0.0, 0.333, 6.0, 0.0);
    let mut solver = Dop853::from_param(
        again,
        from_s,
        to_s,
        every_s,
        scaled,
        tolerance,
        tolerance,
        safety,
        beta,
        least,
        most,
        to_s,
        first_s,
        u32::MAX,
        u32::MAX,
        OutputType::Dense,
    );
    solver.integrate().unwrap();
    let theirs = solver.y_out();
    assert!(theirs.len() > 40);

    let mut state = State::from_array(start);
    let mut ours = Vec::new();
    for step in 0..4000 {
        let t = f64::from(step) * dt;
        let drive = Drive { u, load: load(t), load_end: load(t + dt), a_leak: leak, at: 0.0 };
        state = plant.step(&state, &drive, dt);
        if (step + 1) % 100 == 0 {
            ours.push(state.to_array());
        }
    }
    for i in 0..6 {
        let column = |k: usize| theirs[k + 1][i] * SCALE[i];
        let segment = (0..40).map(column).chain([start[i]]);
        let (low, high) = segment.fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
        let worst = (0..40).map(|k| (column(k) - ours[k][i]).abs()).fold(0.0, f64::max);
        assert!(worst <= 1e-5 * (high - low), "state {i}: {worst} of {}", high - low);
    }
}

/// The plant's equations again, in scaled states.
fn rates_again(
    p: &seepd_sim::PlantParameters,
    y: &[f64; 6],
    u: f64,
    load: f64,
    leak: f64,
    scale: &[f64; 6],
) -> [f64; 6] {
    let [p_s, p_3, p_1, p_2, x, v]: [f64; 6] = std::array::from_fn(|i| y[i] * scale[i]);
    let root = |k: f64, dp: f64| k * dp / (dp.powi(2) + p.transition_pressure_pa.powi(2)).powf(0.25);
    let k = p.valve_m3_per_s_sqrt_pa * u;
    let (q_line, q_1, q_2) =
        (root(p.line_m3_per_s_sqrt_pa, p_s - p_3), root(k, p_3 - p_1), -root(k, p_2 - p.return_pressure_pa));
    let q_leak = root(p.discharge_coefficient * leak * (2.0 / p.density_kg_per_m3).sqrt(), p_1 - p_2)
        + (p_1 - p_2) / p.seal_resistance_pa_s_per_m3;
    let q_32 = (p_3 - p_2) / p.valve_rod_resistance_pa_s_per_m3;
    let q_3r = (p_3 - p.return_pressure_pa) / p.valve_return_resistance_pa_s_per_m3;
    let relief = ((p_s - p.relief_pressure_pa) / p.relief_resistance_pa_s_per_m3).max(0.0);
    let beta = p.bulk_modulus_pa;
    let rates = [
        beta / p.supply_volume_m3 * (p.pump_flow_m3_per_s - q_line - relief),
        beta / p.inlet_volume_m3 * (q_line - q_1 - q_3r - q_32),
        beta / (p.cap_dead_volume_m3 + p.cap_area_m2 * x) * (q_1 - p.cap_area_m2 * v - q_leak),
        beta / (p.rod_dead_volume_m3 + p.annulus_area_m2 * (p.stroke_m - x))
            * (q_2 + p.annulus_area_m2 * v + q_leak + q_32),
        v,
        (p.cap_area_m2 * p_1 - p.annulus_area_m2 * p_2 - p.viscous_friction_n_s_per_m * v + load) / p.mass_kg,
    ];
    std::array::from_fn(|i| rates[i] / scale[i])
}
