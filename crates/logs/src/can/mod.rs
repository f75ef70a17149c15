//! CAN: frames, where signals are in them, and the files that describe and record them.

mod asc;
pub mod bit_field;
pub mod blf;
pub(crate) mod busmaster;
pub mod candump;
pub mod dbc;
mod dbc_error;
pub mod decode;
mod frame_error;
pub mod j1939;
pub mod linux;
pub mod logged;
pub(crate) mod savvycan;
pub mod text_log;
mod timeline;
mod trc;
pub(crate) mod words;

use std::fmt;

/// Most data bytes of a frame (CAN FD).
pub const MOST_BYTES: usize = 64;

/// A frame's identifier.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Identifier {
    /// 11 bits.
    Standard(u16),
    /// 29 bits.
    Extended(u32),
}

impl fmt::Display for Identifier {
    /// As candump writes it: three hexadecimal digits, or eight.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Identifier::Standard(id) => write!(f, "{id:03X}"),
            Identifier::Extended(id) => write!(f, "{id:08X}"),
        }
    }
}

/// What a frame carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Content {
    /// Data, classic or FD.
    Data,
    /// A request for data.
    Remote,
    /// An error that the controller tells of.
    Error,
}

/// A frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    /// Identifier.
    pub identifier: Identifier,
    /// Kind.
    pub content: Content,
    length: u8,
    bytes: [u8; MOST_BYTES],
}

impl Frame {
    /// A frame without data.
    pub const fn new(identifier: Identifier, content: Content) -> Self {
        Frame { identifier, content, length: 0, bytes: [0; MOST_BYTES] }
    }

    /// Adds a data byte; `false` where there is no room.
    pub fn push(&mut self, byte: u8) -> bool {
        let room = self.bytes.get_mut(usize::from(self.length));
        let fits = room.is_some();
        if let Some(room) = room {
            *room = byte;
            self.length += 1;
        }
        fits
    }

    /// The data bytes.
    pub fn data(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }
}
