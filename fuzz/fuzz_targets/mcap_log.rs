//! An MCAP log: samples up to where it ends, and notes. Without its magic bytes the input gets them.
#![no_main]
use std::io::Cursor;

use seepd::config::Config;
use seepd::source::{Source, kind::MCAP_MAGIC, mcap::McapSource};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let bytes = if data.starts_with(MCAP_MAGIC) { data.to_vec() } else { [MCAP_MAGIC, data].concat() };
    let Ok(mut source) = McapSource::new(Cursor::new(bytes), "log", Config::default().mapping()) else { return };
    while let Ok(Some(_)) = source.next_sample() {}
    let _ = source.notes();
});
