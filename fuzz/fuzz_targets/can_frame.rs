//! Frames as a CAN socket gives them, classic ones after 72 bytes as well, read by bit layout: with a counter, and by groups of J1939; what
//! is parsed is written back.
//! Parser: crates/logs/src/can/linux.rs:parse,identifier_word,write crates/logs/src/can/decode.rs:timed_by_counter,take,choices,command_place crates/logs/src/can/j1939.rs:one,of_group,of_number,takes crates/logs/src/can/timeline.rs
#![no_main]
use std::sync::LazyLock;

use seepd::config::DaemonConfig;
use seepd_logs::LogMapping;
use seepd_logs::can::decode::FrameDecoder;
use seepd_logs::can::{Content, linux};

static MAPPINGS: LazyLock<Vec<LogMapping>> = LazyLock::new(|| {
    let config = DaemonConfig::parse(
        r#"
        [[axes]]
        axis = "by its identifier"
        source = { can = "can0", counter = { bits = { id = 0x123, start = 60, length = 4 } } }
        signals.command = { bits = { id = 0x123, start = 0, length = 64, encoding = "float64" } }
        [[axes]]
        axis = "by its group"
        source.can = "can0"
        signals.command = { topic = "can0", bits = { pgn = 0xff01, start = 0, length = 16, encoding = "signed" } }
        signals.load = { source_address = 3, bits = { id = 0x18ef0000, start = 7, length = 32, order = "big_endian" } }
        "#,
    );
    config.expect("a configuration").axes.iter().map(|axis| axis.log_mapping()).collect()
});

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    for mapping in &*MAPPINGS {
        let Ok(decoder) = FrameDecoder::new(mapping.places(), mapping.counter.as_ref(), None) else { return };
        let mut decoder = decoder.timed_by_counter(1000.0);
        for (time_ns, bytes) in (0..).step_by(1_000_000).zip(data.chunks(linux::FD_BYTES)) {
            let Ok(frame) = linux::parse(bytes) else { continue };
            decoder.take(&frame, b"can0", time_ns);
            if frame.content == Content::Data {
                let (written, size) = linux::write(&frame);
                assert_eq!(linux::parse(&written[..size]), Ok(frame));
            }
        }
        let _ = (decoder.counts(), decoder.choices(), decoder.command_place());
    }
});
