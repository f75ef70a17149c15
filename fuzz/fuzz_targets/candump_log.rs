//! A candump log, read with a DBC file of every kind of field.
#![no_main]
use std::sync::LazyLock;

use seepd_logs::can::dbc::Dbc;
use seepd_logs::can::decode::FrameDecoder;
use seepd_logs::{CandumpSource, LogMapping, Selection, Source};

static DBC: LazyLock<Dbc> = LazyLock::new(|| {
    let text = include_bytes!("../../tests/fixtures/can/dbc/multiplex_2.dbc");
    Dbc::parse(text, "multiplex_2.dbc").expect("a DBC file")
});

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    for command in ["Normal.S2", "Extended.S8"] {
        let selection = Selection { command: Some(command.into()), ..Selection::default() };
        let mapping = LogMapping { selection, ..LogMapping::default() }.places();
        let Ok(decoder) = FrameDecoder::new(mapping, None, Some(&DBC)) else { return };
        let mut source = CandumpSource::new(data, "log", decoder);
        while let Ok(Some(_)) = source.next_sample() {}
        let _ = source.notes();
    }
});
