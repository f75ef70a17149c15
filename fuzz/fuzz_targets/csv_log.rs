//! A CSV log, with its time in a column of seconds, in one of another name, and by a rate.
//! Parser: crates/logs/src/csv.rs crates/logs/src/rows.rs crates/logs/src/table.rs crates/logs/src/table_time.rs crates/logs/src/civil.rs
#![no_main]
use seepd_logs::{CsvSource, LogMapping, Source};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let of_column =
        |time_column: &str| LogMapping { time_column: time_column.into(), ..LogMapping::default() };
    let by_rate = LogMapping { sample_rate_hz: Some(1000.0), ..LogMapping::default() };
    for mapping in [of_column("t_s"), of_column("Time"), by_rate] {
        let Ok(mut source) = CsvSource::new(data, "log", &mapping) else { continue };
        while let Ok(Some(_)) = source.next_sample() {}
        let _ = source.notes();
    }
});
