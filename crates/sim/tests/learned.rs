//! Learned laws: where their curve is one that has a name, they are that law; at 0 they change no bit; files hold them.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use seepd_sim::cycle::CycleRun;
use seepd_sim::effects::Effect;
use seepd_sim::learned::{self, LearnedLaw};
use seepd_sim::{Input, Machine, MachineSpec, Schedule};

/// Command, position and pressures of a whole cycle after a warm-up of the same length.
fn cycle(spec: &MachineSpec) -> Vec<[f64; 5]> {
    let machine = Machine::<f64>::new(&[spec]);
    let mut state = machine.start();
    let ticks = (spec.cycle.period_s / spec.controller.period_s) as usize;
    Schedule::new(&spec.cycle, spec.controller.period_s, vec![CycleRun::with_leak(1e-6)])
        .take(2 * ticks)
        .map(|sample| machine.tick(&mut state, &Input::gather(&[sample])))
        .map(|record| [record.command, record.position, record.p_cap, record.p_rod, record.p_supply])
        .skip(ticks)
        .collect()
}

/// The machine with a curve over an argument from one end to the other.
fn with_curve(key: &str, (from, to): (f64, f64), curve: impl Fn(f64) -> f64) -> MachineSpec {
    let law = learned::find(key).unwrap();
    let mut spec = MachineSpec::default();
    let table = spec.effects.entry(key.into()).or_default();
    table.insert("from".into(), from);
    table.insert("to".into(), to);
    for knot in 0..law.knots() {
        let at = from + (to - from) * knot as f64 / (law.knots() - 1) as f64;
        table.insert(format!("at_{knot:02}"), curve(at));
    }
    spec
}

/// Largest difference of two machines over their signals' ranges.
fn difference(one: &MachineSpec, other: &MachineSpec) -> f64 {
    let (one, other) = (cycle(one), cycle(other));
    (0..5)
        .map(|signal| {
            let of = |cycle: &[[f64; 5]]| cycle.iter().map(|row| row[signal]).collect::<Vec<_>>();
            let (a, b) = (of(&one), of(&other));
            let span =
                a.iter().copied().fold(f64::MIN, f64::max) - a.iter().copied().fold(f64::MAX, f64::min);
            a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / span
        })
        .fold(0.0, f64::max)
}

fn changed(change: impl FnOnce(&mut MachineSpec)) -> MachineSpec {
    let mut spec = MachineSpec::default();
    change(&mut spec);
    spec
}

#[test]
fn a_curve_that_has_a_name_is_that_law() {
    let named = |assignment: &str| changed(|spec| spec.set_effect(assignment).unwrap());
    let pairs: Vec<(&str, MachineSpec, MachineSpec)> = vec![
        (
            "viscous friction",
            with_curve("learned_force_over_speed", (-1.0, 1.0), |v| -3e3 * v),
            changed(|spec| spec.plant.viscous_friction_n_s_per_m += 3e3),
        ),
        (
            "a force that is always there",
            with_curve("learned_force_over_time", (0.0, 10.0), |_| 1500.0),
            named("load_bias.force_n=1500"),
        ),
        (
            "a spring",
            with_curve("learned_force_over_position", (0.0, 0.5), |x| -2e4 * (x - 0.2)),
            changed(|spec| {
                spec.set_effect("spring_load.stiffness_n_per_m=20000").unwrap();
                spec.set_effect("spring_load.neutral_position_m=0.2").unwrap();
            }),
        ),
        (
            "Coulomb friction",
            with_curve("learned_friction_over_position", (0.0, 0.5), |_| 1200.0),
            named("coulomb_friction.force_n=1200"),
        ),
        (
            "Coulomb friction over pressure",
            with_curve("learned_friction_over_pressure", (-2e7, 2e7), |_| 1200.0),
            named("coulomb_friction.force_n=1200"),
        ),
        (
            "a shifted null",
            with_curve("learned_spool_over_command", (-1.0, 1.0), |_| 0.01),
            named("valve_bias.offset=0.01"),
        ),
        (
            "a laminar leak",
            with_curve("learned_seal_over_pressure", (-2e7, 2e7), |dp| 1e-12 * dp),
            changed(|spec| {
                let seal = &mut spec.plant.seal_resistance_pa_s_per_m3;
                *seal = 1.0 / (1.0 / *seal + 1e-12);
            }),
        ),
        (
            "the same along the bore",
            with_curve("learned_seal_over_position", (0.0, 0.5), |_| 1e-5),
            changed(|spec| {
                let seal = &mut spec.plant.seal_resistance_pa_s_per_m3;
                *seal = 1.0 / (1.0 / *seal + 1e-12);
            }),
        ),
        (
            "oil lost outside, cap side",
            with_curve("learned_cap_flow_over_pressure", (0.0, 2e7), |p| -2e-12 * p),
            named("external_leak.cap_m3_per_s_pa=2e-12"),
        ),
        (
            "oil lost outside, rod side",
            with_curve("learned_rod_flow_over_pressure", (0.0, 2e7), |p| -2e-12 * p),
            named("external_leak.rod_m3_per_s_pa=2e-12"),
        ),
        (
            "a larger pump",
            with_curve("learned_supply_over_time", (0.0, 10.0), |_| 5e-5),
            changed(|spec| spec.plant.pump_flow_m3_per_s += 5e-5),
        ),
        (
            "a larger pump over pressure",
            with_curve("learned_supply_over_pressure", (0.0, 2e7), |_| 5e-5),
            changed(|spec| spec.plant.pump_flow_m3_per_s += 5e-5),
        ),
        (
            "a sensor's scale",
            with_curve("learned_sensor_over_position", (0.0, 0.5), |x| -0.02 * x),
            named("position_scale.factor=0.98"),
        ),
        (
            "higher gains",
            with_curve("learned_controller_over_error", (-0.5, 0.5), |e| 0.2 * e),
            changed(|spec| {
                spec.controller.kp *= 1.2;
                spec.controller.ki *= 1.2;
            }),
        ),
    ];
    for (name, learned, same) in pairs {
        let apart = difference(&learned, &same);
        // Curves are interpolated, which rounds otherwise; the loop forgets it.
        assert!(apart < 1e-6, "{name}: {apart:.1e}");
        assert!(difference(&learned, &MachineSpec::default()) > 1e-4, "{name} is seen");
    }
}

#[test]
fn the_others_act_where_they_say() {
    // A demand that the controller runs ahead of, and a rod port that opens by half only, have no twin in the plant file.
    let lead = with_curve("learned_sensor_over_speed", (-1.0, 1.0), |v| -0.02 * v);
    let port = with_curve("learned_rod_port_over_command", (-1.0, 1.0), |_| -0.5);
    for spec in [lead, port] {
        assert!(difference(&spec, &MachineSpec::default()) > 1e-3);
    }
}

#[test]
fn curves_of_zeros_leave_every_bit() {
    let bits = |spec: &MachineSpec| cycle(spec).into_iter().flatten().map(f64::to_bits).collect::<Vec<_>>();
    let nominal = bits(&MachineSpec::default());
    for law in learned::ALL {
        assert_eq!(nominal, bits(&with_curve(law.key(), (-1.0, 1.0), |_| 0.0)), "{}", law.key());
    }
}

#[test]
fn a_plant_file_holds_a_curve_and_says_what_is_wrong_with_one() {
    let spec = with_curve("learned_force_over_speed", (-0.3, 0.3), |v| -1e4 * v * v.abs());
    let again = MachineSpec::from_toml(&spec.to_toml().unwrap()).unwrap();
    assert_eq!(again, spec);
    let refused = |text: &str| MachineSpec::from_toml(text).unwrap_err().to_string();
    let upside_down = "[effects.learned_force_over_speed]\nfrom = 0.3\nto = -0.3\nat_00 = 5.0\n";
    assert_eq!(
        refused(upside_down),
        "line 3: `effects.learned_force_over_speed.to` is -0.3; it must be above `from`, which is 0.3"
    );
    assert!(refused("[effects.learned_force_over_speed]\nat_13 = 1.0\nfrom = 0\nto = 1\n").contains("at_12"));
    assert!(refused("[effects.learned_force_over_sped]\nto = 1\n").contains("learned_force_over_speed"));
}

#[test]
fn each_law_has_its_key_its_place_and_its_argument() {
    let place = |law: &LearnedLaw| (law.site.name(), law.argument.name());
    for (index, law) in learned::ALL.iter().enumerate() {
        assert!(std::ptr::eq(learned::find(law.key()).unwrap(), *law));
        assert!(learned::ALL[..index].iter().all(|other| place(other) != place(law)));
        assert_eq!(law.parameters().len(), law.knots() + 2);
        assert!(law.parameters()[2].name == "at_00" && law.parameters()[2].neutral == 0.0);
    }
}
