//! A client that fuzz targets make up; no part of the program.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// Times that a client waits for answers before it leaves.
const WAITS: u8 = 8;

/// Pieces of answers that it takes while nobody listens. A stream of events never ends by itself, and what stands unread behind its request
/// keeps the other side from seeing that the client has ended.
const TAKES: u8 = 64;

/// A connection on which somebody says something head by head, takes what is answered, and leaves after a while.
pub(crate) struct Said<'b> {
    bytes: &'b [u8],
    waits: u8,
    takes: u8,
}

impl<'b> Said<'b> {
    pub(crate) fn new(bytes: &'b [u8]) -> Self {
        Said { bytes, waits: WAITS, takes: TAKES }
    }
}

impl AsyncRead for Said<'_> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        into: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.bytes.is_empty() && self.waits > 0 {
            self.waits -= 1;
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        // An opening of a WebSocket has nothing behind it before it is answered.
        let head = self.bytes.windows(4).position(|four| four == b"\r\n\r\n").map_or(usize::MAX, |at| at + 4);
        let (now, later) = self.bytes.split_at(self.bytes.len().min(into.remaining()).min(head));
        into.put_slice(now);
        self.bytes = later;
        if !now.is_empty() {
            self.takes = TAKES;
        }
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Said<'_> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        _context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let Some(left) = self.takes.checked_sub(1) else {
            return Poll::Ready(Err(io::ErrorKind::BrokenPipe.into()));
        };
        self.takes = left;
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}
