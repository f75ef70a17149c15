//! A configuration file.
#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(config) = seepd::config::DaemonConfig::parse(text) {
        config.axes.iter().for_each(|axis| drop(axis.log_mapping().places()));
    }
});
