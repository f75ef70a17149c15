//! An MCAP log: samples up to where it ends, and notes. Without its magic bytes the input gets them.
#![no_main]
use std::io::Cursor;

use seepd_logs::{LogMapping, MCAP_MAGIC, McapSource, Source};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let bytes = if data.starts_with(MCAP_MAGIC) { data.to_vec() } else { [MCAP_MAGIC, data].concat() };
    let Ok(mut source) = McapSource::new(Cursor::new(bytes), "log", LogMapping::default().places()) else { return };
    while let Ok(Some(_)) = source.next_sample() {}
    let _ = source.notes();
});
