//! Logs as others write them: every signal that is assigned is the right one with the right way to SI, or it is asked.

use seepd_logs::columns::{Column, Columns, Known};
use seepd_logs::{TimeUnit, open_with};
use seepd_signals::Signal;
use seepd_signals::Signal::{Command, Demand, Load, PCap, PInlet, PRod, PSupply, Position};

use seepd_sim::{MachineSpec, SimulatedSignals};

use super::test_logs::{column, log, measured, press, simulated};
use super::{Hints, SignalProposal, propose};

/// A column of a simulated signal: `value · per_si + offset`.
struct As {
    signal: Signal,
    field: &'static str,
    unit: Option<&'static str>,
    per_si: f64,
    offset: f64,
}

const fn of(signal: Signal, field: &'static str, unit: Option<&'static str>, per_si: f64, offset: f64) -> As {
    As { signal, field, unit, per_si, offset }
}

/// In the signal's own unit, under that name.
const fn si(signal: Signal, field: &'static str) -> As {
    of(signal, field, None, 1.0, 0.0)
}

fn rendered(columns: &[As]) -> Vec<Column> {
    rendered_of(press(), columns)
}

fn rendered_of(machine: &[SimulatedSignals<f64>], columns: &[As]) -> Vec<Column> {
    let render = |As { signal, field, unit, per_si, offset }: &As| {
        column(field, *unit, measured(machine, *signal).into_iter().map(|value| value * per_si + offset))
    };
    columns.iter().map(render).collect()
}

/// What is wrong with a proposal: signals that are other columns, or have another way to SI.
fn wrong(found: &SignalProposal, columns: &[As]) -> Vec<String> {
    let is_right = |signal: &Signal, column: usize| {
        let mapping = &found.assigned[signal].mapping;
        columns.get(column).is_some_and(|of| {
            let back = (mapping.scale * of.per_si - 1.0).abs() < 1e-6;
            let zero =
                (mapping.scale * of.offset + mapping.offset).abs() < 1e-6 * (1.0 + mapping.offset.abs());
            of.signal == *signal && back && zero
        })
    };
    let assigned = found.assigned.iter().filter(|(signal, assigned)| !is_right(signal, assigned.column));
    assigned
        .map(|(signal, assigned)| format!("{signal:?} is {:?}, {:?}", assigned.mapping, assigned.evidence))
        .collect()
}

/// That all of these are assigned, and all that are assigned are right.
fn assert_found(columns: &[As], extra: Vec<Column>, sure: &[Signal]) -> SignalProposal {
    let names: Vec<&str> = columns.iter().map(|column| column.field).collect();
    let found = propose(&log([rendered(columns), extra].concat()), &Hints::default());
    assert_eq!(wrong(&found, columns), [""; 0], "{names:?}");
    let missing: Vec<_> = sure.iter().filter(|signal| !found.assigned.contains_key(signal)).collect();
    assert!(
        missing.is_empty(),
        "{names:?}: {missing:?} are missing, {:?} {:?}",
        found.questions,
        found.refusal
    );
    found
}

/// Ways to write the position loop: names, units, scales, order, sign.
#[test]
fn property_no_way_to_write_a_position_loop_is_taken_wrongly() {
    let all = [Command, Demand, Position];
    let [u, d, x] = all;
    let table: Vec<(Vec<As>, &[Signal])> = vec![
        (vec![si(u, "command"), si(d, "demand"), si(x, "position")], &all),
        (vec![si(x, "c"), si(u, "a"), si(d, "b")], &all),
        (vec![si(u, "u"), si(x, "x")], &[Command, Position]),
        (vec![si(u, "value")], &[Command]),
        (vec![of(u, "out", Some("%"), 100.0, 0.0), of(x, "pos", Some("mm"), 1e3, 0.0)], &[Command, Position]),
        (vec![of(u, "out", None, 100.0, 0.0), of(x, "pos", None, 1e3, 0.0)], &[Command, Position]),
        (
            vec![of(u, "ch1", Some("V"), 10.0, 0.0), of(x, "ch2", Some("cm"), 100.0, 0.0)],
            &[Command, Position],
        ),
        (vec![of(u, "ch1", None, 10.0, 0.0), si(x, "ch2")], &[Position]),
        (vec![of(u, "ch1", Some("mV"), 1e4, 0.0), si(x, "ch2")], &[Command, Position]),
        (vec![of(u, "I", Some("mA"), 8.0, 12.0), si(x, "ch2")], &[Command, Position]),
        (vec![of(u, "I", None, 8.0, 12.0), si(x, "ch2")], &[Command, Position]),
        (vec![of(u, "I", Some("mA"), 10.0, 10.0), si(x, "ch2")], &[Command, Position]),
        (vec![of(u, "I", Some("mA"), 20.0, 0.0), si(x, "ch2")], &[Position]),
        (vec![of(u, "Uv", Some("V"), 5.0, 5.0), si(x, "ch2")], &[Command, Position]),
        (vec![of(u, "Uv", None, 5.0, 5.0), si(x, "ch2")], &[Command, Position]),
        (vec![of(u, "y", Some("%"), 50.0, 50.0), si(x, "ch2")], &[Command, Position]),
        (vec![of(u, "y", None, 50.0, 50.0), si(x, "ch2")], &[Command, Position]),
        (vec![of(u, "y", None, 0.5, 0.5), si(x, "ch2")], &[Command, Position]),
        (vec![of(u, "y", None, -1.0, 0.0), si(x, "ch2")], &[Command, Position]),
        (vec![of(u, "y", Some("V"), -10.0, 0.0), si(x, "ch2"), si(d, "ch3")], &all),
        (vec![of(u, "y", Some("mA"), -8.0, 12.0), si(x, "ch2"), si(d, "ch3")], &all),
        (vec![of(u, "y", None, 10_000.0, 0.0), si(x, "ch2")], &[Position]),
        (vec![of(u, "y", None, 32_767.0, 0.0), si(x, "ch2")], &[Position]),
        (vec![of(u, "y", None, 27_648.0, 0.0), si(x, "ch2")], &[Position]),
        (vec![of(u, "y", None, 27_648.0 / 2.0, 27_648.0 / 2.0), si(x, "ch2")], &[Position]),
        (vec![of(x, "x", None, 39.3701, 0.0), si(u, "u")], &[Command]),
        (vec![of(x, "x", Some("inch"), 1.0 / 0.0254, 0.0), si(u, "u")], &[Command, Position]),
        (vec![of(x, "x", None, 100.0, 0.0), si(u, "u")], &[Command]),
        (
            vec![
                of(x, "Kolbenweg", Some("mm"), 1e3, 0.0),
                of(d, "Sollweg", Some("mm"), 1e3, 0.0),
                si(u, "Stellgröße"),
            ],
            &all,
        ),
        (
            vec![
                of(x, "IstPosition", None, 1e3, 0.0),
                of(d, "SollPosition", None, 1e3, 0.0),
                of(u, "VentilSollwert", Some("%"), 100.0, 0.0),
            ],
            &all,
        ),
        (vec![si(d, "position_command"), si(x, "position_feedback"), si(u, "pid")], &all),
        (vec![si(u, "demand_valve"), si(d, "target"), si(x, "lvdt")], &all),
        (
            vec![
                of(d, "set [mm]", Some("mm"), 1e3, 0.0),
                of(x, "act [mm]", Some("mm"), 1e3, 0.0),
                of(u, "out [V]", Some("V"), 10.0, 0.0),
            ],
            &all,
        ),
        // Names that lie: physics decides, or asks.
        (vec![si(x, "demand"), si(d, "position"), si(u, "u")], &[Command]),
        (vec![si(u, "data[0]"), si(x, "data[1]"), si(d, "data[2]")], &all),
        // Units that cannot be: asked.
        (vec![of(u, "u", Some("%"), 1.0, 0.0), si(x, "x")], &[Position]),
        (vec![of(u, "u", Some("V"), 100.0, 0.0), si(x, "x")], &[Position]),
    ];
    for (columns, sure) in table {
        assert_found(&columns, Vec::new(), sure);
    }
}

/// Ways to write pressures and load beside command and position.
#[test]
fn property_no_way_to_write_pressures_and_load_is_taken_wrongly() {
    let bar = |signal: Signal, field: &'static str| of(signal, field, Some("bar"), 1e-5, 0.0);
    let plain_bar = |signal: Signal, field: &'static str| of(signal, field, None, 1e-5, 0.0);
    let table: Vec<(Vec<As>, &[Signal])> = vec![
        (
            vec![
                si(PCap, "p_cap"),
                si(PRod, "p_rod"),
                si(PSupply, "p_supply"),
                si(PInlet, "p_inlet"),
                si(Load, "load"),
            ],
            &[PCap, PRod, PSupply, PInlet, Load],
        ),
        (vec![bar(PCap, "Druck Kolbenseite"), bar(PRod, "Druck Stangenseite")], &[PCap, PRod]),
        (vec![bar(PCap, "pA"), bar(PRod, "pB"), bar(PSupply, "pP")], &[PCap, PRod]),
        (vec![bar(PRod, "pA"), bar(PCap, "pB"), bar(PSupply, "pP")], &[PCap, PRod]),
        (vec![bar(PCap, "p1"), bar(PRod, "p2")], &[PCap, PRod]),
        (vec![bar(PRod, "ch5"), bar(PCap, "ch6")], &[PCap, PRod]),
        (vec![bar(PRod, "ch5"), bar(PCap, "ch6"), bar(PSupply, "ch7")], &[PCap, PRod, PSupply]),
        (vec![bar(PRod, "ch5"), bar(PCap, "ch6"), bar(PSupply, "ch7"), bar(PInlet, "ch8")], &[PCap, PRod]),
        (vec![plain_bar(PCap, "p_cap"), plain_bar(PRod, "p_rod")], &[PCap, PRod]),
        (vec![of(PCap, "p_cap", None, 1e-6, 0.0), of(PRod, "p_rod", None, 1e-6, 0.0)], &[]),
        (
            vec![of(PCap, "p_cap", Some("MPa"), 1e-6, 0.0), of(PRod, "p_rod", Some("kPa"), 1e-3, 0.0)],
            &[PCap, PRod],
        ),
        (vec![of(PCap, "p_cap", Some("psi"), 1.0 / 6_894.757_293_168, 0.0)], &[PCap]),
        (vec![bar(PCap, "p1")], &[PCap]),
        (vec![bar(PRod, "p1")], &[]),
        (vec![bar(PSupply, "pump_pressure")], &[PSupply]),
        // Swapped in words: asked.
        (vec![bar(PRod, "p_cap"), bar(PCap, "p_rod")], &[]),
        (
            vec![of(Load, "force", Some("kN"), -1e-3, 0.0), bar(PCap, "pA"), bar(PRod, "pB")],
            &[Load, PCap, PRod],
        ),
        (vec![of(Load, "force", Some("kN"), 1e-3, 0.0), bar(PCap, "pA"), bar(PRod, "pB")], &[Load]),
        (vec![of(Load, "Kraft", None, 1e-3, 0.0), bar(PCap, "pA"), bar(PRod, "pB")], &[PCap, PRod]),
        (vec![of(Load, "loadcell", Some("N"), -1.0, 0.0)], &[]),
        (vec![of(Load, "loadcell", Some("N"), 1.0, 0.0)], &[]),
    ];
    for (mut columns, sure) in table {
        columns.extend([si(Command, "command"), si(Position, "position")]);
        assert_found(&columns, Vec::new(), sure);
    }
}

/// What a transducer of another kind would show beside the press.
fn along(field: &str, unit: Option<&str>, value: impl Fn(usize) -> f64) -> Column {
    column(field, unit, (0..press().len()).map(value))
}

fn position_loop() -> Vec<As> {
    vec![si(Command, "ch1"), si(Demand, "ch2"), si(Position, "ch3")]
}

#[test]
fn temp_1_is_no_pressure_and_neither_are_currents_counters_and_drifts() {
    let traps = vec![
        along("Temp_1", None, |n| 41.0 + n as f64 * 1e-4 + (n as f64 / 1600.0).sin()),
        along("oil_temp", Some("bar"), |n| 160.0 + n as f64 * 1e-4),
        along("motor_current", Some("A"), |n| 80.0 + 60.0 * (n as f64 / 1600.0).sin()),
        along("pressure_setpoint", Some("bar"), |n| if n / 2000 % 2 == 0 { 100.0 } else { 160.0 }),
        along("cycle_count", None, |n| (n / 10_000) as f64),
        along("stamp", None, |n| 1.7e9 + n as f64 * 1e-3),
        along("state", None, |n| (n / 1000 % 4) as f64),
        along("p_term", None, |n| 200.0 * (n as f64 / 1600.0).sin()),
        along("spare", None, |_| 12.0),
    ];
    let found = assert_found(&position_loop(), traps, &[Command, Demand, Position]);
    assert_eq!(found.assigned.len(), 3, "{:#?}", found.assigned);
    assert_eq!(found.questions, []);
}

#[test]
fn a_control_error_a_speed_and_a_spool_are_no_commands() {
    let [command, demand, position] = [Command, Demand, Position].map(|signal| measured(press(), signal));
    let speed = |n: usize| {
        let at = |n: usize| position[n.clamp(10, position.len() - 11)];
        (at(n.clamp(10, position.len() - 11) + 10) - at(n.clamp(10, position.len() - 11) - 10)) * 50.0
    };
    let named = vec![
        along("error", None, |n| demand[n] - position[n]),
        along("speed", Some("m/s"), speed),
        along("valve_spool_feedback", None, |n| command[n.saturating_sub(12)]),
    ];
    assert_found(&position_loop(), named, &[Command, Demand, Position]);
    // Without names, too.
    for trap in [
        along("ch4", None, |n| demand[n] - position[n]),
        along("ch4", None, |n| 1000.0 * speed(n)),
        along("ch4", None, |n| command[n.saturating_sub(12)]),
    ] {
        let found = assert_found(&position_loop(), vec![trap], &[Command, Demand, Position]);
        assert_eq!(found.assigned[&Command].rivals.len(), 1);
    }
    // A log with the error and no command: asked, not taken.
    let columns = [si(Demand, "ch2"), si(Position, "ch3")];
    let error = along("ch4", None, |n| demand[n] - position[n]);
    let found = assert_found(&columns, vec![error], &[]);
    assert!(!found.assigned.contains_key(&Command));
    assert_eq!(found.questions.iter().map(|question| question.signal).collect::<Vec<_>>(), [Command]);
}

#[test]
fn a_log_without_a_command_is_refused_with_what_each_column_is() {
    let columns =
        [of(Demand, "command_mm", Some("mm"), 1e3, 0.0), of(Position, "position_mm", Some("mm"), 1e3, 0.0)];
    let extra =
        vec![along("force", Some("kN"), |n| (n as f64 / 900.0).sin()), along("k", None, |n| n as f64)];
    let found = assert_found(&columns, extra, &[]);
    assert_eq!(
        found.refusal.as_deref(),
        Some(
            "no column can be a valve command: `command_mm` is a length (mm); `position_mm` is a length (mm); `force` is a force (kN); \
             `k` only counts"
        )
    );
    assert_eq!(found.questions, []);
}

#[test]
fn two_axes_are_asked_and_the_answer_settles_the_rest() {
    let [command, position] = [Command, Position].map(|signal| measured(press(), signal));
    // The other axis does the same 4 s later.
    let later = |values: &[f64], n: usize| values[(n + values.len() - 4000) % values.len()];
    let columns = [si(Command, "left_valve"), si(Position, "left_pos")];
    let other = vec![
        along("right_valve", None, |n| later(&command, n)),
        along("right_pos", None, |n| later(&position, n)),
    ];
    let both = log([rendered(&columns), other].concat());
    let found = propose(&both, &Hints::default());
    assert_eq!(found.assigned.len(), 0, "{:#?}", found.assigned);
    let fields: Vec<&str> =
        found.questions[0].candidates.iter().map(|of| of.mapping.field.as_str()).collect();
    assert_eq!((found.questions[0].signal, fields), (Command, vec!["left_valve", "right_valve"]));
    let answer = found.questions[0].candidates[1].mapping.clone();
    let hints = Hints { given: [(Command, answer)].into(), ..Hints::default() };
    let found = propose(&both, &hints);
    assert_eq!(found.assigned[&Position].mapping.field, "right_pos");
    assert_eq!(found.questions, []);
}

#[test]
fn a_mark_rises_once_a_cycle_at_one_position() {
    let marks = vec![
        along("cycle_start", None, |n| f64::from(n % 10_000 < 50)),
        along("start_pump", None, |n| f64::from(n > 20_000)),
        along("valve_enable", None, |n| f64::from(n % 10_000 < 5000)),
    ];
    let columns = position_loop();
    let found = propose(&log([rendered(&columns), marks].concat()), &Hints::default());
    let mark = &found.assigned[&Signal::CycleStart];
    assert_eq!((mark.column, mark.mapping.scale, mark.mapping.offset), (3, 1.0, 0.0));
}

#[test]
fn a_known_stroke_tells_centimetres() {
    let columns = [si(Command, "u"), of(Position, "x", None, 100.0, 0.0)];
    let hints = Hints { stroke_m: Some(0.5), ..Hints::default() };
    let found = propose(&log(rendered(&columns)), &hints);
    assert_eq!(wrong(&found, &columns), [""; 0]);
    assert_eq!(found.assigned[&Position].mapping.scale, 0.01);
}

#[test]
fn slow_topics_and_gaps_change_nothing() {
    let mut columns = rendered(&position_loop());
    for values in columns.iter_mut().skip(1).map(|column| &mut column.values) {
        for at in 0..values.len() {
            values[at] = if (21_000..22_000).contains(&at) { f32::NAN } else { values[at / 20 * 20] };
        }
    }
    let found = propose(&log(columns), &Hints::default());
    assert_eq!(wrong(&found, &position_loop()), [""; 0]);
    assert!(
        [Command, Position].iter().all(|signal| found.assigned.contains_key(signal)),
        "{:?}",
        found.questions
    );
}

/// Machines with other loads, areas, controllers and wear, of which every column is unnamed.
#[test]
fn property_no_machine_is_taken_wrongly() {
    let plants = [
        "[plant]\nmass_kg = 900.0\n[effects.load_bias]\nforce_n = -5000.0\n",
        "[plant]\nannulus_area_m2 = 2.9e-3\n",
        "[controller]\nkp = 30.0\nki = 0.0\n[effects.valve_deadband]\nhalf_width = 0.04\n",
        "[effects.coulomb_friction]\nforce_n = 1500.0\n[effects.valve_lag]\nnatural_frequency_hz = 12.0\n",
    ];
    let bar = |signal: Signal, field: &'static str| of(signal, field, Some("bar"), 1e-5, 0.0);
    for plant in plants {
        let spec = MachineSpec::from_toml(plant).unwrap();
        let machine = simulated(&spec);
        let columns = [
            bar(PRod, "ch1"),
            bar(PSupply, "ch2"),
            si(Demand, "ch3"),
            of(Load, "force", Some("kN"), -1e-3, 0.0),
            si(Command, "ch4"),
            bar(PCap, "ch5"),
            of(Position, "ch6", None, 1e3, 0.0),
        ];
        let found = propose(&log(rendered_of(&machine, &columns)), &Hints::default());
        assert_eq!(wrong(&found, &columns), [""; 0], "{plant}");
        let all = [Command, Demand, Position, PSupply, PCap, PRod, Load];
        let keys: Vec<Signal> = found.assigned.keys().copied().collect();
        assert_eq!((keys, found.questions), (all.to_vec(), Vec::new()), "{plant}");
    }
}

#[test]
fn a_log_opens_with_the_mapping_that_was_proposed() {
    let signals = [Command, Position, PCap].map(|signal| measured(press(), signal));
    let row = |n: usize| {
        let [u, x, p] = signals.each_ref().map(|values| values[n]);
        format!("{};{:.5};{:.4};{:.3}\n", n, 12.0 - 8.0 * u, 1e3 * x, 1e-5 * p)
    };
    let rows: String = (0..20_000).map(row).collect();
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(
        file.path(),
        format!("Zeit [ms];Ventilstrom [mA];Kolbenweg [mm];Druck Kolbenseite [bar]\n{rows}"),
    )
    .unwrap();
    let columns = Columns::of_file(file.path(), &Known::default()).unwrap();
    let mapping = propose(&columns, &Hints::default()).mapping(&columns).unwrap();
    assert_eq!((mapping.time_column.as_str(), mapping.time_unit), ("Zeit [ms]", Some(TimeUnit::Ms)));
    let mut source = open_with(file.path(), &mapping, |_| {}).unwrap();
    for n in 0..20_000 {
        let sample = source.next_sample().unwrap().unwrap();
        assert_eq!(sample.time_ns, n as i64 * 1_000_000);
        for (signal, (values, tolerance)) in
            [Command, Position, PCap].into_iter().zip(signals.iter().zip([1e-5, 1e-6, 1e3]))
        {
            let read = sample.get(signal).unwrap();
            assert!((read - values[n]).abs() < tolerance, "{signal:?} {n}: {read} {}", values[n]);
        }
    }
}
