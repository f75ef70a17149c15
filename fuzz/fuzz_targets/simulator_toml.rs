//! A file of a user's simulator: what is accepted can be written and read back the same.
//! Parser: crates/simulator/src/spec.rs:from_toml,to_toml,is_kind,check,check_inside,check_simulator,check_fmu,check_process,known_names,bounds,takes_load,is_stepped,has,tick_s,signals,nominal_force_n,command_and_position,yes,is_not,a_minute,one
#![no_main]
use seepd_simulator::SimulatorSpec;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let _ = SimulatorSpec::is_kind(text);
    match SimulatorSpec::from_toml(text) {
        Ok(spec) => {
            let _ = (spec.signals(), spec.is_stepped());
            let written = spec.to_toml().expect("a checked file can be written");
            assert_eq!(SimulatorSpec::from_toml(&written).expect("and read"), spec);
        }
        Err(error) => drop(error.to_string()),
    }
});
