//! Moves that begin open loop: what the valve's own command does, how position control takes over, and what a leak changes of it.

use seepd_sim::cycle::{CycleRun, OpenLoop};
use seepd_sim::{Input, Machine, MachineSpec, Schedule, SimulatedSignals};

const TICK_S: f64 = 1e-3;

/// The nominal press, whose `extend`, from 0.5 s to 2.5 s and from 0.10 m to 0.35 m, is begun at a command of 0.1 until 1.2 s.
fn begun_open_loop() -> MachineSpec {
    let mut spec = MachineSpec::default();
    spec.cycle.moves[0].open_loop = Some(OpenLoop { to_s: 1.2, command: vec![0.0, 0.1, 0.1, 0.1, 0.0] });
    spec
}

fn cycle(spec: &MachineSpec, leak_area_m2: f64) -> Vec<SimulatedSignals<f64>> {
    let machine = Machine::<f64>::new(&[spec]);
    let mut state = machine.start();
    let runs = vec![CycleRun::with_leak(leak_area_m2)];
    Schedule::new(&spec.cycle, TICK_S, runs)
        .take(10_000)
        .map(|sample| machine.tick(&mut state, &Input::gather(&[sample])))
        .collect()
}

fn at(seconds: f64) -> usize {
    (seconds / TICK_S).round() as usize
}

/// The command is the move's own, whatever the leak; the way is the integral of what the valve passes, less the leak.
#[test]
fn analytic_an_open_loop_part_goes_as_far_as_its_command_takes_it() {
    let spec = begun_open_loop();
    let (sound, worn) = (cycle(&spec, 0.0), cycle(&spec, 3e-6));
    for (one, other) in sound[at(0.5)..at(1.2)].iter().zip(&worn[at(0.5)..at(1.2)]) {
        assert_eq!(one.command.to_bits(), other.command.to_bits());
        assert_eq!(one.demand, one.position);
        assert_eq!(other.demand, other.position);
    }
    assert_eq!(sound[at(0.675)].command, 0.1);
    // Steadily, each land passes K u sqrt(dp): the rod chamber's oil leaves by A2 v = K u sqrt(p_rod - p_return), the cap's comes in by
    // A1 v = K u sqrt(p_inlet - p_cap) and loses the leak.
    let p = &spec.plant;
    for (signals, leak) in [(&sound, 0.0), (&worn, 1.0)] {
        let (mut way, mut passed) = (0.0, 0.0);
        for pair in signals[at(0.7)..at(1.0)].windows(2) {
            let now = &pair[0];
            let flow = p.valve_m3_per_s_sqrt_pa * now.command * (now.p_inlet - now.p_cap).max(0.0).sqrt();
            passed += (flow - leak * now.leak_flow) / p.cap_area_m2 * TICK_S;
            way += pair[1].position - now.position;
        }
        assert!((way / passed - 1.0).abs() < 0.01, "{way} {passed}");
    }
    // Where both chambers' pressures are near each other, the larger area wins: this leak takes the piston further out.
    let [sound_m, worn_m] = [&sound, &worn].map(|signals| signals[at(1.2)].position);
    assert!(sound_m - 0.10 > 0.03 && (worn_m - sound_m).abs() > 5e-3, "{sound_m} {worn_m}");
}

/// Position control begins where the machine is: neither demand nor command jumps, and both machines end where the move does.
#[test]
fn analytic_position_control_goes_on_from_where_the_machine_is() {
    let mut spec = begun_open_loop();
    for (kd, feed_forward, compensation) in [(0.0, 0.0, 0.0), (0.05, 0.5, 0.0), (0.0, 0.0, 0.02)] {
        let c = &mut spec.controller;
        (c.kd, c.velocity_feed_forward_s_per_m, c.dead_band_compensation) = (kd, feed_forward, compensation);
        // Taken over in full motion.
        spec.cycle.moves[0].open_loop = Some(OpenLoop { to_s: 1.2, command: vec![0.1] });
        for leak_area_m2 in [0.0, 3e-6] {
            let signals = cycle(&spec, leak_area_m2);
            let fastest = spec.cycle.moves[0].to_m / 2.0 * 1.875 * TICK_S;
            for pair in signals[at(1.19)..at(2.9)].windows(2) {
                assert!((pair[1].demand - pair[0].demand).abs() < 1.5 * fastest, "{:?}", pair[1].demand);
            }
            let [before, after] = [-1.0, 0.0].map(|tick| signals[at(1.2 + tick * TICK_S)].command);
            // The demand's speed becomes the plan's at once, which feed-forward shows.
            let most = 0.02 + compensation + 0.1 * feed_forward;
            assert!((after - before).abs() < most, "{before} {after}");
            for (second, wanted_m) in [(2.5, 0.35), (5.0, 0.38), (9.9, 0.10)] {
                assert!((signals[at(second)].demand - wanted_m).abs() < 1e-12);
            }
            // The integrator has still to learn of the leak.
            let settled_m = if leak_area_m2 == 0.0 { 10e-3 } else { 20e-3 };
            assert!((signals[at(2.95)].position - 0.35).abs() < settled_m, "{}", signals[at(2.95)].position);
        }
    }
}

/// Of the distance beside the plan as much is left as of the way.
#[test]
fn analytic_the_demand_comes_back_to_the_plan_with_the_way() {
    let mut spec = begun_open_loop();
    spec.cycle.moves[0].course = vec![0.0, 1.0];
    let signals = cycle(&spec, 2e-6);
    let beside = |second: f64| signals[at(second)].demand - spec.cycle.demand_m(second);
    let handed_over = signals[at(1.199)].position - spec.cycle.demand_m(1.199);
    // 1.3 s are left of the move of 2 s, and its course is a straight line.
    for (second, share) in [(1.2, 1.0), (1.85, 0.5), (2.175, 0.25), (2.6, 0.0)] {
        assert!((beside(second) - share * handed_over).abs() < 1e-9, "{second}: {}", beside(second));
    }
    // Where the plan is at its end already, time brings it back.
    spec.cycle.moves[0].course = vec![0.0, 1.0, 1.0, 1.0];
    let signals = cycle(&spec, 0.0);
    let beside = |second: f64| signals[at(second)].demand - spec.cycle.demand_m(second);
    let handed_over = signals[at(1.199)].position - spec.cycle.demand_m(1.199);
    assert!(handed_over < -0.1);
    assert!((beside(1.2) - handed_over).abs() < 1e-4 && (beside(1.85) - 0.5 * handed_over).abs() < 1e-9);
    assert_eq!(beside(2.5), 0.0);
}

/// A command that the controller gave, given open loop, moves the machine alike: only where the leak is the same.
#[test]
fn property_the_controllers_own_command_given_open_loop_changes_nothing() {
    let closed = MachineSpec::default();
    let own = cycle(&closed, 0.0);
    let mut open = closed.clone();
    let command: Vec<f64> = own[at(0.5)..=at(1.2)].iter().map(|signals| signals.command).collect();
    open.cycle.moves[0].open_loop = Some(OpenLoop { to_s: 1.2, command });
    let signals = cycle(&open, 0.0);
    for second in [0.8, 1.1, 1.2] {
        let (here, there) = (signals[at(second)].position, own[at(second)].position);
        assert!((here - there).abs() < 1e-7, "{second}: {here} {there}");
    }
}

/// Slower runs go the same way by a smaller command.
#[test]
fn a_stretched_run_goes_as_far() {
    let spec = begun_open_loop();
    let machine = Machine::<f64>::new(&[&spec]);
    let end = |stretch: f64| {
        let run = CycleRun { stretch, ..CycleRun::with_leak(0.0) };
        let mut state = machine.start();
        let ticks = (1200.0 * stretch).round() as usize;
        Schedule::new(&spec.cycle, TICK_S, vec![run])
            .take(ticks)
            .map(|sample| machine.tick(&mut state, &Input::gather(&[sample])).position)
            .last()
            .unwrap()
    };
    assert!(((end(1.1) - 0.10) / (end(1.0) - 0.10) - 1.0).abs() < 0.01);
}

#[test]
fn an_open_loop_part_is_read_written_and_checked() {
    let text = begun_open_loop().to_toml().unwrap();
    assert!(text.contains("open_loop"), "{text}");
    assert_eq!(MachineSpec::from_toml(&text).unwrap(), begun_open_loop());
    assert!(!MachineSpec::default().to_toml().unwrap().contains("open_loop"));
    for (to_s, command, wanted) in [
        (2.5, vec![0.3], "cycle.moves[0].open_loop.to_s"),
        (0.5, vec![0.3], "cycle.moves[0].open_loop.to_s"),
        (f64::NAN, vec![0.3], "cycle.moves[0].open_loop.to_s"),
        (1.2, vec![], "open_loop.command"),
        (1.2, vec![0.3, 1.2], "open_loop.command[1]"),
        (1.2, vec![f64::NAN], "open_loop.command[0]"),
    ] {
        let mut spec = MachineSpec::default();
        spec.cycle.moves[0].open_loop = Some(OpenLoop { to_s, command });
        let error = spec.check().unwrap_err().to_string();
        assert!(error.contains(wanted), "{error}");
    }
}
