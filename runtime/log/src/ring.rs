//! Queues for real-time threads.
//!
//! Memory that was only reserved is mapped at the first write to each page, which costs a fault of
//! microseconds or more in the middle of a tick. So every slot is written once, when the run is set
//! up.

use core::hint::black_box;
use core::mem::MaybeUninit;

use rtrb::{Consumer, Producer, RingBuffer};

/// An empty wait-free queue for `capacity` values, whose memory the system has mapped already: a
/// push takes no page fault.
#[must_use]
pub fn pre_faulted_queue<T>(capacity: usize) -> (Producer<T>, Consumer<T>) {
    let (mut producer, consumer) = RingBuffer::new(capacity);
    if let Ok(mut chunk) = producer.write_chunk_uninit(capacity) {
        let (first, second) = chunk.as_mut_slices();
        for slot in first.iter_mut().chain(second) {
            *slot = MaybeUninit::zeroed();
            black_box(slot);
        }
    }
    (producer, consumer)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn touched_queue_is_empty_and_takes_its_capacity() {
        let (mut producer, mut consumer) = pre_faulted_queue::<String>(3);
        assert!(consumer.is_empty() && producer.slots() == 3);
        for text in ["a", "b", "c"] {
            producer.push(text.to_owned()).unwrap();
        }
        producer.push(String::new()).unwrap_err();
        assert_eq!(consumer.pop().unwrap(), "a");
        assert_eq!(consumer.slots(), 2);
    }
}
