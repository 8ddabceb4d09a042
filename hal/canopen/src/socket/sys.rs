//! The system calls, one thin function each. All unsafe code of this crate is here.
#![expect(
    unsafe_code,
    reason = "libc calls; each takes only memory that its function owns or borrows"
)]

use core::ptr;
use std::io;
use std::os::fd::AsRawFd as _;

use hal::count::count_u32;
use socketcan::CanSocket;

/// Frames in one call.
pub(super) const BATCH: usize = 32;

/// A frame as the kernel has it: `struct can_frame`, 16 bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub(super) struct RawFrame {
    /// Identifier and flags.
    pub(super) id: u32,
    /// Data bytes.
    pub(super) length: u8,
    pub(super) padding: [u8; 3],
    /// Data.
    pub(super) data: [u8; 8],
}

const _: () = assert!(size_of::<RawFrame>() == size_of::<libc::can_frame>());

/// Room for one control message of four bytes, aligned as the kernel wants it.
type Control = [u64; 4];

const fn no_header() -> libc::mmsghdr {
    libc::mmsghdr {
        msg_hdr: libc::msghdr {
            msg_name: ptr::null_mut(),
            msg_namelen: 0,
            msg_iov: ptr::null_mut(),
            msg_iovlen: 0,
            msg_control: ptr::null_mut(),
            msg_controllen: 0,
            msg_flags: 0,
        },
        msg_len: 0,
    }
}

const NO_VECTOR: libc::iovec = libc::iovec {
    iov_base: ptr::null_mut(),
    iov_len: 0,
};

/// One header for each frame, pointing at it through its vector.
fn point(
    frames: &mut [RawFrame],
    vectors: &mut [libc::iovec; BATCH],
    headers: &mut [libc::mmsghdr; BATCH],
) -> libc::c_uint {
    let mut count = 0;
    for ((frame, vector), header) in frames.iter_mut().zip(vectors).zip(headers) {
        *vector = libc::iovec {
            iov_base: ptr::from_mut(frame).cast(),
            iov_len: size_of::<RawFrame>(),
        };
        header.msg_hdr.msg_iov = vector;
        header.msg_hdr.msg_iovlen = 1;
        count += 1;
    }
    count
}

/// Sends up to [`BATCH`] frames without waiting; gives how many the kernel took, of which none
/// means a full queue.
pub(super) fn send(socket: &CanSocket, frames: &mut [RawFrame]) -> io::Result<usize> {
    let mut vectors = [NO_VECTOR; BATCH];
    let mut headers = [no_header(); BATCH];
    let count = point(frames, &mut vectors, &mut headers);
    // SAFETY: the first `count` headers point at vectors, and these at frames, that live in this
    // function or are borrowed by it; the kernel only reads the frames.
    let sent = unsafe {
        libc::sendmmsg(
            socket.as_raw_fd(),
            headers.as_mut_ptr(),
            count,
            libc::MSG_DONTWAIT,
        )
    };
    match usize::try_from(sent) {
        Ok(sent) => Ok(sent),
        Err(_) => match io::Error::last_os_error() {
            full if is_full(&full) => Ok(0),
            error => Err(error),
        },
    }
}

fn is_full(error: &io::Error) -> bool {
    matches!(
        error.raw_os_error(),
        Some(libc::ENOBUFS | libc::EAGAIN | libc::EINTR)
    )
}

/// Receives up to [`BATCH`] frames without waiting; gives how many, and how many this socket has
/// missed so far if the kernel says so.
pub(super) fn receive(
    socket: &CanSocket,
    frames: &mut [RawFrame; BATCH],
) -> io::Result<(usize, Option<u32>)> {
    let mut vectors = [NO_VECTOR; BATCH];
    let mut headers = [no_header(); BATCH];
    let mut controls: [Control; BATCH] = [[0; 4]; BATCH];
    let count = point(frames, &mut vectors, &mut headers);
    for (header, control) in headers.iter_mut().zip(&mut controls) {
        header.msg_hdr.msg_control = ptr::from_mut(control).cast();
        header.msg_hdr.msg_controllen = size_of::<Control>();
    }
    // SAFETY: every header points at a vector, a frame and a control buffer that live in this
    // function or are borrowed by it mutably, with their true lengths; without a time limit the
    // last pointer may be null. Any bytes are a `RawFrame`.
    let received = unsafe {
        libc::recvmmsg(
            socket.as_raw_fd(),
            headers.as_mut_ptr(),
            count,
            libc::MSG_DONTWAIT,
            ptr::null_mut(),
        )
    };
    let Ok(received) = usize::try_from(received) else {
        return match io::Error::last_os_error() {
            none if is_full(&none) => Ok((0, None)),
            error => Err(error),
        };
    };
    let missed = received.checked_sub(1).and_then(|newest| {
        let length = headers[newest].msg_hdr.msg_controllen;
        missed_count(&controls[newest], length)
    });
    Ok((received, missed))
}

/// Sockets that can be waited for at once.
const WAITED_MAX: usize = 8;

/// Waits until one of `sockets` has something to read, for `timeout_ns` at most; `false` if one is
/// in trouble.
pub(super) fn wait_readable<'a>(
    sockets: impl Iterator<Item = &'a CanSocket>,
    timeout_ns: u64,
) -> bool {
    const NONE: libc::pollfd = libc::pollfd {
        fd: -1,
        events: libc::POLLIN,
        revents: 0,
    };
    let mut waited = [NONE; WAITED_MAX];
    for (place, socket) in waited.iter_mut().zip(sockets) {
        place.fd = socket.as_raw_fd();
    }
    let timeout = libc::timespec {
        tv_sec: libc::time_t::try_from(timeout_ns / 1_000_000_000).unwrap_or(libc::time_t::MAX),
        tv_nsec: libc::c_long::try_from(timeout_ns % 1_000_000_000).unwrap_or(0),
    };
    // SAFETY: `waited` and `timeout` are live; entries with a negative descriptor are passed over,
    // and without a signal mask the last pointer may be null.
    unsafe {
        libc::ppoll(
            waited.as_mut_ptr(),
            WAITED_MAX as libc::nfds_t,
            &raw const timeout,
            ptr::null(),
        )
    };
    let bad = libc::POLLERR | libc::POLLHUP | libc::POLLNVAL;
    waited.iter().all(|place| place.revents & bad == 0)
}

/// The count in a control message of `SO_RXQ_OVFL`: header of length, level and type, then four
/// bytes.
fn missed_count(control: &Control, length: usize) -> Option<u32> {
    let [_, kind, value, _] = control.map(u64::to_ne_bytes);
    let [l0, l1, l2, l3, t0, t1, t2, t3] = kind;
    let level = i32::from_ne_bytes([l0, l1, l2, l3]);
    let option = i32::from_ne_bytes([t0, t1, t2, t3]);
    let [v0, v1, v2, v3, ..] = value;
    (length >= 20 && level == libc::SOL_SOCKET && option == libc::SO_RXQ_OVFL)
        .then(|| u32::from_ne_bytes([v0, v1, v2, v3]))
}

/// Asks the kernel to count frames that this socket misses.
pub(super) fn count_missed(socket: &CanSocket) -> io::Result<()> {
    const LENGTH: libc::socklen_t = count_u32(size_of::<libc::c_int>());
    let on: libc::c_int = 1;
    // SAFETY: `on` is a live integer of the length that is said.
    let code = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_RXQ_OVFL,
            (&raw const on).cast(),
            LENGTH,
        )
    };
    if code == 0 {
        Ok(())
    } else {
        Err(io::Error::last_os_error())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A full queue and an interrupted call are no room and nothing else is.
    #[test]
    fn only_a_full_queue_or_an_interrupt_is_no_room() {
        let is = |code| is_full(&io::Error::from_raw_os_error(code));
        // ENOBUFS is what an interface's queue says, EAGAIN the socket's own; vcan says neither.
        assert!(is(libc::ENOBUFS) && is(libc::EAGAIN) && is(libc::EINTR));
        assert!(!is(libc::ENETDOWN) && !is(libc::ENODEV) && !is(libc::EINVAL));
    }
}
