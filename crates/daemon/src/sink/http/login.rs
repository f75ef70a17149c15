//! The form that asks a person for the token.

use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use maud::{DOCTYPE, html};

use super::{Entry, Site, let_in, same};

/// Where the form goes.
pub(super) const PATH: &str = "/login";
/// Longest answer that is read, bytes.
const LONGEST: usize = 4096;

/// What may be asked for without the token: the form's own way in, and how it looks.
pub(super) fn is_open(path: &str) -> bool {
    [PATH, "/dashboard.css"].contains(&path)
}

/// The form; with a remark where what was given is not the token.
pub(super) fn form(is_wrong: bool) -> Response {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { "Log in · seepd" }
                link rel="icon" href="data:,";
                link rel="stylesheet" href="/dashboard.css";
            }
            body.login {
                main {
                    form method="post" action=(PATH) {
                        h1 { "seepd" }
                        p { "This gateway asks for a token. Whoever has set it up knows it: it stands in the file that " code { "http.token_file" } " names." }
                        @if is_wrong { p.refused role="alert" { "That is not the token of this gateway." } }
                        label { "Token " input name="token" type="password" autocomplete="current-password" required autofocus; }
                        button type="submit" { "Log in" }
                    }
                }
            }
        }
    };
    let headers = [(header::CONTENT_TYPE, "text/html; charset=utf-8")];
    (StatusCode::UNAUTHORIZED, headers, page.into_string()).into_response()
}

/// Takes the form: the right token leaves its cookie and leads to the page.
pub(super) async fn enter(State(site): State<Arc<Site>>, body: Bytes) -> Response {
    let Some(token) = &site.token else { return let_in("") };
    let brought = Some(&body).filter(|body| body.len() <= LONGEST).and_then(|body| token_of(body));
    if brought.is_some_and(|brought| same(brought.trim().as_bytes(), token.as_bytes())) {
        return let_in(token);
    }
    form(true)
}

/// The token of a form's answer, which is written like the query of an address.
fn token_of(body: &[u8]) -> Option<String> {
    let address = format!("/?{}", std::str::from_utf8(body).ok()?).parse().ok()?;
    axum::extract::Query::<Entry>::try_from_uri(&address).ok()?.0.token
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_are_read_and_junk_is_not() {
        assert_eq!(token_of(b"token=a%2Bb+c"), Some("a+b c".into()));
        assert_eq!(token_of(b"token="), Some(String::new()));
        for junk in [&b""[..], b"other=1", b"\xff\xfe", b"token=a\r\nb", b"{\"token\":1}"] {
            assert_eq!(token_of(junk), None, "{junk:?}");
        }
    }
}
