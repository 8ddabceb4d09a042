//! `.ci/with-vcan --direct`: a command on interfaces of its own, where the kernel has vcan. So it
//! has here, in whatever way we came by it.

use std::process::{Command, Output};

use super::{alone, file, frame, receive, socket};
use trocar_canopen::master::{Bus as _, Received};

/// What becomes of a shell command there.
fn directly(options: &[&str], command: &str) -> Output {
    Command::new(file(".ci/with-vcan"))
        .args(["--time-limit", "60"])
        .args(options)
        .args(["--direct", "bash", "-c", command])
        .output()
        .unwrap()
}

/// Output and exit code are the commands and one that aborts does not go on.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn vcan_wrapper_passes_output_and_exit_code_on() {
    let _turn = alone();
    let done = directly(&[], "echo out; echo err >&2; exit 7");
    assert_eq!(done.status.code(), Some(7));
    assert_eq!(
        (&*done.stdout, &*done.stderr),
        (&b"out\n"[..], &b"err\n"[..])
    );
    let aborted = directly(&[], "kill -ABRT $$; echo went on");
    assert_eq!(aborted.status.code(), Some(128 + 6));
    assert!(aborted.stdout.is_empty());
    let endless = directly(&["--time-limit", "1"], "sleep 50");
    assert_eq!(endless.status.code(), Some(124));
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn buses_and_shared_memory_are_nobody_elses() {
    let _turn = alone();
    let mut here = socket("vcan1");
    let mark = format!("/dev/shm/trocar-{}", std::process::id());
    let script = format!(
        "set -e
        candump -n 1 -T 50000 vcan1 >/tmp/iceoryx2/heard &
        until grep -q '^ *vcan1 ' /proc/net/can/rcvlist_all; do sleep 0.05; done
        cansend vcan1 123#11; wait
        cat /tmp/iceoryx2/heard
        touch {mark}; ls /dev/shm"
    );
    let done = directly(&[], &script);
    let said = String::from_utf8(done.stdout).unwrap();
    let words: Vec<&str> = said.split_whitespace().collect();
    let name = mark.trim_start_matches("/dev/shm/");
    assert_eq!(words, ["vcan1", "123", "[1]", "11", name], "{said}");
    assert!(!std::path::Path::new(&mark).exists());
    // What comes first here is ours.
    let ours = frame(0x124, &[]);
    socket("vcan1").send(0, &[ours]);
    assert_eq!(receive(&mut here, 1), [Received::Frame(ours)]);
}
