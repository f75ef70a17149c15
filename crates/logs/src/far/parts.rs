//! A file that is far away, read by parts.

use std::error::Error as _;
use std::future::Future;
use std::io::{self, Read, Seek, SeekFrom};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use object_store::aws::AmazonS3Builder;
use object_store::client::{HttpError, HttpErrorKind};
use object_store::http::HttpBuilder;
use object_store::path::Path;
use object_store::{BackoffConfig, ClientOptions, GetOptions, ObjectStore, ObjectStoreExt, RetryConfig};
use tokio::runtime::Runtime;

/// Bytes of the first part that is asked for, and of the first after a jump…
const LEAST_PART: u64 = 256 << 10;
/// … and of the longest, where one is read after the other.
const LONGEST_PART: u64 = 8 << 20;
/// How long a server may be silent.
pub(crate) const SILENCE: Duration = Duration::from_secs(30);
/// How long to wait for a connection.
const CONNECTING: Duration = Duration::from_secs(10);
/// How often is asked again what has failed on the way.
const RETRIES: usize = 2;

/// A file that is far away: what is asked for is fetched, and the newest part of it held.
pub(crate) struct Parts {
    store: Arc<dyn ObjectStore>,
    place: Path,
    /// What told this content from others of the name.
    e_tag: Option<String>,
    length: u64,
    at: u64,
    held: Vec<u8>,
    held_from: u64,
    worker: Worker,
}

impl Parts {
    /// Asks for the file of an address; a server that is silent for so long has failed.
    ///
    /// # Errors
    /// It is not there, may not be read, or the server does not answer.
    pub(crate) fn open(address: &str, silence: Duration) -> io::Result<Self> {
        // Another part of the program may have chosen one already.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let worker = Worker::new(silence)?;
        let (store, place) = store(address, silence)?;
        let facts = worker.wait(store.head(&place))?.map_err(|error| said(&error, silence))?;
        Ok(Parts {
            store,
            place,
            e_tag: facts.e_tag,
            length: facts.size,
            at: 0,
            held: Vec::new(),
            held_from: 0,
            worker,
        })
    }

    /// Bytes in all.
    pub(crate) fn length(&self) -> u64 {
        self.length
    }

    /// What is held from where reading stands.
    fn at_hand(&self) -> &[u8] {
        let from = self.at.checked_sub(self.held_from).and_then(|from| usize::try_from(from).ok());
        from.and_then(|from| self.held.get(from..)).unwrap_or_default()
    }

    /// Fetches the part where reading stands: twice as much as the last one where it follows that.
    fn fetch(&mut self) -> io::Result<()> {
        let follows = !self.held.is_empty() && self.at == self.held_from + self.held.len() as u64;
        let bytes = if follows { (2 * self.held.len() as u64).min(LONGEST_PART) } else { LEAST_PART };
        let range = self.at..self.length.min(self.at + bytes);
        let silence = self.worker.silence;
        let (store, place) = (&self.store, &self.place);
        let options = GetOptions { range: Some(range.clone().into()), ..GetOptions::default() };
        let (e_tag, part) = self
            .worker
            .wait(async move {
                let answer = store.get_opts(place, options).await?;
                Ok((answer.meta.e_tag.clone(), answer.bytes().await?))
            })?
            .map_err(|error| said(&error, silence))?;
        if e_tag != self.e_tag {
            return Err(io::Error::other("it was replaced while it was read; read it again"));
        }
        if part.len() as u64 != range.end - range.start {
            let text =
                format!("the server's answer is cut short at byte {}", range.start + part.len() as u64);
            return Err(io::Error::new(io::ErrorKind::UnexpectedEof, text));
        }
        self.held = part.into();
        self.held_from = range.start;
        Ok(())
    }
}

impl Read for Parts {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.at >= self.length || buffer.is_empty() {
            return Ok(0);
        }
        if self.at_hand().is_empty() {
            self.fetch()?;
        }
        let there = self.at_hand();
        let count = there.len().min(buffer.len());
        buffer[..count].copy_from_slice(&there[..count]);
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for Parts {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let to = match to {
            SeekFrom::Start(to) => Some(to),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.length.checked_add_signed(by),
        };
        self.at = to.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}

/// Waits for answers, on a thread of its own each time: whoever reads a log may stand in another runtime.
struct Worker {
    runtime: Option<Runtime>,
    silence: Duration,
}

impl Worker {
    fn new(silence: Duration) -> io::Result<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        Ok(Worker { runtime: Some(runtime), silence })
    }

    fn wait<T: Send>(&self, answer: impl Future<Output = T> + Send) -> io::Result<T> {
        let gone = || io::Error::other("nobody waits for the server's answer any more");
        let runtime = self.runtime.as_ref().ok_or_else(gone)?;
        thread::scope(|scope| scope.spawn(|| runtime.block_on(answer)).join()).map_err(|_| gone())
    }
}

impl Drop for Worker {
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
        Error::NotSupported { .. } => (
            ErrorKind::Unsupported,
            "the server gives no parts of a file (HTTP ranges); download it first".to_owned(),
        ),
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

/// The innermost cause, on one line.
fn root_of(error: &object_store::Error) -> String {
    let mut innermost: &dyn std::error::Error = error;
    while let Some(source) = innermost.source() {
        innermost = source;
    }
    innermost.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests;
