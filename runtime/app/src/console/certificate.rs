//! The certificate that a console beyond loopback makes for itself.
//!
//! It is self-signed, good for a year, and names loopback, the machine and the addresses at which
//! it is reached. It is kept, with its key, in `trocar/console.json` of `$XDG_STATE_HOME` (or
//! `~/.local/state`), which its user alone may read: a headset that has accepted it once knows it
//! the next time. Another one is made when it lacks a name or has less than 30 days left.

use std::env;
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{self, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use rcgen::{
    CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, KeyPair, date_time_ymd,
};
use serde::{Deserialize, Serialize};

use crate::rt;

/// For how long a certificate is good, s.
const GOOD_S: u64 = 365 * DAY_S;

/// With less than this left another one is made, s.
const LEFT_S_MIN: u64 = 30 * DAY_S;

/// It is good from so long ago on, for clocks that are late, s.
const BEFORE_S: u64 = DAY_S;

const DAY_S: u64 = 24 * 3600;

/// A certificate with its key, as it is kept.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Certificate {
    /// DNS names and addresses.
    names: Vec<String>,
    /// Until when it is good, seconds of the Unix epoch.
    not_after_unix_s: u64,
    /// The certificate, PEM.
    pub(super) certificate: String,
    /// Its private key, PEM.
    pub(super) key: String,
}

impl Certificate {
    /// The kept one of this user if it names all of `names`, or another one, which is kept if there
    /// is a place for it.
    ///
    /// # Errors
    /// If none can be made.
    pub(super) fn of_user(names: &[String]) -> Result<Self, rcgen::Error> {
        let now_unix_s = now_unix_s();
        let path = place();
        let kept = path.as_deref().and_then(read);
        if let Some(kept) = kept.filter(|kept| kept.will_do(names, now_unix_s)) {
            return Ok(kept);
        }
        let made = Self::make(names, now_unix_s)?;
        // Without a place for it the next start makes another one.
        let _kept = path.map(|path| made.keep(&path));
        Ok(made)
    }

    /// A new key and a certificate for `names` from a day ago on.
    fn make(names: &[String], now_unix_s: u64) -> Result<Self, rcgen::Error> {
        let not_after_unix_s = now_unix_s + GOOD_S;
        let mut params = CertificateParams::new(names)?;
        let epoch = date_time_ymd(1970, 1, 1);
        params.not_before = epoch + Duration::from_secs(now_unix_s.saturating_sub(BEFORE_S));
        params.not_after = epoch + Duration::from_secs(not_after_unix_s);
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
        params.distinguished_name = DistinguishedName::new();
        params
            .distinguished_name
            .push(DnType::CommonName, "Trocar console");
        let key = KeyPair::generate()?;
        Ok(Self {
            names: names.to_vec(),
            not_after_unix_s,
            certificate: params.self_signed(&key)?.pem(),
            key: key.serialize_pem(),
        })
    }

    /// Whether it names all of `names` and is good for long enough.
    fn will_do(&self, names: &[String], now_unix_s: u64) -> bool {
        names.iter().all(|name| self.names.contains(name))
            && self.not_after_unix_s > now_unix_s + LEFT_S_MIN
            // One of a clock that was ahead is not valid yet.
            && self.not_after_unix_s <= now_unix_s + GOOD_S + BEFORE_S
    }

    /// Writes it where its user alone can read it.
    fn keep(&self, path: &Path) -> io::Result<()> {
        if let Some(folder) = path.parent() {
            DirBuilder::new()
                .mode(0o700)
                .recursive(true)
                .create(folder)?;
        }
        let part = path.with_extension(format!("{}.part", std::process::id()));
        let mut options = OpenOptions::new();
        let mut file = options
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(&part)?;
        let written = serde_json::to_vec(self).map_err(io::Error::other);
        let written = written.and_then(|text| file.write_all(&text));
        let kept = written.and_then(|()| fs::rename(&part, path));
        if kept.is_err() {
            let _gone = fs::remove_file(&part);
        }
        kept
    }
}

/// What is kept at `path`, if it is this user's alone.
fn read(path: &Path) -> Option<Certificate> {
    let file = File::open(path).ok()?;
    let (found, own) = (file.metadata().ok()?, fs::metadata("/proc/self").ok()?);
    let private = found.uid() == own.uid() && found.mode() & 0o077 == 0;
    private
        .then(|| serde_json::from_reader(io::BufReader::new(file)).ok())
        .flatten()
}

/// Where this user's is kept.
fn place() -> Option<PathBuf> {
    let folder = |name| env::var_os(name).map(PathBuf::from);
    let state = folder("XDG_STATE_HOME").filter(|path| path.is_absolute());
    let state = state.or_else(|| {
        let home = folder("HOME").filter(|path| path.is_absolute())?;
        Some(home.join(".local/state"))
    });
    Some(state?.join("trocar/console.json"))
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "whole seconds since 1970"
)]
fn now_unix_s() -> u64 {
    rt::unix_seconds() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: u64 = 1_800_000_000;

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|&name| name.to_owned()).collect()
    }

    fn scratch(name: &str) -> PathBuf {
        let folder = env::temp_dir().join(format!("trocar-{name}-{}", std::process::id()));
        let _old = fs::remove_dir_all(&folder);
        folder.join("trocar/console.json")
    }

    #[test]
    fn one_is_kept_for_its_user_alone() {
        let path = scratch("certificate");
        let made = Certificate::make(&names(&["localhost", "10.0.0.1"]), NOW).unwrap();
        made.keep(&path).unwrap();
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o777, 0o600);
        assert_eq!(read(&path), Some(made));
        fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o640)).unwrap();
        assert_eq!(read(&path), None, "others can read its key");
        fs::write(&path, "{").unwrap();
        assert_eq!(read(&path), None);
        fs::remove_dir_all(path.ancestors().nth(2).unwrap()).unwrap();
    }

    #[test]
    fn another_is_made_for_another_name_and_in_time() {
        let made = Certificate::make(&names(&["localhost", "10.0.0.1"]), NOW).unwrap();
        assert!(made.will_do(&names(&["10.0.0.1"]), NOW));
        assert!(!made.will_do(&names(&["10.0.0.2", "localhost"]), NOW));
        let last = NOW + GOOD_S - LEFT_S_MIN;
        assert!(made.will_do(&names(&["localhost"]), last - 1));
        assert!(!made.will_do(&names(&["localhost"]), last));
        assert!(!made.will_do(&names(&["localhost"]), NOW - BEFORE_S - 1));
    }
}
