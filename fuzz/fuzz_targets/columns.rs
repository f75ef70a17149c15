//! A log of any kind as columns over one grid of time; of a bus, with a DBC file.
//! Parser: crates/logs/src/columns/mod.rs:read,by_opening,surveyed,nothing_to_see,wanted_fields crates/logs/src/columns/fill.rs crates/logs/src/columns/grid.rs crates/logs/src/columns/time_column.rs:find,rank,as_time,as_stamps,taken_as_told,clock_step,named_unit,unit_of_date,unit_of_step,heads,listed_heads crates/logs/src/columns/unit.rs crates/logs/src/bus_survey.rs
#![no_main]
use std::io::Cursor;
use std::sync::LazyLock;

use seepd_logs::TimeUnit;
use seepd_logs::can::dbc::Dbc;
use seepd_logs::columns::{Columns, Known};

static KNOWN: LazyLock<[Known; 2]> = LazyLock::new(|| {
    let text = include_bytes!("../../tests/fixtures/can/dbc/multiplex_2.dbc");
    let dbc = Some(Dbc::parse(text, "multiplex_2.dbc").expect("a DBC file"));
    [
        Known { dbc, ..Known::default() },
        Known { time_column: Some("t".into()), time_unit: Some(TimeUnit::Ms), dbc: None },
    ]
});

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    for known in &*KNOWN {
        if let Ok(columns) = Columns::read(Cursor::new(data), "log", known) {
            let samples = columns.columns.first().map_or(0, |column| column.values.len());
            assert!(
                columns.rate_hz > 0.0 && columns.columns.iter().all(|column| column.values.len() == samples)
            );
        }
    }
});
