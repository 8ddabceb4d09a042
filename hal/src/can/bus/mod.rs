//! The bus in time: how long frames take, what a plan of frames costs, and a wire on which that happens.

pub mod bits;
pub mod load;
pub mod network;
pub mod wire;

pub use load::{Overload, Plan};
pub use network::{Motor, Network, Tampering};
pub use wire::Wire;

#[cfg(test)]
mod tests;
