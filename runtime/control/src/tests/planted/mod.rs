//! Faults planted in the safety filter, one at a time: each must be found, and what survives must
//! change nothing.

mod measure;
mod places;
mod rows;
