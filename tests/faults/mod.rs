//! Machines that try to break the daemon: sequences of faults are drawn at random, and what the daemon tells is held against what it
//! must tell. A few sequences run with every test; as many as wanted with
//! `SEEPD_SEQUENCES=200 cargo test --workspace --test gateway faults::`.

mod broker;
mod bus;
mod clocks;
mod determinism;
mod disks;
mod interface;
mod load;
mod logs;
mod model;
mod patient;
mod reloads;
mod web;

/// A sender so late, by its own clock, has stood still with its computer: half of the silence after which the daemon gives a cycle up.
const STOOD_STILL_MS: u64 = 100;

/// How many sequences to try: as many as SEEPD_SEQUENCES says, else so many.
fn sequences(short: u32) -> u32 {
    std::env::var("SEEPD_SEQUENCES").ok().and_then(|text| text.parse().ok()).unwrap_or(short)
}

/// Numbers that look random and are the same in each run (SplitMix64).
pub(crate) fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mixed = (*state ^ (*state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}
