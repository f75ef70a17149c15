//! Models stepped from outside are the simulator's machines, and what is written of them reads back.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use std::io::Cursor;

use seepd_fmi::{Fmu, Version};
use seepd_fmu::{
    Causality, Kind, LibraryError, ModelError, Package, Placement, Platform, Resources, Simulation, Subject,
};
use seepd_sim::MachineSpec;
use seepd_sim::cycle::DriveSample;
use seepd_sim::machine::{Input, Machine};

fn press(placement: Placement, spec: &MachineSpec) -> Resources {
    Resources::new(Subject::Press, placement, spec.to_toml().unwrap())
}

fn reference(model: &Simulation, name: &str) -> u32 {
    model.variables().iter().position(|variable| variable.name == name).unwrap() as u32
}

fn started(model: &mut Simulation) {
    model.enter_initialisation(0.0).unwrap();
    model.exit_initialisation().unwrap();
}

/// With effects of each kind set as parameters: command and position are the machine's, to the bit, over a stroke and a hold.
#[test]
fn reference_the_press_with_its_controller_is_the_machine() {
    let effects = [
        ("valve_deadband.half_width", 0.03),
        ("command_delay.delay_s", 0.0065),
        ("position_lag.time_constant_s", 0.004),
        ("coulomb_friction.force_n", 900.0),
        ("entrained_air.fraction", 0.01),
    ];
    let mut spec = MachineSpec::default();
    let mut model = Simulation::new(&press(Placement::Inside, &spec)).unwrap();
    for (effect, value) in effects {
        spec.set_effect(&format!("{effect}={value}")).unwrap();
        model.set(Kind::Real, reference(&model, &format!("effects.{effect}")), value).unwrap();
    }
    spec = spec.with_stable_steps();
    let [demand, load, leak] = ["demand", "load", "plant.leak_area_m2"].map(|name| reference(&model, name));
    let shown = ["command", "position", "p_cap", "leak_flow"].map(|name| reference(&model, name));
    model.set(Kind::Real, load, -2000.0).unwrap();
    started(&mut model);
    let machine = Machine::<f64>::new(&[&spec]);
    let input = |tick: u32| {
        let at_s = f64::from(tick) * 1e-3;
        let sample = DriveSample::new(at_s, spec.cycle.demand_m(at_s), -2000.0);
        Input::from(DriveSample { leak_area_m2: 3e-7, ..sample })
    };
    let mut state = machine.start_at(&input(0));
    // The leak may change between steps.
    model.set(Kind::Real, leak, 3e-7).unwrap();
    for tick in 0..4000 {
        let position = model.get(Kind::Real, shown[1]).unwrap();
        model.set(Kind::Real, demand, input(tick).demand).unwrap();
        model.step(1e-3).unwrap();
        let signals = machine.tick(&mut state, &input(tick));
        assert_eq!(position.to_bits(), signals.position.to_bits(), "{tick}");
        let [command, _, p_cap, leak_flow] = shown.map(|place| model.get(Kind::Real, place).unwrap());
        assert_eq!(command.to_bits(), signals.command.to_bits(), "{tick}");
        assert_eq!(p_cap.to_bits(), state.plant.p_1.to_bits(), "{tick}");
        assert_eq!(leak_flow.to_bits(), machine.leak_flow(&state, 3e-7).to_bits(), "{tick}");
    }
}

/// A command is held over a step whatever the step's length: one of 10 ms is ten of 1 ms.
#[test]
fn property_long_steps_are_short_ones() {
    let run = |step_s: f64, steps: usize| {
        let mut model = Simulation::new(&press(Placement::Outside, &MachineSpec::default())).unwrap();
        let [command, position] = ["command", "position"].map(|name| reference(&model, name));
        started(&mut model);
        model.set(Kind::Real, command, 0.2).unwrap();
        (0..steps).for_each(|_| model.step(step_s).unwrap());
        model.get(Kind::Real, position).unwrap()
    };
    let (short, long, odd) = (run(1e-3, 300), run(10e-3, 30), run(1.05e-3, 300));
    assert!((short - long).abs() < 1e-9, "{short} {long}");
    assert!(odd > short, "{odd} {short}");
}

#[test]
fn property_a_kept_state_goes_on_as_the_first_did_and_a_reset_begins_anew() {
    let mut model = Simulation::new(&press(Placement::Inside, &MachineSpec::default())).unwrap();
    let [demand, position] = ["demand", "position"].map(|name| reference(&model, name));
    let run = |model: &mut Simulation| {
        model.set(Kind::Real, demand, 0.3).unwrap();
        (0..200).for_each(|_| model.step(1e-3).unwrap());
        model.get(Kind::Real, position).unwrap()
    };
    started(&mut model);
    let first = run(&mut model);
    let mut kept = model.copied().unwrap();
    let on = run(&mut model);
    assert_eq!(run(&mut kept).to_bits(), on.to_bits());
    assert!(on > first);
    model.reset().unwrap();
    started(&mut model);
    assert_eq!(run(&mut model).to_bits(), first.to_bits());
}

#[test]
fn what_may_not_be_done_is_said_in_a_sentence() {
    let mut model = Simulation::new(&press(Placement::Inside, &MachineSpec::default())).unwrap();
    let of = |model: &Simulation, name: &str| reference(model, name);
    let (demand, position, mass) =
        (of(&model, "demand"), of(&model, "position"), of(&model, "plant.mass_kg"));
    let told = |result: Result<(), ModelError>| result.unwrap_err().to_string();
    assert_eq!(told(model.step(1e-3)), "the model is not initialised");
    assert_eq!(told(model.set(Kind::Real, 9999, 0.0)), "there is no Real variable with the reference 9999");
    assert_eq!(
        told(model.set(Kind::Boolean, demand, 0.0)),
        format!("there is no Boolean variable with the reference {demand}")
    );
    assert_eq!(told(model.set(Kind::Real, position, 0.0)), "`position` cannot be set");
    assert_eq!(
        told(model.set(Kind::Real, demand, f64::NAN)),
        "`demand` was set to something that is no number"
    );
    started(&mut model);
    assert_eq!(
        told(model.set(Kind::Real, mass, 300.0)),
        "`plant.mass_kg` is fixed: it is set before the first step"
    );
    assert_eq!(
        told(model.step(1.5e-3)),
        "a step of 0.0015 s: with the controller inside it must be a whole multiple of its period, 0.001 s"
    );
    assert_eq!(told(model.step(f64::NAN)), "a step of NaN s: it must be positive");
    assert!(told(model.enter_initialisation(0.0)).contains("reset it first"));
    // Parameters are checked together, where the initialisation ends.
    model.reset().unwrap();
    let half_width = of(&model, "effects.valve_deadband.half_width");
    model.set(Kind::Real, half_width, 0.9).unwrap();
    model.enter_initialisation(0.0).unwrap();
    let refused = told(model.exit_initialisation());
    assert!(refused.contains("effects.valve_deadband.half_width` is 0.9"), "{refused}");
    // A delay longer than what is remembered in such steps.
    let mut model = Simulation::new(&press(Placement::Outside, &MachineSpec::default())).unwrap();
    model.set(Kind::Real, of(&model, "effects.command_delay.delay_s"), 0.02).unwrap();
    started(&mut model);
    assert!(told(model.step(1e-4)).contains("effects.command_delay of 0.02 s is more than 30 of them"));
    for junk in ["", "kind = 3", "[plant]\nmass_kg = -1.0"] {
        let resources = Resources::new(Subject::ElectricAxis, Placement::Inside, junk.into());
        assert!(Simulation::new(&resources).is_err(), "{junk}");
    }
    assert!(Simulation::new(&Resources::new(Subject::Monitor, Placement::Outside, "{}".into())).is_err());
}

/// Our own host reads what is written: every number with its unit, start and bounds; the same content gives the same bytes.
#[test]
fn archives_read_back() {
    let resources = press(Placement::Outside, &MachineSpec::default());
    let mut library = b"\x7fELF\x02\x01".to_vec();
    library.resize(64, 0);
    library[18] = 62;
    for version in [Version::Two, Version::Three] {
        let mut package = Package::new(&resources, version).unwrap();
        assert_eq!(
            package.add_library(Platform::ArmLinux, library.clone()),
            Err(LibraryError(Platform::ArmLinux))
        );
        package.add_library(Platform::X86Linux, library.clone()).unwrap();
        let bytes = package.write(Cursor::new(Vec::new())).unwrap().into_inner();
        assert_eq!(bytes, package.write(Cursor::new(Vec::new())).unwrap().into_inner());
        let fmu = Fmu::read(Cursor::new(bytes)).unwrap();
        assert!(fmu.binary("x86_64-linux").unwrap().ends_with("/seepd_press.so"));
        assert_eq!((fmu.description.version, fmu.description.token.as_str()), (version, resources.token()));
        let model = Simulation::new(&resources).unwrap();
        assert_eq!(fmu.description.variables.len(), model.variables().len());
        for (read, written) in fmu.description.variables.iter().zip(model.variables()) {
            assert_eq!(
                (read.name.as_str(), read.unit.as_deref()),
                (written.name.as_str(), Some(written.unit))
            );
            assert_eq!(read.bounds, written.bounds, "{}", read.name);
            if written.causality == Causality::Parameter {
                assert_eq!(read.start, Some(written.start), "{}", read.name);
            }
        }
        let mass = fmu.description.variable("plant.mass_kg").unwrap();
        assert_eq!(fmu.description.unit_of(mass).unwrap().exponents[..3], [1, 0, 0]);
    }
}
