//! The simulator against independent implementations.

use std::path::Path;

use seepd_sim::cycle::Turn;
use seepd_sim::{Input, Machine, MachineSpec, Schedule};

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
        let names = ["command", "demand", "position", "p_supply", "p_inlet", "p_cap", "p_rod", "load", "leak_flow"];
        for (column, name) in names.iter().enumerate() {
            let theirs = rows.iter().map(|row| row[column + 1]);
            let range = theirs.clone().fold(f64::MIN, f64::max) - theirs.clone().fold(f64::MAX, f64::min);
            let worst = theirs.zip(&ours).map(|(a, b)| (a - b[column]).abs()).fold(0.0, f64::max);
            assert!(worst <= 1e-6 * range, "leak {leak_area_m2}: {name} differs by {} of its range", worst / range);
        }
    }
}

fn second_cycle(leak_area_m2: f64) -> Vec<[f64; 9]> {
    let spec = MachineSpec::default();
    let machine = Machine::<f64>::new(&[&spec]);
    let mut state = machine.start();
    Schedule::new(&spec.cycle, spec.controller.period_s, vec![Turn::with_leak(leak_area_m2)])
        .take(20_000)
        .map(|instant| {
            let r = machine.tick(&mut state, &Input::gather(&[instant]));
            [r.command, r.demand, r.position, r.p_supply, r.p_inlet, r.p_cap, r.p_rod, r.load, r.leak_flow]
        })
        .skip(10_000)
        .collect()
}
