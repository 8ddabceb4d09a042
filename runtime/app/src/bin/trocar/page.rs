//! `--console` and `--foxglove`: where a browser, and Foxglove, find what a verb does.

use std::path::PathBuf;

use clap::Args;

use trocar::console::{Address, Console, DEFAULT_ADDRESS, Doors, FOXGLOVE_ADDRESS};
use trocar::session::SessionError;

use crate::console;

/// Where a page is.
#[derive(Args, Clone, Debug)]
pub(crate) struct PageArgs {
    /// Show this in the browser, and steer from there what can be steered: a page at this address, 127.0.0.1:8080 if none is given, whose URL
    /// with its token is printed. At other addresses than loopback, such as 0.0.0.0:8443, the page is reached by TLS; the SHA-256 of its
    /// certificate is printed too. The page's stop button is no emergency stop.
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = DEFAULT_ADDRESS)]
    pub(crate) console: Option<Address>,
    /// Serve --console, and --foxglove, by TLS with this certificate, PEM, its chain behind it, instead of a self-signed one.
    #[arg(long, value_name = "FILE", requires = "console_key")]
    pub(crate) console_cert: Option<PathBuf>,
    /// The private key of --console-cert, PEM.
    #[arg(long, value_name = "FILE", requires = "console_cert")]
    pub(crate) console_key: Option<PathBuf>,
}

/// Where Foxglove is told.
#[derive(Args, Clone, Debug)]
pub(crate) struct FoxgloveArgs {
    /// Serve Foxglove's WebSocket protocol: cameras, joints, frames, shapes, filter and guard, at this
    /// address, 127.0.0.1:8765 if none is given; its URL with its token is printed. It moves nothing. config/foxglove.json is a layout.
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = FOXGLOVE_ADDRESS)]
    pub(crate) foxglove: Option<Address>,
}

impl PageArgs {
    /// Opens the page and the door for `viewers`, each if asked for, and says where they are.
    pub(crate) fn open(&self, viewers: Option<Address>) -> Result<Option<Console>, SessionError> {
        let certificate = self.console_cert.clone().zip(self.console_key.clone());
        if self.console.is_none() && viewers.is_none() {
            return match certificate {
                None => Ok(None),
                Some(_) => Err(SessionError::BadArgument(
                    "--console-cert needs --console".to_owned(),
                )),
            };
        }
        let opened = Console::open_doors(&Doors {
            page: self.console,
            viewers,
            certificate,
        })?;
        if let Some(sha256) = opened.fingerprint() {
            console::note(&format!("trocar: certificate: SHA-256 {sha256}"));
        }
        if let Some(url) = opened.viewer_url() {
            console::note(&format!("trocar: foxglove: {url}"));
        }
        if let Some(url) = opened.url() {
            console::note(&format!("trocar: console: {url}"));
        }
        Ok(Some(opened))
    }
}
