//! Logs as others write them: every signal that is assigned is the right one, or it is asked.

use seepd_logs::columns::Column;
use seepd_signals::Signal;

use super::test_logs::{column, log, measured, press};
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

fn rendered(columns: &[As]) -> Vec<Column> {
    let render = |As { signal, field, unit, per_si, offset }: &As| {
        column(field, *unit, measured(press(), *signal).into_iter().map(|value| value * per_si + offset))
    };
    columns.iter().map(render).collect()
}

fn proposed(columns: &[As]) -> SignalProposal {
    propose(&log(rendered(columns)), &Hints::default())
}

/// That a signal is that column, with the way back to SI.
fn assert_is(found: &SignalProposal, columns: &[As], signal: Signal, field: &str) {
    let assigned = found.assigned.get(&signal).unwrap_or_else(|| panic!("{signal:?} is missing: {found:#?}"));
    assert_eq!(assigned.mapping.field, field, "{found:#?}");
    let As { per_si, offset, .. } = columns.iter().find(|column| column.field == field).unwrap();
    let mapping = &assigned.mapping;
    assert!((mapping.scale * per_si - 1.0).abs() < 1e-9, "{signal:?}: scale {}: {found:#?}", mapping.scale);
    assert!((mapping.scale * offset + mapping.offset).abs() < 1e-9, "{signal:?}: offset {}", mapping.offset);
}

#[test]
fn the_press_with_its_own_names() {
    use Signal::{Command, Demand, Position};
    let columns = [
        of(Command, "command", None, 1.0, 0.0),
        of(Demand, "demand", None, 1.0, 0.0),
        of(Position, "position", None, 1.0, 0.0),
    ];
    let found = proposed(&columns);
    for (signal, field) in [(Command, "command"), (Demand, "demand"), (Position, "position")] {
        assert_is(&found, &columns, signal, field);
    }
    assert_eq!(found.questions, []);
}

#[test]
fn names_that_say_nothing_and_a_4_to_20_ma_command_of_reversed_sign() {
    use Signal::{Command, Demand, Position};
    let columns = [
        of(Position, "ch1", None, 1000.0, 0.0),
        of(Command, "ch2", Some("mA"), -8.0, 12.0),
        of(Demand, "ch3", None, 1000.0, 0.0),
    ];
    let found = proposed(&columns);
    for (signal, field) in [(Command, "ch2"), (Demand, "ch3"), (Position, "ch1")] {
        assert_is(&found, &columns, signal, field);
    }
}
