//! An MCAP log, at hand and far away: samples up to where it ends, and notes. Without its magic bytes the input gets them; from 0xf0 on the
//! first byte says how the rest is packed as a chunk's records: plain, lz4, zstd (bits 0 and 1), with the right CRC or (bit 2) none.
//! Parser: crates/logs/src/mcap.rs crates/logs/src/mcap_file.rs crates/logs/src/mcap_chunk.rs
#![no_main]
use std::io::{Cursor, Write};

use seepd_logs::fuzzing::read_file;
use seepd_logs::{LogMapping, MCAP_MAGIC, McapSource, Source};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let bytes = match data {
        _ if data.starts_with(MCAP_MAGIC) => data.to_vec(),
        [how @ 0xf0..=0xff, records @ ..] => [MCAP_MAGIC, &chunk(*how, records)[..]].concat(),
        _ => [MCAP_MAGIC, data].concat(),
    };
    read_file(&bytes, true, "command");
    let Ok(mut source) = McapSource::new(Cursor::new(bytes), "log", LogMapping::default().places()) else {
        return;
    };
    while let Ok(Some(_)) = source.next_sample() {}
    let _ = source.notes();
});

fn chunk(how: u8, records: &[u8]) -> Vec<u8> {
    let (name, packed) = match how % 4 {
        1 => {
            let mut encoder = lz4::EncoderBuilder::new().build(Vec::new()).expect("memory");
            encoder.write_all(records).expect("memory");
            ("lz4", encoder.finish().0)
        }
        2 => ("zstd", zstd::bulk::compress(records, 1).expect("memory")),
        _ => ("", records.to_vec()),
    };
    let crc = if how & 4 == 0 { crc32fast::hash(records) } else { 0 };
    let content = [
        &[0; 16][..],
        &(records.len() as u64).to_le_bytes(),
        &crc.to_le_bytes(),
        &(name.len() as u32).to_le_bytes(),
        name.as_bytes(),
        &(packed.len() as u64).to_le_bytes(),
        &packed,
    ]
    .concat();
    [&[6][..], &(content.len() as u64).to_le_bytes(), &content].concat()
}
