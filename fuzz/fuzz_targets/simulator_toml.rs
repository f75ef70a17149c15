//! A file of a user's simulator: what is accepted can be written and read back the same.
//! Parser: crates/simulator/src/spec.rs
#![no_main]
use seepd_simulator::SimulatorSpec;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(spec) = SimulatorSpec::from_toml(text) {
        let written = spec.to_toml().expect("a checked file can be written");
        assert_eq!(SimulatorSpec::from_toml(&written).expect("and read"), spec);
    }
});
