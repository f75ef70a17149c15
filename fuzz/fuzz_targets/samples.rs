//! Samples: pairs of a time step in ns (i64) and a command (f64), through the embedded model's reader.
//! Parser: crates/features/src/intake.rs crates/features/src/reader.rs:start,push,finish,restart,take
#![no_main]
use std::sync::LazyLock;

use seepd_model::Model;
use seepd_signals::Sample;

static MODEL: LazyLock<Model> =
    LazyLock::new(|| Model::from_json(seepd::EMBEDDED_MODEL).expect("the embedded model"));

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let reader = MODEL.reader().expect("the embedded model");
    let mut state =
        reader.start(vec![0.0f32; reader.definition().ring_samples()]).expect("memory for a cycle");
    let mut time_ns = 0i64;
    for pair in data.chunks_exact(16) {
        let number = |at: usize| <[u8; 8]>::try_from(&pair[at..at + 8]).expect("eight bytes");
        time_ns = time_ns.wrapping_add(i64::from_le_bytes(number(0)));
        reader.push(&mut state, &Sample::command(time_ns, f64::from_le_bytes(number(8))), &mut |_| ());
    }
    reader.finish(&mut state, &mut |_| ());
});
