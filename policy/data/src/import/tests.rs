//! Demonstrations that h5py wrote, and those that another author's code writes here, come in number
//! for number; what can't be meant is refused by name.

mod demo;
mod read;
mod refused;
