//! What every service of a run is opened with.

use core::time::Duration;

/// Ports may move between threads; each call takes an uncontended lock.
pub(super) type Service = iceoryx2::service::ipc_threadsafe::Service;

/// Readers a topic can have: the other process, a log, and one more.
pub(super) const SUBSCRIBERS_MAX: usize = 3;
/// Unread values a reader keeps of most topics; 1 makes the newest win.
pub(super) const UNREAD: usize = 1;
/// Values a reader can look at while another arrives.
pub(super) const HELD_MAX: usize = 2;
/// Values kept for a reader that comes late.
pub(super) const HISTORY: usize = 1;
/// Values a writer can be filling at once.
pub(super) const LOANED_MAX: usize = 1;

/// Buffers a writer reserves for all of the above, if readers keep `unread` values.
pub(super) const fn buffers(unread: usize) -> usize {
    SUBSCRIBERS_MAX * (unread + HELD_MAX) + HISTORY + LOANED_MAX
}

/// Processes, and threads with a membership of their own, of a run.
pub(super) const NODES_MAX: usize = 16;
/// While a peer creates or removes the same service, opening is tried again this often, a retry
/// pause apart.
pub(super) const OPEN_TRIES: usize = 200;
pub(super) const RETRY_PAUSE: Duration = Duration::from_millis(5);
