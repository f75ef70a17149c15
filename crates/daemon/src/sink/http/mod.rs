//! The dashboard, JSON, metrics and health over HTTP.
//!
//! Bound to the host's own addresses unless told otherwise, and then each request must bring the token: as
//! `Authorization: Bearer …`, or as the cookie that the login form, or `/?token=…`, leaves. Requests from pages of other places are refused.

mod connections;
mod login;

use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::Router;
use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, Path, Query, Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::sse::{self, Sse};
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::{get, post};
use seepd_settings::side_file;
use serde::{Deserialize, Serialize};
use serde_json::json;
use tokio::net::TcpListener;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, watch};
use tokio::time::timeout;
use tokio_stream::wrappers::ReceiverStream;

use self::connections::Limits;
use super::prometheus;
use crate::clock::{self, Clock};
use crate::config::HttpConfig;
use crate::failure::Failure;
use crate::hub::SourceState;
use crate::hub::{AxisStatus, Hub, NewRepair, NotTaken, Order, Signature, SinkStatus};
use crate::reasons;

/// The dashboard's name among the sinks.
pub const SINK: &str = "http";
const PAGE: &str = include_str!("../dashboard/index.html");
const SCRIPT: &str = include_str!("../dashboard/dashboard.js");
const STYLE: &str =
    concat!(include_str!("../../html/palette.css"), include_str!("../dashboard/dashboard.css"));
/// All that is served, for programs that write clients: OpenAPI 3.1.
const DESCRIPTION: &str = include_str!("openapi.json");
/// Nothing is loaded from elsewhere, and no other page may frame this one.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
                      frame-ancestors 'none'; base-uri 'none'; form-action 'self'";
/// The dashboard hears this often.
const BEAT: Duration = Duration::from_millis(250);
/// Events that wait for a client that hears slowly.
const EVENTS_BEHIND: usize = 64;
/// Event streams at a time; the dashboard takes one for each window.
const STREAMS: usize = 32;
/// Longest body that is read, bytes: many times what an order can have.
const LONGEST_BODY: usize = 128 << 10;
/// Time in which a request's body must be there.
const WHOLE: Duration = Duration::from_secs(10);
/// Shortest token that is taken.
const SHORTEST_TOKEN: usize = 16;

struct Site {
    hub: Arc<Hub>,
    clock: Clock,
    token: Option<String>,
    listen: SocketAddr,
    stop: watch::Receiver<bool>,
    streams: Arc<Semaphore>,
}

/// A site that is ready to be opened.
pub struct Http {
    site: Site,
}

impl Http {
    /// Reads the token.
    ///
    /// # Errors
    /// [`Failure`] where its file cannot be read, or it is too short to be one.
    pub fn new(
        config: &HttpConfig,
        hub: Arc<Hub>,
        clock: Clock,
        stop: watch::Receiver<bool>,
    ) -> Result<Self, Failure> {
        let token = token(config)?;
        let streams = Arc::new(Semaphore::new(STREAMS));
        Ok(Http { site: Site { hub, clock, token, listen: config.listen, stop, streams } })
    }

    /// Opens the port.
    ///
    /// # Errors
    /// The port is taken or not allowed.
    pub async fn bind(&self) -> io::Result<TcpListener> {
        TcpListener::bind(self.site.listen).await
    }

    /// Serves until told to stop.
    pub async fn run(self, listener: TcpListener) {
        let (stop, listen) = (self.site.stop.clone(), self.site.listen);
        self.site
            .hub
            .update_sink(SINK, |sink| (sink.good, sink.detail) = (true, format!("http://{listen}/")));
        connections::serve(listener, routes(Arc::new(self.site)), Limits::default(), stop).await;
    }
}

/// Answers clients that say something and no more.
#[cfg(fuzzing)]
#[derive(Clone)]
pub struct Heard {
    routes: Router,
    stop: watch::Receiver<bool>,
}

#[cfg(fuzzing)]
impl Heard {
    /// Answers as the site would.
    pub fn by(http: Http) -> Self {
        let stop = http.site.stop.clone();
        Heard { routes: routes(Arc::new(http.site)), stop }
    }

    /// Answers a connection's bytes.
    pub async fn hear(&self, bytes: &[u8]) {
        connections::hear(bytes, self.routes.clone(), self.stop.clone()).await;
    }
}

/// The token that requests must bring.
///
/// # Errors
/// [`Failure`] where its file cannot be read, or it is too short to be one.
pub fn token(config: &HttpConfig) -> Result<Option<String>, Failure> {
    config.token_file.as_deref().map(read_token).transpose()
}

/// Reads a token from its file.
///
/// # Errors
/// [`Failure`] where the file cannot be read, or has no token.
pub(super) fn read_token(path: &std::path::Path) -> Result<String, Failure> {
    let text = side_file::read_text(path).map_err(|error| Failure::reading(path, &error))?;
    let token = text.trim().to_owned();
    if token.len() < SHORTEST_TOKEN || !token.chars().all(|c| c.is_ascii_graphic() && c != ';') {
        let what = format!(
            "the file has no token: a token is {SHORTEST_TOKEN} or more characters without spaces and `;`"
        );
        return Err(Failure::configuration(path, what));
    }
    Ok(token)
}

fn routes(site: Arc<Site>) -> Router {
    Router::new()
        .route("/", get(async || asset("text/html; charset=utf-8", PAGE)))
        .route("/dashboard.js", get(async || asset("text/javascript; charset=utf-8", SCRIPT)))
        .route("/dashboard.css", get(async || asset("text/css; charset=utf-8", STYLE)))
        .route(login::PATH, post(login::enter))
        .route("/metrics", get(metrics))
        .route("/api/v1/openapi.json", get(async || asset("application/json", DESCRIPTION)))
        .route("/api/v1/reasons", get(async || Json(reasons::ALL)))
        .route("/api/v1/status", get(status))
        .route("/api/v1/axes/{axis}", get(axis))
        .route("/api/v1/axes/{axis}/trend", get(trend))
        .route("/api/v1/axes/{axis}/cycles", get(cycles))
        .route("/api/v1/axes/{axis}/healthy", get(healthy))
        .route("/api/v1/axes/{axis}/acknowledge", post(acknowledge))
        .route("/api/v1/axes/{axis}/new-baseline", post(new_baseline))
        .route("/api/v1/axes/{axis}/repairs", post(repairs))
        .route("/api/v1/events", get(events))
        .route("/api/v1/history", get(history))
        .layer(DefaultBodyLimit::max(LONGEST_BODY))
        .layer(middleware::from_fn(in_time))
        .layer(middleware::from_fn_with_state(Arc::clone(&site), admit))
        // Whether it is well may be asked by everybody who gets here.
        .route("/healthz", get(healthz))
        .fallback(async || problem(StatusCode::NOT_FOUND, "there is nothing here; / is the dashboard"))
        .layer(middleware::map_response(async |mut response: Response| {
            let headers = response.headers_mut();
            headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
            headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
            // With none at all a browser would not say that the login form is this page's own.
            headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("same-origin"));
            headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
            response
        }))
        .with_state(site)
}

fn problem(code: StatusCode, what: &str) -> Response {
    (code, Json(json!({ "error": what }))).into_response()
}

/// Gives a request up whose body does not come; an answer's own time is its connection's affair.
async fn in_time(request: Request, next: Next) -> Response {
    match timeout(WHOLE, next.run(request)).await {
        Ok(answer) => answer,
        Err(_) => problem(StatusCode::REQUEST_TIMEOUT, "the request did not come to its end"),
    }
}

/// Lets in who may come in.
async fn admit(State(site): State<Arc<Site>>, request: Request, next: Next) -> Response {
    let headers = request.headers();
    if let Err(what) = check_site(request.method(), headers).and_then(|()| check_origin(&site, headers)) {
        return problem(StatusCode::FORBIDDEN, what);
    }
    if let Some(token) = &site.token
        && !login::is_open(request.uri().path())
    {
        let is_it = |brought: &str| same(brought.as_bytes(), token.as_bytes());
        if !bearer(headers).or_else(|| cookie(headers)).is_some_and(is_it) {
            return match by_query(&request) {
                Some(brought) if is_it(&brought) => let_in(token),
                _ if request.uri().path() == "/" => login::form(false),
                _ => problem(
                    StatusCode::UNAUTHORIZED,
                    "a token is needed: send `Authorization: Bearer TOKEN`, or open / and log in",
                ),
            };
        }
    }
    next.run(request).await
}

/// A page of another place must not give orders, and no other name may lead here (DNS rebinding).
fn check_origin(site: &Site, headers: &HeaderMap) -> Result<(), &'static str> {
    let text = |name| headers.get(name).and_then(|value: &HeaderValue| value.to_str().ok());
    let host = text(header::HOST).unwrap_or_default();
    if let Some(origin) = text(header::ORIGIN)
        && origin.split_once("://").is_none_or(|(_, place)| place != host)
    {
        return Err("requests from pages of other sites are refused");
    }
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
    let own = ["localhost", "127.0.0.1", "[::1]"].contains(&name) || name == site.listen.ip().to_string();
    if site.token.is_none() && !own {
        return Err("this daemon answers only to its own address; set http.token_file to open it to others");
    }
    Ok(())
}

/// What a browser says of who asks: a page of another site may lead a person here, and neither load anything nor give orders.
fn check_site(method: &Method, headers: &HeaderMap) -> Result<(), &'static str> {
    let said = |name: &str| headers.get(name).map(HeaderValue::as_bytes);
    let is_own = [None, Some(&b"same-origin"[..]), Some(b"none")].contains(&said("sec-fetch-site"));
    let is_link = *method == Method::GET && said("sec-fetch-mode") == Some(b"navigate");
    if is_own || is_link { Ok(()) } else { Err("requests from pages of other sites are refused") }
}

fn bearer(headers: &HeaderMap) -> Option<&str> {
    headers.get(header::AUTHORIZATION)?.to_str().ok()?.strip_prefix("Bearer ")
}

fn cookie(headers: &HeaderMap) -> Option<&str> {
    let cookies = headers.get(header::COOKIE)?.to_str().ok()?;
    cookies.split(';').find_map(|cookie| cookie.trim().strip_prefix("seepd_token="))
}

/// Compares in a time that tells nothing of where two tokens differ.
pub(super) fn same(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |differences, (a, b)| differences | (a ^ b)) == 0
}

#[derive(Deserialize)]
struct Entry {
    token: Option<String>,
}

/// The token of `/?token=…`.
fn by_query(request: &Request) -> Option<String> {
    let Query(entry) = Query::<Entry>::try_from_uri(request.uri()).ok()?;
    entry.token.filter(|_| request.uri().path() == "/")
}

/// Leaves the token as a cookie and leads to the page, so that the address does not show it any longer.
fn let_in(token: &str) -> Response {
    let cookie = format!("seepd_token={token}; Path=/; HttpOnly; SameSite=Strict; Max-Age=31536000");
    let mut response = Redirect::to("/").into_response();
    if let Ok(cookie) = HeaderValue::from_str(&cookie) {
        response.headers_mut().insert(header::SET_COOKIE, cookie);
    }
    response
}

fn asset(media_type: &'static str, text: &'static str) -> Response {
    ([(header::CONTENT_TYPE, media_type)], text).into_response()
}

async fn metrics(State(site): State<Arc<Site>>) -> Response {
    match prometheus::text(&site.hub.axes(), &site.hub.sinks()) {
        Ok(text) => ([(header::CONTENT_TYPE, prometheus::MEDIA_TYPE)], text).into_response(),
        Err(error) => problem(StatusCode::INTERNAL_SERVER_ERROR, &error.to_string()),
    }
}

#[derive(Serialize)]
struct Overview {
    schema: &'static str,
    version: &'static str,
    run: String,
    time: Option<String>,
    now_ns: i64,
    axes: Vec<AxisStatus>,
    sinks: Vec<SinkStatus>,
}

fn overview(site: &Site) -> Overview {
    Overview {
        schema: "seepd.overview/1",
        version: env!("CARGO_PKG_VERSION"),
        run: site.hub.run().to_owned(),
        time: clock::wall_text(),
        now_ns: site.clock.now_ns(),
        axes: site.hub.axes(),
        sinks: site.hub.sinks(),
    }
}

async fn status(State(site): State<Arc<Site>>) -> Json<Overview> {
    Json(overview(&site))
}

fn no_axis(site: &Site, axis: &str) -> Response {
    let axes = site.hub.axes().into_iter().map(|status| status.axis).collect();
    problem(StatusCode::NOT_FOUND, &NotTaken::NoAxis { axis: axis.into(), axes }.to_string())
}

async fn axis(State(site): State<Arc<Site>>, Path(axis): Path<String>) -> Response {
    site.hub.axis(&axis).map_or_else(|| no_axis(&site, &axis), |status| Json(status).into_response())
}

async fn trend(State(site): State<Arc<Site>>, Path(axis): Path<String>) -> Response {
    let trend = site.hub.view(&axis, |view| view.trend.iter().copied().collect::<Vec<_>>());
    trend.map_or_else(|| no_axis(&site, &axis), |trend| Json(trend).into_response())
}

async fn cycles(State(site): State<Arc<Site>>, Path(axis): Path<String>) -> Response {
    let courses = site.hub.view(&axis, |view| view.courses.iter().cloned().collect::<Vec<_>>());
    courses.map_or_else(|| no_axis(&site, &axis), |courses| Json(courses).into_response())
}

/// What a healthy cycle is like, and the stretches of the duty cycle.
async fn healthy(State(site): State<Arc<Site>>, Path(axis): Path<String>) -> Response {
    let healthy = site.hub.view(&axis, |view| json!({ "healthy": view.healthy, "phases": view.phases }));
    healthy.map_or_else(|| no_axis(&site, &axis), |healthy| Json(healthy).into_response())
}

/// Takes note of the latched flag; the body, where there is one, says who does.
async fn acknowledge(State(site): State<Arc<Site>>, Path(axis): Path<String>, body: Bytes) -> Response {
    match Signature::from_json(&body) {
        Ok(signature) => order(&site, &axis, Order::Acknowledge(signature), "acknowledged"),
        Err(what) => problem(StatusCode::BAD_REQUEST, &what),
    }
}

async fn new_baseline(State(site): State<Arc<Site>>, Path(axis): Path<String>) -> Response {
    order(&site, &axis, Order::Renew, "new_baseline")
}

/// Notes a repair; the body is the entry as JSON.
async fn repairs(State(site): State<Arc<Site>>, Path(axis): Path<String>, body: Bytes) -> Response {
    match NewRepair::from_json(&body) {
        Ok(entry) => order(&site, &axis, Order::Repair(entry), "noted"),
        Err(what) => problem(StatusCode::BAD_REQUEST, &what),
    }
}

fn order(site: &Site, axis: &str, order: Order, answer: &str) -> Response {
    let Err(not_taken) = site.hub.order(axis, order) else {
        return (StatusCode::ACCEPTED, Json(json!({ answer: axis }))).into_response();
    };
    let code = match &not_taken {
        NotTaken::NoAxis { .. } => StatusCode::NOT_FOUND,
        NotTaken::NotRunning { .. } => StatusCode::CONFLICT,
        NotTaken::Busy { .. } => StatusCode::SERVICE_UNAVAILABLE,
    };
    problem(code, &not_taken.to_string())
}

/// 200 where every axis hears its machine, else 503 with what is wrong.
async fn healthz(State(site): State<Arc<Site>>) -> Response {
    let axes = site.hub.axes();
    let ill: Vec<String> = axes
        .iter()
        .filter(|axis| axis.stale || axis.source.state == SourceState::Down)
        .map(|axis| {
            let why = axis.source.detail.clone().unwrap_or_else(|| "no command arrives".into());
            format!("{}: {why}", axis.axis)
        })
        .collect();
    if ill.is_empty() {
        (StatusCode::OK, "ok\n").into_response()
    } else {
        (StatusCode::SERVICE_UNAVAILABLE, format!("{}\n", ill.join("\n"))).into_response()
    }
}

/// The last events that are no cycles, oldest first.
async fn history(State(site): State<Arc<Site>>) -> Response {
    let events = format!("[{}]", site.hub.history().join(","));
    ([(header::CONTENT_TYPE, "application/json")], events).into_response()
}

#[derive(Deserialize)]
struct Wanted {
    axis: Option<String>,
}

/// A stream of `status` (everything's condition), `live` (the command of one axis lately) and each event under its name.
async fn events(State(site): State<Arc<Site>>, Query(wanted): Query<Wanted>) -> Response {
    let Ok(permit) = Arc::clone(&site.streams).try_acquire_owned() else {
        let what = format!("{STREAMS} event streams are open; end one, or ask for the status");
        return problem(StatusCode::SERVICE_UNAVAILABLE, &what);
    };
    let (sender, receiver) = mpsc::channel::<Result<sse::Event, Infallible>>(32);
    tokio::spawn(feed(site, wanted.axis, sender, Some(permit)));
    Sse::new(ReceiverStream::new(receiver))
        .keep_alive(sse::KeepAlive::new().interval(Duration::from_secs(15)))
        .into_response()
}

/// Feeds a stream until its client goes or is left behind; `_permit` is one of the streams that there may be.
async fn feed(
    site: Arc<Site>,
    wanted: Option<String>,
    sender: mpsc::Sender<Result<sse::Event, Infallible>>,
    _permit: Option<OwnedSemaphorePermit>,
) {
    let mut publications = site.hub.subscribe(EVENTS_BEHIND);
    let mut beats = tokio::time::interval(BEAT);
    beats.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut stop = site.stop.clone();
    let (mut beat, mut seen_ns) = (0u64, i64::MIN);
    loop {
        let event = tokio::select! {
            _ = stop.changed() => return,
            () = sender.closed() => return,
            Some(publication) = publications.recv() => {
                // One that was left behind is told by the end of its stream: it asks again, and for the history.
                if publications.lost() > 0 {
                    return;
                }
                sse::Event::default().event(publication.kind.name()).data(&publication.json)
            }
            _ = beats.tick() => {
                beat += 1;
                if beat % 4 == 1 {
                    named("status", &overview(&site))
                } else {
                    let Some(axis) = wanted.as_deref() else { continue };
                    let fresh = site.hub.view(axis, |view| {
                        view.live.iter().filter(|(t_ns, _)| *t_ns > seen_ns).copied().collect::<Vec<_>>()
                    });
                    let fresh = fresh.unwrap_or_default();
                    let Some((newest_ns, _)) = fresh.last() else { continue };
                    seen_ns = *newest_ns;
                    named("live", &fresh)
                }
            }
        };
        if sender.send(Ok(event)).await.is_err() {
            return;
        }
    }
}

fn named(name: &str, value: &impl Serialize) -> sse::Event {
    sse::Event::default().event(name).data(serde_json::to_string(value).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hub::Acknowledgement;
    use seepd_monitor::event::Flag;

    fn site() -> (Arc<Site>, watch::Sender<bool>) {
        let (keep_open, stop) = watch::channel(false);
        let listen = HttpConfig::default().listen;
        let hub = Hub::new("test".into());
        let streams = Arc::new(Semaphore::new(STREAMS));
        let site = Site { hub, clock: Clock::start(), token: None, listen, stop, streams };
        (Arc::new(site), keep_open)
    }

    fn nobody() -> Acknowledgement {
        Acknowledgement { t_ns: 0, who: None, note: None }
    }

    #[tokio::test]
    async fn a_name_with_line_breaks_ends_no_event_and_no_stream() {
        let (site, _keep_open) = site();
        let (sender, receiver) = mpsc::channel(32);
        tokio::spawn(feed(Arc::clone(&site), None, sender, None));
        tokio::task::yield_now().await;
        site.hub.publish_acknowledged("press\r\n1", Some(Flag::Leak), &nobody());
        let stream = Sse::new(ReceiverStream::new(receiver)).into_response().into_body().into_data_stream();
        let text = first_piece_with(stream, "event: acknowledged").await;
        assert!(text.contains(r#""axis":"press\r\n1""#), "{text}");
        assert_eq!(text.trim_end().lines().count(), 2, "{text}");
    }

    async fn first_piece_with(mut stream: axum::body::BodyDataStream, what: &str) -> String {
        use tokio_stream::StreamExt;
        while let Some(piece) = stream.next().await {
            let text = String::from_utf8(piece.unwrap().to_vec()).unwrap();
            if text.contains(what) {
                return text;
            }
        }
        panic!("the stream ended without {what}");
    }

    #[test]
    fn pages_of_other_sites_may_lead_here_and_nothing_else() {
        let check = |method: Method, site: &'static str, mode: &'static str| {
            let fields = [("sec-fetch-site", site), ("sec-fetch-mode", mode)];
            let named =
                |(name, value)| (header::HeaderName::from_static(name), HeaderValue::from_static(value));
            check_site(&method, &fields.map(named).into_iter().collect()).is_ok()
        };
        assert!(check_site(&Method::POST, &HeaderMap::new()).is_ok(), "no browser says nothing of it");
        for (method, site, mode, is_taken) in [
            (Method::POST, "same-origin", "cors", true),
            (Method::GET, "none", "navigate", true),
            (Method::GET, "cross-site", "navigate", true),
            (Method::POST, "cross-site", "navigate", false),
            (Method::GET, "cross-site", "no-cors", false),
            (Method::POST, "same-site", "cors", false),
            (Method::GET, "what", "cors", false),
        ] {
            assert_eq!(check(method.clone(), site, mode), is_taken, "{method} {site} {mode}");
        }
    }

    #[tokio::test]
    async fn a_client_that_is_left_behind_is_sent_away() {
        let (site, _keep_open) = site();
        let (sender, mut receiver) = mpsc::channel(1);
        let task = tokio::spawn(feed(Arc::clone(&site), None, sender, None));
        tokio::task::yield_now().await;
        for _ in 0..2 * EVENTS_BEHIND {
            site.hub.publish_acknowledged("press", None, &nobody());
            tokio::task::yield_now().await;
        }
        let mut heard = 0;
        while receiver.recv().await.is_some() {
            heard += 1;
        }
        task.await.unwrap();
        assert!((1..EVENTS_BEHIND).contains(&heard), "{heard}");
    }
}
