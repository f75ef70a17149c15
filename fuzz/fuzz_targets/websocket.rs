//! Foxglove's port: what a client says on a connection, with a token (the first byte has bit 0) and without; with bit 1 after an opening
//! that is taken, in which the rest is the frames.
//! Parser: crates/daemon/src/sink/foxglove.rs:converse,admit crates/daemon/src/sink/foxglove/client.rs:run,serve,greet,offer,heed,subscribe,warn,tell_status,deliver,send,send_text crates/daemon/src/sink/foxglove/protocol.rs
#![no_main]
use std::cell::RefCell;
use std::sync::Arc;

use seepd::hub::{AxisStatus, Hub};
use seepd::sink::foxglove;
use tokio::runtime::Runtime;
use tokio::sync::{mpsc, watch};

const OPENING: &[u8] = b"GET /?token=0123456789abcdef HTTP/1.1\r\nHost: a\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
    Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n";

struct Port {
    runtime: Runtime,
    hub: Arc<Hub>,
    stop: watch::Sender<bool>,
}

thread_local! {
    static PORT: RefCell<Port> = RefCell::new(port());
}

fn port() -> Port {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let hub = Hub::new("fuzzed".into());
    hub.add_axis(AxisStatus::new("press", 7e6), mpsc::channel(1).0);
    Port { runtime, hub, stop: watch::channel(false).0 }
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Some((which, said)) = data.split_first() else { return };
    let token = (which & 1 != 0).then(|| "0123456789abcdef".to_owned());
    let said = if which & 2 == 0 { said.to_vec() } else { [OPENING, said].concat() };
    PORT.with_borrow(|port| {
        port.runtime.block_on(foxglove::hear(&said, token, Arc::clone(&port.hub), port.stop.subscribe()));
    });
});
