//! Where a console listens: for pages, for Foxglove, each by TLS where other machines reach it.

use std::io;
use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;

use super::address::{Address, names};
use super::server::{ListenerKind, Opened};
use super::tls::Tls;
use crate::session::SessionError;

/// Addresses that a console listens on.
#[derive(Clone, Debug, Default)]
pub struct ListenAddresses {
    /// For pages.
    pub page: Option<Address>,
    /// For Foxglove.
    pub viewers: Option<Address>,
    /// A certificate of the user's own, with its chain, and its key, PEM: then all is TLS, at
    /// loopback too. Without one a self-signed one is made for what other machines reach.
    pub certificate: Option<(PathBuf, PathBuf)>,
}

/// Where a listener is reached.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reached {
    pub(super) address: SocketAddr,
    /// Whether by TLS.
    pub(super) secure: bool,
}

/// What listens.
pub(super) struct Listening {
    pub(super) page: Option<Reached>,
    pub(super) viewers: Option<Reached>,
    /// Of the certificate, if there is one.
    pub(super) fingerprint: Option<String>,
    pub(super) listeners: Vec<Opened>,
}

impl ListenAddresses {
    /// Listens at all of them.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] if nobody can listen there, or a certificate is none.
    pub(super) fn listen(&self) -> Result<Listening, SessionError> {
        let tls = self.tls()?;
        let mut listeners = Vec::new();
        let mut listen = |option, address: Option<Address>, door| {
            let Some(asked) = address else {
                return Ok::<_, SessionError>(None);
            };
            let (listener, mut address) = bound(option, asked)?;
            if let Some(first) = asked.reached_at().first() {
                address.set_ip(*first);
            }
            let open = self.certificate.is_some() || asked.is_open();
            let tls = tls.clone().filter(|_| open);
            let secure = tls.is_some();
            listeners.push(Opened {
                listener,
                door,
                tls,
            });
            Ok(Some(Reached { address, secure }))
        };
        let page = listen("--console", self.page, ListenerKind::Pages)?;
        let viewers = listen("--foxglove", self.viewers, ListenerKind::Viewers)?;
        Ok(Listening {
            page,
            viewers,
            fingerprint: tls.map(|tls| tls.fingerprint()),
            listeners,
        })
    }

    /// The TLS of those that other machines reach, or of all if the certificate is the user's own.
    fn tls(&self) -> Result<Option<Tls>, SessionError> {
        if let Some((certificate, key)) = &self.certificate {
            let tls = Tls::of_files(certificate, key);
            let bad = |error| format!("--console-cert and --console-key: {error}");
            return tls
                .map(Some)
                .map_err(|error| SessionError::BadArgument(bad(error)));
        }
        let all = [self.page, self.viewers].into_iter().flatten();
        let open: Vec<Address> = all.filter(|address| address.is_open()).collect();
        if open.is_empty() {
            return Ok(None);
        }
        let tls = Tls::of_user(&names(&open));
        tls.map(Some)
            .map_err(|error| SessionError::BadArgument(error.to_string()))
    }
}

/// A listener at `address`, which `option` asks for, and where it is.
fn bound(option: &str, address: Address) -> Result<(TcpListener, SocketAddr), SessionError> {
    let asked = address.socket();
    let failed = |error: io::Error| {
        let hint = if error.kind() == io::ErrorKind::AddrInUse {
            "; port 0 is any that is free"
        } else {
            ""
        };
        let reason = format!("{option} {asked}: cannot listen there: {error}{hint}");
        SessionError::BadArgument(reason)
    };
    let listener = TcpListener::bind(asked).map_err(failed)?;
    listener.set_nonblocking(true).map_err(failed)?;
    let address = listener.local_addr().map_err(failed)?;
    Ok((listener, address))
}
