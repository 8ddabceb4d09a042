//! Closed-form kinematics of the PSM. Hot path: bounded, no allocation, no I/O, no lock.
//!
//! [`forward`] and [`jacobian`] go from joints to the tip, [`inverse`] comes back. Everything is in
//! the RCM frame, and the tip is the dVRK's control point on the wrist-yaw axis; the finger tips
//! are [`hal::psm::FINGER_M`] further along its z.

mod forward;
mod inverse;

pub use forward::{Frames, forward, jacobian};
pub use inverse::{IkError, inverse, inverse_clamped};

#[cfg(test)]
mod tests;
