//! Where the console listens, and under which names others reach it there. An address is checked as
//! it is typed; whether one can listen there shows in `doors`.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::str::FromStr;

use nix::ifaddrs::{InterfaceAddress, getifaddrs};
use nix::net::if_::InterfaceFlags;
use nix::unistd::gethostname;
use rustls::pki_types::DnsName;

/// Address and port if none are given.
pub const DEFAULT_ADDRESS: &str = "127.0.0.1:8080";

/// Loopback, and the port of Foxglove's own examples.
pub const FOXGLOVE_ADDRESS: &str = "127.0.0.1:8765";

/// An address and a port; port 0 is any that is free. What is not loopback is reached from other
/// machines, by TLS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Address(SocketAddr);

/// A text that is no such address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is no address: expected ADDRESS:PORT or PORT, such as 127.0.0.1:8080, localhost:9000, [::1]:8080, 8080 or, for other machines, 0.0.0.0:8443, with a port in [0, 65535]"
)]
pub struct BadAddress(String);

impl Address {
    /// The address.
    #[must_use]
    pub const fn socket(self) -> SocketAddr {
        self.0
    }

    /// Whether other machines reach it.
    #[must_use]
    pub const fn is_open(self) -> bool {
        !self.0.ip().is_loopback()
    }

    /// The addresses at which it is reached: its own, or those of all interfaces, the ones of other
    /// machines first.
    pub(super) fn reached_at(self) -> Vec<IpAddr> {
        let own = self.0.ip();
        if !own.is_unspecified() {
            return vec![own];
        }
        let mut all = interfaces();
        // Linux takes IPv4 at [::] too.
        all.retain(|ip| own.is_ipv6() || ip.is_ipv4());
        all.sort_by_key(|ip| (ip.is_loopback(), ip.is_ipv6()));
        all
    }
}

/// The addresses of all interfaces that are up, without those that need the interface's name beside
/// them.
fn interfaces() -> Vec<IpAddr> {
    let of = |interface: InterfaceAddress| {
        let address = interface.address?;
        let v4 = address.as_sockaddr_in().map(|it| IpAddr::V4(it.ip()));
        let v6 = || address.as_sockaddr_in6().map(|it| IpAddr::V6(it.ip()));
        v4.or_else(v6)
            .filter(|_| interface.flags.contains(InterfaceFlags::IFF_UP))
    };
    let all = getifaddrs().into_iter().flatten().filter_map(of);
    let far = |ip: &IpAddr| match ip {
        IpAddr::V4(_) => true,
        IpAddr::V6(ip) => !ip.is_unicast_link_local(),
    };
    all.filter(far).collect()
}

/// What a certificate for `addresses` names: this machine, by loopback and by its name, and all at
/// which it is reached.
pub(super) fn names(addresses: &[Address]) -> Vec<String> {
    let mut names = vec![
        "localhost".to_owned(),
        "127.0.0.1".to_owned(),
        "::1".to_owned(),
    ];
    let host = gethostname().ok().and_then(|name| name.into_string().ok());
    if let Some(host) = host {
        // As multicast DNS knows it.
        let local = (!host.contains('.')).then(|| format!("{host}.local"));
        names.extend(local);
        names.push(host);
    }
    let reached = addresses.iter().flat_map(|address| address.reached_at());
    names.extend(reached.map(|ip| ip.to_string()));
    names.retain(|name| name.parse::<IpAddr>().is_ok() || DnsName::try_from(name.as_str()).is_ok());
    names.sort();
    names.dedup();
    names
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
        address.map(Self).ok_or_else(|| BadAddress(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_loopback_is_open() {
        for (text, expected, open) in [
            ("127.0.0.1:8080", "127.0.0.1:8080", false),
            ("localhost:9000", "127.0.0.1:9000", false),
            ("9000", "127.0.0.1:9000", false),
            ("[::1]:0", "[::1]:0", false),
            ("127.8.9.1:1", "127.8.9.1:1", false),
            ("0.0.0.0:8080", "0.0.0.0:8080", true),
            ("192.168.1.2:80", "192.168.1.2:80", true),
            ("[::]:8080", "[::]:8080", true),
        ] {
            let address: Address = text.parse().unwrap();
            assert_eq!(address.to_string(), expected);
            assert_eq!(address.is_open(), open, "{text}");
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
            assert!(refused.to_string().contains("expected ADDRESS:PORT"));
        }
    }

    #[test]
    fn a_certificate_names_where_it_is_reached() {
        let one: Address = "192.0.2.7:80".parse().unwrap();
        assert_eq!(one.reached_at(), [IpAddr::from([192, 0, 2, 7])]);
        let all: Address = "0.0.0.0:80".parse().unwrap();
        let reached = all.reached_at();
        let last = reached.last().unwrap();
        assert!(last.is_loopback(), "other machines have no use for it");
        assert!(reached.iter().all(IpAddr::is_ipv4));
        let names = names(&[one, all]);
        for name in ["localhost", "127.0.0.1", "::1", "192.0.2.7"] {
            let count = names.iter().filter(|known| *known == name).count();
            assert_eq!(count, 1, "{name} in {names:?}");
        }
    }
}
