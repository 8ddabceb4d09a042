//! Checkpoints and weights that are damaged or made to harm: read or refused with the file's name,
//! never a panic, never unbounded memory. How many cases there are, and where they begin, is said
//! in `policy/data/tests/hostile/main.rs`.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test fails by panicking, its helpers too"
)]

mod checkpoints;
mod cloud;
mod networks;

#[path = "../../../data/tests/hostile/common.rs"]
mod common;
#[path = "../../../data/tests/hostile/damage.rs"]
mod damage;
#[path = "../../../data/tests/hostile/digits.rs"]
mod digits;
