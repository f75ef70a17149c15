#![doc = include_str!("../README.md")]
mod bus_survey;
pub mod can;
mod candump;
mod channels;
pub mod columns;
mod counted;
mod csv;
mod decode;
mod error;
mod fields;
#[doc(hidden)]
pub mod fuzzing;
mod guess;
mod intervals;
mod json;
mod kind;
mod lines;
mod mapping;
mod mcap;
mod mcap_chunk;
mod mcap_file;
mod protobuf;
mod protobuf_wire;
pub mod record;
mod ros;
mod rows;
mod source;
pub mod survey;

pub use bus_survey::BusSurvey;
pub use candump::CandumpSource;
pub use counted::CountedReader;
pub use csv::CsvSource;
pub use error::LogError;
pub use kind::{LogKind, MCAP_MAGIC};
pub use mapping::{
    BitsMapping, CounterMapping, LogMapping, Selection, SignalMapping, TimeUnit, check_signals, identifier,
};
pub use mcap::McapSource;
pub use source::{Source, frame_decoder, open, open_with};
