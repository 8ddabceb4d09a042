//! Soft tissue: an elastic flap over an organ, attached to the body along one edge, grasped by
//! area.
//!
//! # What it is
//!
//! The flap is a thin elastic sheet on a grid of mass points ([`Sheet`]): bilinear cells with Green
//! strain and plane stress for stretching and shearing, a Kirchhoff plate in finite differences for
//! bending and twisting, Kelvin-Voigt damping. It is stepped explicitly (symplectic Euler, eight
//! sub-steps a millisecond): no iteration that may not have converged stands between the parameters
//! and what they do, statics do not depend on the step, momentum is kept to the last bits, and
//! equal inputs give equal bits, since there is no solver, no sorting and no thread. The organ is
//! an elastic bed with a height for every place ([`Ground`]); fingers are boxes, the wrist a
//! capsule; they press on material points a millimetre apart and rub at nodes with Coulomb friction
//! that sticks. A closing jaw ties the material between its pads to itself, with a break force
//! ([`GraspConfig`]).
//!
//! # Why a sheet of our own
//!
//! Measured for a flap of 60 x 48 x 1.5 mm, E 100 kPa, Poisson ratio 0.45, a millisecond a step,
//! one core, release (the thread's own time, median; `tests/bench.rs`), and for the sag of a bar of
//! 20 x 3 x 1.5 mm of it against `rho g A L^4 / (8 E I)`:
//!
//! | | nodes | us a step | sag of the bar |
//! |---|---|---|---|
//! | this sheet, nothing near | 208 | 100 | -0.4 % |
//! | this sheet between closing fingers, or held and lifted | 208 | 140 | |
//! | rapier 0.36 soft body, constraints (4 iterations), one cell thick, no contact | 416 | 3300 | -11 % |
//! | the same, two cells thick | 624 | 6800 | +37 % |
//! | rapier 0.36 soft body, `fem`, one cell thick, no contact | 416 | 4500 | -62 % |
//! | the same, two cells thick | 624 | 8400 | -38 % |
//!
//! With other sub-steps the same lift takes the same force (to 0.2 %); with cells of 6, 4 and 3 mm
//! it takes 60, 58 and 50 mN, of which a part is that the grasped area comes in whole samples.
//!
//! A sheet much thinner than its cells is the case in which linear tetrahedra lock and in which
//! constraint sweeps do not converge, and 3 ms for a millisecond is what real time leaves out.
//! Explicit stepping, in turn, is only possible since tissue is soft: the fastest oscillation of
//! this flap is 1 kHz. A stiffer or finer one needs more sub-steps, and a file that has too few is
//! refused ([`TissueConfig::substeps_min`]).
//!
//! # What it leaves out
//!
//! The flap does not touch itself. A torn flap does not open: beyond the tearing strain its stress
//! stays, and the report says so. Damping of bending takes a little spin from a curved sheet that
//! turns as a whole (3e-7 of it in a second). The organ presses on nodes, 4 mm apart: a finger end
//! pressed into it between them meets a somewhat softer bed.

mod bed;
mod config;
mod contact;
mod flap;
mod grasp;
mod ground;
mod instrument;
mod jaw;
mod lay;
mod mark;
mod material;
mod patch;
mod report;
mod retraction;
mod samples;
mod sheet;
mod snapshot;
mod surface;

pub use config::{MarkConfig, TissueConfig};
pub use flap::Tissue;
pub use grasp::GraspConfig;
pub use ground::{ContactParameters, Ground};
pub use jaw::{JawInput, PAD_MIDDLE_M, Wrench};

pub use material::Material;
pub use patch::Patch;
pub use report::{Grasp, JawReport, TissueExtremes, TissueReport};
pub use retraction::{Retraction, RetractionConfig, RetractionFailure, RetractionMonitor};
pub use sheet::{Sheet, SheetShape};
pub use snapshot::{FlapSnapshot, NODES_MAX};
pub use surface::Surface;

#[cfg(test)]
mod tests;
