//! A share of a training that was simulated elsewhere: its content with a digest that is right, and the bytes as they are.
//! Parser: crates/train/src/portions.rs:add,training_of
#![no_main]
use std::sync::LazyLock;

use seepd_sim::MachineSpec;
use seepd_train::{Portions, TrainingSettings};
use sha2::{Digest, Sha256};

static TRAINING: LazyLock<(MachineSpec, TrainingSettings)> = LazyLock::new(Default::default);

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let (spec, settings) = &*TRAINING;
    let sealed = [data, Sha256::digest(data).as_slice()].concat();
    for share in [data, &sealed] {
        let _ = Portions::default().add(spec, settings, share);
    }
});
