//! Checks of the tissue against closed forms, conservation laws and its own stated limits.

mod bench;
mod statics;

use hal::Pose;
use hal::config::Source;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use super::{Ground, JawInput, TissueConfig};
use crate::organ::OrganShape;

/// The flap that the tests use.
fn flap_config() -> TissueConfig {
    let source = Source::embedded("flap.toml", include_str!("flap.toml"));
    let config: TissueConfig = source.parse().unwrap();
    config.check(&source, "tissue").unwrap();
    config
}

/// A rolling organ that ends before the flap does.
fn organ_ground() -> Ground {
    let organ = OrganShape { length_m: 0.12, width_m: 0.09, amplitude_m: 0.001_5, wavelength_m: 0.09 };
    Ground::sampled([-0.06, -0.02], [0.06, 0.045], |x, y| organ.height_m(x, y))
}

/// A jaw that hangs straight down with its ends at `ends_m`, opened by `opening_rad`, its hinge along x turned by `yaw_rad`.
fn jaw_at(ends_m: [f64; 3], opening_rad: f64, grip_n: f64) -> JawInput {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), core::f64::consts::PI);
    let hinge = Translation3::new(ends_m[0], ends_m[1], ends_m[2] + hal::psm::FINGER_M);
    jaw(&Pose::from_parts(hinge, down), opening_rad, grip_n)
}

/// A jaw with its tip frame at `tip`.
fn jaw(tip: &Pose, opening_rad: f64, grip_n: f64) -> JawInput {
    let finger = |side: f64| {
        tip * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -side * 0.5 * opening_rad)
    };
    JawInput {
        fingers: [finger(1.0), finger(-1.0)],
        wrist: [tip * Point3::new(0.0, 0.0, -hal::psm::WRIST_M), tip * Point3::origin()],
        grip_n,
    }
}
