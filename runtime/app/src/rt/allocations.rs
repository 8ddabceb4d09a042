//! The system allocator, counting the allocations of each thread, so that a run can say that its
//! control thread made none. Reallocations count too, deallocations do not: a real-time thread may
//! do neither, and memory that it frees is mostly its own. A count is one thread-local addition.
#![expect(
    unsafe_code,
    reason = "an allocator can't be had without; every call goes on to the system's unchanged"
)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    /// Without a destructor, so that it can be used until the thread's very end; it wraps around.
    static REQUESTS: Cell<u64> = const { Cell::new(0) };
}

/// One more for the calling thread; itself allocates nothing.
fn count() {
    REQUESTS.with(|requests| requests.set(requests.get().wrapping_add(1)));
}

/// How often the calling thread has asked for memory; stays 0 where [`CountingAllocator`] is not
/// the program's.
#[must_use]
pub fn thread_allocations() -> u64 {
    REQUESTS.with(Cell::get)
}

/// The system allocator for a program's `#[global_allocator]`.
#[derive(Debug)]
pub struct CountingAllocator;

// SAFETY: every call goes on to the system allocator unchanged; counting touches a thread-local
// cell without a destructor.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.realloc(memory, layout, size) }
    }
}
