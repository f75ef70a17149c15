//! A share of a training that was simulated elsewhere: the bytes as they are, sealed as a share, as the portions of one of this training, and
//! as a portion.
//! Parser: crates/train/src/portions.rs:add,training_of,statistics crates/features/src/stored.rs:from_numbers
#![no_main]
use std::sync::LazyLock;

use seepd_sim::MachineSpec;
use seepd_train::portions::{is_of_cycles, sealed};
use seepd_train::{Portions, TrainingSettings};
use sha2::{Digest, Sha256};

static TRAINING: LazyLock<(MachineSpec, TrainingSettings)> = LazyLock::new(Default::default);

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let (spec, settings) = &*TRAINING;
    let foreign = [data, Sha256::digest(data).as_slice()].concat();
    let own = sealed(spec, settings, data).expect("the default plant");
    for share in [data, &foreign, &own] {
        let _ = Portions::default().add(spec, settings, share).map_err(|error| error.to_string());
    }
    let _ = is_of_cycles(data);
});
