//! The camera and the light beside it, and the projections they imply.
//!
//! Camera frame: x right, y down, z along the view, m (OpenCV's). A point projects to the pixel
//! `(fx x / z + cx, fy y / z + cy)`, with whole numbers at the corners of pixels and (0, 0) at the
//! top left of the image. Clip coordinates are wgpu's: x right, y up, depth 0 to 1, `w` = z.

use hal::{Intrinsics, Pose};
use nalgebra::{Matrix4, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::{Optics, RenderError};

/// A camera somewhere in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// The lens. Of one that distorts all planes of the image show the distorted picture: colour
    /// blended, ids and depth from the nearest pixel of a pinhole's image.
    pub intrinsics: Intrinsics,
    /// Pose in the scene frame: x right, y down, z along the view.
    pub camera_in_scene: Pose,
    /// Nothing nearer than this along z is drawn, m; above 0.
    pub near_m: f64,
    /// Nothing further than this along z is drawn, m; above `near_m`. The backdrop is drawn
    /// whatever it is.
    pub far_m: f64,
    /// What else lies between scene and picture.
    pub optics: Optics,
}

/// The light guide of an endoscope: a spot with a place of its own, so that all cameras see the
/// scene in the same light.
///
/// The spot's irradiance at distance `d` is `intensity * reference_distance_m^2 / d^2`, times a
/// smoothstep of the cosine to the axis: 0 at `cone_half_angle_rad`, 1 within half of that angle.
/// Brightness has no unit: the filmic response maps 1 to 0.71 (`tone.wgsl`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Where the guide ends and points, scene frame: it shines along z.
    pub guide_in_scene: Pose,
    /// Angle from the axis at which the spot has faded to nothing, rad, below a quarter turn.
    pub cone_half_angle_rad: f64,
    /// Brightness of the spot at [`Self::reference_distance_m`]; it falls with the square of the
    /// distance.
    pub intensity: f64,
    /// Distance at which [`Self::intensity`] is meant, m.
    pub reference_distance_m: f64,
    /// Brightness of the light that tissue all around throws back.
    pub ambient: f64,
    /// Share by which all light has more red and less blue; less red and more blue below 0.
    pub warmth: f64,
}

/// Where the light guide ends beside the lens of an endoscope, camera frame, m: as in a tip that
/// is 12 mm thick, above and to the right. At the lens itself no shadow would be seen.
const GUIDE_IN_CAMERA_M: [f64; 3] = [0.004, -0.005, 0.0];

impl Light {
    /// The light of an endoscope whose lens is `camera`: it covers what the camera sees and a
    /// little more.
    ///
    /// The cone's half angle is 1.15 times the angle to the farthest corner of the picture plus
    /// 0.06 rad, clamped to 0.1 to 1.2 rad; distortion is ignored.
    #[must_use]
    pub fn beside(camera: &Camera) -> Self {
        let lens = &camera.intrinsics;
        let reach =
            |centre: f64, size: u32, focal: f64| centre.max(f64::from(size) - centre) / focal;
        let across = reach(lens.cx, lens.width, lens.fx);
        let down = reach(lens.cy, lens.height, lens.fy);
        Self {
            guide_in_scene: camera.camera_in_scene * Translation3::from(GUIDE_IN_CAMERA_M),
            cone_half_angle_rad: (1.15 * across.hypot(down).atan() + 0.06).clamp(0.1, 1.2),
            ..Self::default()
        }
    }
}

impl Default for Light {
    fn default() -> Self {
        Self {
            guide_in_scene: Pose::identity(),
            cone_half_angle_rad: 0.7,
            intensity: 3.0,
            reference_distance_m: 0.12,
            ambient: 0.20,
            warmth: 0.0,
        }
    }
}

/// The pose of a camera at `eye_m` that looks at `target_m` with `up` upwards in its image, all in
/// the scene frame.
///
/// Where `up` is parallel to the view another upward direction is chosen, always the same; where
/// eye and target coincide the view is along the scene's z.
#[must_use]
pub fn look_at(eye_m: Point3<f64>, target_m: Point3<f64>, up: Vector3<f64>) -> Pose {
    let forward = (target_m - eye_m)
        .try_normalize(1e-12)
        .unwrap_or_else(Vector3::z);
    let right = [up, Vector3::x(), Vector3::y()]
        .into_iter()
        .find_map(|candidate| forward.cross(&candidate).try_normalize(1e-9))
        .unwrap_or_else(Vector3::x);
    let down = forward.cross(&right);
    let rotation = Rotation3::from_basis_unchecked(&[right, down, forward]);
    Pose::from_parts(
        Translation3::from(eye_m.coords),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

impl Camera {
    /// Whether the camera can take an image of at most `size_px_max` pixels a side.
    ///
    /// Poses are not checked. Distortion is checked when its window is made (`lens`).
    pub(super) fn check(&self, size_px_max: u32) -> Result<(), RenderError> {
        let lens = &self.intrinsics;
        let sizes = 1..=size_px_max;
        if !sizes.contains(&lens.width) || !sizes.contains(&lens.height) {
            return Err(RenderError::ImageSize {
                width: lens.width,
                height: lens.height,
                max: size_px_max,
            });
        }
        let finite = [lens.fx, lens.fy, lens.cx, lens.cy, self.near_m, self.far_m]
            .iter()
            .all(|v| v.is_finite());
        if !(finite && lens.fx > 0.0 && lens.fy > 0.0) {
            return Err(RenderError::Camera(
                "the focal lengths must be positive, all intrinsics finite",
            ));
        }
        if !(self.near_m > 0.0 && self.far_m > self.near_m) {
            return Err(RenderError::Camera(
                "the planes must satisfy 0 < near_m < far_m",
            ));
        }
        if !self.optics.can_be() {
            return Err(RenderError::Camera(
                "vignette, blood and fog must be in [0, 1], exposure in (0, 1000], noise and smoke in [0, 1000]",
            ));
        }
        Ok(())
    }

    /// Clip coordinates (y up, depth 0 at the near plane, 1 at the far one) of the pinhole from
    /// camera coordinates.
    ///
    /// Depth is `far (z - near) / (z (far - near))`: much finer near the camera. The depth plane is
    /// interpolated z in metres instead.
    pub(super) fn clip_from_camera(&self) -> Matrix4<f64> {
        let lens = &self.intrinsics;
        let (width, height) = (f64::from(lens.width), f64::from(lens.height));
        let mut clip = depth_rows(self.near_m, self.far_m);
        clip[(0, 0)] = 2.0 * lens.fx / width;
        clip[(0, 2)] = 2.0 * lens.cx / width - 1.0;
        clip[(1, 1)] = -2.0 * lens.fy / height;
        clip[(1, 2)] = 1.0 - 2.0 * lens.cy / height;
        clip
    }
}

impl Light {
    /// Whether brightness, distance, cone, warmth and pose are numbers that the shader can use.
    pub(super) fn check(&self) -> Result<(), RenderError> {
        let numbers = [self.intensity, self.reference_distance_m, self.ambient];
        let finite = numbers
            .iter()
            .chain(self.guide_in_scene.to_homogeneous().iter())
            .all(|v| v.is_finite());
        let cone = self.cone_half_angle_rad > 0.0
            && self.cone_half_angle_rad < core::f64::consts::FRAC_PI_2;
        let warm = self.warmth.abs() <= 1.0;
        if finite && cone && warm && numbers.iter().all(|v| *v >= 0.0) {
            Ok(())
        } else {
            Err(RenderError::Light(
                "brightness and distance must be finite and not negative, the cone in (0, pi/2), the warmth in [-1, 1]",
            ))
        }
    }

    /// Half width of the shadow map over distance: it holds the whole cone.
    pub(super) fn window_tan(&self) -> f64 {
        self.cone_half_angle_rad.tan()
    }

    /// Clip coordinates of the shadow map from coordinates of the guide.
    ///
    /// A perspective along the guide's z with a square window; x and y of the guide only turn the
    /// map.
    pub(super) fn clip_from_light(&self) -> Matrix4<f64> {
        let scale = 1.0 / self.window_tan();
        let mut clip = depth_rows(SHADOW_NEAR_M, SHADOW_FAR_M);
        clip[(0, 0)] = scale;
        clip[(1, 1)] = -scale;
        clip
    }
}

/// Depth range of the shadow map, m; what is beyond gets light.
///
/// The shader turns depths of the map back into metres with both numbers, for penumbras.
pub(super) const SHADOW_NEAR_M: f64 = 0.01;
pub(super) const SHADOW_FAR_M: f64 = 0.7;

/// The depth and w rows that every projection along +z shares.
///
/// x and y rows are 0 and left to the caller.
fn depth_rows(near_m: f64, far_m: f64) -> Matrix4<f64> {
    let mut clip = Matrix4::zeros();
    clip[(2, 2)] = far_m / (far_m - near_m);
    clip[(2, 3)] = -near_m * far_m / (far_m - near_m);
    clip[(3, 2)] = 1.0;
    clip
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn look_at_puts_the_target_ahead_and_up_upwards() {
        let eye = Point3::new(0.1, -0.2, 0.3);
        let target = Point3::new(0.02, 0.01, 0.0);
        let camera_from_scene = look_at(eye, target, Vector3::z()).inverse();
        let ahead = camera_from_scene * target;
        assert!(ahead.x.abs() < 1e-12 && ahead.y.abs() < 1e-12);
        assert!((ahead.z - (target - eye).norm()).abs() < 1e-12);
        let above = camera_from_scene * (target + Vector3::z() * 0.01);
        assert!(above.y < -1e-3 && above.x.abs() < 1e-12);
    }

    #[test]
    fn look_at_survives_a_view_along_up() {
        let pose = look_at(Point3::new(0.0, 0.0, 1.0), Point3::origin(), Vector3::z());
        assert!((pose * Point3::new(0.0, 0.0, 1.0)).coords.norm() < 1e-12);
    }

    #[test]
    fn the_clip_planes_lie_at_zero_and_one() {
        let camera = Camera {
            intrinsics: Intrinsics::from_vertical_fov(640, 480, 0.9),
            camera_in_scene: Pose::identity(),
            near_m: 0.01,
            far_m: 0.5,
            optics: Optics::CLEAN,
        };
        for (z, depth) in [(0.01, 0.0), (0.5, 1.0)] {
            let clip = camera.clip_from_camera() * nalgebra::Vector4::new(0.0, 0.0, z, 1.0);
            assert!((clip.z / clip.w - depth).abs() < 1e-12);
        }
    }
}
