//! What a daemon finds after a power cut: a state file and an entry of the spool.
#![no_main]
use seepd::sink::mqtt::spool::Entry;
use seepd::live::state;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let _ = state::parse(&String::from_utf8_lossy(data));
    let _ = Entry::parse(data);
});
