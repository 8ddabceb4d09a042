//! A task's scene for whoever draws it without a renderer of ours: shapes, and where they and the
//! cameras are at an instant.

use hal::{Intrinsics, Mesh, Pose};
use trocar_render::Optics;
use trocar_render::visual::{Visual, VisualPoses, instance};

use super::View;
use super::flap::DrawnFlap;
use crate::SimulationError;
use crate::scene::{SceneSnapshot, THINGS_MAX};
use crate::task::{TaskConfig, TaskScene, arms_poses, arms_visuals, scene_visuals};

/// Places of things and goal by which what moves is told from what does not, m: in no order along
/// any line are they the same.
const PLACES_M: [[f64; 2]; 3] = [[1.0, 0.3], [-0.2, 1.0], [-1.0, -0.7]];

/// The shapes of one episode. All poses are in the scene frame, in metres; cameras look along their
/// z axis, x is to the right of the image.
pub struct SceneModel {
    /// None of arms alone.
    scene: Option<Box<dyn TaskScene>>,
    /// Of each visual of the scene, whether it is shown; those of the arms follow.
    shown: Vec<bool>,
    visuals: Vec<Visual>,
    flap: Option<DrawnFlap>,
    views: Vec<View>,
}

impl SceneModel {
    /// Those of the episode `seed` of `task`.
    #[must_use]
    pub fn new(task: &TaskConfig, seed: u64) -> Self {
        let scene = task.scene_of(seed);
        let mut visuals = scene_visuals(task);
        for (visual, own) in visuals.iter_mut().zip(scene.visuals()) {
            *visual = own;
        }
        Self {
            flap: DrawnFlap::new(&*scene, &visuals),
            views: View::of_episode(task, seed, &task.drawn(seed)),
            shown: vec![true; visuals.len()],
            scene: Some(scene),
            visuals,
        }
    }

    /// What of that episode does not move, and the arms, whatever else there may be: of an episode
    /// of which it is known where the arms are, and not where things are, nor the goal, nor a flap.
    #[must_use]
    pub fn at_rest(task: &TaskConfig, seed: u64) -> Self {
        let mut model = Self::new(task, seed);
        model.flap = None;
        let Some(scene) = &model.scene else {
            return model;
        };
        // What moves is elsewhere when things and goal are.
        let poses = PLACES_M.map(|[x, y]| {
            let place = Pose::translation(x, y, 0.0);
            scene.visual_poses(&[place; THINGS_MAX], &place)
        });
        let rests = |index: usize| {
            let mut places = poses.iter().map(|poses| poses.get(index));
            let first = places.next();
            places.all(|place| Some(place) == first)
        };
        let bends = |visual: &Visual| [instance::TISSUE, instance::MARK].contains(&visual.instance);
        let own = model.visuals.iter().take(poses[0].len()).enumerate();
        model.shown = own
            .map(|(index, visual)| rests(index) && !bends(visual))
            .collect();
        let mut shown = model.shown.iter();
        model
            .visuals
            .retain(|_| shown.next().is_none_or(|shown| *shown));
        model
    }

    /// So many arms, and nothing around them.
    #[must_use]
    pub fn of_arms(count: usize) -> Self {
        Self {
            scene: None,
            shown: Vec::new(),
            visuals: arms_visuals(count),
            flap: None,
            views: Vec::new(),
        }
    }

    /// The same with these cameras too, which no task has: name, lens, and where it is in the
    /// scene.
    #[must_use]
    pub fn seen_by(
        mut self,
        cameras: impl IntoIterator<Item = (String, Intrinsics, Pose)>,
    ) -> Self {
        let views = cameras.into_iter();
        let views = views.map(|(name, intrinsics, camera_in_scene)| View {
            name,
            intrinsics,
            camera_in_mount: camera_in_scene,
            carrier: None,
            optics: Optics::CLEAN,
        });
        self.views.extend(views);
        self
    }

    /// From now on the camera of this index is there; one that an arm carries goes with it as
    /// before.
    pub fn move_camera(&mut self, camera: usize, camera_in_scene: &Pose) {
        let view = self.views.get_mut(camera);
        if let Some(view) = view.filter(|view| view.carrier.is_none()) {
            view.camera_in_mount = *camera_in_scene;
        }
    }

    /// The same without cameras.
    #[must_use]
    pub fn without_cameras(mut self) -> Self {
        self.views.clear();
        self
    }

    /// Everything that is drawn, a soft thing as it is before anything touches it.
    #[must_use]
    pub fn visuals(&self) -> &[Visual] {
        &self.visuals
    }

    /// Where each of the visuals is.
    #[must_use]
    pub fn poses(&self, snapshot: &SceneSnapshot) -> VisualPoses {
        let scene = self.scene.iter();
        let poses = scene.flat_map(|scene| scene.visual_poses(&snapshot.things, &snapshot.goal));
        let shown = poses.zip(&self.shown).filter(|(_, shown)| **shown);
        let poses = shown.map(|(pose, _)| pose);
        poses.chain(arms_poses(snapshot)).collect()
    }

    /// The visuals whose shape changes, by index, with the shapes that they have now.
    pub fn bent(&mut self, snapshot: &SceneSnapshot) -> Vec<(usize, &Mesh)> {
        let (Some(drawn), Some(flap)) = (&mut self.flap, &snapshot.flap) else {
            return Vec::new();
        };
        drawn.bend(flap);
        drawn.meshes().to_vec()
    }

    /// Names and lenses of the cameras.
    pub fn cameras(&self) -> impl Iterator<Item = (&str, Intrinsics)> {
        self.views
            .iter()
            .map(|view| (view.name.as_str(), view.intrinsics))
    }

    /// Where each of the cameras is.
    ///
    /// # Errors
    /// [`SimulationError::NoCarrier`] if an arm that carries one is not in `snapshot`.
    pub fn camera_poses(&self, snapshot: &SceneSnapshot) -> Result<Vec<Pose>, SimulationError> {
        let placed = self.views.iter().map(|view| view.camera_in_scene(snapshot));
        placed.collect()
    }
}

#[cfg(test)]
mod tests {
    use trocar_world::ArmBodies;

    use super::*;
    use crate::simulation::{Rendering, Simulation};

    /// The arms are where a simulation has them, from their joints alone, with the ground and
    /// without anything that moves on it.
    #[test]
    fn arms_and_what_rests_are_known_without_a_simulation() {
        for name in TaskConfig::names() {
            let task = TaskConfig::built_in(name).unwrap();
            let simulation = Simulation::new(&task, 3, Rendering::Off).unwrap();
            let whole = simulation.snapshot();
            let mut arms = [None; hal::ARMS_MAX];
            for (arm, start) in arms.iter_mut().zip(&task.arms) {
                let jaw = start.jaw;
                *arm = Some(ArmBodies::at(&start.scene_from_rcm, &start.joints, jaw));
            }
            let known = SceneSnapshot {
                moment_ms: 0,
                things: [Pose::identity(); THINGS_MAX],
                goal: Pose::identity(),
                arms,
                flap: None,
            };
            let (all, mut rests) = (SceneModel::new(&task, 3), SceneModel::at_rest(&task, 3));
            assert!(rests.bent(&known).is_empty(), "{name}");
            let named = |model: &SceneModel, poses: VisualPoses| -> Vec<(&'static str, Pose)> {
                let names = model.visuals().iter().map(|visual| visual.name);
                assert_eq!(names.len(), poses.len(), "{name}");
                names.zip(poses).collect()
            };
            let mut all = named(&all, all.poses(&whole)).into_iter();
            let known = named(&rests, rests.poses(&known));
            for (visual, pose) in &known {
                let (_, expected) = all.find(|(other, _)| other == visual).unwrap();
                let apart = expected.inv_mul(pose);
                let turn = apart.rotation.angle();
                assert!(
                    apart.translation.vector.norm() < 1e-9 && turn < 1e-6,
                    "{name}: {visual} {apart}"
                );
            }
            assert!(known.len() > 4 * task.arms.len(), "{name}: no ground");
            for moves in ["needle", "block", "flap", "mark"] {
                assert!(known.iter().all(|(visual, _)| *visual != moves), "{name}");
            }
            let alone = SceneModel::of_arms(task.arms.len());
            assert_eq!(alone.visuals().len(), 4 * task.arms.len());
            assert_eq!(alone.cameras().count(), 0);
        }
    }

    /// A camera of no task is where it says; one that an arm carries stays on it.
    #[test]
    fn cameras_of_no_task_are_where_they_say() {
        let lens = Intrinsics::from_vertical_fov(64, 48, 1.0);
        let mut there = Pose::translation(0.1, 0.0, 0.2);
        let named = [("endoscope", Pose::identity()), ("room", there)];
        let named = named.map(|(name, pose)| (name.to_owned(), lens, pose));
        let mut alone = SceneModel::of_arms(1).seen_by(named);
        let nothing = SceneSnapshot {
            moment_ms: 0,
            things: [Pose::identity(); THINGS_MAX],
            goal: Pose::identity(),
            arms: [None; hal::ARMS_MAX],
            flap: None,
        };
        assert_eq!(alone.cameras().last(), Some(("room", lens)));
        assert_eq!(alone.camera_poses(&nothing).unwrap()[1], there);
        there = Pose::translation(0.0, 0.3, 0.0);
        alone.move_camera(1, &there);
        alone.move_camera(2, &there);
        let poses = alone.camera_poses(&nothing).unwrap();
        assert_eq!(poses, [Pose::identity(), there]);
        let task = TaskConfig::names().map(|name| TaskConfig::built_in(name).unwrap());
        let mut carried = 0;
        for task in task {
            let whole = Simulation::new(&task, 3, Rendering::Off)
                .unwrap()
                .snapshot();
            let mut model = SceneModel::new(&task, 3);
            let before = model.camera_poses(&whole).unwrap();
            for camera in 0..before.len() {
                model.move_camera(camera, &there);
            }
            let moved = model.camera_poses(&whole).unwrap();
            for ((view, before), moved) in model.views.iter().zip(&before).zip(&moved) {
                let stays = view.carrier.is_some();
                carried += usize::from(stays);
                assert_eq!(moved, if stays { before } else { &there }, "{}", view.name);
            }
        }
        assert!(carried > 0);
    }
}
