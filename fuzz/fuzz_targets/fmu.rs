//! An FMU's archive and its description: junk is refused, and what is accepted has a plant file that reads once it is completed.
//! Parser: crates/fmi/src/archive.rs:listed,read,binary,folder,platforms crates/fmi/src/description.rs crates/simulator/src/proposal.rs
#![no_main]
use std::io::Cursor;

use seepd_fmi::{Fmu, ModelDescription};
use seepd_simulator::proposal;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    match Fmu::read(Cursor::new(data)) {
        Ok(fmu) => {
            for platform in ["x86_64-linux", "x86_64-windows", "x86_64-darwin"] {
                let _ = fmu.binary(platform).map_err(|error| error.to_string());
            }
            proposed(&fmu.description);
        }
        Err(error) => drop(error.to_string()),
    }
    let Ok(text) = std::str::from_utf8(data) else { return };
    match ModelDescription::parse(text) {
        Ok(description) => proposed(&description),
        Err(error) => drop(error.to_string()),
    }
});

fn proposed(description: &ModelDescription) {
    let _ = proposal::overview(description);
    for variable in &description.variables {
        assert!(description.variable(&variable.name).is_some());
        let _ = description.unit_of(variable);
    }
    let text = proposal::plant_file("model.fmu", description);
    toml::from_str::<toml::Table>(&text).expect("the proposal is TOML");
}
