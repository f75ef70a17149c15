//! A configuration file.
//! Parser: crates/daemon/src/config/mod.rs crates/daemon/src/config/axis.rs crates/daemon/src/config/endpoint.rs crates/daemon/src/config/plant.rs crates/daemon/src/config/sinks.rs
#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(config) = seepd::config::DaemonConfig::parse(text) {
        config.axes.iter().for_each(|axis| drop(axis.log_mapping().places()));
    }
});
