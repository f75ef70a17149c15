//! A plant file: what is accepted can be written and read back the same.
//! Parser: crates/sim/src/spec.rs:at_line,line_of,from_toml,to_toml,check,check_as,check_bounds,check_sensors,check_controller,check_cycle,check_effects,furthest_from_nominal,check_stability,located,check_ends,check_course,check_open_loop,readable,value_error,unknown_name,in_range crates/sim/src/electric.rs:from_toml,to_toml,check crates/settings/src/lib.rs:parse_toml,fmt,nearest,new,unknown_field
#![no_main]
use seepd_sim::MachineSpec;
use seepd_sim::electric::ElectricAxis;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    match MachineSpec::from_toml(text) {
        Ok(spec) => {
            let written = spec.to_toml().expect("a checked machine can be written");
            assert_eq!(MachineSpec::from_toml(&written).expect("and read"), spec);
        }
        Err(error) => drop(error.to_string()),
    }
    if ElectricAxis::is_kind(text)
        && let Ok(axis) = ElectricAxis::from_toml(text)
    {
        let written = axis.to_toml().expect("a checked axis can be written");
        assert_eq!(ElectricAxis::from_toml(&written).expect("and read"), axis);
    }
});
