//! The server of an address, how it is asked, and what is said where that fails.

use std::error::Error as _;
use std::future::Future;
use std::io;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use object_store::aws::AmazonS3Builder;
use object_store::client::{HttpError, HttpErrorKind};
use object_store::http::HttpBuilder;
use object_store::path::Path;
use object_store::{BackoffConfig, ClientOptions, ObjectStore, RetryConfig};
use tokio::runtime::Runtime;

/// How long a server may be silent.
pub(crate) const SILENCE: Duration = Duration::from_secs(30);
/// How long to wait for a connection.
const CONNECTING: Duration = Duration::from_secs(10);
/// How often is asked again what has failed on the way.
const RETRIES: usize = 2;

/// The server of an address.
pub(super) struct Server {
    store: Arc<dyn ObjectStore>,
    runtime: Option<Runtime>,
    silence: Duration,
}

impl Server {
    /// The server of an address, and the place in it; it has failed where it is silent for so long.
    ///
    /// # Errors
    /// It is no address.
    pub(super) fn of(address: &str, silence: Duration) -> io::Result<(Self, Path)> {
        // Another part of the program may have chosen one already.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (store, place) = store(address, silence)?;
        Ok((Server { store, runtime: Some(runtime), silence }, place))
    }

    /// Waits for an answer, on a thread of its own each time: whoever reads a log may stand in another runtime.
    ///
    /// # Errors
    /// What went wrong, in a line.
    pub(super) fn wait<'s, T: Send, F>(&'s self, ask: impl FnOnce(&'s dyn ObjectStore) -> F) -> io::Result<T>
    where
        F: Future<Output = object_store::Result<T>> + Send,
    {
        let gone = || io::Error::other("nobody waits for the server's answer any more");
        let runtime = self.runtime.as_ref().ok_or_else(gone)?;
        let answer = ask(&*self.store);
        thread::scope(|scope| scope.spawn(|| runtime.block_on(answer)).join())
            .map_err(|_| gone())?
            .map_err(|error| said(&error, self.silence))
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // Dropped as it is, a runtime would wait, which no other runtime allows within.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// The store of an address, and the place in it.
fn store(address: &str, silence: Duration) -> io::Result<(Arc<dyn ObjectStore>, Path)> {
    let wrong = |error: object_store::Error| {
        io::Error::new(io::ErrorKind::InvalidInput, format!("as an address: {}", root_of(&error)))
    };
    let (scheme, rest) = address.split_once("://").ok_or(io::ErrorKind::InvalidInput)?;
    let (host, path) = rest.split_once('/').unwrap_or((rest, ""));
    let options = ClientOptions::new()
        .with_connect_timeout(CONNECTING)
        .with_read_timeout(silence)
        .with_timeout_disabled()
        .with_allow_http(true);
    let retry = RetryConfig {
        backoff: BackoffConfig { max_backoff: Duration::from_secs(2), ..BackoffConfig::default() },
        max_retries: RETRIES,
        retry_timeout: (RETRIES as u32 + 1) * silence,
    };
    if scheme == "s3" {
        let builder = AmazonS3Builder::from_env().with_bucket_name(host);
        let built = builder.with_client_options(options).with_retry(retry).build().map_err(wrong)?;
        return Ok((Arc::new(built), Path::parse(path).map_err(|error| wrong(error.into()))?));
    }
    let (path, query) = path.split_once('?').map_or((path, None), |(path, query)| (path, Some(query)));
    let place = Path::from_url_path(path).map_err(|error| wrong(error.into()))?;
    let base =
        query.map_or_else(|| format!("{scheme}://{host}"), |query| format!("{scheme}://{host}?{query}"));
    let builder = HttpBuilder::new().with_url(base).with_client_options(options).with_retry(retry);
    Ok((Arc::new(builder.build().map_err(wrong)?), place))
}

/// What went wrong, in a line that has no address: it may hold a signature.
fn said(error: &object_store::Error, silence: Duration) -> io::Error {
    use io::ErrorKind;
    use object_store::Error;
    let (kind, text) = match error {
        Error::NotFound { .. } => (ErrorKind::NotFound, "there is no such object".to_owned()),
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => (
            ErrorKind::PermissionDenied,
            "access is denied; for s3:// set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY".to_owned(),
        ),
        error if gives_no_parts(error) => {
            (ErrorKind::Unsupported, "the server gives no parts of a file (HTTP ranges)".to_owned())
        }
        error => match kind_of(error) {
            Some(HttpErrorKind::Timeout) => {
                (ErrorKind::TimedOut, format!("the server has not answered for {} s", silence.as_secs_f64()))
            }
            Some(HttpErrorKind::Interrupted | HttpErrorKind::Decode) => {
                (ErrorKind::UnexpectedEof, format!("the server's answer is cut short: {}", root_of(error)))
            }
            _ => (ErrorKind::Other, root_of(error)),
        },
    };
    io::Error::new(kind, text)
}

/// How a request has failed, where it was one.
fn kind_of(error: &object_store::Error) -> Option<HttpErrorKind> {
    let causes = std::iter::successors(error.source(), |&error| error.source());
    causes.filter_map(|error| error.downcast_ref::<HttpError>()).map(HttpError::kind).next()
}

/// Whether it is for want of parts: after a cut, a part is asked for.
pub(super) fn gives_no_parts(error: &object_store::Error) -> bool {
    let causes = std::iter::successors(Some(error as &dyn std::error::Error), |&error| error.source());
    causes
        .filter_map(|error| error.downcast_ref())
        .any(|error| matches!(error, object_store::Error::NotSupported { .. }))
}

/// The innermost cause, on one line; of an answer of S3, its message.
fn root_of(error: &object_store::Error) -> String {
    let mut innermost: &dyn std::error::Error = error;
    while let Some(source) = innermost.source() {
        innermost = source;
    }
    let text = innermost.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
    let message =
        text.split_once("<Message>").and_then(|(_, rest)| rest.split_once("</Message>")).map(|(it, _)| it);
    message.map_or_else(|| text.clone(), |message| format!("the server says: {message}"))
}
