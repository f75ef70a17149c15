//! An FMU's archive and its description: junk is refused, and what is accepted has a plant file that reads once it is completed.
//! Parser: crates/fmi/src/archive.rs crates/fmi/src/description.rs crates/simulator/src/proposal.rs
#![no_main]
use std::io::Cursor;

use seepd_fmi::{Fmu, ModelDescription};
use seepd_simulator::proposal;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Ok(fmu) = Fmu::read(Cursor::new(data)) {
        proposed(&fmu.description);
    }
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(description) = ModelDescription::parse(text) {
        proposed(&description);
    }
});

fn proposed(description: &ModelDescription) {
    let _ = proposal::overview(description);
    let text = proposal::plant_file("model.fmu", description);
    toml::from_str::<toml::Table>(&text).expect("the proposal is TOML");
}
