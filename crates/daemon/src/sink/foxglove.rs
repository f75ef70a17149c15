//! Foxglove's WebSocket: command, estimates, conditions and events live, for whoever watches in Foxglove or a program that speaks its
//! protocol (`foxglove.websocket.v1`, and `foxglove.sdk.v1`, which has the same messages).
//!
//! Topics are those of recordings, and `/AXIS/status` beside them, so that a layout fits both. The command comes as the page draws it, the
//! mean of 20 ms. A client that takes nothing is ended and counted; what it misses by then is bounded by its queue.

mod client;
mod protocol;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use nix::sys::socket::{setsockopt, sockopt::SndBuf};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};
use tokio_tungstenite::accept_hdr_async_with_config;
use tokio_tungstenite::tungstenite::handshake::server::{ErrorResponse, Request, Response};
use tokio_tungstenite::tungstenite::http::{HeaderValue, StatusCode};
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;

use self::client::{Client, End, PATIENCE};
use crate::clock;
use crate::config::FoxgloveConfig;
use crate::failure::Failure;
use crate::hub::Hub;
use crate::journal::Warnings;
use crate::sink::http::{read_token, same};

/// Its name among the sinks.
pub const SINK: &str = "foxglove";
/// Clients at a time; others wait.
const CLIENTS: usize = 16;
/// Time for a client to say what it wants.
const HANDSHAKE: Duration = Duration::from_secs(5);
/// Wait before a port that is taken is tried again, and where the system has no descriptor left.
const RETRY: Duration = Duration::from_secs(3);
/// Bytes that the kernel keeps for a client.
const KERNEL_BUFFER: usize = 128 << 10;
/// Longest message that a client may send, and how much may wait for it, bytes.
const BUFFERS: (usize, usize) = (64 << 10, 1 << 20);
/// Protocols that are spoken, the newest first.
const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// Pages that may connect without a token: Foxglove's own, and the desktop programs'. Any other page in a browser could be anybody's.
const ORIGINS: [&str; 3] = ["https://app.foxglove.dev", "https://studio.foxglove.dev", "file://"];

/// Takes clients.
pub struct Server {
    listen: SocketAddr,
    token: Option<String>,
    hub: Arc<Hub>,
    warnings: Warnings,
}

impl Server {
    /// Reads the token.
    ///
    /// # Errors
    /// [`Failure`] where its file cannot be used.
    pub fn new(config: &FoxgloveConfig, hub: Arc<Hub>) -> Result<Self, Failure> {
        let token = config.token_file.as_deref().map(read_token).transpose()?;
        Ok(Server { listen: config.listen, token, hub, warnings: Warnings::new(clock::instant()) })
    }

    /// Serves until told to stop.
    pub async fn run(mut self, mut stop: watch::Receiver<bool>) {
        let Some(listener) = self.open(&mut stop).await else { return };
        let mut clients = JoinSet::new();
        self.tell(0);
        loop {
            let full = clients.len() >= CLIENTS;
            tokio::select! {
                _ = stop.changed() => break,
                Some(ended) = clients.join_next() => {
                    self.heed(&ended.unwrap_or(End::Left));
                    self.tell(clients.len());
                }
                accepted = listener.accept(), if !full => match accepted {
                    Ok((stream, _)) => {
                        clients.spawn(attend(stream, self.token.clone(), Arc::clone(&self.hub), stop.clone()));
                        self.tell(clients.len());
                    }
                    Err(error) => {
                        self.warn(&format!("a connection cannot be taken: {error}"));
                        sleep(RETRY).await;
                    }
                },
            }
        }
        drop(listener);
        while clients.join_next().await.is_some() {}
    }

    /// Opens the port as soon as it is free; nothing where told to stop before.
    async fn open(&mut self, stop: &mut watch::Receiver<bool>) -> Option<TcpListener> {
        loop {
            match TcpListener::bind(self.listen).await {
                Ok(listener) => return Some(listener),
                Err(error) => {
                    let what = format!("opening {}: {error}", self.listen);
                    self.warn(&what);
                    self.hub.update_sink(SINK, |sink| (sink.good, sink.detail) = (false, what));
                }
            }
            tokio::select! {
                () = sleep(RETRY) => {}
                _ = stop.changed() => return None,
            }
        }
    }

    fn warn(&mut self, what: &str) {
        self.warnings.warn(clock::instant(), &format!("foxglove: {what}"));
    }

    fn heed(&mut self, end: &End) {
        match end {
            End::Left => {}
            End::Stalled => {
                self.warn("a client took nothing for too long and was ended");
                self.hub.update_sink(SINK, |sink| sink.dropped += 1);
            }
            End::Refused(why) => self.warn(&format!("a client was refused: {why}")),
        }
    }

    fn tell(&self, clients: usize) {
        let detail = format!("ws://{}: {clients} clients", self.listen);
        self.hub.update_sink(SINK, |sink| (sink.good, sink.detail) = (true, detail));
    }
}

/// Serves a client from its first byte to its end.
async fn attend(stream: TcpStream, token: Option<String>, hub: Arc<Hub>, stop: watch::Receiver<bool>) -> End {
    // The kernel would keep megabytes for one that takes nothing.
    let _ = setsockopt(&stream, SndBuf, &KERNEL_BUFFER);
    converse(stream, token, hub, stop).await
}

/// Serves a client over anything that goes both ways.
async fn converse<S: AsyncRead + AsyncWrite + Unpin>(
    stream: S,
    token: Option<String>,
    hub: Arc<Hub>,
    stop: watch::Receiver<bool>,
) -> End {
    let config = WebSocketConfig::default()
        .max_message_size(Some(BUFFERS.0))
        .max_frame_size(Some(BUFFERS.0))
        .read_buffer_size(4 << 10)
        .write_buffer_size(0)
        .max_write_buffer_size(BUFFERS.1);
    let mut refusal = None;
    #[expect(clippy::result_large_err, reason = "the type is the library's, and there is one a connection")]
    let look = |request: &Request, mut response: Response| match admit(request, token.as_deref()) {
        Ok(protocol) => {
            response.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_static(protocol));
            Ok(response)
        }
        Err((status, why)) => {
            refusal = Some(why);
            let mut response = ErrorResponse::new(Some(format!("{why}\n")));
            *response.status_mut() = status;
            Err(response)
        }
    };
    let accepted = timeout(HANDSHAKE, accept_hdr_async_with_config(stream, look, Some(config))).await;
    let socket = match (accepted, refusal) {
        (_, Some(why)) => return End::Refused(why.to_owned()),
        (Ok(Ok(socket)), None) => socket,
        (Ok(Err(error)), None) => return End::Refused(error.to_string()),
        (Err(_), None) => return End::Refused("it did not say what it wants".into()),
    };
    Client::new(socket, hub, PATIENCE).run(stop).await
}

/// Serves a client that says these bytes and no more.
#[cfg(fuzzing)]
pub async fn hear(bytes: &[u8], token: Option<String>, hub: Arc<Hub>, stop: watch::Receiver<bool>) {
    let end = converse(crate::fuzzing::Said::new(bytes), token, Arc::clone(&hub), stop).await;
    tracing::debug!("{end:?}");
}

/// The protocol that is spoken with a client, or why none is.
fn admit(request: &Request, token: Option<&str>) -> Result<&'static str, (StatusCode, &'static str)> {
    let text = |name: &str| request.headers().get(name).and_then(|value| value.to_str().ok());
    let brought =
        request.uri().query().unwrap_or_default().split('&').find_map(|one| one.strip_prefix("token="));
    let has_token = match (token, brought) {
        (Some(token), Some(brought)) => same(token.as_bytes(), brought.as_bytes()),
        _ => false,
    };
    if token.is_some() && !has_token {
        return Err((
            StatusCode::UNAUTHORIZED,
            "the address must end in /?token=TOKEN, with this gateway's token",
        ));
    }
    let is_known = |origin: &str| ORIGINS.contains(&origin);
    if !has_token && request.headers().contains_key("origin") && !text("origin").is_some_and(is_known) {
        return Err((
            StatusCode::FORBIDDEN,
            "pages of other origins need a token: name a file with one in foxglove.token_file",
        ));
    }
    let offered = text("sec-websocket-protocol").unwrap_or_default();
    let offered: Vec<&str> = offered.split(',').map(str::trim).collect();
    let spoken = PROTOCOLS.into_iter().find(|protocol| offered.contains(protocol));
    spoken.ok_or((StatusCode::BAD_REQUEST, "the protocols are foxglove.sdk.v1 and foxglove.websocket.v1"))
}

/// Whether the port is free for the daemon, or the daemon answers at it.
///
/// # Errors
/// In words, why neither.
pub async fn test(config: &FoxgloveConfig) -> Result<String, String> {
    Server::new(config, Hub::new("test".into())).map_err(|failure| failure.message)?;
    match TcpListener::bind(config.listen).await {
        Ok(_) => Ok(format!("{} is free for the daemon", config.listen)),
        Err(bound) => match TcpStream::connect(config.listen).await {
            Ok(_) => Ok(format!("{} answers", config.listen)),
            Err(_) => Err(format!("{} cannot be opened: {bound}", config.listen)),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(uri: &str, headers: &[(&str, &str)]) -> Request {
        let mut request = Request::builder().uri(uri);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        request.body(()).unwrap()
    }

    #[test]
    fn who_may_come_in() {
        let of = |uri: &str, headers: &[(&str, &str)], token| {
            admit(&asked(uri, headers), token).map_err(|(status, _)| status.as_u16())
        };
        let old = ("sec-websocket-protocol", "foxglove.websocket.v1");
        let both = ("sec-websocket-protocol", "foxglove.websocket.v1, foxglove.sdk.v1");
        assert_eq!(of("/", &[old], None), Ok("foxglove.websocket.v1"));
        assert_eq!(of("/", &[both], None), Ok("foxglove.sdk.v1"));
        assert_eq!(of("/", &[], None), Err(400));
        assert_eq!(of("/", &[("sec-websocket-protocol", "foxglove.sdk.v2")], None), Err(400));
        assert_eq!(
            of("/", &[old, ("origin", "https://app.foxglove.dev")], None),
            Ok("foxglove.websocket.v1")
        );
        assert_eq!(of("/", &[old, ("origin", "https://app.foxglove.dev.evil.example")], None), Err(403));
        assert_eq!(of("/", &[old, ("origin", "null")], None), Err(403));
        let token = Some("0123456789abcdef");
        assert_eq!(of("/", &[old], token), Err(401));
        assert_eq!(of("/?token=0123456789abcdeF", &[old], token), Err(401));
        assert_eq!(
            of("/?token=0123456789abcdef", &[old, ("origin", "https://panel.example")], token),
            Ok(PROTOCOLS[1])
        );
    }
}
