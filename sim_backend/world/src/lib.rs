#![doc = include_str!("../README.md")]

pub mod block;
pub mod needle;
pub mod organ;
pub mod plant;
pub mod rng;
pub mod tissue;
mod world;

#[cfg(test)]
mod shipped;

pub use world::{
    ArmBodies, ArmStart, Collider, CollisionMask, FINGER_THICKNESS_M, Flap, Grasp, Ground,
    REST_M_S, RigidBody, Scenery, Shape, SoftOrgan, Surface, World, WorldConfig,
};
