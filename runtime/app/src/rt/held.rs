//! What a run in real time holds of the system for its whole process: memory, and cores out of idle
//! states.

use std::fs::File;
use std::io::{self, Write as _};
use std::path::Path;
use std::sync::Arc;

use super::thread::Grant;

/// Where the kernel takes how long a core may need to leave an idle state. A wish holds as long as
/// its writer keeps the file open.
pub const CPU_DMA_LATENCY: &str = "/dev/cpu_dma_latency";

/// What became of the wishes of a process. What was granted of them holds until the last clone is
/// dropped.
#[derive(Clone, Debug)]
pub struct Held {
    /// Locked memory.
    pub memory: Grant,
    /// Cores out of idle states.
    pub cpu_latency: Grant,
    /// Open as long as the wish is to hold.
    latency: Option<Arc<File>>,
}

impl Held {
    /// `memory` is what became of locking it; cores are kept out of idle states if `cores` is true.
    pub(super) fn of(memory: Grant, cores: bool) -> Self {
        let latency = cores.then(|| hold_cpu_latency(Path::new(CPU_DMA_LATENCY)));
        let (cpu_latency, latency) = match latency {
            None => (Grant::NotAsked, None),
            Some(Ok(file)) => (Grant::Granted, Some(Arc::new(file))),
            Some(Err(error)) => (Grant::Refused(error.to_string()), None),
        };
        Self {
            memory,
            cpu_latency,
            latency,
        }
    }

    /// Whether the system refused something.
    pub(super) const fn any_refused(&self) -> bool {
        self.memory.is_refused() || self.cpu_latency.is_refused()
    }

    /// Whether cores are kept out of idle states at this moment.
    #[must_use]
    pub const fn keeps_cores_awake(&self) -> bool {
        self.latency.is_some()
    }
}

/// Wishes that no core needs any time to leave an idle state, at `device`, as long as the file is
/// kept: [`CPU_DMA_LATENCY`].
///
/// # Errors
/// The system's: the device is there and may be written by root alone, if nobody changed that.
pub fn hold_cpu_latency(device: &Path) -> io::Result<File> {
    let mut file = File::options().write(true).open(device)?;
    file.write_all(&0_i32.to_ne_bytes())?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn zero_microseconds_are_written_and_the_file_stays_open() {
        let file = std::env::temp_dir().join(format!("trocar-latency-{}", std::process::id()));
        fs::write(&file, "").unwrap();
        let held = hold_cpu_latency(&file).unwrap();
        assert_eq!(fs::read(&file).unwrap(), [0; 4]);
        let open = fs::read_dir("/proc/self/fd").unwrap();
        let open = open.filter_map(|entry| fs::read_link(entry.ok()?.path()).ok());
        assert!(open.into_iter().any(|target| target == file));
        drop(held);
        fs::remove_file(&file).unwrap();
        let refused = hold_cpu_latency(&file).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::NotFound);
    }

    #[test]
    fn what_is_not_asked_for_is_not_held() {
        let held = Held::of(Grant::Granted, false);
        assert_eq!(held.cpu_latency, Grant::NotAsked);
        assert!(!held.keeps_cores_awake() && !held.any_refused());
        assert!(Held::of(Grant::Refused("no".to_owned()), false).any_refused());
    }

    /// Whether or not this system grants it.
    #[test]
    fn a_wish_is_held_if_and_only_if_it_is_granted() {
        let held = Held::of(Grant::NotAsked, true);
        let granted = held.cpu_latency == Grant::Granted;
        assert_eq!(granted, held.keeps_cores_awake());
        assert_eq!(
            granted,
            hold_cpu_latency(Path::new(CPU_DMA_LATENCY)).is_ok()
        );
        assert_eq!(granted, !held.any_refused());
    }
}
