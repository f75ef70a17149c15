//! A log of any kind, as far as its bytes tell: surveyed, then read. From 0xf0 on the first byte says what archives or encodings of text are
//! around the rest: gzip, zstd, UTF-16 of either order (bits 0 and 1), and around that (bit 2) gzip or zstd (bit 3).
//! Parser: crates/logs/src/kind.rs crates/logs/src/wrapping.rs crates/logs/src/opened.rs:of,of_kind,head,into_stream,into_file,unpack,mcap_file crates/logs/src/survey.rs:survey,of_opened,survey_records,announce,take,note,survey_csv,survey_frames,into_survey,look_into,take_time,take_field,take_field_of,finished crates/logs/src/guess.rs crates/logs/src/fields.rs crates/logs/src/decode.rs:pick,decoder_bytes crates/logs/src/json.rs:mended
#![no_main]
use std::io::{Cursor, Write};

use seepd_logs::fuzzing::read_log;
use seepd_logs::survey::survey;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let wrapped: Vec<u8>;
    let log = match data {
        [how @ 0xf0..=0xff, content @ ..] => {
            let inner = around(how & 3, content.to_vec());
            wrapped = if how & 4 == 0 { inner } else { around(how >> 3 & 1, inner) };
            &wrapped
        }
        _ => data,
    };
    // What unpacks to gigabytes is read as a stream, which takes its time.
    let _ = survey(Cursor::new(log), "log", "t_s", None);
    for command in ["command", "valve"] {
        read_log(log, command);
    }
});

fn around(how: u8, content: Vec<u8>) -> Vec<u8> {
    let units = || String::from_utf8_lossy(&content).encode_utf16().collect::<Vec<u16>>();
    match how {
        0 => {
            let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
            encoder.write_all(&content).expect("memory");
            encoder.finish().expect("memory")
        }
        1 => zstd::bulk::compress(&content, 1).expect("memory"),
        2 => {
            [&b"\xff\xfe"[..], &units().into_iter().flat_map(u16::to_le_bytes).collect::<Vec<u8>>()].concat()
        }
        _ => {
            [&b"\xfe\xff"[..], &units().into_iter().flat_map(u16::to_be_bytes).collect::<Vec<u8>>()].concat()
        }
    }
}
