//! The axes in which an operator's hands move: those of the endoscope's picture.

use hal::Pose;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use trocar_render::look_at;
use trocar_tasks::task::{CameraConfig, ENDOSCOPE, Mount, TaskConfig};

/// Where the picture is, as an arm's base sees it: x to the right, y up, z towards the viewer, the origin at the lens. The small shift
/// of a view that moves cameras by chance is not in it.
///
/// The picture is the endoscope's, or that of the first other camera that stands in the scene; without any, the scene's own axes.
pub(super) fn rcm_from_view(task: &TaskConfig, scene_from_rcm: &Pose) -> Pose {
    let camera = picture(task).and_then(|index| task.cameras.get(index));
    scene_from_rcm.inverse() * camera.map_or_else(Pose::identity, scene_from_view)
}

/// The camera of that picture, in the order of the task's.
pub(crate) fn picture(task: &TaskConfig) -> Option<usize> {
    let find = |fits: fn(&CameraConfig) -> bool| task.cameras.iter().position(fits);
    let endoscope = find(|it| it.name == ENDOSCOPE && it.mount == Mount::Scene);
    endoscope.or_else(|| find(|it| it.mount == Mount::Scene))
}

/// A camera looks along its own z with y down.
fn scene_from_view(camera: &CameraConfig) -> Pose {
    let (eye, target) = (Point3::from(camera.eye_m), Point3::from(camera.target_m));
    let scene_from_camera = look_at(eye, target, Vector3::from(camera.up));
    let about_x = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), core::f64::consts::PI);
    scene_from_camera * about_x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::{PolicyChoice, Setup};

    /// In the picture of the endoscope, right is the scene's x, and up is more of its z and y.
    #[test]
    fn hands_move_in_the_axes_of_the_picture() {
        for task in ["needle-lift", "needle-handover"] {
            let setup = Setup::load(task, None, &PolicyChoice::Noop).unwrap();
            for arm in &setup.task.arms {
                let scene_from_view =
                    arm.scene_from_rcm * rcm_from_view(&setup.task, &arm.scene_from_rcm);
                let [right, up, back] =
                    [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| scene_from_view * axis);
                assert!(right.x > 0.9, "{task}: {right}");
                assert!(up.y > 0.3 && up.z > 0.2, "{task}: {up}");
                assert!(back.z > 0.5 && back.y < 0.0, "{task}: {back}");
                // Something in the middle of the picture lies straight ahead.
                let camera = setup.task.cameras.iter().find(|it| it.name == ENDOSCOPE);
                let target = Point3::from(camera.unwrap().target_m);
                let seen = scene_from_view.inverse() * target;
                assert!(
                    seen.x.abs() < 1e-9 && seen.y.abs() < 1e-9 && seen.z < -0.05,
                    "{seen}"
                );
            }
        }
    }
}
