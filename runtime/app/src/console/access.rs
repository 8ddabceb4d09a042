//! Who may open the console: whoever has the token, from a page that this server served.
//!
//! The token stands in the URL that the run prints. It is taken from there once: the page comes
//! with a cookie of the same value, which the page's other requests carry and no script can read.
//! The host must be a loopback name, or with TLS one that the certificate names, so that a foreign
//! name that was made to point here (DNS rebinding) reaches nothing; and a WebSocket must come from
//! a page of the same host, which a browser states as its origin.

use std::fs::File;
use std::io::{self, Read as _};
use std::net::{IpAddr, SocketAddr};

use axum::http::{HeaderMap, StatusCode, header};

use super::tls::Tls;

/// Pages that show what a viewer is told.
const VIEWERS: [&str; 2] = ["https://app.foxglove.dev", "https://embed.foxglove.dev"];

/// Bytes of a token.
const TOKEN_BYTES: usize = 16;

/// Random words that whoever opens the console must know, hexadecimal: one for pages, and one for
/// viewers, whose address is passed on more easily and opens no page.
#[derive(Clone, Debug)]
pub(super) struct Access {
    token: String,
    viewer_token: String,
    cookie: String,
}

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refusal {
    /// The host is another machine's name.
    Host,
    /// The page that asks is another server's.
    Origin,
    /// There is no token, or another one.
    Token,
}

impl Refusal {
    /// The status and the text of the answer.
    pub(super) const fn answer(self) -> (StatusCode, &'static str) {
        match self {
            Self::Host => (
                StatusCode::MISDIRECTED_REQUEST,
                "refused: the console answers to localhost, 127.0.0.1 and [::1] alone, or with TLS to the names of its certificate\n",
            ),
            Self::Origin => (
                StatusCode::FORBIDDEN,
                "refused: the WebSocket is for the console's own page\n",
            ),
            Self::Token => (
                StatusCode::UNAUTHORIZED,
                "refused: open the address that trocar has printed, with its token\n",
            ),
        }
    }
}

impl Access {
    /// Fresh tokens for a console at `port`.
    ///
    /// # Errors
    /// If the system gives no random bytes.
    pub(super) fn new(port: u16) -> io::Result<Self> {
        Ok(Self {
            token: token()?,
            viewer_token: token()?,
            // Cookies are shared by all ports of a host.
            cookie: format!("trocar_console_{port}"),
        })
    }

    /// What opens the console at `address` in a browser, by TLS if it is `secure`.
    pub(super) fn url(&self, address: SocketAddr, secure: bool) -> String {
        format!("http{}://{address}/?token={}", s(secure), self.token)
    }

    /// What a viewer opens, at `address`.
    pub(super) fn viewer_url(&self, address: SocketAddr, secure: bool) -> String {
        format!("ws{}://{address}/?token={}", s(secure), self.viewer_token)
    }

    /// The header that makes a browser keep the token, and send it by TLS alone if it came by that.
    pub(super) fn set_cookie(&self, secure: bool) -> String {
        let (name, token) = (&self.cookie, &self.token);
        let secure = if secure { "; Secure" } else { "" };
        format!("{name}={token}; Path=/; HttpOnly; SameSite=Strict{secure}")
    }

    /// Whether `query`, what stands behind the `?` of a URL, has the token.
    pub(super) fn is_in_query(&self, query: Option<&str>) -> bool {
        in_query(query).is_some_and(|token| is_same(&self.token, token))
    }

    /// Whether `query` has the viewers' token.
    pub(super) fn is_viewer_in_query(&self, query: Option<&str>) -> bool {
        in_query(query).is_some_and(|token| is_same(&self.viewer_token, token))
    }

    /// # Errors
    /// [`Refusal::Token`] if no cookie has the token.
    pub(super) fn check_cookie(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        let lines = headers.get_all(header::COOKIE).into_iter();
        let cookies = lines.filter_map(|line| line.to_str().ok());
        let mut pairs = cookies.flat_map(|line| line.split(';'));
        let own = pairs.find_map(|pair| {
            let (name, value) = pair.trim().split_once('=')?;
            (name == self.cookie).then_some(value)
        });
        let known = own.is_some_and(|token| is_same(&self.token, token));
        known.then_some(()).ok_or(Refusal::Token)
    }
}

/// What a scheme has at its end.
const fn s(secure: bool) -> &'static str {
    if secure { "s" } else { "" }
}

/// A fresh token.
fn token() -> io::Result<String> {
    let mut bytes = [0; TOKEN_BYTES];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// The token in `query`, what stands behind the `?` of a URL.
fn in_query(query: Option<&str>) -> Option<&str> {
    let mut pairs = query?.split('&');
    pairs.find_map(|pair| pair.strip_prefix("token="))
}

/// Whether the token `own` was given. The time that this takes tells nothing about where they
/// differ.
fn is_same(own: &str, given: &str) -> bool {
    let pairs = own.bytes().zip(given.bytes());
    let differing = pairs.fold(0, |differing, (one, other)| differing | (one ^ other));
    given.len() == own.len() && std::hint::black_box(differing) == 0
}

/// # Errors
/// [`Refusal::Host`] if the request is not for a loopback name, or with TLS not for a name of the
/// certificate.
pub(super) fn check_host(headers: &HeaderMap, tls: Option<&Tls>) -> Result<(), Refusal> {
    let host = text(headers, header::HOST).ok_or(Refusal::Host)?;
    let loopback = |name: &str| {
        let bare = name.trim_start_matches('[').trim_end_matches(']');
        name == "localhost" || bare.parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
    };
    let name = without_port(host);
    let own = tls.map_or_else(|| loopback(name), |tls| tls.names(name));
    own.then_some(()).ok_or(Refusal::Host)
}

/// # Errors
/// [`Refusal::Origin`] if the page that asks is not one of the host that it asks.
pub(super) fn check_origin(headers: &HeaderMap, secure: bool) -> Result<(), Refusal> {
    let scheme = if secure { "https://" } else { "http://" };
    let origin = text(headers, header::ORIGIN).and_then(|origin| origin.strip_prefix(scheme));
    let host = text(headers, header::HOST);
    let own = origin.is_some() && origin == host;
    own.then_some(()).ok_or(Refusal::Origin)
}

/// # Errors
/// [`Refusal::Origin`] if a viewer is a page, and neither Foxglove's nor one of this machine.
pub(super) fn check_viewer_origin(headers: &HeaderMap) -> Result<(), Refusal> {
    if !headers.contains_key(header::ORIGIN) {
        return Ok(());
    }
    let origin = text(headers, header::ORIGIN).unwrap_or_default();
    let local = ["http://localhost", "http://127.0.0.1", "file://"];
    let known = VIEWERS.contains(&origin) || local.contains(&without_port(origin));
    known.then_some(()).ok_or(Refusal::Origin)
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    let mut values = headers.get_all(name).into_iter();
    let only = values.next().filter(|_| values.next().is_none());
    only?.to_str().ok()
}

/// A host without the port behind it.
fn without_port(host: &str) -> &str {
    match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    }
}

#[cfg(test)]
mod tests {
    use axum::http::{HeaderName, HeaderValue};

    use super::*;

    fn headers(pairs: &[(HeaderName, &str)]) -> HeaderMap {
        let pairs = pairs.iter().cloned();
        let pairs = pairs.map(|(name, value)| (name, HeaderValue::from_str(value).unwrap()));
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.append(name, value);
        }
        headers
    }

    #[test]
    fn a_loopback_name_is_a_host_and_no_other() {
        for host in [
            "localhost:8080",
            "127.0.0.1:1",
            "[::1]:8080",
            "localhost",
            "127.0.0.1",
        ] {
            assert_eq!(
                check_host(&headers(&[(header::HOST, host)]), None),
                Ok(()),
                "{host}"
            );
        }
        for host in [
            "",
            "evil.example",
            "evil.example:8080",
            "localhost.evil.example",
            "192.168.0.1:8080",
            "127.0.0.1.evil.example:80",
            "[::]:80",
        ] {
            let refused = check_host(&headers(&[(header::HOST, host)]), None);
            assert_eq!(refused, Err(Refusal::Host), "{host}");
        }
        let two = headers(&[(header::HOST, "localhost"), (header::HOST, "evil.example")]);
        assert_eq!(check_host(&two, None), Err(Refusal::Host));
        assert_eq!(check_host(&HeaderMap::new(), None), Err(Refusal::Host));
    }

    #[test]
    fn the_origin_is_the_host() {
        let with =
            |origin: &str| headers(&[(header::HOST, "localhost:1"), (header::ORIGIN, origin)]);
        let own = with("http://localhost:1");
        assert_eq!(check_origin(&own, false), Ok(()));
        assert_eq!(check_origin(&own, true), Err(Refusal::Origin));
        assert_eq!(check_origin(&with("https://localhost:1"), true), Ok(()));
        for origin in [
            "http://localhost:2",
            "http://evil.example",
            "null",
            "localhost:1",
            "https://localhost:1",
        ] {
            assert_eq!(
                check_origin(&with(origin), false),
                Err(Refusal::Origin),
                "{origin}"
            );
        }
        let none = headers(&[(header::HOST, "localhost:1")]);
        assert_eq!(check_origin(&none, false), Err(Refusal::Origin));
    }

    #[test]
    fn only_the_whole_token_is_the_token() {
        let access = Access::new(7).unwrap();
        let token = access.token.clone();
        assert_eq!(token.len(), 2 * TOKEN_BYTES);
        assert!(access.is_in_query(Some(&format!("token={token}"))));
        assert!(access.is_in_query(Some(&format!("a=b&token={token}"))));
        let short = &token[1..];
        let [shorter, longer] = [format!("token={short}"), format!("token={token}0")];
        for query in ["", "token=", short, shorter.as_str(), longer.as_str()] {
            assert!(!access.is_in_query(Some(query)), "{query}");
        }
        assert!(!access.is_in_query(None));
        let cookie = |text: &str| access.check_cookie(&headers(&[(header::COOKIE, text)]));
        assert_eq!(cookie(&format!("a=b; trocar_console_7={token}")), Ok(()));
        assert_eq!(
            cookie(&format!("trocar_console_8={token}")),
            Err(Refusal::Token)
        );
        assert_eq!(cookie("trocar_console_7="), Err(Refusal::Token));
        assert_ne!(Access::new(7).unwrap().token, token);
    }
}
