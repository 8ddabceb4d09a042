//! TLS of a listener that other machines reach.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustls::ServerConfig;
use rustls::client::verify_server_name;
use rustls::crypto::ring;
use rustls::pki_types::pem::{self, PemObject as _};
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use rustls::server::ParsedCertificate;
use rustls::version::TLS13;
use sha2::{Digest as _, Sha256};
use tokio_rustls::TlsAcceptor;

use super::certificate::Certificate;

/// A certificate that can't be served.
#[derive(Debug, thiserror::Error)]
pub(super) enum BadCertificate {
    /// The file holds none.
    #[error("{}: no PEM of a certificate or a private key: {error}", path.display())]
    Pem { path: PathBuf, error: pem::Error },
    /// None could be made.
    #[error("no certificate can be made: {0}")]
    Making(#[from] rcgen::Error),
    /// The one that was made is none.
    #[error("the certificate that was made can't be read: {0}")]
    Made(#[from] pem::Error),
    /// Certificate and key do not belong together, or can't be used.
    #[error("{0}")]
    Tls(#[from] rustls::Error),
}

/// Who the server is, and how it proves that.
#[derive(Clone)]
pub(super) struct Tls {
    acceptor: TlsAcceptor,
    certificate: CertificateDer<'static>,
}

impl fmt::Debug for Tls {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Tls({})", self.fingerprint())
    }
}

impl Tls {
    /// With the user's own certificate, its chain behind it, and its key.
    ///
    /// # Errors
    /// [`BadCertificate`] if the files hold none, or not both of one.
    pub(super) fn of_files(certificate: &Path, key: &Path) -> Result<Self, BadCertificate> {
        let bad = |path: &Path| {
            let path = path.to_owned();
            move |error| BadCertificate::Pem { path, error }
        };
        let chain = CertificateDer::pem_file_iter(certificate).map_err(bad(certificate))?;
        let chain: Result<Vec<_>, _> = chain.collect();
        let chain = chain.map_err(bad(certificate))?;
        let key = PrivateKeyDer::from_pem_file(key).map_err(bad(key))?;
        let first = chain.first().cloned().ok_or(pem::Error::NoItemsFound);
        let first = first.map_err(bad(certificate))?;
        Self::new(first, chain, key)
    }

    /// With this user's self-signed certificate for `names`.
    ///
    /// # Errors
    /// [`BadCertificate`] if none can be made.
    pub(super) fn of_user(names: &[String]) -> Result<Self, BadCertificate> {
        let made = Certificate::of_user(names)?;
        let certificate = CertificateDer::from_pem_slice(made.certificate.as_bytes())?;
        let key = PrivateKeyDer::from_pem_slice(made.key.as_bytes())?;
        Self::new(certificate.clone(), vec![certificate], key)
    }

    fn new(
        certificate: CertificateDer<'static>,
        chain: Vec<CertificateDer<'static>>,
        key: PrivateKeyDer<'static>,
    ) -> Result<Self, BadCertificate> {
        // Whoever asks for a name finds it in there: an old form of certificate is refused here and
        // not by every browser.
        ParsedCertificate::try_from(&certificate)?;
        let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_protocol_versions(&[&TLS13])?
            .with_no_client_auth()
            .with_single_cert(chain, key)?;
        Ok(Self {
            acceptor: TlsAcceptor::from(Arc::new(config)),
            certificate,
        })
    }

    /// What makes TLS of a connection.
    pub(super) const fn acceptor(&self) -> &TlsAcceptor {
        &self.acceptor
    }

    /// Whether the certificate names `host`, a DNS name or an address, `[::1]` or `::1`.
    pub(super) fn names(&self, host: &str) -> bool {
        let bare = host.strip_prefix('[').and_then(|it| it.strip_suffix(']'));
        let parsed = ParsedCertificate::try_from(&self.certificate);
        match (parsed, ServerName::try_from(bare.unwrap_or(host))) {
            (Ok(certificate), Ok(name)) => verify_server_name(&certificate, &name).is_ok(),
            (Err(_), _) | (_, Err(_)) => false,
        }
    }

    /// SHA-256 of the certificate, as browsers show it.
    pub(super) fn fingerprint(&self) -> String {
        let hash = Sha256::digest(&self.certificate);
        let pairs: Vec<String> = hash.iter().map(|byte| format!("{byte:02X}")).collect();
        pairs.join(":")
    }
}
