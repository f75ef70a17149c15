//! The page's connections: at most so many, and none that is kept open without use.
//!
//! Whoever reaches the port may open connections without a token. Each takes a file descriptor, which state, recording and spool
//! need too, so that `axum::serve`, which takes any number of them for any time, will not do.

use std::pin::pin;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use nix::sys::socket::{setsockopt, sockopt::TcpUserTimeout};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::sleep;

use crate::clock;
use crate::journal::Warnings;

/// Wait where the system has no descriptor left.
const RETRY: Duration = Duration::from_millis(200);
/// Memory that a connection's request or answer may take under way, bytes.
const BUFFER: usize = 64 << 10;

/// What a client may take.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Connections at a time.
    pub(super) most: usize,
    /// Time for a request's head, also for the next one's of a connection that is kept.
    pub(super) head: Duration,
    /// Time in which a client must take something of what it is sent.
    pub(super) stalled: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Limits { most: 128, head: Duration::from_secs(5), stalled: Duration::from_secs(20) }
    }
}

/// Takes connections until told to stop, and ends them.
pub(super) async fn serve(
    listener: TcpListener,
    routes: Router,
    limits: Limits,
    mut stop: watch::Receiver<bool>,
) {
    let mut connections = JoinSet::new();
    let mut warnings = Warnings::new(clock::instant());
    loop {
        let full = connections.len() >= limits.most;
        if full {
            let what = format!("http: {} connections are open; others wait until one ends", limits.most);
            warnings.warn(clock::instant(), &what);
        }
        tokio::select! {
            _ = stop.changed() => break,
            Some(_) = connections.join_next() => {}
            accepted = listener.accept(), if !full => match accepted {
                Ok((stream, _)) => {
                    connections.spawn(attend(stream, routes.clone(), limits, stop.clone()));
                }
                Err(error) => {
                    warnings.warn(clock::instant(), &format!("http: a connection cannot be taken: {error}"));
                    sleep(RETRY).await;
                }
            },
        }
    }
    drop(listener);
    while connections.join_next().await.is_some() {}
}

/// Answers a connection's requests until it ends, stalls, or the daemon stops.
async fn attend(stream: TcpStream, routes: Router, limits: Limits, mut stop: watch::Receiver<bool>) {
    let stalled_ms = u32::try_from(limits.stalled.as_millis()).unwrap_or(u32::MAX);
    if let Err(error) = setsockopt(&stream, TcpUserTimeout, &stalled_ms) {
        tracing::debug!("http: a stalled client will be waited for: {error}");
    }
    let mut connection = pin!(
        http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(limits.head)
            .max_buf_size(BUFFER)
            .serve_connection(TokioIo::new(stream), TowerToHyperService::new(routes))
    );
    let ended = tokio::select! {
        ended = connection.as_mut() => ended,
        _ = stop.changed() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        tracing::debug!("http: a connection ended: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::Body;
    use axum::routing::get;
    use std::convert::Infallible;
    use std::net::SocketAddr;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::time::timeout;

    const PATIENCE: Duration = Duration::from_secs(20);

    async fn site(limits: Limits) -> (SocketAddr, watch::Sender<bool>) {
        let endless = || async {
            let piece = Ok::<_, Infallible>(vec![b' '; 1 << 16]);
            Body::from_stream(tokio_stream::iter(std::iter::repeat(piece)))
        };
        let routes = Router::new().route("/", get(async || "here")).route("/endless", get(endless));
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let place = listener.local_addr().unwrap();
        let (stop, stopped) = watch::channel(false);
        tokio::spawn(serve(listener, routes, limits, stopped));
        (place, stop)
    }

    async fn ask(place: SocketAddr, request: &str) -> TcpStream {
        let mut stream = TcpStream::connect(place).await.unwrap();
        stream.write_all(request.as_bytes()).await.unwrap();
        stream
    }

    /// What comes until the other side ends the connection.
    async fn hear(mut stream: TcpStream) -> String {
        let mut text = Vec::new();
        let _ = timeout(PATIENCE, stream.read_to_end(&mut text)).await.expect("the connection ends");
        String::from_utf8_lossy(&text).into_owned()
    }

    #[tokio::test]
    async fn a_head_that_does_not_come_and_a_client_that_takes_nothing_make_way() {
        let short = Duration::from_millis(300);
        let (place, _stop) = site(Limits { most: 1, head: short, stalled: short }).await;
        for hindrance in ["GET / HT", "GET /endless HTTP/1.1\r\nHost: a\r\n\r\n"] {
            let in_the_way = ask(place, hindrance).await;
            let behind = ask(place, "GET / HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n").await;
            assert!(hear(behind).await.ends_with("here"), "{hindrance}");
            drop(in_the_way);
        }
    }

    #[tokio::test]
    async fn a_stop_ends_connections_that_wait_for_a_request() {
        let (place, stop) = site(Limits::default()).await;
        let mut kept = ask(place, "GET / HTTP/1.1\r\nHost: a\r\n\r\n").await;
        let mut answer = [0; 4];
        kept.read_exact(&mut answer).await.unwrap();
        stop.send_replace(true);
        assert!(hear(kept).await.ends_with("here"));
        assert!(TcpStream::connect(place).await.is_err());
    }
}
