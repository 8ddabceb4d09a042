//! The soft flap of a world: where the instruments are for it, what it does to them, and how they
//! hold it.

use super::Grasp;
use super::arm::ArmUnit;
use super::chain::Wrench;
use super::scenery::{Flap, Ground};
use crate::tissue::{self, JawInput, Tissue};

/// Share of a new grip that counts in a millisecond, a low pass at 8 Hz: cables give, and a drive's
/// effort ripples while the jaw closes, which is no reason for held tissue to be let go.
const GRIP_SHARE: f64 = 0.05;

/// A flap with the jaws that may touch it, one an arm.
pub(super) struct Drape {
    tissue: Tissue,
    jaws: Vec<JawInput>,
}

impl Drape {
    /// A flap at rest on `ground`, which the instruments of `arms` must not touch yet.
    pub(super) fn new(flap: &Flap, ground: &Ground, arms: &[ArmUnit]) -> Self {
        let bed = match ground {
            Ground::Bed(bed) => bed.clone(),
            Ground::Organ(_) | Ground::Solids(_) | Ground::OrganWithSolids(..) => {
                tissue::Ground::none()
            }
        };
        let jaws: Vec<JawInput> = arms.iter().map(ArmUnit::jaw_input).collect();
        Self {
            tissue: Tissue::new(&flap.config, bed, flap.seed, &jaws),
            jaws,
        }
    }

    /// Advances one millisecond, in which the instruments go to where `arms` are.
    pub(super) fn step(&mut self, arms: &[ArmUnit]) {
        for (jaw, arm) in self.jaws.iter_mut().zip(arms) {
            let grip_n = jaw.grip_n;
            *jaw = arm.jaw_input();
            jaw.grip_n = grip_n + GRIP_SHARE * (jaw.grip_n - grip_n);
        }
        self.tissue.step(&self.jaws);
    }

    /// What it puts on left finger, right finger and wrist of an arm, about the tip frame's origin.
    pub(super) fn wrenches(&self, arm: usize) -> [Wrench; 3] {
        let felt = self.tissue.jaw(arm);
        let [left, right] = felt.fingers;
        [left, right, felt.wrist].map(|wrench| Wrench {
            force: wrench.force,
            moment: wrench.moment,
        })
    }

    /// How an arm holds it.
    pub(super) fn grasp(&self, arm: usize) -> Grasp {
        let felt = self.tissue.jaw(arm);
        let [left_force_n, right_force_n] = felt.finger_n();
        Grasp {
            left_force_n,
            right_force_n,
            both_touch: felt.grasp.is_some(),
            penetration_m: felt.depth_m,
        }
    }

    /// Every number that decides the future, for hashing.
    pub(super) fn state(&self) -> impl Iterator<Item = f64> + '_ {
        let grips = self.jaws.iter().map(|jaw| jaw.grip_n);
        self.tissue.state().chain(grips)
    }

    pub(super) const fn tissue(&self) -> &Tissue {
        &self.tissue
    }
}
