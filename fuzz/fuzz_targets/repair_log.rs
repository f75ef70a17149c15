//! Repair logs, entries given by hand, and who takes note of a flag.
//! Parser: crates/daemon/src/repair_log.rs:parse,check_texts,parse_time,time_text crates/daemon/src/hub/order.rs:from_json,said,at
#![no_main]
use seepd::hub::{NewRepair, Signature};
use seepd::repair_log;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let _ = Signature::from_json(data);
    if let Ok(entry) = NewRepair::from_json(data) {
        let _ = entry.at(0);
    }
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(repairs) = repair_log::parse(text, "press") {
        for repair in repairs {
            // A time that the file is given back is the same one, but for seconds without a date, which are rounded.
            let again = repair_log::parse_time(&repair_log::time_text(repair.at_ns)).expect("a time");
            assert!(again.abs_diff(repair.at_ns) <= repair.at_ns.unsigned_abs() >> 50);
        }
    }
});
