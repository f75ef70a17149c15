//! The plant against closed forms: what physics says, no other program asked.

use seepd_sim::cycle::CycleRun;
use seepd_sim::plant::{Drive, Plant};
use seepd_sim::{Input, Machine, MachineSpec, PlantParameters, Schedule, State};

fn closed(load: f64) -> Drive<f64> {
    Drive { u: 0.0, load, load_end: load, a_leak: 0.0, at: 0.0 }
}

/// Without piston areas the mass falls freely against viscous friction: v = F/b (1 − e^(−b t/M)). RK4's error after
/// 0.2 s in steps of 0.1 ms is (b h/M)⁴/120 · t b/M ≈ 1e-14 of the final speed; rounding dominates.
#[test]
fn analytic_free_fall_against_viscous_friction() {
    let parameters =
        PlantParameters { cap_area_m2: 1e-30, annulus_area_m2: 1e-30, ..PlantParameters::default() };
    let plant = Plant::<f64>::new(&[&parameters]);
    let (force, b, mass, h) = (3000.0, parameters.viscous_friction_n_s_per_m, parameters.mass_kg, 1e-4);
    let mut state = State { p_s: 16e6, p_3: 16e6, p_1: 5e6, p_2: 5e6, x: 0.05, v: 0.0 };
    for _ in 0..2000 {
        state = plant.step(&state, &closed(force), h);
    }
    let (t, tau) = (0.2, mass / b);
    let v = force / b * (1.0 - f64::exp(-t / tau));
    let x = 0.05 + force / b * (t - tau * (1.0 - f64::exp(-t / tau)));
    assert!((state.v - v).abs() < 1e-12 * v, "{} {v}", state.v);
    assert!((state.x - x).abs() < 1e-12, "{} {x}", state.x);
}

/// A piston that nothing can slow compresses the closed rod chamber: dp/dt = β A v/V gives
/// p = p_0 + β ln(V_0/V). The cap chamber expands by the same law. Seal and valve are tight.
#[test]
fn analytic_pressure_of_closed_chambers_is_logarithmic_in_volume() {
    let parameters = PlantParameters {
        mass_kg: 1e15,
        seal_resistance_pa_s_per_m3: 1e30,
        valve_rod_resistance_pa_s_per_m3: 1e30,
        ..PlantParameters::default()
    };
    let p = &parameters;
    let plant = Plant::<f64>::new(&[p]);
    let mut state = State { p_s: 16e6, p_3: 16e6, p_1: 20e6, p_2: 1e6, x: 0.2, v: 0.01 };
    let cap = |x: f64| p.cap_dead_volume_m3 + p.cap_area_m2 * x;
    let rod = |x: f64| p.rod_dead_volume_m3 + p.annulus_area_m2 * (p.stroke_m - x);
    for _ in 0..2000 {
        state = plant.step(&state, &closed(0.0), 1e-4);
    }
    assert!((state.x - 0.202).abs() < 1e-9);
    let p_1 = 20e6 + p.bulk_modulus_pa * (cap(0.2) / cap(state.x)).ln();
    let p_2 = 1e6 + p.bulk_modulus_pa * (rod(0.2) / rod(state.x)).ln();
    assert!((state.p_1 - p_1).abs() < 1.0, "{} {p_1}", state.p_1);
    assert!((state.p_2 - p_2).abs() < 1.0, "{} {p_2}", state.p_2);
}

/// Far above dp_t the leak is the sharp-edged orifice's C_d A √(2 Δp/ρ), to (dp_t/Δp)²/4; far below it is laminar,
/// C_d A √(2/ρ) Δp/√dp_t; it is odd in Δp. The article's 1e-5 m² passes about 53 L/min at 7 MPa.
#[test]
fn analytic_steady_orifice_flow() {
    let parameters = PlantParameters { seal_resistance_pa_s_per_m3: 1e30, ..PlantParameters::default() };
    let plant = Plant::<f64>::new(&[&parameters]);
    let flow = |dp: f64| {
        plant.leak_flow(&State { p_s: 0.0, p_3: 0.0, p_1: 8e6 + dp, p_2: 8e6, x: 0.1, v: 0.0 }, 1e-5)
    };
    let orifice = parameters.orifice_flow_m3_per_s(1e-5, 7e6);
    assert!((flow(7e6) / orifice - 1.0).abs() < 0.26 * (2e5f64 / 7e6).powi(2));
    assert!((orifice * 60e3 - 53.3).abs() < 0.1);
    let laminar = 0.7 * 1e-5 * (2.0f64 / 870.0).sqrt() * 100.0 / 2e5f64.sqrt();
    assert!((flow(100.0) / laminar - 1.0).abs() < 1e-6);
    assert_eq!(flow(-3e6).to_bits(), (-flow(3e6)).to_bits());
}

/// The flow that the valve passes at rest: with both chambers held by a heavy piston, du/dt = 0 and the inlet settles
/// where line and valve leak agree, (p_3 − p_r)/R_vlv + (p_3 − p_2)/R_vlv2 = k_line √(p_s − p_3).
#[test]
fn analytic_inlet_settles_where_its_flows_agree() {
    let p = PlantParameters { mass_kg: 1e15, ..PlantParameters::default() };
    let plant = Plant::<f64>::new(&[&p]);
    let mut state = State { p_s: 16e6, p_3: 16e6, p_1: 8e6, p_2: 8e6, x: 0.2, v: 0.0 };
    for _ in 0..20_000 {
        state = plant.step(&state, &closed(0.0), 1e-4);
    }
    let dp = state.p_s - state.p_3;
    let line = p.line_m3_per_s_sqrt_pa * dp / (dp * dp + p.transition_pressure_pa.powi(2)).powf(0.25);
    let out = (state.p_3 - p.return_pressure_pa) / p.valve_return_resistance_pa_s_per_m3
        + (state.p_3 - state.p_2) / p.valve_rod_resistance_pa_s_per_m3;
    assert!((line - out).abs() < 1e-3 * out, "{line} {out}");
    // The pump's flow less the line's leaves through the relief valve.
    let relief = (state.p_s - p.relief_pressure_pa) / p.relief_resistance_pa_s_per_m3;
    assert!((p.pump_flow_m3_per_s - line - relief).abs() < 1e-6 * p.pump_flow_m3_per_s);
}

/// Energy over a cycle: what the pump delivers is throttled, rubbed off, put into the load or stored. Every flow is
/// written out here again, at the ends of each tick; the trapezoid's error over 1 ms is far below the 0.1 % asked for.
#[test]
fn analytic_energy_balance_over_a_cycle() {
    for leak_area_m2 in [0.0, 1e-6, 1e-5] {
        let spec = MachineSpec::default();
        let machine = Machine::<f64>::new(&[&spec]);
        let mut state = machine.start();
        let (mut delivered, mut accounted) = (0.0, 0.0);
        for (tick, sample) in
            Schedule::new(&spec.cycle, 1e-3, vec![CycleRun::with_leak(leak_area_m2)]).take(20_000).enumerate()
        {
            let before = state.plant;
            let u = machine.tick(&mut state, &Input::gather(&[sample])).command;
            if tick < 10_000 {
                continue;
            }
            let start = powers(&spec.plant, &before, u, sample.load_n, leak_area_m2);
            let end = powers(&spec.plant, &state.plant, u, sample.load_end_n, leak_area_m2);
            delivered += 0.5e-3 * (start.delivered + end.delivered);
            accounted += 0.5e-3 * (start.lost + end.lost) + stored(&spec.plant, &before, &state.plant);
        }
        assert!(delivered > 1e5);
        let error = (delivered - accounted).abs() / delivered;
        assert!(error < 1e-3, "leak {leak_area_m2}: {error}");
    }
}

struct Powers {
    delivered: f64,
    lost: f64,
}

fn powers(p: &PlantParameters, s: &State<f64>, u: f64, load: f64, leak: f64) -> Powers {
    let sq = |k: f64, dp: f64| {
        k * dp.signum() * dp.abs() / (dp * dp + p.transition_pressure_pa.powi(2)).powf(0.25)
    };
    let k = p.valve_m3_per_s_sqrt_pa * u.abs();
    // Pressure drops over the two open lands: inlet to one chamber, the other chamber to the return.
    let (fed, drained) = if u > 0.0 { (s.p_1, s.p_2) } else { (s.p_2, s.p_1) };
    let (into, out) = (sq(k, s.p_3 - fed), sq(k, drained - p.return_pressure_pa));
    let line = sq(p.line_m3_per_s_sqrt_pa, s.p_s - s.p_3);
    let relief = ((s.p_s - p.relief_pressure_pa) / p.relief_resistance_pa_s_per_m3).max(0.0);
    let dp = s.p_1 - s.p_2;
    let piston = sq(p.discharge_coefficient * leak * (2.0 / p.density_kg_per_m3).sqrt(), dp)
        + dp / p.seal_resistance_pa_s_per_m3;
    let to_return = (s.p_3 - p.return_pressure_pa) / p.valve_return_resistance_pa_s_per_m3;
    let to_rod = (s.p_3 - s.p_2) / p.valve_rod_resistance_pa_s_per_m3;
    Powers {
        delivered: s.p_s * p.pump_flow_m3_per_s,
        lost: s.p_s * relief
            + (s.p_s - s.p_3) * line
            + (s.p_3 - fed) * into
            + drained * out
            + s.p_3 * to_return
            + (s.p_3 - s.p_2) * to_rod
            + dp * piston
            + p.viscous_friction_n_s_per_m * s.v * s.v
            - load * s.v,
    }
}

/// Energy put into compressed oil, V/β p dp, and into the moving mass.
fn stored(p: &PlantParameters, a: &State<f64>, b: &State<f64>) -> f64 {
    let beta = p.bulk_modulus_pa;
    let x = 0.5 * (a.x + b.x);
    let fluid = |volume: f64, from: f64, to: f64| volume / beta * 0.5 * (to * to - from * from);
    fluid(p.supply_volume_m3, a.p_s, b.p_s)
        + fluid(p.inlet_volume_m3, a.p_3, b.p_3)
        + fluid(p.cap_dead_volume_m3 + p.cap_area_m2 * x, a.p_1, b.p_1)
        + fluid(p.rod_dead_volume_m3 + p.annulus_area_m2 * (p.stroke_m - x), a.p_2, b.p_2)
        + 0.5 * p.mass_kg * (b.v * b.v - a.v * a.v)
}

/// Halving the step divides the error by 2⁴ on a smooth segment (a steady extension after its fast transients).
#[test]
fn analytic_fourth_order_convergence() {
    let plant = Plant::<f64>::new(&[&PlantParameters::default()]);
    let drive = Drive { u: 0.15, load: -2e3, load_end: -2e3, a_leak: 1e-6, at: 0.0 };
    let run = |from: State<f64>, h: f64, t: f64| {
        (0..(t / h).round() as usize).fold(from, |state, _| plant.step(&state, &drive, h))
    };
    let from = run(plant.rest(0.15, -2e3), 2e-5, 0.05);
    let exact = run(from, 1.25e-6, 0.02);
    let error = |h: f64| {
        let at = run(from, h, 0.02);
        ((at.p_1 - exact.p_1) / 1e7).abs().max(((at.p_3 - exact.p_3) / 1e7).abs())
    };
    let orders = [8e-5, 4e-5].map(|h| (error(h) / error(h / 2.0)).log2());
    // Asymptotically 4; the coarser step is near the stability limit, where the next order still shows.
    assert!(orders.iter().all(|order| (3.6..5.5).contains(order)), "{orders:?}");
    assert!((orders[1] - 4.0).abs() < 0.4, "{orders:?}");
}

/// Driven into an end stop the piston stands there, and leaves it again.
#[test]
fn analytic_end_stops_are_inelastic() {
    let plant = Plant::<f64>::new(&[&PlantParameters::default()]);
    let mut state = plant.rest(0.49, 0.0);
    let push = |u| Drive { u, load: 0.0, load_end: 0.0, a_leak: 0.0, at: 0.0 };
    for _ in 0..5000 {
        state = plant.step(&state, &push(0.5), 1e-4);
        assert!(state.x <= 0.5);
    }
    assert_eq!((state.x, state.v), (0.5, 0.0));
    for _ in 0..5000 {
        state = plant.step(&state, &push(-0.5), 1e-4);
    }
    assert!(state.x < 0.45 && state.v < 0.0);
}

/// PLANT: the line against V_3 at no flow, β (1/V_3 + 1/V_s) k_line/√dp_t ≈ 2.3e4 1/s.
#[test]
fn analytic_fastest_eigenvalue_is_the_lines() {
    let p = PlantParameters::default();
    let line =
        p.bulk_modulus_pa * (1.0 / p.inlet_volume_m3 + 1.0 / p.supply_volume_m3) * p.line_m3_per_s_sqrt_pa
            / p.transition_pressure_pa.sqrt();
    assert!((p.fastest_eigenvalue_per_s() / line - 1.0).abs() < 0.03);
    assert!((line - 2.3e4).abs() < 0.05e4);
}

/// The statistics of one cycle that the plant's description states, and the levels of its signals.
#[test]
fn reference_command_statistics_over_leaks() {
    let expected = [
        (0.0, -0.0038, 0.116),
        (5e-7, -0.0097, 0.119),
        (1e-6, -0.0152, 0.124),
        (3e-6, -0.0361, 0.148),
        (1e-5, -0.1024, 0.268),
    ];
    for (leak_area_m2, mean, deviation) in expected {
        let spec = MachineSpec::default();
        let machine = Machine::<f64>::new(&[&spec]);
        let mut state = machine.start();
        let commands: Vec<f64> = Schedule::new(&spec.cycle, 1e-3, vec![CycleRun::with_leak(leak_area_m2)])
            .take(20_000)
            .map(|sample| machine.tick(&mut state, &Input::gather(&[sample])).command)
            .skip(10_000)
            .collect();
        let m = commands.iter().sum::<f64>() / 1e4;
        let s = (commands.iter().map(|u| (u - m).powi(2)).sum::<f64>() / 1e4).sqrt();
        assert!((m - mean).abs() < 6e-5 && (s - deviation).abs() < 6e-4, "{leak_area_m2}: {m} {s}");
    }
}

/// A piston of 1 kg that the rod chamber presses against its end with 450 N displaces no oil there: with the valve shut the chambers only
/// equalise past the seal, dp/dt = −(β/V_1 + β/V_2) dp / R_cyl, and the time constant is volumes over β times R_cyl.
#[test]
fn analytic_chambers_of_a_piston_pressed_against_its_end_equalise_past_the_seal_alone() {
    let parameters = PlantParameters {
        cap_area_m2: 2e-4,
        annulus_area_m2: 1.2e-4,
        stroke_m: 0.2,
        mass_kg: 1.0,
        viscous_friction_n_s_per_m: 50.0,
        bulk_modulus_pa: 5e8,
        cap_dead_volume_m3: 2e-4,
        rod_dead_volume_m3: 2e-4,
        seal_resistance_pa_s_per_m3: 1e13,
        valve_rod_resistance_pa_s_per_m3: 1e20,
        ..PlantParameters::default()
    };
    let plant = Plant::<f64>::new(&[&parameters]);
    let (p_1, p_2) = (2e5, 4e6);
    let mut state = State { p_s: 16e6, p_3: 16e6, p_1, p_2, x: 0.0, v: 0.0 };
    for _ in 0..2000 {
        state = plant.step(&state, &closed(0.0), 5e-5);
    }
    let (v_1, v_2): (f64, f64) = (2e-4, 2e-4 + 1.2e-4 * 0.2);
    let rate_per_s = 5e8 * (1.0 / v_1 + 1.0 / v_2) / 1e13;
    let expected = (p_1 - p_2) * (-rate_per_s * 0.1).exp();
    assert_eq!((state.x, state.v), (0.0, 0.0));
    assert!(((state.p_1 - state.p_2) / expected - 1.0).abs() < 1e-6, "{} {expected}", state.p_1 - state.p_2);
    // What one chamber lost, the other has.
    assert!(((state.p_1 - p_1) * v_1 + (state.p_2 - p_2) * v_2).abs() < 1e-6 * p_2 * v_2);
}

/// A run begins with the pressures that are known; those that are not follow from the end at which the piston stands, or from the balance.
#[test]
fn analytic_a_run_begins_in_balance_or_against_an_end() {
    use seepd_sim::cycle::{DriveSample, RunStart};
    let machine = MachineSpec::default();
    let p = &machine.plant;
    let sample = DriveSample::new(0.0, f64::NAN, -2000.0);
    let begin = |position_m: f64, p_cap_pa: Option<f64>, p_rod_pa: Option<f64>| {
        let start = RunStart { position_m, p_cap_pa, p_rod_pa };
        let state = Machine::<f64>::new(&[&machine]).start_from(&start, &Input::from(sample)).plant;
        (state.p_1, state.p_2)
    };
    assert_eq!(begin(0.2, Some(3e6), Some(5e6)), (3e6, 5e6));
    assert_eq!(begin(0.0, None, None), (p.return_pressure_pa, p.relief_pressure_pa));
    assert_eq!(begin(p.stroke_m, None, None), (p.relief_pressure_pa, p.return_pressure_pa));
    assert_eq!(begin(0.0, Some(4e5), None), (4e5, p.relief_pressure_pa));
    let (p_cap, p_rod) = begin(0.2, None, Some(5e6));
    assert!((p.cap_area_m2 * p_cap - p.annulus_area_m2 * p_rod - 2000.0).abs() < 1e-6);
    let (p_cap, p_rod) = begin(0.2, Some(5e6), None);
    assert!((p.cap_area_m2 * p_cap - p.annulus_area_m2 * p_rod - 2000.0).abs() < 1e-6);
}
