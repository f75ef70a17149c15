//! A DBC file: every signal that it names, looked up and read from a frame.
//! Parser: crates/logs/src/can/dbc.rs crates/logs/src/can/bit_field.rs
#![no_main]
use seepd_logs::can::candump::Line;
use seepd_logs::can::dbc::Dbc;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Ok(dbc) = Dbc::parse(data, "fuzzed.dbc") else { return };
    for name in dbc.names().take(50).collect::<Vec<_>>() {
        let Ok(signal) = dbc.find(&name) else { continue };
        let line = format!("(1.0) can0 {}#0123456789ABCDEF", signal.frames.identifier);
        let frame = Line::parse(line.as_bytes()).expect("a frame").frame;
        let _ = signal.read(&frame);
    }
});
