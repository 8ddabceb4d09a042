//! `--console` and `--foxglove`: where a browser, and Foxglove, find what a verb does.

use std::path::PathBuf;

use clap::Args;

use trocar::console::{Address, Console, DEFAULT_ADDRESS, FOXGLOVE_ADDRESS, ListenAddresses};
use trocar::session::{SessionError, Setup};

use crate::console;

/// Where a page is.
#[derive(Args, Clone, Debug)]
pub(crate) struct PageArgs {
    /// Show this in the browser, and steer from there what can be steered: a page at this address,
    /// 127.0.0.1:8080 if none is given, whose URL with its token is printed. At other addresses
    /// than loopback, such as 0.0.0.0:8443, the page is reached by TLS; the SHA-256 of its
    /// certificate is printed too. The page's stop button is no emergency stop.
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = DEFAULT_ADDRESS)]
    pub(crate) console: Option<Address>,
    /// Serve --console, and --foxglove, by TLS with this certificate, PEM, its chain behind it,
    /// instead of a self-signed one.
    #[arg(long, value_name = "FILE", requires = "console_key")]
    pub(crate) console_cert: Option<PathBuf>,
    /// The private key of --console-cert, PEM.
    #[arg(long, value_name = "FILE", requires = "console_cert")]
    pub(crate) console_key: Option<PathBuf>,
}

/// Foxglove's server.
#[derive(Args, Clone, Debug)]
pub(crate) struct FoxgloveArgs {
    /// Serve Foxglove's WebSocket protocol at this address, 127.0.0.1:8765 if none is given:
    /// cameras, joints, frames, and, as far as there are, shapes, filter, guard and events. Its URL
    /// with its token is printed. It moves nothing. A log is played where a page of --console
    /// looks, or else in its own time, over and over. config/foxglove.json is a layout.
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = FOXGLOVE_ADDRESS)]
    pub(crate) foxglove: Option<Address>,
}

/// What a person in a headset sees.
#[derive(Args, Clone, Copy, Debug)]
pub(crate) struct HeadsetArgs {
    /// Stereo in the headset: a right eye 5 mm beside the endoscope, which is the left one,
    /// rendered while a headset shows it. Not with --vary views.
    #[arg(long, requires = "console")]
    pub(crate) stereo: bool,
}

impl HeadsetArgs {
    /// `setup` with as many eyes as asked for.
    pub(crate) fn eyes(self, setup: Setup) -> Result<Setup, SessionError> {
        if self.stereo {
            setup.with_stereo()
        } else {
            Ok(setup)
        }
    }
}

/// What a person moves the arms with.
#[derive(Args, Clone, Debug)]
pub(crate) struct DeskArgs {
    /// Move the arms with a keyboard, gamepad or SpaceMouse of this computer, such as
    /// /dev/input/event5, in place of a page's: the controls are the page's own; G or Start starts
    /// a demonstration, Y or A keeps it, Z or Select has it done again, X or B discards it; a
    /// robot's run is marked a success by Y or A, and to be discarded by X or B. Beside a policy
    /// whoever takes the clutch drives; B of a keyboard, or RB, hands back to it. Several may be
    /// given; of two arms the first then moves psm1 and the others psm2. A keyboard moves the arms
    /// whichever window has the focus. A file or pipe of recorded events will do as well.
    #[arg(long, value_name = "PATH")]
    pub(crate) hands: Vec<PathBuf>,
}

impl DeskArgs {
    /// The console of a session whose hands are these devices: the `opened` one, or one that
    /// listens nowhere.
    pub(crate) fn take_hands(
        &self,
        opened: Option<Console>,
    ) -> Result<Option<Console>, SessionError> {
        if self.hands.is_empty() {
            return Ok(opened);
        }
        let console = match opened {
            Some(console) => console,
            None => Console::listen_on(&ListenAddresses::default())?,
        };
        console.take_hands(&self.hands, console::warning)?;
        Ok(Some(console))
    }

    /// Whether there is a device.
    pub(crate) const fn is_given(&self) -> bool {
        !self.hands.is_empty()
    }
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
        let opened = Console::listen_on(&ListenAddresses {
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
