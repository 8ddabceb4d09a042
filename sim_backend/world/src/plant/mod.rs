//! The seven drives of the arm at actuator level: motors, gears, encoders, joint controllers and
//! friction.

mod config;
mod coupling;
mod drive;

pub use config::PlantConfig;
pub use coupling::{
    AXIS_COUNT, AxisVector, actuator_efforts, actuator_positions, joint_efforts, joint_positions,
};
pub(crate) use drive::FreeDrives;
pub use drive::{DriveSetpoint, Load, Plant};

#[cfg(test)]
mod tests;
