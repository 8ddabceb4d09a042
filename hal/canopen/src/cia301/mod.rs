//! CiA 301, the application layer: one service a file, each with a view of bytes that may be
//! nonsense and a representation that cannot be.
//!
//! `parse` takes the bytes of a frame and gives the representation or the
//! [`WireError`](super::WireError) that says what is wrong; `emit` goes back, and what was emitted
//! parses to the same again. Nothing here allocates.

pub mod abort;
pub mod cob;
mod codes;
pub mod emcy;
pub mod nmt;
pub mod pdo;
pub mod sdo;
pub mod sync;

pub use abort::AbortCode;
pub use cob::Cob;
pub use emcy::Emergency;
pub use nmt::{NmtCommand, NmtState, NmtTarget};
pub use sdo::Address;

#[cfg(test)]
mod tests;
