//! Faults planted in the safety filter and in the guard, one at a time: each must make a test fail, and what survives must be
//! one that changes nothing.

mod bench;
mod guard;
mod places;
mod rows;
