//! Hot path: bounded, no allocation, no I/O, never waits. The newest value from one thread to
//! another.
//!
//! A triple buffer: the writer owns one slot, the reader another, and the third lies between them;
//! handing over is one atomic swap of slot numbers. Each slot sits in a mutex only so that no
//! unsafe code is needed: a slot number is held by one side at a time, so its lock is always free
//! and taking it is a single compare-and-swap. (A queue such as `rtrb` does not fit: when it is
//! full the newest value is the one that is lost.)

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, TryLockError};

/// Set beside the number of the slot in between when the reader has not taken it yet.
const FRESH: usize = 4;
/// The bits of the slot's number, 0 to 2.
const SLOT: usize = 3;

/// What both ends hold.
#[derive(Debug)]
struct Shared<T> {
    slots: [Mutex<Option<T>>; 3],
    /// The number of the slot that neither end owns, with `FRESH` beside it.
    between: AtomicUsize,
}

impl<T: Copy> Shared<T> {
    /// Applies `action` to a slot that the caller holds the number of.
    #[expect(clippy::panic, reason = "a broken invariant of this module alone")]
    fn with<R>(&self, slot: usize, action: impl FnOnce(&mut Option<T>) -> R) -> R {
        match self.slots[slot].try_lock() {
            Ok(mut value) => action(&mut value),
            Err(TryLockError::Poisoned(poisoned)) => action(&mut poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => panic!("slot {slot} is held by both sides"),
        }
    }
}

/// The side that puts values in.
#[derive(Debug)]
pub struct MailboxWriter<T> {
    shared: Arc<Shared<T>>,
    mine: usize,
}

/// The side that takes the newest out.
#[derive(Debug)]
pub struct MailboxReader<T> {
    shared: Arc<Shared<T>>,
    mine: usize,
}

/// An empty mailbox, as its two ends.
#[must_use]
pub fn mailbox<T: Copy + Send>() -> (MailboxWriter<T>, MailboxReader<T>) {
    let slots = [Mutex::new(None), Mutex::new(None), Mutex::new(None)];
    let shared = Arc::new(Shared {
        slots,
        between: AtomicUsize::new(1),
    });
    (
        MailboxWriter {
            shared: Arc::clone(&shared),
            mine: 0,
        },
        MailboxReader { shared, mine: 2 },
    )
}

impl<T: Copy + Send> MailboxWriter<T> {
    /// Replaces what the reader has not taken yet; `true` if it had not.
    pub fn put(&mut self, value: T) -> bool {
        self.shared.with(self.mine, |slot| *slot = Some(value));
        let old = self
            .shared
            .between
            .swap(self.mine | FRESH, Ordering::AcqRel);
        self.mine = old & SLOT;
        old & FRESH != 0
    }
}

impl<T: Copy + Send> MailboxReader<T> {
    /// The newest value, if one was put in since the last call.
    pub fn take(&mut self) -> Option<T> {
        if self.shared.between.load(Ordering::Relaxed) & FRESH == 0 {
            return None;
        }
        self.mine = self.shared.between.swap(self.mine, Ordering::AcqRel) & SLOT;
        self.shared.with(self.mine, |slot| *slot)
    }

    /// Whether the writer is gone.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        Arc::strong_count(&self.shared) < 2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newest_value_is_taken_once() {
        let (mut writer, mut reader) = mailbox();
        assert_eq!(reader.take(), None);
        assert!(!writer.put(1));
        assert!(writer.put(2));
        assert_eq!((reader.take(), reader.take()), (Some(2), None));
        assert!(!writer.put(3));
        assert_eq!(reader.take(), Some(3));
        assert!(!reader.is_abandoned());
        writer.put(4);
        drop(writer);
        assert!(reader.is_abandoned());
        assert_eq!((reader.take(), reader.take()), (Some(4), None));
    }

    /// Reader on another thread sees whole values in order and the last one.
    #[test]
    fn reader_thread_sees_whole_values_in_order() {
        const LAST: u64 = 200_000;
        let (mut writer, mut reader) = mailbox::<[u64; 64]>();
        let writing = std::thread::spawn(move || {
            for number in 1..=LAST {
                writer.put([number; 64]);
            }
        });
        let mut seen = 0;
        while seen < LAST {
            let Some(value) = reader.take() else {
                std::thread::yield_now();
                continue;
            };
            assert!(value.iter().all(|&word| word == value[0]), "a torn value");
            assert!(value[0] > seen, "{} after {seen}", value[0]);
            seen = value[0];
        }
        writing.join().unwrap();
        assert_eq!(reader.take(), None);
    }
}
