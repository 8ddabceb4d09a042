//! How much shared memory there is, asked before a topic takes some.

use super::TopicError;

/// The file system that POSIX shared memory lives on.
pub const SHARED_MEMORY_DIR: &str = "/dev/shm";

/// Room on [`SHARED_MEMORY_DIR`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SharedMemorySpace {
    /// Size of the file system, bytes.
    pub total_bytes: u64,
    /// What is left, bytes.
    pub free_bytes: u64,
}

/// Room for shared memory; `None` where the file system is missing.
#[must_use]
pub fn shared_memory_space() -> Option<SharedMemorySpace> {
    let stat = rustix::fs::statvfs(SHARED_MEMORY_DIR).ok()?;
    Some(SharedMemorySpace {
        total_bytes: stat.f_blocks.saturating_mul(stat.f_frsize),
        free_bytes: stat.f_bavail.saturating_mul(stat.f_frsize),
    })
}

/// Checks that `needed_bytes` fit into `space`.
///
/// A segment that does not fit would otherwise kill the process on first touch.
pub(super) fn check_room(
    topic: &str,
    needed_bytes: u64,
    space: SharedMemorySpace,
) -> Result<(), TopicError> {
    if needed_bytes <= space.free_bytes {
        return Ok(());
    }
    Err(TopicError::SharedMemoryTooSmall {
        topic: topic.to_owned(),
        dir: SHARED_MEMORY_DIR,
        needed_bytes,
        free_bytes: space.free_bytes,
        total_bytes: space.total_bytes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_small_shared_memory_is_said_with_numbers_and_remedy() {
        let docker = SharedMemorySpace {
            total_bytes: 64 << 20,
            free_bytes: 10 << 20,
        };
        assert!(check_room("t", 10 << 20, docker).is_ok());
        let message = check_room("trocar/r/psm1/endoscope", 20 << 20, docker)
            .unwrap_err()
            .to_string();
        for part in [
            "trocar/r/psm1/endoscope",
            "20971520",
            "10485760",
            "67108864",
            "--shm-size",
        ] {
            assert!(message.contains(part), "{message}");
        }
    }

    #[test]
    fn this_machine_has_shared_memory() {
        let space = shared_memory_space().unwrap();
        assert!(space.total_bytes >= space.free_bytes && space.free_bytes > 0);
    }
}
