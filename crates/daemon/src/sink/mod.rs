//! Where events go: each file turns an event into the bytes of one format.

pub mod csv;
pub mod html;
pub mod json;
pub mod mcap;
pub mod terminal;
