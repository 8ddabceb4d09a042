//! How much memory the current thread asks for and holds.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// The system allocator, counting for each thread.
struct Counting;

thread_local! {
    static REQUESTS: Cell<u64> = const { Cell::new(0) };
    static HELD: Cell<i64> = const { Cell::new(0) };
    static MOST: Cell<i64> = const { Cell::new(0) };
}

fn change(bytes: i64) {
    let held = HELD.get() + bytes;
    HELD.set(held);
    MOST.set(MOST.get().max(held));
}

fn size(layout: Layout) -> i64 {
    i64::try_from(layout.size()).unwrap_or(i64::MAX)
}

#[expect(unsafe_code, reason = "an allocator can't be had without")]
// SAFETY: every call goes on to the system allocator unchanged; counting touches thread-local cells
// without destructors.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        REQUESTS.set(REQUESTS.get() + 1);
        change(size(layout));
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        change(-size(layout));
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        REQUESTS.set(REQUESTS.get() + 1);
        change(i64::try_from(new_size).unwrap_or(i64::MAX) - size(layout));
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.realloc(memory, layout, new_size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// How often this thread has allocated.
pub(crate) fn requests() -> u64 {
    REQUESTS.get()
}

/// Begins to look for the most that this thread holds.
pub(crate) fn begin() {
    HELD.set(0);
    MOST.set(0);
}

/// The most that it has held since, bytes more than at the beginning.
pub(crate) fn most() -> i64 {
    MOST.get()
}
