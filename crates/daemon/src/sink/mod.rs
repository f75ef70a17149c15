//! Where events go: each file turns an event into the bytes of one format.

#[cfg(feature = "live")]
pub mod can;
pub mod csv;
pub mod evaluation;
#[cfg(feature = "foxglove")]
pub mod foxglove;
pub mod html;
#[cfg(feature = "live")]
pub mod http;
#[cfg(feature = "live")]
pub mod influx;
#[cfg(feature = "j1939")]
pub mod j1939;
pub mod json;
pub mod mcap;
#[cfg(feature = "live")]
pub mod mqtt;
#[cfg(feature = "opentelemetry")]
pub mod opentelemetry;
#[cfg(feature = "parquet")]
pub mod parquet;
pub mod plain;
#[cfg(feature = "live")]
pub mod prometheus;
#[cfg(feature = "live")]
pub mod recording;
#[cfg(feature = "live")]
mod series;
#[cfg(feature = "live")]
mod sizes;
pub mod terminal;
#[cfg(feature = "live")]
mod tls;
