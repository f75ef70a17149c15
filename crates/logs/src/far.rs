//! Logs at an address: objects of S3 (`s3://bucket/key`), files of web servers (`https://…`).
//!
//! They are read by parts, as they are asked for: an MCAP log's index first and then the chunks that it takes, everything else from
//! beginning to end. A folder of S3 (`s3://bucket/press-1/`) or a pattern (`s3://bucket/press-1/2026-*.mcap`) stands for the logs in it. The
//! environment says who asks, as for AWS's own tools.

use std::path::{Path, PathBuf};

use crate::error::LogError;

#[cfg(feature = "object-store")]
mod listing;
#[cfg(feature = "object-store")]
mod parts;
#[cfg(feature = "object-store")]
mod store;

#[cfg(feature = "object-store")]
pub(crate) use parts::Parts;
#[cfg(feature = "object-store")]
pub(crate) use store::SILENCE;

const S3: &str = "s3://";
const SCHEMES: [&str; 3] = [S3, "https://", "http://"];
/// What says that a name is a pattern.
pub(crate) const WILDCARDS: [char; 3] = ['*', '?', '['];

/// Whether a path is an address.
pub(crate) fn is_address(path: &Path) -> bool {
    path.to_str().is_some_and(|text| SCHEMES.iter().any(|scheme| text.starts_with(scheme)))
}

/// Whether an address stands for several logs: a folder, or a pattern.
pub(crate) fn is_series(path: &Path) -> bool {
    is_folder(path) || is_pattern(path)
}

/// Whether an address is a folder's.
pub(crate) fn is_folder(path: &Path) -> bool {
    is_address(path) && told(&path.to_string_lossy()).ends_with('/')
}

/// Whether an address is a pattern. What follows a `?` is a query for a web server.
fn is_pattern(path: &Path) -> bool {
    let text = path.to_string_lossy();
    match text.strip_prefix(S3) {
        Some(place) => place.contains(WILDCARDS),
        None => is_address(path) && told(&text).contains('*'),
    }
}

/// The files of a folder, or those that fit a pattern, in no order.
///
/// # Errors
/// [`LogError`] where a server does not list them, or cannot be asked.
pub(crate) fn files_of(path: &Path) -> Result<Vec<PathBuf>, LogError> {
    let address = path.to_string_lossy();
    if !address.starts_with(S3) {
        return Err(LogError::data(told(&address), "a web server does not list its logs; name each of them"));
    }
    listed(&address)
}

#[cfg(feature = "object-store")]
fn listed(address: &str) -> Result<Vec<PathBuf>, LogError> {
    listing::listed(address, SILENCE).map_err(|error| LogError::reading(address, error))
}

#[cfg(not(feature = "object-store"))]
fn listed(address: &str) -> Result<Vec<PathBuf>, LogError> {
    Err(not_built(address))
}

/// What a build without a client of HTTP says.
#[cfg(not(feature = "object-store"))]
pub(crate) fn not_built(name: &str) -> LogError {
    let what =
        "this build reads no addresses; download the log first, or build with `--features object-store`";
    LogError::data(name, what)
}

/// An address as it may be told: without a password, and without what is behind `?`, which may be a signature.
pub(crate) fn told(address: &str) -> String {
    let address = address.split(['?', '#']).next().unwrap_or_default();
    let Some((scheme, rest)) = address.split_once("://") else { return address.to_owned() };
    let (host, path) = rest.split_once('/').map_or((rest, None), |(host, path)| (host, Some(path)));
    let host = host.rsplit_once('@').map_or(host, |(_, host)| host);
    path.map_or_else(|| format!("{scheme}://{host}"), |path| format!("{scheme}://{host}/{path}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_may_be_secret_in_an_address_is_not_told() {
        for (address, expected) in [
            ("https://h/a.mcap?X-Amz-Signature=abc", "https://h/a.mcap"),
            ("https://user:word@h:8080/a/b.csv#x", "https://h:8080/a/b.csv"),
            ("https://h?key=1", "https://h"),
            ("s3://bucket/line 1/a@b.mcap", "s3://bucket/line 1/a@b.mcap"),
        ] {
            assert_eq!(told(address), expected);
            assert!(is_address(Path::new(address)));
        }
        assert!(!is_address(Path::new("ftp://h/a")) && !is_address(Path::new("a/https:/b")));
    }

    #[test]
    fn folders_and_patterns_are_told_from_logs() {
        for (address, series) in [
            ("s3://bucket/line 1/", true),
            ("s3://bucket/", true),
            ("s3://bucket/2026-*.mcap", true),
            ("s3://bucket/press-?/a.mcap", true),
            ("s3://bucket/a.mcap", false),
            ("https://h/logs/", true),
            ("https://h/2026-*.mcap", true),
            ("https://h/a.mcap?key=a*b/", false),
            ("logs/*.mcap", false),
        ] {
            assert_eq!(is_series(Path::new(address)), series, "{address}");
        }
        let refused = files_of(Path::new("https://user:word@h/logs/?key=secret")).unwrap_err().to_string();
        assert_eq!(refused, "https://h/logs/: a web server does not list its logs; name each of them");
    }
}
