//! Independent jobs on several threads, their results in order.

use std::sync::Mutex;
use std::sync::mpsc;
use std::thread;

/// Runs `work(index)` for every index below `count` on `threads` threads and hands the results to `consume` in order of
/// the index, as soon as each is next.
///
/// Every thread gets a worker of its own from `make_worker`. The first error stops the hand-out of further jobs and is
/// returned.
///
/// # Errors
/// The first error, by index, of `make_worker`, a worker or `consume`.
pub fn in_order<W, T, E>(
    count: usize,
    threads: usize,
    make_worker: impl Fn() -> Result<W, E> + Sync,
    consume: &mut dyn FnMut(usize, T) -> Result<(), E>,
) -> Result<(), E>
where
    W: FnMut(usize) -> Result<T, E>,
    T: Send,
    E: Send,
{
    let next = Mutex::new(0..count);
    let (sender, receiver) = mpsc::sync_channel(2 * threads.max(1));
    thread::scope(|scope| {
        for _ in 0..threads.max(1) {
            let sender = sender.clone();
            let (next, make_worker) = (&next, &make_worker);
            scope.spawn(move || {
                let mut worker = match make_worker() {
                    Ok(worker) => worker,
                    Err(error) => {
                        // The receiver is gone only when another error has already ended the work.
                        let _ended = sender.send((0, Err(error)));
                        return;
                    }
                };
                loop {
                    let job = next.lock().ok().and_then(|mut jobs| jobs.next());
                    let Some(index) = job else { return };
                    if sender.send((index, worker(index))).is_err() {
                        return;
                    }
                }
            });
        }
        drop(sender);
        collect(count, receiver, consume)
    })
}

/// Puts results that arrive in any order back into order. Returning drops the receiver, which ends the workers.
fn collect<T, E>(
    count: usize,
    receiver: mpsc::Receiver<(usize, Result<T, E>)>,
    consume: &mut dyn FnMut(usize, T) -> Result<(), E>,
) -> Result<(), E> {
    let mut waiting: Vec<Option<T>> = (0..count).map(|_| None).collect();
    let mut expected = 0;
    for (index, result) in receiver {
        waiting[index] = Some(result?);
        while let Some(value) = waiting.get_mut(expected).and_then(Option::take) {
            consume(expected, value)?;
            expected += 1;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_in_order_from_any_number_of_threads() {
        for threads in [1, 3, 8] {
            let mut seen = Vec::new();
            in_order(
                40,
                threads,
                || Ok::<_, ()>(|index: usize| Ok(index * index)),
                &mut |index, square| {
                    seen.push((index, square));
                    Ok(())
                },
            )
            .unwrap();
            assert_eq!(seen, (0..40).map(|i| (i, i * i)).collect::<Vec<_>>());
        }
    }

    #[test]
    fn an_error_ends_the_work() {
        let result = in_order(
            1000,
            2,
            || Ok(|index: usize| if index == 7 { Err("seven") } else { Ok(index) }),
            &mut |_, _| Ok(()),
        );
        assert_eq!(result, Err("seven"));
    }
}
