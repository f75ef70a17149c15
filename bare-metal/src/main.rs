//! One duty cycle on a Cortex-M4F: the samples of `cycle.bin` (little-endian f32 commands at 1 kHz) through the
//! embedded model, and the bits of every feature and of the estimate on the debug console. The host's test
//! (`crates/daemon`, test `bare_metal`) writes the samples and compares the bits with its own.
#![no_std]
#![no_main]

extern crate alloc;

use core::ptr::addr_of_mut;

use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use embedded_alloc::LlffHeap;
use panic_semihosting as _;
use seepd_features::Outcome;
use seepd_model::Model;
use seepd_signals::Sample;

#[global_allocator]
static HEAP: LlffHeap = LlffHeap::empty();

/// Room for the model while it is read: the features themselves allocate nothing.
const HEAP_BYTES: usize = 3 << 20;
static mut HEAP_MEMORY: [u8; HEAP_BYTES] = [0; HEAP_BYTES];

static MODEL: &[u8] = include_bytes!("../../crates/daemon/assets/model.json");
static CYCLE: &[u8] = include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/cycle.bin"));

#[entry]
fn main() -> ! {
    // Once, before anything is allocated; nothing else refers to this memory.
    unsafe { HEAP.init(addr_of_mut!(HEAP_MEMORY) as usize, HEAP_BYTES) }
    match Model::from_json(MODEL) {
        Ok(model) => read_cycle(&model),
        Err(error) => {
            hprintln!("{}", error);
            debug::exit(debug::EXIT_FAILURE);
        }
    }
    debug::exit(debug::EXIT_SUCCESS);
    loop {}
}

fn read_cycle(model: &Model) {
    let Ok(reader) = model.reader() else { return hprintln!("no reader") };
    let Ok(mut state) = reader.start(alloc::vec![0.0f32; reader.definition().ring_samples()]) else {
        return hprintln!("no state");
    };
    let mut tell = |outcome: Outcome<'_>| match outcome {
        Outcome::Valid(cycle) => {
            for value in cycle.features {
                hprintln!("feature {:016x}", value.to_bits());
            }
            let estimate = model.estimate(cycle.features);
            hprintln!("estimate {:016x}", estimate.value.to_bits());
            hprintln!("interval {:016x} {:016x}", estimate.interval[0].to_bits(), estimate.interval[1].to_bits());
        }
        Outcome::Rejected(rejected) => hprintln!("rejected {}", rejected.reason.name()),
    };
    for (number, bytes) in CYCLE.chunks_exact(4).enumerate() {
        let command = f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let sample = Sample::command(number as i64 * 1_000_000, f64::from(command));
        reader.push(&mut state, &sample, &mut tell);
    }
    reader.finish(&mut state, &mut tell);
}
