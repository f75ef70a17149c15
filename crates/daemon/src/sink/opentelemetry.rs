//! OpenTelemetry: the series of the metrics, sent every few seconds by OTLP over HTTP.
//!
//! A request is protobuf, which every receiver of OTLP over HTTP must take. Requests that an endpoint does not take now wait for it, the
//! newest few of them; one that it will never take is given up and counted. Whatever the endpoint does, it holds nothing up but this task.

mod request;

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, to_bytes};
use hyper::client::conn::http1;
use hyper::header::{AUTHORIZATION, CONTENT_TYPE, HOST, HeaderValue, RETRY_AFTER};
use hyper::{Request, StatusCode};
use hyper_util::rt::TokioIo;
use prost::Message;
use rustls::ClientConfig;
use rustls::pki_types::ServerName;
use seepd_settings::side_file;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until, timeout};
use tokio_rustls::TlsConnector;

use self::request::{Response, Sender, request};
use crate::clock;
use crate::config::{Endpoint, OpenTelemetryConfig};
use crate::failure::Failure;
use crate::hub::Hub;
use crate::journal::Warnings;
use crate::sink::series::{Points, Series, series};
use crate::sink::tls;

/// Its name among the sinks.
pub const SINK: &str = "opentelemetry";
/// Requests that wait for an endpoint that is away; the oldest go first.
const WAITING: usize = 20;
/// Bytes that these may have together.
const WAITING_BYTES: usize = 1 << 20;
/// Time for a connection, a request and its answer.
const PATIENCE: Duration = Duration::from_secs(10);
/// First and longest wait before another try.
const WAITS: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));
/// Bytes of an answer that are read.
const ANSWER: usize = 64 << 10;

/// What became of a request.
#[derive(Debug, PartialEq, Eq)]
enum Sent {
    /// It was taken, less some points.
    Taken { rejected: u64, why: String },
    /// It may be taken later; the endpoint may have said when.
    NotNow { why: String, after: Option<Duration> },
    /// It will never be.
    Never(String),
}

/// Where requests go, and with what.
#[derive(Clone)]
struct Way {
    place: Endpoint,
    token: Option<HeaderValue>,
    tls: Option<Arc<ClientConfig>>,
}

/// Sends all series every few seconds.
pub struct Exporter {
    config: OpenTelemetryConfig,
    way: Way,
    sender: Sender,
    hub: Arc<Hub>,
    waiting: VecDeque<Vec<u8>>,
    retry_at: Instant,
    wait: Duration,
    sent: u64,
    dropped: u64,
    warnings: Warnings,
}

type UnderWay = Pin<Box<dyn Future<Output = Sent> + Send>>;

impl Exporter {
    /// Reads token and certificates.
    ///
    /// # Errors
    /// [`Failure`] where one of these files cannot be used.
    pub fn new(config: &OpenTelemetryConfig, hub: Arc<Hub>) -> Result<Self, Failure> {
        let now = clock::instant();
        let host = nix::unistd::gethostname().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Exporter {
            way: Way::new(config)?,
            sender: Sender { service: config.service_name.clone(), host, since_ns: wall_ns().unwrap_or(0) },
            config: config.clone(),
            hub,
            waiting: VecDeque::new(),
            retry_at: now,
            wait: WAITS.0,
            sent: 0,
            dropped: 0,
            warnings: Warnings::new(now),
        })
    }

    /// Sends until told to stop.
    pub async fn run(mut self, mut stop: watch::Receiver<bool>) {
        let mut ticks = tokio::time::interval(Duration::from_secs_f64(self.config.period_s));
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut under_way: Option<UnderWay> = None;
        loop {
            if under_way.is_none() && clock::instant() >= self.retry_at {
                under_way = self.waiting.front().cloned().map(|body| self.way.clone().send(body));
            }
            let may_retry = under_way.is_none() && !self.waiting.is_empty();
            tokio::select! {
                _ = stop.changed() => return,
                _ = ticks.tick() => self.measure(),
                sent = ended(&mut under_way) => {
                    under_way = None;
                    self.heed(sent);
                }
                () = sleep_until(self.retry_at), if may_retry => {}
            }
        }
    }

    /// Makes a request of what is so now. A clock that was never set has no time to give it.
    fn measure(&mut self) {
        let Some(now_ns) = wall_ns() else {
            self.tell(false, "nothing is sent before the system's clock is set");
            return;
        };
        if self.sender.since_ns == 0 {
            self.sender.since_ns = now_ns;
        }
        let all = series(&self.hub.axes(), &self.hub.sinks());
        self.waiting.push_back(request(&self.sender, all, now_ns).encode_to_vec());
        let bytes = |waiting: &VecDeque<Vec<u8>>| waiting.iter().map(Vec::len).sum::<usize>();
        while self.waiting.len() > WAITING || self.waiting.len() > 1 && bytes(&self.waiting) > WAITING_BYTES {
            self.waiting.pop_front();
            self.dropped += 1;
        }
    }

    fn heed(&mut self, sent: Sent) {
        match sent {
            Sent::Taken { rejected, why } => {
                self.waiting.pop_front();
                self.sent += 1;
                self.dropped += rejected;
                self.wait = WAITS.0;
                if rejected == 0 {
                    self.tell(true, "sending");
                } else {
                    self.complain(&format!("{rejected} points were refused: {why}"));
                }
            }
            Sent::NotNow { why, after } => {
                self.retry_at = clock::instant() + after.unwrap_or(self.wait).min(WAITS.1);
                self.wait = (self.wait * 2).min(WAITS.1);
                self.complain(&why);
            }
            Sent::Never(why) => {
                self.waiting.pop_front();
                self.dropped += 1;
                self.complain(&why);
            }
        }
    }

    /// Heeds an answer as if the endpoint had given it.
    #[cfg(fuzzing)]
    pub fn hear(&mut self, status: u16, after: &[u8], body: &[u8]) {
        let after = HeaderValue::from_bytes(after).ok();
        let status = StatusCode::from_u16(status).unwrap_or_default();
        self.heed(verdict(status, retry_after(after.as_ref()), body));
    }

    fn complain(&mut self, why: &str) {
        self.warnings.warn(clock::instant(), &format!("{SINK}: {}: {why}", self.config.endpoint));
        self.tell(false, why);
    }

    fn tell(&self, good: bool, detail: &str) {
        let (sent, dropped, waiting) = (self.sent, self.dropped, self.waiting.len() as u64);
        self.hub.update_sink(SINK, |sink| {
            (sink.good, sink.sent, sink.dropped, sink.waiting) = (good, sent, dropped, waiting);
            sink.detail = format!("{}: {detail}", self.config.endpoint);
        });
    }
}

/// What becomes of the request that is under way; never, where none is.
async fn ended(under_way: &mut Option<UnderWay>) -> Sent {
    match under_way {
        Some(sending) => sending.await,
        None => std::future::pending().await,
    }
}

fn wall_ns() -> Option<u64> {
    clock::wall_ns().and_then(|ns| u64::try_from(ns).ok())
}

impl Way {
    fn new(config: &OpenTelemetryConfig) -> Result<Self, Failure> {
        let place = config.place().map_err(|what| Failure::new(crate::failure::Code::Configuration, what))?;
        let token = match &config.token_file {
            Some(path) => {
                let text = side_file::read_text(path).map_err(|error| Failure::reading(path, &error))?;
                let mut value = HeaderValue::from_str(&format!("Bearer {}", text.trim())).map_err(|_| {
                    Failure::configuration(path, "a token is one line of letters, digits and signs")
                })?;
                value.set_sensitive(true);
                Some(value)
            }
            None => None,
        };
        let tls = if place.tls { Some(tls::client(&config.ca_file, None)?) } else { None };
        Ok(Way { place, token, tls })
    }

    /// Sends a request on a connection of its own, within a time.
    fn send(self, body: Vec<u8>) -> UnderWay {
        let not_now = |why: String| Sent::NotNow { why, after: None };
        Box::pin(async move {
            match timeout(PATIENCE, self.try_send(body)).await {
                Ok(Ok(sent)) => sent,
                Ok(Err(why)) => not_now(why),
                Err(_) => not_now(format!("no answer within {} s", PATIENCE.as_secs())),
            }
        })
    }

    async fn try_send(&self, body: Vec<u8>) -> Result<Sent, String> {
        let Endpoint { host, port, .. } = &self.place;
        let stream = TcpStream::connect((host.as_str(), *port)).await.map_err(|error| error.to_string())?;
        match &self.tls {
            None => self.exchange(stream, body).await,
            Some(tls) => {
                let name = ServerName::try_from(host.clone()).map_err(|error| error.to_string())?;
                let connector = TlsConnector::from(Arc::clone(tls));
                let stream = connector.connect(name, stream).await.map_err(|error| error.to_string())?;
                self.exchange(stream, body).await
            }
        }
    }

    async fn exchange<S>(&self, stream: S, body: Vec<u8>) -> Result<Sent, String>
    where
        S: AsyncRead + AsyncWrite + Send + Unpin + 'static,
    {
        let words = |error: hyper::Error| error.to_string();
        let (mut requests, connection) = http1::handshake(TokioIo::new(stream)).await.map_err(words)?;
        let exchange = async move {
            let answer = requests.send_request(self.request(body)?).await.map_err(words)?;
            let (status, after) = (answer.status(), retry_after(answer.headers().get(RETRY_AFTER)));
            let body = to_bytes(Body::new(answer.into_body()), ANSWER).await.unwrap_or_default();
            Ok(verdict(status, after, &body))
        };
        // The connection is driven here, so that it ends with its only request.
        tokio::pin!(exchange);
        tokio::select! {
            sent = &mut exchange => sent,
            ended = connection => match ended {
                Ok(()) => exchange.await,
                Err(error) => Err(error.to_string()),
            },
        }
    }

    fn request(&self, body: Vec<u8>) -> Result<Request<Body>, String> {
        let mut request = Request::post(self.place.path.as_str())
            .header(HOST, self.place.authority.as_str())
            .header(CONTENT_TYPE, "application/x-protobuf")
            .header("user-agent", concat!("seepd/", env!("CARGO_PKG_VERSION")))
            .header("connection", "close");
        if let Some(token) = &self.token {
            request = request.header(AUTHORIZATION, token.clone());
        }
        request.body(Body::from(body)).map_err(|error| error.to_string())
    }
}

/// Seconds that the endpoint asks to be left alone; a date is not heeded.
fn retry_after(value: Option<&HeaderValue>) -> Option<Duration> {
    value?.to_str().ok()?.trim().parse().ok().map(Duration::from_secs)
}

/// What an answer means (OTLP 1, "OTLP/HTTP Response").
fn verdict(status: StatusCode, after: Option<Duration>, body: &[u8]) -> Sent {
    match status.as_u16() {
        200..=299 => {
            let part = Response::decode(body).ok().and_then(|response| response.partial_success);
            let part = part.unwrap_or_default();
            let why = part.error_message.chars().filter(|c| !c.is_control()).take(200).collect();
            // Nobody was sent more points than that; the count of all answers is not to run over.
            let rejected = u64::try_from(part.rejected_data_points).unwrap_or(0).min(u32::MAX.into());
            Sent::Taken { rejected, why }
        }
        429 | 502 | 503 | 504 => Sent::NotNow { why: format!("it answers {status}"), after },
        _ => Sent::Never(format!("it refuses the metrics: {status}")),
    }
}

/// Sends a gauge that is no machine's, which the endpoint must accept.
///
/// # Errors
/// In words, why it did not.
pub async fn test(config: &OpenTelemetryConfig, axis: &str) -> Result<String, String> {
    let exporter = Exporter::new(config, Hub::new("test".into())).map_err(|failure| failure.message)?;
    let gauge = Series {
        name: "test",
        help: "A test of the sinks; nothing leaks",
        points: Points::Gauges(vec![(vec![("axis", axis.to_owned())], 1.0)]),
    };
    let now_ns = wall_ns().ok_or("the system's clock was never set")?;
    let body = request(&exporter.sender, vec![gauge], now_ns).encode_to_vec();
    let place = &config.endpoint;
    match exporter.way.send(body).await {
        Sent::Taken { rejected: 0, .. } => Ok(format!("{place} accepted seepd_test")),
        Sent::Taken { why, .. } | Sent::NotNow { why, .. } | Sent::Never(why) => {
            Err(format!("{place}: {why}"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exporter() -> Exporter {
        Exporter::new(&OpenTelemetryConfig::default(), Hub::new("test".into())).unwrap()
    }

    #[test]
    fn an_endpoint_that_is_away_costs_the_oldest_and_is_asked_ever_more_rarely() {
        let mut exporter = exporter();
        let mut waits = Vec::new();
        for _ in 0..WAITING + 5 {
            exporter.measure();
            waits.push(exporter.wait.as_secs());
            exporter.heed(Sent::NotNow { why: "refused".into(), after: None });
        }
        assert_eq!((exporter.waiting.len(), exporter.dropped, exporter.sent), (WAITING, 5, 0));
        assert_eq!(waits[..8], [1, 2, 4, 8, 16, 32, 60, 60]);
        exporter.heed(Sent::Never("400".into()));
        exporter.heed(Sent::Taken { rejected: 3, why: String::new() });
        assert_eq!((exporter.waiting.len(), exporter.dropped, exporter.sent), (WAITING - 2, 9, 1));
        assert_eq!(exporter.wait, WAITS.0);
        // Requests of many axes are large: the newest is kept in any case.
        exporter.waiting.extend([vec![0; WAITING_BYTES], vec![0; WAITING_BYTES]]);
        exporter.measure();
        assert_eq!(exporter.waiting.len(), 1);
    }

    #[test]
    fn answers_mean_what_the_specification_says() {
        let of = |code: u16, body: &[u8]| verdict(StatusCode::from_u16(code).unwrap(), None, body);
        assert_eq!(of(200, &[]), Sent::Taken { rejected: 0, why: String::new() });
        let part = [10, 6, 8, 2, 18, 2, b'n', b'o'];
        assert_eq!(of(200, &part), Sent::Taken { rejected: 2, why: "no".into() });
        let all = [10, 10, 8, 255, 255, 255, 255, 255, 255, 255, 255, 127];
        assert_eq!(of(200, &all), Sent::Taken { rejected: u32::MAX.into(), why: String::new() });
        assert!(matches!(of(503, &[]), Sent::NotNow { .. }) && matches!(of(429, &[]), Sent::NotNow { .. }));
        assert!(matches!(of(400, &[]), Sent::Never(_)) && matches!(of(500, &[]), Sent::Never(_)));
        assert!(matches!(of(301, &[]), Sent::Never(_)));
        let after = |text: &'static str| retry_after(Some(&HeaderValue::from_static(text)));
        assert_eq!((after("7"), after("soon")), (Some(Duration::from_secs(7)), None));
    }
}
