//! A log of any kind, archives and MDF included, as far as its bytes tell: surveyed, then read.
#![no_main]
use std::io::Cursor;

use seepd_logs::fuzzing::read_log;
use seepd_logs::survey::survey;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    // What unpacks to gigabytes is read as a stream, which takes its time.
    let _ = survey(Cursor::new(data), "log", "t_s", None);
    for command in ["command", "valve"] {
        read_log(data, command);
    }
});
