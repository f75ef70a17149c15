//! What an adopted machine's data sheet says: an error, or a plant that can be told.
//! Parser: crates/adopt/src/machine_data.rs crates/adopt/src/plant.rs:describe,check,circle_m2,set,known,usual,supply_pressure,cylinder,flow_share,valve,rest_of_the_plant,speed_fits,controller,soften_the_inlet,rated_land_pa,by_the_pump,speed_of crates/adopt/src/flow_curve.rs:possible_flow_percent,knee_of,stated
#![no_main]
use seepd_adopt::machine_data::MachineData;
use seepd_adopt::plant::{LoggedSize, describe};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Ok(data) = MachineData::from_toml(text) else { return };
    for (positions_m, speed_m_per_s, largest_command) in
        [(None, None, None), (Some((0.01, 0.2)), Some(0.3), Some(0.5)), (None, Some(0.3), Some(0.0))]
    {
        let logged =
            LoggedSize { log_period_s: 1e-3, period_s: 4.0, positions_m, speed_m_per_s, largest_command };
        match describe(&data, &logged) {
            Ok(plant) => drop(plant.spec.to_toml()),
            Err(error) => drop(error.to_string()),
        }
    }
});
