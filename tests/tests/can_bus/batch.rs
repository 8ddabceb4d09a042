//! Several frames in one system call: what a cycle of a CAN master wants, and the socket crate
//! lacks.

use std::io;
use std::mem::zeroed;
use std::os::fd::{AsRawFd as _, RawFd};
use std::ptr;

use socketcan::{CanSocket, Socket as _};

use crate::pair::pass_ms;
use crate::peer::alone;

/// As many as an arm's drives and a SYNC.
const COUNT: usize = 8;

/// Frames in memory with the headers that point at them.
struct Batch {
    frames: [libc::can_frame; COUNT],
    parts: [libc::iovec; COUNT],
    headers: [libc::mmsghdr; COUNT],
}

impl Batch {
    fn new() -> Box<Self> {
        #[expect(unsafe_code, reason = "C structures have no other start")]
        // SAFETY: all fields are numbers and pointers, for which zero bytes are a value.
        let mut batch: Box<Self> = Box::new(unsafe { zeroed() });
        for place in 0..COUNT {
            batch.parts[place] = libc::iovec {
                iov_base: ptr::from_mut(&mut batch.frames[place]).cast(),
                iov_len: size_of::<libc::can_frame>(),
            };
            batch.headers[place].msg_hdr.msg_iov = ptr::from_mut(&mut batch.parts[place]);
            batch.headers[place].msg_hdr.msg_iovlen = 1;
        }
        batch
    }

    #[expect(unsafe_code, reason = "a system call without a safe binding")]
    fn send(&mut self, socket: RawFd) -> io::Result<usize> {
        // SAFETY: the headers, and what they point at, live in the boxed batch, which does not
        // move.
        let sent = unsafe {
            libc::sendmmsg(
                socket,
                self.headers.as_mut_ptr(),
                u32::try_from(COUNT).unwrap(),
                libc::MSG_DONTWAIT,
            )
        };
        usize::try_from(sent).map_err(|_negative| io::Error::last_os_error())
    }

    #[expect(unsafe_code, reason = "a system call without a safe binding")]
    fn receive(&mut self, socket: RawFd) -> io::Result<usize> {
        // SAFETY: the headers, and what they point at, live in the boxed batch, which does not
        // move.
        let received = unsafe {
            libc::recvmmsg(
                socket,
                self.headers.as_mut_ptr(),
                u32::try_from(COUNT).unwrap(),
                libc::MSG_DONTWAIT,
                ptr::null_mut(),
            )
        };
        usize::try_from(received).map_err(|_negative| io::Error::last_os_error())
    }
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn one_call_sends_and_one_call_receives_eight_frames() {
    let _turn = alone();
    let [sender, receiver] = [(); 2].map(|()| CanSocket::open("vcan0").unwrap());
    let mut out = Batch::new();
    for (frame, id) in out.frames.iter_mut().zip(0x201..) {
        frame.can_id = id;
        frame.can_dlc = 6;
        frame.data = [1, 2, 3, 4, 5, 6, 0, 0];
    }
    assert_eq!(out.send(sender.as_raw_fd()).unwrap(), COUNT);
    let mut back = Batch::new();
    // The kernel may hand the frames over a little after it took them.
    pass_ms(20);
    assert_eq!(back.receive(receiver.as_raw_fd()).unwrap(), COUNT);
    for (frame, id) in back.frames.iter().zip(0x201..) {
        assert_eq!((frame.can_id, frame.can_dlc), (id, 6));
        assert_eq!(frame.data[..6], [1, 2, 3, 4, 5, 6]);
    }
    // And an empty queue does not block.
    let nothing = back.receive(receiver.as_raw_fd()).unwrap_err();
    assert_eq!(nothing.kind(), io::ErrorKind::WouldBlock);
}
