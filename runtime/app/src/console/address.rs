//! Where the console listens.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::str::FromStr;

/// The port if none is given.
pub const DEFAULT_ADDRESS: &str = "127.0.0.1:8080";

/// The port of Foxglove's own examples.
pub const FOXGLOVE_ADDRESS: &str = "127.0.0.1:8765";

/// A loopback address and a port; port 0 is any that is free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Address(SocketAddr);

/// A text that is no such address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BadAddress {
    /// It has another form.
    #[error(
        "{0:?} is no address: expected HOST:PORT or PORT, such as 127.0.0.1:8080, localhost:9000, [::1]:8080 or 8080, with a port in [0, 65535]"
    )]
    Form(String),
    /// It can be reached from other machines.
    #[error(
        "{0} can be reached from other machines, and the console speaks plain HTTP: allowed are loopback addresses. From another machine use a tunnel: ssh -L 8080:127.0.0.1:{port} HOST", port = .0.port()
    )]
    Open(SocketAddr),
}

impl Address {
    /// The address.
    #[must_use]
    pub const fn socket(self) -> SocketAddr {
        self.0
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl FromStr for Address {
    type Err = BadAddress;

    fn from_str(text: &str) -> Result<Self, BadAddress> {
        let loopback = IpAddr::from(Ipv4Addr::LOCALHOST);
        let port = |port: &str| Some(SocketAddr::new(loopback, port.parse().ok()?));
        let named = || text.strip_prefix("localhost:").and_then(port);
        let address = text.parse().ok().or_else(|| port(text)).or_else(named);
        let address = address.ok_or_else(|| BadAddress::Form(text.to_owned()))?;
        if address.ip().is_loopback() {
            Ok(Self(address))
        } else {
            Err(BadAddress::Open(address))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_loopback_addresses_are_taken() {
        for (text, expected) in [
            ("127.0.0.1:8080", "127.0.0.1:8080"),
            ("localhost:9000", "127.0.0.1:9000"),
            ("9000", "127.0.0.1:9000"),
            ("[::1]:0", "[::1]:0"),
            ("127.8.9.1:1", "127.8.9.1:1"),
        ] {
            let address: Address = text.parse().unwrap();
            assert_eq!(address.to_string(), expected);
        }
        for text in ["0.0.0.0:8080", "192.168.1.2:80", "[::]:8080", "8.8.8.8:1"] {
            let refused = text.parse::<Address>().unwrap_err();
            assert!(matches!(refused, BadAddress::Open(_)), "{text}: {refused}");
            assert!(refused.to_string().contains("ssh -L"));
        }
        for text in [
            "",
            "65536",
            "localhost",
            "runs/a.mcap",
            "127.0.0.1",
            "-1",
            "::1",
        ] {
            let refused = text.parse::<Address>().unwrap_err();
            assert!(matches!(refused, BadAddress::Form(_)), "{text}: {refused}");
        }
    }
}
