//! Checks of the tissue against closed forms, conservation laws and its own stated limits.

mod bench;
mod config;
mod dynamics;
mod grasp;
mod retraction;
mod statics;
mod surface;
mod violence;

use hal::Pose;
use hal::config::Source;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use super::{Ground, JawInput, RetractionConfig, Tissue, TissueConfig};
use crate::organ::OrganShape;

/// The parts of the task's file that are about the tissue.
#[derive(serde::Deserialize)]
struct TaskFile {
    tissue: TissueConfig,
    success: RetractionConfig,
}

/// The task as it ships.
fn task() -> TaskFile {
    let source = task_source();
    let file: TaskFile = source.parse().unwrap();
    file.tissue.check(&source, "tissue").unwrap();
    file.success.check(&source, "success").unwrap();
    file
}

fn task_source() -> Source {
    Source::embedded(
        "config/tasks/tissue-retraction/scene.toml",
        include_str!("../../../../../config/tasks/tissue-retraction/scene.toml"),
    )
}

/// The flap of the task as it ships.
fn flap_config() -> TissueConfig {
    task().tissue
}

/// A rolling organ that ends before the flap does.
fn organ_ground() -> Ground {
    let organ = OrganShape {
        length_m: 0.12,
        width_m: 0.09,
        amplitude_m: 0.001_5,
        wavelength_m: 0.09,
    };
    Ground::sampled([-0.06, -0.02], [0.06, 0.045], 0.003, |x, y| {
        organ.height_m(x, y)
    })
}

/// A jaw that hangs straight down with its ends at `ends_m`, opened by `opening_rad`, its hinge
/// along x.
fn jaw_at(ends_m: [f64; 3], opening_rad: f64, grip_n: f64) -> JawInput {
    let hinge = Translation3::new(ends_m[0], ends_m[1], ends_m[2] + hal::psm::FINGER_M);
    jaw(&Pose::from_parts(hinge, down()), opening_rad, grip_n)
}

/// The orientation of a tip frame that points straight down, its hinge along x.
fn down() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), core::f64::consts::PI)
}

/// A jaw with its tip frame at `tip`.
fn jaw(tip: &Pose, opening_rad: f64, grip_n: f64) -> JawInput {
    let finger = |side: f64| {
        tip * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -side * 0.5 * opening_rad)
    };
    JawInput {
        fingers: [finger(1.0), finger(-1.0)],
        wrist: [
            tip * Point3::new(0.0, 0.0, -hal::psm::WRIST_M),
            tip * Point3::origin(),
        ],
        grip_n,
    }
}

/// A jaw led by hand through a tissue.
struct Puppet {
    tissue: Tissue,
    tip: Pose,
    opening_rad: f64,
    grip_n: f64,
}

/// Opening at which the ends are 6 mm apart.
const OPEN_RAD: f64 = 0.6;

impl Puppet {
    /// A flap with an open jaw far away.
    fn new(config: &TissueConfig, ground: Ground) -> Self {
        let tip = Pose::from_parts(Translation3::new(0.0, 0.0, 0.1), down());
        Self {
            tissue: Tissue::new(config, ground, 3, &[jaw(&tip, OPEN_RAD, 0.0)]),
            tip,
            opening_rad: OPEN_RAD,
            grip_n: 0.0,
        }
    }

    /// [`Self::at_edge_over`] the rolling organ.
    fn at_edge(config: &TissueConfig, over_m: f64, aside_m: f64) -> Self {
        Self::at_edge_over(organ_ground(), config, over_m, aside_m)
    }

    /// A flap over `ground` with an open jaw that lies flat and points to the free edge from
    /// outside, its fingers above and below; its ends reach `over_m` past the edge of the resting
    /// flap at the mark, `aside_m` along the edge.
    fn at_edge_over(ground: Ground, config: &TissueConfig, over_m: f64, aside_m: f64) -> Self {
        let mut puppet = Self::new(config, ground);
        let mark = puppet.tissue.mark_in_scene().translation.vector;
        let level =
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -core::f64::consts::FRAC_PI_2);
        let hinge = Translation3::new(
            mark.x + aside_m,
            mark.y - config.mark.inset_m + over_m - hal::psm::FINGER_M,
            mark.z - 0.5 * config.material.thickness_m,
        );
        puppet.tip = Pose::from_parts(hinge, level);
        puppet
    }

    fn step(&mut self) {
        self.tissue
            .step(&[jaw(&self.tip, self.opening_rad, self.grip_n)]);
    }

    /// Moves at `speed_m_s` by `by_m`.
    fn travel(&mut self, by_m: Vector3<f64>, speed_m_s: f64) {
        let steps = (by_m.norm() / speed_m_s * 1e3).ceil();
        let mut step = 0.0;
        while step < steps {
            self.tip = Translation3::from(by_m / steps) * self.tip;
            self.step();
            step += 1.0;
        }
    }

    /// Closes with `grip_n` until something is grasped or nothing is left to close.
    fn close(&mut self, grip_n: f64) {
        self.grip_n = grip_n;
        while self.opening_rad > 0.0 && self.tissue.report().grasp.is_none() {
            self.opening_rad = (self.opening_rad - 0.001).max(0.0);
            self.step();
        }
    }

    fn wait(&mut self, steps: usize) {
        for _ in 0..steps {
            self.step();
        }
    }
}

/// A jaw that has just grasped the flap at the mark, by its edge.
fn grasped(config: &TissueConfig) -> Puppet {
    let mut puppet = Puppet::at_edge(config, 0.006, 0.0);
    puppet.close(2.0);
    assert!(
        puppet.tissue.report().grasp.is_some(),
        "{:?}",
        puppet.tissue.report()
    );
    puppet
}
