//! Machines that try to break the daemon: sequences of faults are drawn at random, and what the daemon tells is held against what it
//! must tell. A few sequences run with every test; as many as wanted with
//! `SEEPD_SEQUENCES=200 cargo test --workspace --test gateway faults::`.

mod broker;
mod model;

/// How many sequences to try: as many as SEEPD_SEQUENCES says, else so many.
fn sequences(short: u32) -> u32 {
    std::env::var("SEEPD_SEQUENCES").ok().and_then(|text| text.parse().ok()).unwrap_or(short)
}
