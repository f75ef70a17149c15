//! Logs at an address: objects of S3 (`s3://bucket/key`), files of web servers (`https://…`).
//!
//! They are read by parts, as they are asked for: an MCAP log's index first and then the chunks that it takes, everything else from
//! beginning to end. The environment says who asks, as for AWS's own tools.

use std::path::Path;

#[cfg(feature = "object-store")]
mod parts;

#[cfg(feature = "object-store")]
pub(crate) use parts::{Parts, SILENCE};

const SCHEMES: [&str; 3] = ["s3://", "https://", "http://"];

/// Whether a path is an address.
pub(crate) fn is_address(path: &Path) -> bool {
    path.to_str().is_some_and(|text| SCHEMES.iter().any(|scheme| text.starts_with(scheme)))
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
}
