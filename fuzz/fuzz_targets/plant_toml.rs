//! A plant file: what is accepted can be written and read back the same.
//! Parser: crates/sim/src/spec.rs crates/sim/src/electric.rs:from_toml,check crates/settings/src/lib.rs
#![no_main]
use seepd_sim::MachineSpec;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(spec) = MachineSpec::from_toml(text) {
        let written = spec.to_toml().expect("a checked machine can be written");
        assert_eq!(MachineSpec::from_toml(&written).expect("and read"), spec);
    }
});
