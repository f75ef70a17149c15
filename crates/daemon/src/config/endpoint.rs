//! Where something is sent to over HTTP.

/// Longest URL, bytes.
const LONGEST: usize = 2000;

/// A URL's parts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// Whether it is `https`.
    pub tls: bool,
    /// Host; an IPv6 address stands without brackets.
    pub host: String,
    /// Port.
    pub port: u16,
    /// Path and query; `/` where there is none.
    pub path: String,
    /// Host and port as they stand in the URL.
    pub authority: String,
}

impl Endpoint {
    /// Takes a URL apart.
    ///
    /// # Errors
    /// What is wrong with it, to be put behind the key's name.
    pub(super) fn parse(url: &str) -> Result<Self, String> {
        if url.len() > LONGEST {
            return Err(format!("has {} bytes; a URL has {LONGEST} at most", url.len()));
        }
        let wrong = |what: &str| format!("is `{}`; {what}", url.escape_debug());
        let is_allowed = |c: char| {
            c.is_ascii_graphic() && !matches!(c, '"' | '<' | '>' | '\\' | '^' | '`' | '{' | '|' | '}' | '#')
        };
        if !url.chars().all(is_allowed) {
            return Err(wrong(
                "a URL has no blanks, quotes, # or characters beyond ASCII; write them as %XX",
            ));
        }
        let (tls, rest) = match (url.strip_prefix("http://"), url.strip_prefix("https://")) {
            (Some(rest), _) => (false, rest),
            (_, Some(rest)) => (true, rest),
            _ => return Err(wrong("it must begin with http:// or https://")),
        };
        let end = rest.find(['/', '?']).unwrap_or(rest.len());
        let (authority, path) = rest.split_at(end);
        if authority.contains('@') {
            return Err(wrong("it must have no user and password; a token stands in token_file"));
        }
        let (host, port) =
            split_authority(authority).ok_or_else(|| wrong("it must be http://HOST:PORT/PATH"))?;
        let port = port.unwrap_or(if tls { 443 } else { 80 });
        let path = if path.starts_with('/') { path.to_owned() } else { format!("/{path}") };
        Ok(Endpoint { tls, host: host.to_owned(), port, path, authority: authority.to_owned() })
    }
}

/// Host and port.
fn split_authority(authority: &str) -> Option<(&str, Option<u16>)> {
    let (host, port) = match authority.strip_prefix('[') {
        Some(rest) => {
            let (host, rest) = rest.split_once(']')?;
            host.parse::<std::net::Ipv6Addr>().ok()?;
            (host, if rest.is_empty() { None } else { Some(rest.strip_prefix(':')?) })
        }
        None => match authority.split_once(':') {
            Some((host, port)) => (host, Some(port)),
            None => (authority, None),
        },
    };
    let is_host = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_' | ':');
    let port = port.map(str::parse).transpose().ok()?;
    (!host.is_empty() && host.chars().all(is_host) && port != Some(0)).then_some((host, port))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls_are_taken_apart_or_refused() {
        let parts = |url: &str| {
            let Endpoint { tls, host, port, path, .. } = Endpoint::parse(url)?;
            Ok((tls, host, port, path))
        };
        let good = |tls, host: &str, port, path: &str| {
            Ok::<_, String>((tls, host.to_owned(), port, path.to_owned()))
        };
        assert_eq!(parts("http://localhost:4318/v1/metrics"), good(false, "localhost", 4318, "/v1/metrics"));
        assert_eq!(parts("https://otlp.example"), good(true, "otlp.example", 443, "/"));
        assert_eq!(parts("http://[::1]:80?a=b"), good(false, "::1", 80, "/?a=b"));
        for url in [
            "",
            "localhost:4318",
            "ftp://a",
            "http://",
            "http://:4318",
            "http://a:0",
            "http://a:70000",
            "http://a b/",
            "http://u:p@a/",
            "http://a/\r\nX: y",
            "http://[::1",
            "http://[a]:1",
            "http://a/#b",
            "http://a\"b",
            "http://ä",
        ] {
            assert!(parts(url).is_err(), "{url}");
        }
        assert!(parts(&format!("http://{}", "a".repeat(10_000))).unwrap_err().len() < 100);
    }
}
