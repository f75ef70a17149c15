//! Frames as a CAN socket gives them, read by bit layout with a counter; what is parsed is written back.
//! Parser: crates/logs/src/can/linux.rs crates/logs/src/can/decode.rs crates/logs/src/can/j1939.rs
#![no_main]
use std::sync::LazyLock;

use seepd_logs::LogMapping;
use seepd_logs::can::decode::FrameDecoder;
use seepd_logs::can::{Content, linux};
use seepd::config::DaemonConfig;

static MAPPING: LazyLock<LogMapping> = LazyLock::new(|| {
    let config = DaemonConfig::parse(
        "[source]\ncan = \"can0\"\ncounter = { bits = { id = 0x123, start = 60, length = 4 } }\n[signals.command]\nbits = { id = 0x123, \
         start = 0, length = 64, encoding = \"float64\" }\n",
    );
    config.expect("a configuration").axes[0].log_mapping()
});

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let mapping = &*MAPPING;
    let Ok(mut decoder) = FrameDecoder::new(mapping.places(), mapping.counter.as_ref(), None) else { return };
    for bytes in data.chunks(linux::FD_BYTES) {
        let Ok(frame) = linux::parse(bytes) else { continue };
        decoder.take(&frame, b"can0", 0);
        if frame.content == Content::Data {
            let (written, size) = linux::write(&frame);
            assert_eq!(linux::parse(&written[..size]), Ok(frame));
        }
    }
});
