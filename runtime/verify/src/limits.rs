//! The limits of a run, read from its configuration texts. Places are in the scene's frame.
//!
//! The same keys as the controller reads, by a parser of its own (`document`). Ranges of the limits
//! themselves are not checked: commands are judged by what the texts say.

use hal::Pose;
use hal::joints::{INSERTION, JOINT_NAMES};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use super::VerifyError;
use super::differences::AXES;
use super::distance::Shape;
use super::document::{Document, Entry};

/// File with the axes' limits.
pub const CONTROL: &str = "control.toml";
/// File with the places where the instruments may be.
pub const SAFETY: &str = "safety.toml";

/// Limits of one axis, rad (insertion m) and their derivatives.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct AxisLimits {
    /// The joint's name, or `jaw`.
    pub(super) name: &'static str,
    pub(super) low: f64,
    pub(super) high: f64,
    /// Bounds of velocity, acceleration and jerk.
    ///
    /// rad/s, rad/s², rad/s³; of the insertion m/s, m/s², m/s³.
    pub(super) derivatives: [f64; 3],
}

/// Where an arm stands and where its instrument may work.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ArmLimits {
    pub(super) name: String,
    /// The pose of the remote centre in the scene.
    pub(super) scene_from_rcm: Pose,
    /// Box for the control point and the finger tips, m.
    ///
    /// Along the scene's axes, as in the file: the controller has the box in the arm's frame.
    pub(super) box_low_m: Vector3<f64>,
    pub(super) box_high_m: Vector3<f64>,
}

/// A region that no part of an instrument may touch.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Region {
    pub(super) name: String,
    pub(super) shape: Shape,
}

/// Least gaps between the surfaces of two instruments, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BetweenArms {
    pub(super) shaft_to_shaft_m: f64,
    pub(super) tip_to_shaft_m: f64,
}

/// Everything that a command is checked against.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Limits {
    pub(super) axes: [AxisLimits; AXES],
    pub(super) tip_speed_m_s: f64,
    pub(super) tip_angular_speed_rad_s: f64,
    /// How much further out an arm that was enabled outside may get, m.
    pub(super) recovery_m: f64,
    /// What stops keep from every boundary, m.
    pub(super) guard_m: f64,
    pub(super) arms: Vec<ArmLimits>,
    /// Scene frame, the same for all arms.
    pub(super) regions: Vec<Region>,
    /// None for one arm, unless the file has them.
    pub(super) between_arms: Option<BetweenArms>,
}

impl Limits {
    /// What the two configuration texts say.
    ///
    /// # Errors
    /// [`VerifyError::Malformed`] for a text that does not parse, a key that is missing or of
    /// another type, or no arm at all.
    pub(super) fn parse(control: &str, safety: &str) -> Result<Self, VerifyError> {
        let (control, safety) = (
            Document::parse(CONTROL, control)?,
            Document::parse(SAFETY, safety)?,
        );
        let (control, safety) = (control.root(), safety.root());
        let axes = axes(&control)?;
        let arms: Vec<_> = each(&safety, "arm", arm)?;
        if arms.is_empty() {
            return Err(safety.missing("arm"));
        }
        let has_gaps = arms.len() > 1 || safety.has("between_arms");
        let between_arms = has_gaps.then(|| between_arms(&safety)).transpose()?;
        Ok(Self {
            axes,
            tip_speed_m_s: control.number("limits.tip_speed_m_s")?,
            tip_angular_speed_rad_s: control.number("limits.tip_angular_speed_rad_s")?,
            recovery_m: safety.number("margins.recovery_m")?,
            guard_m: safety.number("margins.guard_m")?,
            arms,
            regions: each(&safety, "forbidden", region)?,
            between_arms,
        })
    }
}

/// All tables of the array at `key`, read one by one; the first error ends it.
fn each<T>(
    root: &Entry<'_>,
    key: &str,
    read: impl Fn(&Entry<'_>) -> Result<T, VerifyError>,
) -> Result<Vec<T>, VerifyError> {
    root.list(key)?.iter().map(read).collect()
}

fn axis(control: &Entry<'_>, index: usize, name: &'static str) -> Result<AxisLimits, VerifyError> {
    let unit = if index == INSERTION { "m" } else { "rad" };
    let number = |key: &str| control.number(&format!("limits.{name}.{key}"));
    Ok(AxisLimits {
        name,
        low: number(&format!("low_{unit}"))?,
        high: number(&format!("high_{unit}"))?,
        derivatives: [
            number(&format!("velocity_{unit}_s"))?,
            number(&format!("acceleration_{unit}_s2"))?,
            number(&format!("jerk_{unit}_s3"))?,
        ],
    })
}

fn arm(entry: &Entry<'_>) -> Result<ArmLimits, VerifyError> {
    Ok(ArmLimits {
        name: entry.text("name")?.to_owned(),
        scene_from_rcm: pose(
            &entry.vector("rcm_in_scene_m")?,
            &entry.vector("rcm_in_scene_rpy_rad")?,
        ),
        box_low_m: entry.vector("workspace_min_m")?,
        box_high_m: entry.vector("workspace_max_m")?,
    })
}

fn axes(control: &Entry<'_>) -> Result<[AxisLimits; AXES], VerifyError> {
    let axis = |index, name| axis(control, index, name);
    let [yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw] = JOINT_NAMES;
    Ok([
        axis(0, yaw)?,
        axis(1, pitch)?,
        axis(INSERTION, insertion)?,
        axis(3, roll)?,
        axis(4, wrist_pitch)?,
        axis(5, wrist_yaw)?,
        axis(6, "jaw")?,
    ])
}

fn between_arms(safety: &Entry<'_>) -> Result<BetweenArms, VerifyError> {
    Ok(BetweenArms {
        shaft_to_shaft_m: safety.number("between_arms.shaft_to_shaft_m")?,
        tip_to_shaft_m: safety.number("between_arms.tip_to_shaft_m")?,
    })
}

fn region(entry: &Entry<'_>) -> Result<Region, VerifyError> {
    let shape = shape(entry)?;
    Ok(Region {
        name: entry.text("name")?.to_owned(),
        shape,
    })
}

/// The direction of the vector at `key`, which must be of length 0.5 or more.
fn unit(entry: &Entry<'_>, key: &str) -> Result<Vector3<f64>, VerifyError> {
    let normal = entry.vector(key)?.try_normalize(0.5);
    normal.ok_or_else(|| entry.missing(key))
}

fn shape(entry: &Entry<'_>) -> Result<Shape, VerifyError> {
    let point = |key: &str| entry.vector(key).map(Point3::from);
    let shape = match entry.text("shape")? {
        "sphere" => Shape::Sphere {
            center: point("center_m")?,
            radius_m: entry.number("radius_m")?,
        },
        "capsule" => Shape::Capsule {
            start: point("from_m")?,
            end: point("to_m")?,
            radius_m: entry.number("radius_m")?,
        },
        "half_space" => Shape::HalfSpace {
            point: point("point_m")?,
            normal: unit(entry, "normal")?,
        },
        "box" => Shape::Box {
            box_from_scene: pose(&entry.vector("center_m")?, &entry.vector("rpy_rad")?).inverse(),
            half_m: entry.vector("size_m")? / 2.0,
        },
        _ => return Err(entry.missing("shape")),
    };
    Ok(shape)
}

/// A frame at `place_m`, turned by roll about the fixed x, then pitch about the fixed y, then yaw
/// about the fixed z.
fn pose(place_m: &Vector3<f64>, rpy_rad: &Vector3<f64>) -> Pose {
    let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
    let roll = about(Vector3::x_axis(), rpy_rad.x);
    let pitch = about(Vector3::y_axis(), rpy_rad.y);
    let yaw = about(Vector3::z_axis(), rpy_rad.z);
    Pose::from_parts(Translation3::from(*place_m), yaw * pitch * roll)
}
