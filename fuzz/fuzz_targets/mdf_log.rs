//! An MDF log: surveyed, then read, measured signals and the frames of a bus.
//! Parser: crates/logs/src/mdf/mod.rs crates/logs/src/mdf/block.rs crates/logs/src/mdf/channel.rs crates/logs/src/mdf/frames.rs crates/logs/src/mdf/records.rs crates/logs/src/mdf/signals.rs crates/logs/src/mdf/stream.rs crates/logs/src/survey.rs:survey_mdf
#![no_main]
use std::io::Cursor;

use seepd_logs::fuzzing::read_file;
use seepd_logs::survey::survey;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    // Other kinds have targets of their own.
    if !(data.starts_with(b"MDF ") || data.starts_with(b"UnFinMF ")) {
        return;
    }
    let _ = survey(Cursor::new(data), "log", "t_s", None);
    for command in ["command", "valve", ""] {
        read_file(data, false, command);
    }
});
