//! What a daemon finds after a power cut: a state file, an entry of the spool, and what pages draw.
//! Parser: crates/daemon/src/live/state.rs:parse,of_alarm,parse_trends,parse_events crates/daemon/src/sink/mqtt/spool.rs:parse
#![no_main]
use seepd::live::state;
use seepd::sink::mqtt::spool::Entry;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let _ = state::parse(&String::from_utf8_lossy(data));
    state::parse_drawn(data);
    let _ = Entry::parse(data);
});
