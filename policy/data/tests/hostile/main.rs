//! Datasets and demonstrations that are damaged or made to harm: read or refused with the file's
//! name, never a panic, never unbounded memory.
//!
//! Damage is drawn from a seed that stands in every message. `TROCAR_HOSTILE_CASES` sets how many
//! cases each test draws (400 if it is not set), `TROCAR_HOSTILE_SEED` where they begin: `make`'s
//! tests are quick, and `TROCAR_HOSTILE_CASES=200000 cargo test --release --workspace --test
//! hostile` is not.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test fails by panicking, its helpers too"
)]

mod common;
mod damage;
mod datasets;
mod digits;
mod hdf5;
mod old_datasets;
mod recorded;
