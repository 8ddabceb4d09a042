//! The network library's random numbers, which belong to the whole process.
//!
//! The library knows no generator of one's own in the operations used here, so whoever draws seeds
//! the process's and keeps everybody else from it: two trainings in one process draw what each
//! would draw alone.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Held by whoever draws; a poisoned one is taken all the same, since there is no state to be
/// damaged.
static GENERATOR: Mutex<()> = Mutex::new(());

/// Seeds the process's generator, which is the caller's while the answer lives.
#[must_use = "others may draw as soon as this is dropped"]
pub fn seeded(seed: u64) -> MutexGuard<'static, ()> {
    let drawing = GENERATOR.lock().unwrap_or_else(PoisonError::into_inner);
    tch::manual_seed(seed.cast_signed());
    drawing
}

#[cfg(test)]
mod tests {
    use super::seeded;
    use std::thread;
    use tch::{Device, Kind, Tensor};

    /// Eight times four numbers, another thread running in between.
    fn drawn(seed: u64) -> Vec<f32> {
        let _drawing = seeded(seed);
        let mut all = Vec::new();
        for _ in 0..8 {
            let four = Tensor::randn([4], (Kind::Float, Device::Cpu));
            all.extend(Vec::<f32>::try_from(four).unwrap());
            thread::yield_now();
        }
        all
    }

    #[test]
    fn who_draws_beside_another_draws_what_it_draws_alone() {
        let alone = [drawn(1), drawn(2)];
        assert_ne!(alone[0], alone[1]);
        for _ in 0..200 {
            let [one, other] = thread::scope(|scope| {
                [1, 2]
                    .map(|seed| scope.spawn(move || drawn(seed)))
                    .map(|run| run.join().unwrap())
            });
            assert_eq!([one, other], alone);
        }
    }
}
