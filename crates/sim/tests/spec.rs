//! `plant.toml`: what is read, and how mistakes are answered.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use seepd_sim::{MachineSpec, SpecError};

fn refusal(text: &str) -> String {
    MachineSpec::from_toml(text).unwrap_err().to_string()
}

#[test]
fn property_written_default_reads_back_the_same() {
    let default = MachineSpec::default();
    assert_eq!(MachineSpec::from_toml(&default.to_toml().unwrap()).unwrap(), default);
    assert_eq!(MachineSpec::from_toml("").unwrap(), default);
}

#[test]
fn symbols_of_the_equations_are_keys_too() {
    let spec =
        MachineSpec::from_toml("[plant]\nk_v = 9e-7\nM = 300.0\n[effects.coulomb_friction]\nforce_n = 500\n")
            .unwrap();
    assert_eq!((spec.plant.valve_m3_per_s_sqrt_pa, spec.plant.mass_kg), (9e-7, 300.0));
    assert_eq!(spec.effects["coulomb_friction"]["force_n"], 500.0);
}

#[test]
fn wrong_key_is_answered_with_line_and_nearest_key() {
    assert_eq!(
        refusal("[plant]\nmass_kg = 250.0\nbulk_modulus = 1e9\n"),
        "line 3: unknown key `bulk_modulus`; did you mean `bulk_modulus_pa`?"
    );
    assert_eq!(
        refusal("[effects.coulom_friction]\nforce_n = 1\n"),
        "line 1: effects: unknown key `coulom_friction`; did you mean `coulomb_friction`?"
    );
    assert!(refusal("[effects.coulomb_friction]\nforce = 1\n").contains("did you mean `force_n`?"));
}

#[test]
fn impossible_values_are_answered_with_key_and_bound() {
    assert_eq!(
        refusal("[plant]\ninlet_volume_m3 = -4e-4\n"),
        "line 2: `plant.inlet_volume_m3` is -0.0004; it must be positive, in m3"
    );
    assert!(refusal("[plant]\nmass_kg = nan\n").contains("`plant.mass_kg` is NaN"));
    assert!(refusal("[effects.valve_deadband]\nhalf_width = 0.5\n").contains("it must lie in 0 … 0.25"));
    assert!(refusal("[cycle]\nmoves = []\n").contains("no duty cycle"));
    assert!(
        refusal("[[cycle.moves]]\nname = \"a\"\nfrom_s = 3.0\nto_s = 2.0\nto_m = 0.1\n")
            .contains("cycle.moves[0].to_s")
    );
}

#[test]
fn unstable_step_is_refused_with_the_steps_that_it_needs() {
    let error = MachineSpec::from_toml("[plant]\ninlet_volume_m3 = 1e-4\n").unwrap_err();
    let SpecError::UnstableStep { steps, product, needed, .. } = error else { panic!("{error}") };
    assert_eq!(steps, 10);
    assert!(product > 2.78);
    let text = format!("[plant]\ninlet_volume_m3 = 1e-4\n[controller]\nsteps_per_period = {needed}\n");
    assert!(MachineSpec::from_toml(&text).is_ok());
}

/// Little oil between pump and valve at a slow task, as `adopt` makes of a small cylinder: what is taken unasked, the file admits.
#[test]
fn a_stiff_machine_at_a_slow_task_gets_the_steps_that_its_file_asks_for() {
    let mut spec = MachineSpec::default();
    spec.plant.inlet_volume_m3 = 5e-5;
    spec.controller.period_s = 0.004;
    let spec = spec.with_stable_steps();
    assert!(spec.controller.steps_per_period > 100, "{}", spec.controller.steps_per_period);
    spec.check().unwrap();
}

/// Numbers that overflow are answered, and soon: the search for eigenvalues ends.
#[test]
fn numbers_many_decades_off_are_answered_with_their_key() {
    let told = refusal("[plant]\npump_flow_m3_per_s = 1e300\n");
    assert!(told.contains("line 2") && told.contains("`plant.pump_flow_m3_per_s` is 1e300"), "{told}");
    assert!(told.contains("no step is short enough"), "{told}");
    for info in seepd_sim::PlantParameters::ALL {
        for value in [1e300, 1e-300, f64::MAX, f64::MIN_POSITIVE] {
            let text = format!("[plant]\n{} = {value:e}\n", info.key);
            if let Err(error) = MachineSpec::from_toml(&text) {
                let told = error.to_string();
                assert!(
                    told.contains(info.key) || told.contains("steps_per_period") || told.contains("cycle."),
                    "{told}"
                );
            }
        }
    }
}

#[test]
fn a_machine_without_a_controller_has_no_gains_and_no_duty_cycle() {
    let spec = MachineSpec::from_toml("[plant]\nstroke_m = 0.2\n[controller]\nkind = \"none\"\n").unwrap();
    assert!(spec.controller.is_none() && !MachineSpec::default().controller.is_none());
    let text = spec.to_toml().unwrap();
    assert!(!text.contains("cycle") && !text.contains("kp"), "{text}");
    assert_eq!(MachineSpec::from_toml(&text).unwrap(), spec);
    assert!(refusal("[controller]\nkind = \"non\"\n").contains("none"));
}

/// What a diagnosis found of transducers is kept in the plant file; a machine whose sensors show what is there writes nothing of them.
#[test]
fn errors_of_sensors_are_kept() {
    let text = "[sensors.p_cap]\ngain = -0.006\nzero = -58697.6\n";
    let spec = MachineSpec::from_toml(text).unwrap();
    assert!((spec.sensors["p_cap"].shown(1e6) - (0.994e6 - 58_697.6)).abs() < 1e-6);
    assert_eq!(MachineSpec::from_toml(&spec.to_toml().unwrap()).unwrap(), spec);
    assert!(!MachineSpec::default().to_toml().unwrap().contains("sensors"));
    for (wrong, told) in [
        ("[sensors.position]\ngain = 0.0\nzero = 0.0\n", "position"),
        ("[sensors.p_cap]\ngain = 0.9\nzero = 0.0\n", "sensors.p_cap.gain"),
        ("[sensors.p_cap]\ngain = 0.0\n", "zero"),
    ] {
        let error = MachineSpec::from_toml(wrong).unwrap_err().to_string();
        assert!(error.contains(told), "{error}");
    }
}
