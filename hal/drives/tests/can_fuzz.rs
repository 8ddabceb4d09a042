//! Arbitrary frames, and the trouble that buses make, against a whole arm with its drives and
//! against a single drive: no panic, no memory without bound and none at all in the master's cycle,
//! no axis outside its range or faster than its drive may be, no set-point outside the plan, and
//! nobody who enables himself again; no measurement that is more than three cycles older than it is
//! told to be, no SYNC but in its time or counted as left out, and no motion after a fault.
//!
//! What fails is made small, printed, and kept in `can_fuzz/seeds-*.txt`, which every later run
//! begins with. `make fuzz-can` throws ten million frames at each and says what came of them;
//! `TROCAR_FUZZ_FRAMES` sets another number and `TROCAR_FUZZ_SEED` another beginning.
#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

#[path = "can_fuzz/arm.rs"]
mod arm;
#[path = "can_fuzz/drive.rs"]
mod drive;
#[path = "can_fuzz/frames.rs"]
mod frames;
#[path = "can_fuzz/life.rs"]
mod life;
#[path = "can_fuzz/memory.rs"]
mod memory;
#[path = "can_fuzz/noisy.rs"]
mod noisy;
#[path = "can_fuzz/promises.rs"]
mod promises;
#[path = "can_fuzz/seen.rs"]
mod seen;

use std::cell::RefCell;

use proptest::prelude::*;
use proptest::test_runner::{FileFailurePersistence, RngSeed, TestError, TestRunner};
use trocar_canopen::master::config::CanConfig;

/// Lives between two looks at how many frames have been thrown.
const BATCH: u32 = 16;
/// For how long a failure may be tried anew to make it smaller, ms.
const SHRINK_MS: u32 = 20_000;

const ARM_SEEDS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/can_fuzz/seeds-arm.txt");
const DRIVE_SEEDS: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/tests/can_fuzz/seeds-drive.txt"
);

fn number(variable: &str, otherwise: u64) -> u64 {
    let text = std::env::var(variable);
    text.map_or(otherwise, |text| text.parse().unwrap())
}

/// A runner of [`BATCH`] cases that begin with `seed`; failures are kept in `file`.
fn runner(seed: u64, file: &'static str) -> TestRunner {
    TestRunner::new(ProptestConfig {
        cases: BATCH,
        rng_seed: RngSeed::Fixed(seed),
        max_shrink_time: SHRINK_MS,
        max_shrink_iters: u32::MAX,
        failure_persistence: Some(Box::new(FileFailurePersistence::Direct(file))),
        ..ProptestConfig::default()
    })
}

/// Tries batches of what `strategy` gives until `enough` says so.
///
/// # Panics
/// With the smallest failure.
fn hammer<S: Strategy>(
    file: &'static str,
    strategy: &S,
    test: impl Fn(&S::Value) -> Result<(), String>,
    enough: impl Fn() -> bool,
) {
    let first = number("TROCAR_FUZZ_SEED", 1);
    for seed in first.. {
        let test = |value| test(&value).map_err(TestCaseError::fail);
        let failure = match runner(seed, file).run(strategy, test) {
            Ok(()) => None,
            Err(TestError::Fail(why, value)) => Some(format!("{why}\n{value:?}")),
            Err(TestError::Abort(why)) => Some(why.to_string()),
        };
        assert!(
            failure.is_none(),
            "seed {seed}: {}",
            failure.unwrap_or_default()
        );
        if enough() {
            return;
        }
    }
}

fn hammer_arm(frames: u64) -> arm::Tally {
    let shipped = CanConfig::load(&CanConfig::shipped()).unwrap().arms[0].plan;
    let mut tally = arm::Tally::default();
    for buses in [life::Buses::Roomy, life::Buses::Three] {
        arm::live(&shipped, &life::Scenario::quiet(buses), &mut tally).unwrap();
    }
    let tally = RefCell::new(tally);
    hammer(
        ARM_SEEDS,
        &life::life(),
        |life| arm::live(&shipped, life, &mut tally.borrow_mut()),
        || tally.borrow().seen.thrown >= frames,
    );
    tally.into_inner()
}

fn hammer_drive(frames: u64) -> drive::Tally {
    let mut tally = drive::Tally::default();
    drive::live(&[], &mut tally).unwrap();
    let tally = RefCell::new(tally);
    hammer(
        DRIVE_SEEDS,
        &drive::story(),
        |story| drive::live(story, &mut tally.borrow_mut()),
        || tally.borrow().thrown >= frames,
    );
    tally.into_inner()
}

/// Arbitrary frames never move an arm outside its limits nor take memory.
#[test]
fn fuzzed_arm_keeps_its_limits_and_allocates_nothing() {
    let tally = hammer_arm(50_000);
    // It is no test if the arm is never enabled, never moves, or never fails.
    assert!(tally.enabled_cycles > 500, "{tally:?}");
    assert!(tally.seen.travelled > 1e5, "{tally:?}");
    assert!(tally.spoiled < tally.lives / 2, "{tally:?}");
    let kinds = tally.faults.iter().filter(|count| **count > 0).count();
    assert!(kinds >= 5, "{tally:?}");
    // Nor if what is promised of time is never at stake.
    assert!(tally.seen.ages > 1000, "{tally:?}");
    assert!(tally.left_out > 10 && tally.seen.stills > 1000, "{tally:?}");
}

/// Arbitrary frames never panic nor move the axis outside its limits.
#[test]
fn fuzzed_drive_keeps_its_limits_without_a_panic() {
    let tally = hammer_drive(100_000);
    // It is no test if the axis never moves or never fails.
    assert!(
        tally.enabled > 10_000 && tally.travelled > 5e4 && tally.faults > 100,
        "{tally:?}"
    );
}

/// Ten million arbitrary frames never move an arm outside its limits nor take memory.
#[test]
#[ignore = "ten million frames: make fuzz-can"]
#[expect(clippy::print_stdout, reason = "figures for a person")]
fn ten_million_frames_never_move_an_arm_outside_its_limits() {
    let frames = number("TROCAR_FUZZ_FRAMES", 10_000_000);
    let tally = hammer_arm(frames);
    assert!(tally.seen.thrown >= frames);
    println!("arm: {tally:#?}");
}

/// Ten million arbitrary frames never move the axis outside its limits.
#[test]
#[ignore = "ten million frames: make fuzz-can"]
#[expect(clippy::print_stdout, reason = "figures for a person")]
fn ten_million_frames_never_move_an_axis_outside_its_limits() {
    let frames = number("TROCAR_FUZZ_FRAMES", 10_000_000);
    let tally = hammer_drive(frames);
    assert!(tally.thrown >= frames);
    println!("drive: {tally:#?}");
}
