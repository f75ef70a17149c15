//! A bus's log in every format, by the bytes that tell it: text a line a frame, or BLF; read with a DBC file of every kind of field.
//! Parser: crates/logs/src/bus_log.rs crates/logs/src/can/asc.rs crates/logs/src/can/blf.rs crates/logs/src/can/busmaster.rs crates/logs/src/can/candump.rs crates/logs/src/can/savvycan.rs crates/logs/src/can/trc.rs crates/logs/src/can/text_log.rs:new,take,logged,next_frame,place crates/logs/src/can/words.rs crates/logs/src/can/logged.rs
#![no_main]
use std::sync::LazyLock;

use seepd_logs::can::blf::Blf;
use seepd_logs::can::dbc::Dbc;
use seepd_logs::can::decode::FrameDecoder;
use seepd_logs::can::logged::FrameLog;
use seepd_logs::can::text_log::{TextFormat, TextLog};
use seepd_logs::{BusLogSource, LogKind, LogMapping, Selection, Source};

static DBC: LazyLock<Dbc> = LazyLock::new(|| {
    let text = include_bytes!("../../tests/fixtures/can/dbc/multiplex_2.dbc");
    Dbc::parse(text, "multiplex_2.dbc").expect("a DBC file")
});

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let frames: Box<dyn FrameLog + Send> = match LogKind::of(data, "log") {
        Ok(LogKind::Frames(format)) => Box::new(TextLog::new(data, format)),
        Ok(LogKind::Blf) => match Blf::new(data) {
            Ok(blf) => Box::new(blf),
            Err(_) => return,
        },
        _ => Box::new(TextLog::new(data, TextFormat::Candump)),
    };
    let selection = Selection { command: Some("Extended.S8".into()), ..Selection::default() };
    let mapping = LogMapping { selection, ..LogMapping::default() }.places();
    let Ok(decoder) = FrameDecoder::new(mapping, None, Some(&DBC)) else { return };
    let mut source = BusLogSource::new(frames, "log", decoder);
    while let Ok(Some(_)) = source.next_sample() {}
    let _ = source.notes();
});
