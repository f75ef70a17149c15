//! The page's connections: at most so many, and none that is kept open without use.
//!
//! Whoever reaches the port may open connections without a token. Each takes a file descriptor, which state, recording and spool
//! need too, so that `axum::serve`, which takes any number of them for any time, will not do. Nor may those that are taken keep others
//! out: where there is no room for another one, the one that has said nothing whole for the longest time goes.

use std::collections::BTreeMap;
use std::pin::{Pin, pin};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::Router;
use axum::body::{Body, Bytes};
use hyper::Request;
use hyper::body::{Frame, Incoming, SizeHint};
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use nix::sys::socket::{setsockopt, sockopt::TcpUserTimeout};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Notify, watch};
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
    let waiting = Arc::<Waiting>::default();
    // Whether another one must end before there is room.
    let mut owes_room = false;
    loop {
        let full = connections.len() >= limits.most;
        owes_room &= full;
        if owes_room && waiting.end_longest() {
            owes_room = false;
        }
        tokio::select! {
            _ = stop.changed() => break,
            Some(_) = connections.join_next() => {}
            () = waiting.entered.notified(), if owes_room => {}
            accepted = listener.accept(), if !full => match accepted {
                Ok((stream, _)) => {
                    let seat = Seat::take(&waiting);
                    connections.spawn(attend(stream, seat, routes.clone(), limits, stop.clone()));
                    if connections.len() >= limits.most {
                        owes_room = true;
                        let what = format!(
                            "http: {} connections are open; the one that has waited longest makes way for each further one",
                            limits.most
                        );
                        warnings.warn(clock::instant(), &what);
                    }
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

/// Connections that are not being answered: nobody has asked anything whole there.
#[derive(Default)]
struct Waiting {
    /// By the order in which they began to wait.
    seats: Mutex<(u64, BTreeMap<u64, Arc<Notify>>)>,
    /// Told of each that begins to.
    entered: Notify,
}

impl Waiting {
    // Nothing panics while it holds the lock.
    fn lock(&self) -> MutexGuard<'_, (u64, BTreeMap<u64, Arc<Notify>>)> {
        self.seats.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the one that has waited longest; `false` where there is none beside the one that came last, which has not had its turn.
    fn end_longest(&self) -> bool {
        let mut seats = self.lock();
        let longest = if seats.1.len() > 1 { seats.1.pop_first() } else { None };
        drop(seats);
        longest.is_some_and(|(_, end)| {
            end.notify_one();
            true
        })
    }
}

/// A connection's place among those that wait, while it waits.
struct Seat {
    waiting: Arc<Waiting>,
    end: Arc<Notify>,
    number: Mutex<Option<u64>>,
}

impl Seat {
    fn take(waiting: &Arc<Waiting>) -> Arc<Self> {
        let seat = Seat { waiting: Arc::clone(waiting), end: Arc::default(), number: Mutex::default() };
        seat.sit();
        Arc::new(seat)
    }

    /// Begins to wait.
    fn sit(&self) {
        let mut seats = self.waiting.lock();
        let (next, ends) = &mut *seats;
        *next += 1;
        ends.insert(*next, Arc::clone(&self.end));
        let number = *next;
        drop(seats);
        *self.number.lock().unwrap_or_else(PoisonError::into_inner) = Some(number);
        self.waiting.entered.notify_one();
    }

    /// Waits no longer.
    fn rise(&self) {
        let number = self.number.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(number) = number {
            self.waiting.lock().1.remove(&number);
        }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.rise();
    }
}

/// An answer under way; once it is handed over, its connection waits again.
struct Answering {
    body: Body,
    seat: Arc<Seat>,
}

impl hyper::body::Body for Answering {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

impl Drop for Answering {
    fn drop(&mut self) {
        self.seat.sit();
    }
}

/// Answers a connection's requests until it ends, stalls, must make way, or the daemon stops.
async fn attend(
    stream: TcpStream,
    seat: Arc<Seat>,
    routes: Router,
    limits: Limits,
    stop: watch::Receiver<bool>,
) {
    let stalled_ms = u32::try_from(limits.stalled.as_millis()).unwrap_or(u32::MAX);
    if let Err(error) = setsockopt(&stream, TcpUserTimeout, &stalled_ms) {
        tracing::debug!("http: a stalled client will be waited for: {error}");
    }
    converse(stream, seat, routes, limits, stop).await;
}

/// Answers the requests of a connection over anything that goes both ways.
async fn converse<S: AsyncRead + AsyncWrite + Unpin>(
    stream: S,
    seat: Arc<Seat>,
    routes: Router,
    limits: Limits,
    mut stop: watch::Receiver<bool>,
) {
    let site = TowerToHyperService::new(routes);
    let end = Arc::clone(&seat.end);
    let answer = service_fn(move |request: Request<Incoming>| {
        let (answer, seat) = (site.call(request), Arc::clone(&seat));
        async move {
            let answer = answer.await;
            seat.rise();
            answer.map(|answer| answer.map(|body| Answering { body, seat }))
        }
    });
    let mut connection = pin!(
        http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(limits.head)
            .max_buf_size(BUFFER)
            .serve_connection(TokioIo::new(stream), answer)
    );
    let ended = tokio::select! {
        ended = connection.as_mut() => ended,
        () = end.notified() => return,
        _ = stop.changed() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        tracing::debug!("http: a connection ended: {error}");
    }
}

/// Answers a client that says these bytes and no more.
#[cfg(fuzzing)]
pub(super) async fn hear(bytes: &[u8], routes: Router, stop: watch::Receiver<bool>) {
    let seat = Seat::take(&Arc::default());
    converse(crate::fuzzing::Said::new(bytes), seat, routes, Limits::default(), stop).await;
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
        let said = axum::routing::post(async |said: Bytes| said);
        let routes = Router::new().route("/", get(async || "here")).route("/endless", get(endless));
        let routes = routes.route("/said", said);
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
    async fn who_asks_nothing_whole_makes_way_and_who_is_answered_does_not() {
        let (place, _stop) = site(Limits { most: 4, ..Limits::default() }).await;
        let answered = ask(place, "GET /endless HTTP/1.1\r\nHost: a\r\n\r\n").await;
        let mut idle = Vec::new();
        for _ in 0..20 {
            idle.push(ask(place, "GET / HT").await);
            idle.push(ask(place, "POST /said HTTP/1.1\r\nHost: a\r\nContent-Length: 9\r\n\r\n").await);
        }
        let behind = ask(place, "GET / HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n").await;
        assert!(hear(behind).await.ends_with("here"));
        let mut answered = answered;
        let mut much = vec![0; 1 << 22];
        timeout(PATIENCE, answered.read_exact(&mut much)).await.unwrap().unwrap();
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
