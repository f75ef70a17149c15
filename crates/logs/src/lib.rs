#![doc = include_str!("../README.md")]
#[cfg(feature = "bags")]
mod bag;
mod bus_log;
mod bus_survey;
pub mod can;
mod channels;
mod civil;
pub mod columns;
mod counted;
mod csv;
mod decode;
mod error;
mod far;
mod fields;
mod forward;
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
mod mdf;
mod message_error;
mod opened;
mod protobuf;
mod protobuf_wire;
pub mod record;
mod record_log;
mod ros;
mod rows;
mod schema_error;
mod series;
mod source;
pub mod survey;
mod table;
mod table_time;
mod unit;
mod window;
mod wrapping;

pub use bus_log::BusLogSource;
pub use bus_survey::BusSurvey;
pub use counted::CountedReader;
pub use csv::CsvSource;
pub use error::LogError;
pub use kind::{LogKind, MCAP_MAGIC};
pub use mapping::{
    BitsMapping, CounterMapping, LogMapping, Selection, SignalMapping, TimeUnit, check_signals, identifier,
};
pub use mcap::McapSource;
pub use series::{bytes_of, logs_of};
pub use source::{Source, frame_decoder, frames, log_name, open, open_with};
