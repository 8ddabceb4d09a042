//! Shared memory, CAN, graphics and the network library.

use std::fs;
use std::path::Path;

use socketcan::{CanSocket, Socket as _};
use trocar_topics::{SHARED_MEMORY_DIR, shared_memory_space};

use super::{Finding, Probe, Status};

/// Topics of one arm with two cameras of 512 by 512 take about 48 MB.
const SHARED_MEMORY_GOOD_BYTES: u64 = 128 << 20;
/// One camera takes 23 MB.
const SHARED_MEMORY_LEAST_BYTES: u64 = 32 << 20;
/// Hardware type of CAN interfaces in sysfs.
const ARPHRD_CAN: &str = "280";

/// Room on `/dev/shm`, in which topics live: enough for one arm with two cameras is well, for one
/// camera limited.
pub(super) fn shared_memory() -> Finding {
    let name = "shared memory";
    let remedy = "make /dev/shm larger (containers: --shm-size=512m) and remove stale files there";
    let Some(space) = shared_memory_space() else {
        return Finding::new(
            name,
            Status::Missing,
            format!("{SHARED_MEMORY_DIR} is not there"),
            remedy,
        );
    };
    let status = match space.free_bytes {
        SHARED_MEMORY_GOOD_BYTES.. => Status::Ok,
        SHARED_MEMORY_LEAST_BYTES.. => Status::Limited,
        _ => Status::Missing,
    };
    let (free, total) = (space.free_bytes >> 20, space.total_bytes >> 20);
    Finding::new(
        name,
        status,
        format!("{free} of {total} MiB free on {SHARED_MEMORY_DIR}"),
        remedy,
    )
}

/// What helps where the kernel has no CAN sockets.
pub(crate) const NO_CAN_REMEDY: &str =
    "load the modules can, can_raw and vcan; without kernel support use the simulated arm";

/// Whether the kernel has CAN sockets, and which interfaces there are. One socket is opened for
/// that, bound to all interfaces, and nothing is sent.
pub(super) fn can() -> Finding {
    let interfaces = can_interfaces(Path::new("/sys/class/net"));
    // Index 0 stands for all interfaces, so this asks only whether the kernel knows CAN.
    match CanSocket::open_iface(0) {
        Ok(_) if interfaces.is_empty() => Finding::new(
            "can",
            Status::Limited,
            "CAN supported, no interface",
            "`ip link add dev vcan0 type vcan && ip link set vcan0 up`, or attach an adapter",
        ),
        Ok(_) => Finding::new(
            "can",
            Status::Ok,
            format!("interfaces: {}", interfaces.join(" ")),
            "",
        ),
        Err(error) => Finding::new(
            "can",
            Status::Missing,
            format!("no CAN sockets: {error}"),
            NO_CAN_REMEDY,
        ),
    }
}

/// Names of the CAN interfaces, sorted. By their hardware type, whatever they are called; up or
/// down.
fn can_interfaces(net: &Path) -> Vec<String> {
    let Ok(entries) = fs::read_dir(net) else {
        return Vec::new();
    };
    let is_can = |path: &Path| {
        fs::read_to_string(path.join("type")).is_ok_and(|kind| kind.trim() == ARPHRD_CAN)
    };
    let mut names: Vec<String> = entries
        .flatten()
        .filter(|entry| is_can(&entry.path()))
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// The device that the renderer opens, as the caller's probe names it.
pub(super) fn graphics(probe: Probe<'_>) -> Finding {
    let remedy = "install a Vulkan driver (Debian, in software: mesa-vulkan-drivers libvulkan1)";
    of_probe("graphics", probe, remedy)
}

/// Version and accelerators of libtorch, as the caller's probe names them.
pub(super) fn networks(probe: Probe<'_>) -> Finding {
    of_probe(
        "networks",
        probe,
        "`make build` fetches libtorch; or set LIBTORCH to your own",
    )
}

/// A probe that answers is well, whatever it says: a device in software is one.
fn of_probe(name: &'static str, probe: Probe<'_>, remedy: &str) -> Finding {
    match probe() {
        Ok(detail) => Finding::new(name, Status::Ok, detail, remedy),
        Err(reason) => Finding::new(name, Status::Missing, reason, remedy),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_can_interfaces_are_listed() {
        let net = std::env::temp_dir().join(format!("trocar-doctor-{}", std::process::id()));
        for (name, kind) in [("vcan1", "280\n"), ("eth0", "1\n"), ("can0", "280\n")] {
            fs::create_dir_all(net.join(name)).unwrap();
            fs::write(net.join(name).join("type"), kind).unwrap();
        }
        assert_eq!(can_interfaces(&net), ["can0", "vcan1"]);
        fs::remove_dir_all(&net).unwrap();
        assert!(can_interfaces(&net).is_empty());
    }
}
