//! A CSV log.
#![no_main]
use seepd_logs::{CsvSource, LogMapping, Source};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Ok(mut source) = CsvSource::new(data, "log", &LogMapping::default()) else { return };
    while let Ok(Some(_)) = source.next_sample() {}
    let _ = source.notes();
});
