//! The axes in which an operator's hands move: those of the endoscope's picture.

use hal::Pose;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use trocar_render::look_at;
use trocar_tasks::task::{CameraConfig, ENDOSCOPE, Mount, TaskConfig};

/// Where the picture is, as an arm's base sees it: x to the right, y up, z towards the viewer, the
/// origin at the lens. The small shift of a view that moves cameras by chance is not in it.
///
/// The picture is the endoscope's, or that of the first other camera that stands in the scene;
/// without any, the scene's own axes.
pub(super) fn rcm_from_view(task: &TaskConfig, scene_from_rcm: &Pose) -> Pose {
    let camera = picture(task).and_then(|index| task.cameras.get(index));
    scene_from_rcm.inverse() * camera.map_or_else(Pose::identity, scene_from_view)
}

/// That of each arm of `task`, in their order.
pub(crate) fn rcms_from_view(task: &TaskConfig) -> Vec<Pose> {
    let arms = task.arms.iter();
    arms.map(|arm| rcm_from_view(task, &arm.scene_from_rcm))
        .collect()
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
    use crate::session::{HandsView, PolicyChoice, Setup};

    /// What a robot is told of its operator's view is what a task has of its own.
    #[test]
    fn a_view_that_is_told_is_that_of_the_task() {
        let setup = Setup::load("needle-handover", None, &PolicyChoice::Noop).unwrap();
        let told = ["psm2=25,30,0", "psm1=25, -30, 0"].map(|text| text.parse().unwrap());
        let robot = setup.robot.clone().moved_in(&told).unwrap();
        let views = rcms_from_view(&setup.task);
        for (told, view) in robot.rcms_from_view.iter().zip(&views) {
            let apart = told.rotation.angle_to(&view.rotation);
            assert!(apart < 1e-3, "{apart}");
        }
        let refused = |texts: &[&str]| {
            let views = texts.iter().map(|text| text.parse::<HandsView>());
            let views: Result<Vec<_>, String> = views.collect();
            views.map_or_else(|reason| reason, |views| robot_of(&setup, &views))
        };
        for (texts, expected) in [
            (&["psm1=0,0,0"][..], "psm2 has none"),
            (&["psm1=0,0,0", "psm2=0,0,0", "psm2=1,0,0"], "psm2 has two"),
            (&["psm1=0,0,0", "psm2=0,0,0", "psm3=1,0,0"], "no arm psm3"),
            (&["psm1=0,0"], "ARM=X,Y,Z"),
            (&["psm1=0,nan,0"], "[-360, 360]"),
            (&["25,0,0"], "ARM=X,Y,Z"),
        ] {
            let reason = refused(texts);
            assert!(reason.contains(expected), "{reason}");
        }
    }

    fn robot_of(setup: &Setup, views: &[HandsView]) -> String {
        let robot = setup.robot.clone().moved_in(views);
        robot
            .err()
            .map_or_else(String::new, |error| error.to_string())
    }

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
