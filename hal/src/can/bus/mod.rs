//! The bus in time: how long frames take, what a plan of frames costs, and a wire on which that happens.

pub mod bits;
pub mod load;
pub mod motor;
pub mod network;
pub mod wire;

pub use load::{Overload, Plan};
pub use motor::{IdealMotor, Motor};
pub use network::{Network, Tampering};
pub use wire::Wire;

#[cfg(test)]
mod tests;
