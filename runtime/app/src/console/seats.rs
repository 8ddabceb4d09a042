//! Who looks on, and who steers: at most one page. Steering is nobody's until a page asks for it,
//! and free again when it gives it up or goes.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;

use super::drawn::Stream;
use super::pictures::Board;

/// Pages and viewers at a time. Each takes a connection, some buffers, and its part of the server's
/// one thread, at normal priority.
pub(super) const PAGES_MAX: usize = 64;

/// What pages are told of each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Taken {
    /// How many pages there are.
    pub(super) pages: usize,
    /// The one that steers.
    pub(super) steers: Option<u64>,
}

/// All seats.
#[derive(Debug)]
pub(super) struct Seats {
    inner: Mutex<Inner>,
    taken: watch::Sender<Taken>,
    board: Arc<Board>,
}

#[derive(Debug, Default)]
struct Inner {
    next: u64,
    /// What each page looks at.
    watched: BTreeMap<u64, Vec<Stream>>,
    steers: Option<u64>,
}

/// A page's seat; dropping it frees it.
#[derive(Debug)]
pub(super) struct Seat {
    seats: Arc<Seats>,
    id: u64,
}

impl Seats {
    pub(super) fn new(board: Arc<Board>) -> Self {
        Self {
            inner: Mutex::default(),
            taken: watch::Sender::new(Taken::default()),
            board,
        }
    }

    /// Seats another page, if there is room.
    pub(super) fn sit(self: &Arc<Self>) -> Option<Seat> {
        let mut inner = self.lock();
        if inner.watched.len() >= PAGES_MAX {
            return None;
        }
        inner.next += 1;
        let id = inner.next;
        inner.watched.insert(id, Vec::new());
        self.tell(&inner);
        let seats = Arc::clone(self);
        drop(inner);
        Some(Seat { seats, id })
    }

    pub(super) fn watch(&self) -> watch::Receiver<Taken> {
        self.taken.subscribe()
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells the board which streams are wanted and, if that has changed, pages who is there.
    fn tell(&self, inner: &Inner) {
        self.board.want(inner.watched.values().flatten().copied());
        let pages = inner.watched.len();
        let now = Taken {
            pages,
            steers: inner.steers,
        };
        // What a page looks at is nothing to the others.
        self.taken
            .send_if_modified(|before| std::mem::replace(before, now) != now);
    }
}

impl Seat {
    /// Which one it is.
    pub(super) const fn id(&self) -> u64 {
        self.id
    }

    /// Whether this page steers.
    pub(super) fn steers(&self) -> bool {
        self.seats.lock().steers == Some(self.id)
    }

    /// Takes the right to steer, if nobody has it.
    pub(super) fn steer(&self) -> bool {
        let mut inner = self.seats.lock();
        let steers = *inner.steers.get_or_insert(self.id) == self.id;
        self.seats.tell(&inner);
        steers
    }

    /// Gives it back.
    pub(super) fn let_go(&self) {
        let mut inner = self.seats.lock();
        inner.steers = inner.steers.filter(|id| *id != self.id);
        self.seats.tell(&inner);
    }

    /// From now on this page looks at `streams`.
    pub(super) fn look_at(&self, streams: &[Stream]) {
        let mut inner = self.seats.lock();
        inner.watched.insert(self.id, streams.to_vec());
        self.seats.tell(&inner);
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mut inner = self.seats.lock();
        inner.watched.remove(&self.id);
        inner.steers = inner.steers.filter(|id| *id != self.id);
        self.seats.tell(&inner);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_page_steers_until_it_lets_go_or_goes() {
        let seats = Arc::new(Seats::new(Arc::new(Board::new())));
        let [one, other] = [(); 2].map(|()| seats.sit().unwrap());
        assert!(one.steer() && !other.steer() && one.steer());
        assert!(one.steers() && !other.steers());
        other.let_go();
        assert!(one.steers(), "only who steers can let go");
        one.let_go();
        assert!(other.steer() && !one.steer());
        drop(other);
        assert!(one.steer());
        let taken = *seats.watch().borrow();
        assert_eq!((taken.pages, taken.steers), (1, Some(one.id())));
    }

    #[test]
    fn seats_are_bounded_and_freed() {
        let seats = Arc::new(Seats::new(Arc::new(Board::new())));
        let mut all: Vec<Seat> = std::iter::from_fn(|| seats.sit()).collect();
        assert_eq!(all.len(), PAGES_MAX);
        all.pop();
        assert!(seats.sit().is_some());
    }
}
