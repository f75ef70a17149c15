//! A CSV log.
#![no_main]
use seepd::config::Config;
use seepd::source::{Source, csv::CsvSource};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Ok(mut source) = CsvSource::new(data, "log", &Config::default().mapping(), "t_s", None) else { return };
    while let Ok(Some(_)) = source.next_sample() {}
    let _ = source.notes();
});
