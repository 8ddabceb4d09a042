//! Independent jobs on several threads, their results in order.

use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, PoisonError, mpsc};
use std::thread;

/// No more threads than this are started, however many are asked for.
const THREADS_MAX: usize = 1024;

/// Runs `work(index)` for every index below `count` on `threads` threads and hands the results to
/// `consume` in order of the index, as soon as each is next.
///
/// Every thread gets a worker of its own from `make_worker`. There are no more threads than jobs,
/// and no job is begun before the one that lies `ahead` jobs before it is consumed, so that no more
/// than `ahead` are under way or wait for their turn. An error ends the work when its turn comes,
/// after the results before it.
///
/// # Errors
/// The first error of a worker or of `consume`, by index; or the first of `make_worker`, as soon as
/// it arrives.
pub fn in_order<W, T, E>(
    count: usize,
    threads: usize,
    ahead: usize,
    make_worker: impl Fn() -> Result<W, E> + Sync,
    consume: &mut dyn FnMut(usize, T) -> Result<(), E>,
) -> Result<(), E>
where
    W: FnMut(usize) -> Result<T, E>,
    T: Send,
    E: Send,
{
    in_order_until(count, threads, ahead, &|| false, make_worker, consume)
}

/// The same, but that no job is begun any more once `stop` says so.
///
/// # Errors
/// As [`in_order`].
pub fn in_order_until<W, T, E>(
    count: usize,
    threads: usize,
    ahead: usize,
    stop: &(dyn Fn() -> bool + Sync),
    make_worker: impl Fn() -> Result<W, E> + Sync,
    consume: &mut dyn FnMut(usize, T) -> Result<(), E>,
) -> Result<(), E>
where
    W: FnMut(usize) -> Result<T, E>,
    T: Send,
    E: Send,
{
    let next = Mutex::new(0..count);
    let turn = Turn::new(ahead.max(1));
    let threads = threads.min(THREADS_MAX).clamp(1, count.max(1));
    let (sender, receiver) = mpsc::sync_channel(2 * threads);
    thread::scope(|scope| {
        for _ in 0..threads {
            let sender = sender.clone();
            let (next, turn, make_worker) = (&next, &turn, &make_worker);
            scope.spawn(move || {
                let mut worker = match make_worker() {
                    Ok(worker) => worker,
                    Err(error) => {
                        // The receiver is gone only when another error has already ended the work.
                        let _ended = sender.send(Err(error));
                        return;
                    }
                };
                while !stop() {
                    let job = next.lock().ok().and_then(|mut jobs| jobs.next());
                    let Some(index) = job else { return };
                    if !turn.wait(index) {
                        return;
                    }
                    if sender.send(Ok((index, worker(index)))).is_err() {
                        return;
                    }
                }
            });
        }
        drop(sender);
        let _ending = Ending(&turn);
        collect(receiver, consume, &turn)
    })
}

/// How far the results are.
struct Turn {
    /// The index of the first that is not consumed; none when nobody consumes any more.
    expected: Mutex<Option<usize>>,
    changed: Condvar,
    ahead: usize,
}

impl Turn {
    const fn new(ahead: usize) -> Self {
        Self {
            expected: Mutex::new(Some(0)),
            changed: Condvar::new(),
            ahead,
        }
    }

    /// Waits until the job `index` may begin; false if it need not any more.
    fn wait(&self, index: usize) -> bool {
        let expected = self.expected.lock().unwrap_or_else(PoisonError::into_inner);
        let too_early = |expected: &mut Option<usize>| {
            expected.is_some_and(|expected| index - expected.min(index) >= self.ahead)
        };
        let expected = self.changed.wait_while(expected, too_early);
        expected.unwrap_or_else(PoisonError::into_inner).is_some()
    }

    fn set(&self, expected: Option<usize>) {
        *self.expected.lock().unwrap_or_else(PoisonError::into_inner) = expected;
        self.changed.notify_all();
    }
}

/// Lets nobody wait any longer, however the work ends.
struct Ending<'a>(&'a Turn);

impl Drop for Ending<'_> {
    fn drop(&mut self) {
        self.0.set(None);
    }
}

/// A job's index and its result; or why a thread has no worker.
type Arrival<T, E> = Result<(usize, Result<T, E>), E>;

/// Puts results that arrive in any order back into order, and tells `turn`. Returning drops the
/// receiver, which ends the workers.
fn collect<T, E>(
    receiver: mpsc::Receiver<Arrival<T, E>>,
    consume: &mut dyn FnMut(usize, T) -> Result<(), E>,
    turn: &Turn,
) -> Result<(), E> {
    let mut waiting = BTreeMap::new();
    let mut expected = 0;
    for arrival in receiver {
        let (index, result) = arrival?;
        waiting.insert(index, result);
        while let Some(result) = waiting.remove(&expected) {
            consume(expected, result?)?;
            expected += 1;
            turn.set(Some(expected));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};

    #[test]
    fn once_stopped_no_job_is_begun() {
        let stop = AtomicBool::new(false);
        let mut seen = Vec::new();
        in_order_until(
            usize::MAX,
            3,
            usize::MAX,
            &|| stop.load(Ordering::Acquire),
            || Ok::<_, ()>(Ok),
            &mut |index, result: usize| {
                assert_eq!(index, result);
                seen.push(index);
                stop.store(index >= 10, Ordering::Release);
                Ok(())
            },
        )
        .unwrap();
        // It ended, long before all were done; those that were under way are not lost.
        assert!(seen.len() >= 11, "{}", seen.len());
        assert!(seen.iter().copied().eq(0..seen.len()));
    }

    #[test]
    fn results_come_in_order_from_any_number_of_threads() {
        for threads in [1, 3, 8] {
            let mut seen = Vec::new();
            in_order(
                40,
                threads,
                usize::MAX,
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
    fn absurd_numbers_of_threads_are_cut_to_the_jobs() {
        for count in [0, 3] {
            let mut seen = 0;
            in_order(
                count,
                usize::MAX,
                usize::MAX,
                || Ok::<_, ()>(|index: usize| Ok(index)),
                &mut |_, _| {
                    seen += 1;
                    Ok(())
                },
            )
            .unwrap();
            assert_eq!(seen, count);
        }
    }

    #[test]
    fn the_first_error_by_index_wins_even_if_it_comes_last() {
        // The thread that fails at 1 goes on to 2 only when its error is sent; 0 waits for that.
        let one_has_failed = std::sync::Barrier::new(2);
        let result = in_order(
            3,
            2,
            usize::MAX,
            || {
                Ok(|index: usize| {
                    if index != 1 {
                        one_has_failed.wait();
                    }
                    Err::<(), _>(index)
                })
            },
            &mut |_, ()| Ok(()),
        );
        assert_eq!(result, Err(0));
    }

    #[test]
    fn a_worker_that_cannot_be_made_ends_the_work() {
        let result = in_order(
            5,
            2,
            1,
            || Err::<fn(usize) -> Result<(), &'static str>, _>("no worker"),
            &mut |_, ()| Ok(()),
        );
        assert_eq!(result, Err("no worker"));
    }

    #[test]
    fn no_job_is_begun_far_ahead_of_what_is_consumed() {
        for (threads, ahead) in [(4, 1), (4, 2), (3, 3), (2, 5)] {
            let consumed = std::sync::atomic::AtomicUsize::new(0);
            let farthest = std::sync::atomic::AtomicUsize::new(0);
            let order = std::sync::atomic::Ordering::SeqCst;
            in_order(
                60,
                threads,
                ahead,
                || {
                    Ok::<_, ()>(|index: usize| {
                        farthest.fetch_max(index - consumed.load(order).min(index), order);
                        Ok(index)
                    })
                },
                &mut |index, _| {
                    // Slower than the work, so that threads would run ahead.
                    for _ in 0..200 {
                        thread::yield_now();
                    }
                    consumed.store(index + 1, order);
                    Ok(())
                },
            )
            .unwrap();
            let farthest = farthest.into_inner();
            assert!(farthest < ahead, "{farthest} of {ahead}");
            assert_eq!(consumed.into_inner(), 60);
        }
    }

    #[test]
    fn an_error_ends_the_work() {
        let result = in_order(
            1000,
            2,
            2,
            || Ok(|index: usize| if index == 7 { Err("seven") } else { Ok(index) }),
            &mut |_, _| Ok(()),
        );
        assert_eq!(result, Err("seven"));
    }
}
