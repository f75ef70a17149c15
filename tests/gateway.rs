//! The daemon, and what it shares with replay, as a gateway runs it: frames in, sinks out, restarts, full disks, brokers that refuse.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]
#![expect(clippy::disallowed_methods, reason = "tests of a live daemon wait")]

#[path = "support/daemon.rs"]
mod daemon;
#[expect(dead_code, reason = "the tests of the commands use the rest")]
mod support;

mod demo_live;
mod disk;
mod duty_cycles;
mod faults;
mod hostile_logs;
mod http_api;
mod live;
mod network;
mod plant_languages;
mod relative;
mod repairs;
mod window;
