//! The bus in time: how long frames take, what a plan of frames costs, and a wire on which that happens; drives on such
//! wires, and the same drives for a master outside.

pub mod bits;
pub mod load;
pub mod motor;
pub mod network;
pub mod station;
pub mod wire;

pub use load::{Overload, Plan};
pub use motor::{IdealMotor, Motor, Terminal};
pub use network::{Network, Tampering};
pub use station::Station;
pub use wire::Wire;

#[cfg(test)]
mod tests;
