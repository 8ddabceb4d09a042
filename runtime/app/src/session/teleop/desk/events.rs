//! Events of an input device as the kernel tells them (`linux/input.h`), or as they were recorded.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read as _};
use std::os::unix::fs::FileTypeExt as _;
use std::path::Path;

use crate::session::SessionError;

/// Bytes of a `struct input_event`: time, kind, code, value.
const BYTES: usize = size_of::<libc::timeval>() + 8;

/// Vendor of SpaceMice, and what those are called that have another's.
const CAP_VENDOR: u16 = 0x256f;
const CAP_NAMES: [&str; 3] = ["SpaceMouse", "SpaceNavigator", "3Dconnexion"];

/// An event; kinds and codes are the kernel's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Event {
    pub(super) kind: u16,
    pub(super) code: u16,
    pub(super) value: i32,
}

/// A device that can be read.
#[derive(Debug)]
pub(super) struct Source {
    file: File,
    /// Whether it is a cap with six axes, as far as one can tell.
    pub(super) is_cap: bool,
    /// The ends of each absolute axis, if the device tells them.
    pub(super) ranges: BTreeMap<u16, (i32, i32)>,
}

impl Source {
    /// Opens the device at `path`, or a file or pipe with events of one.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] if it can't be read, or is no input device.
    pub(super) fn open(path: &Path) -> Result<Self, SessionError> {
        let failed = |error: io::Error, what: &str| {
            let hint = if error.kind() == io::ErrorKind::PermissionDenied {
                "; members of the group that owns it (input) may read it"
            } else {
                ""
            };
            let path = path.display();
            SessionError::BadArgument(format!("--hands {path}: {what}{error}{hint}"))
        };
        let found = fs::metadata(path)
            .map_err(|error| failed(error, ""))?
            .file_type();
        let (mut is_cap, mut ranges) = (false, BTreeMap::new());
        if found.is_char_device() {
            let what = "no input device: ";
            let device = evdev::Device::open(path).map_err(|error| failed(error, what))?;
            let name = device.name().unwrap_or_default();
            is_cap = device.input_id().vendor() == CAP_VENDOR
                || CAP_NAMES.iter().any(|known| name.contains(known));
            let axes = device.get_absinfo().map_err(|error| failed(error, what))?;
            ranges.extend(axes.map(|(axis, info)| (axis.0, (info.minimum(), info.maximum()))));
        } else if !found.is_file() && !found.is_fifo() {
            let error =
                io::Error::other("it is neither an input device nor a file or pipe of events");
            return Err(failed(error, ""));
        }
        Ok(Self {
            file: File::open(path).map_err(|error| failed(error, ""))?,
            is_cap,
            ranges,
        })
    }

    /// Hands every event to `each`, until there are no more or it says so.
    pub(super) fn read(mut self, mut each: impl FnMut(Event) -> bool) {
        let mut bytes = [0; BYTES];
        while self.file.read_exact(&mut bytes).is_ok() && each(parse(&bytes)) {}
    }
}

fn parse(bytes: &[u8; BYTES]) -> Event {
    let tail = |from: usize| [bytes[BYTES - 8 + from], bytes[BYTES - 7 + from]];
    let [a, b] = tail(4);
    let [c, d] = tail(6);
    Event {
        kind: u16::from_ne_bytes(tail(0)),
        code: u16::from_ne_bytes(tail(2)),
        value: i32::from_ne_bytes([a, b, c, d]),
    }
}
