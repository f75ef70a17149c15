//! A configuration file; what is accepted is told of, and its signals are looked up.
//! Parser: crates/daemon/src/config/mod.rs:parse,parse_unchecked,into_axis,remarks,check_name,named_twice crates/daemon/src/config/axis.rs:default,check,is_relative,check_duty_cycles,remark,log_mapping crates/daemon/src/config/endpoint.rs crates/daemon/src/config/plant.rs:default,connection,place,remark,check crates/logs/src/can/decode.rs:find,frames_of crates/daemon/src/config/sinks.rs:default,remark,check_listen,is_local,check_connection,check,places,check_axis,remarks,one
#![no_main]
use seepd::config::DaemonConfig;
use seepd_logs::can::decode::FrameDecoder;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Ok(config) = DaemonConfig::parse(text) else { return };
    let _ = config.remarks();
    for mapping in config.axes.iter().map(|axis| axis.log_mapping()) {
        let _ = FrameDecoder::new(mapping.places(), mapping.counter.as_ref(), None);
    }
    let _ = config.into_axis(Some("press"));
});
