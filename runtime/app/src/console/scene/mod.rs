//! The scene in three dimensions: shapes once, as a binary glTF file, then where everything is, as
//! often as the simulation says.
//!
//! Everything is in the scene frame, in metres. `glb` writes the file, `safety` what of the limits
//! is drawn; `shapes` are the same shapes one by one.

mod glb;
mod safety;
mod shapes;

use std::sync::Arc;

use axum::body::Bytes;
use hal::count::count_u32;
use hal::{ARMS_MAX, Intrinsics, JOINT_COUNT, JointVector, Mesh, Pose, TimeNs};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use trocar_control::config::ArmConfig;
use trocar_control::motion::AXES;
use trocar_tasks::SimulationError;
use trocar_tasks::cameras::SceneModel;
use trocar_tasks::scene::{SceneSnapshot, THINGS_MAX};
use trocar_world::ArmBodies;

use super::drawn::Stream;
use super::encode;
use super::path::Lenses;
use super::pictures::Board;
use glb::Writer;
pub(super) use shapes::Shapes;

/// Bytes of a pose and of a vector in a message of [`message`].
const POSE_BYTES: usize = 28;
const VECTOR_BYTES: usize = 12;

/// Of each bent shape the number of its visual and its positions, m.
type BentPositions = Vec<(usize, Vec<[f32; 3]>)>;

/// The file of `model` as it is in `start`, with the limits of `arms`.
///
/// Its first nodes are the model's visuals, in their order; the next ones its cameras; what follows
/// does not move.
pub(super) fn file(
    model: &SceneModel,
    start: &SceneSnapshot,
    arms: &[ArmConfig],
) -> Result<Bytes, SimulationError> {
    let mut writer = Writer::default();
    for (visual, pose) in model.visuals().iter().zip(model.poses(start)) {
        writer.mesh(visual.name, &visual.mesh, &visual.material, &pose);
    }
    for ((name, lens), pose) in model.cameras().zip(model.camera_poses(start)?) {
        writer.camera(name, &lens, &pose);
    }
    safety::draw(&mut writer, arms);
    Ok(writer.finish().into())
}

/// The scene with arms alone: of each where its remote centre is in the scene, and its joints with
/// the jaw, rad (insertion m).
pub(crate) fn of_arms(arms: impl Iterator<Item = (Pose, [f64; AXES])>) -> SceneSnapshot {
    let mut bodies = [None; ARMS_MAX];
    for (body, (base, axes)) in bodies.iter_mut().zip(arms) {
        let (joints, jaw) = axes.split_at(JOINT_COUNT);
        let joints = JointVector::from_column_slice(joints);
        *body = Some(ArmBodies::at(&base, &joints, jaw[0]));
    }
    SceneSnapshot {
        moment_ms: 0,
        things: [Pose::identity(); THINGS_MAX],
        goal: Pose::identity(),
        arms: bodies,
        flap: None,
    }
}

/// Whether a camera that says `lens` and `camera_in_scene` of itself says where it is: one that
/// doesn't has no focal length, or stands at the origin.
pub(crate) fn is_placed(lens: &Intrinsics, camera_in_scene: &Pose) -> bool {
    let focal = [lens.fx, lens.fy].map(|length| length > 0.0 && length.is_finite());
    let numbers = seven(camera_in_scene).into_iter();
    focal == [true; 2]
        && numbers.into_iter().all(f32::is_finite)
        && *camera_in_scene != Pose::identity()
}

/// Adds those of the cameras `names` that `model` has, as they are in `snapshot`, to `lenses`, each
/// in its place among `names`.
pub(super) fn add_lenses(
    model: &SceneModel,
    snapshot: &SceneSnapshot,
    names: &[String],
    lenses: &mut Lenses,
) {
    let poses = model.camera_poses(snapshot).ok();
    for ((camera, lens), pose) in model.cameras().zip(poses.into_iter().flatten()) {
        let place = (0..=u8::MAX).zip(names).find(|(_, name)| *name == camera);
        if let Some((place, _)) = place {
            lenses.entry(place).or_insert((lens, pose));
        }
    }
}

/// Where everything is at one instant, little endian: the head of a picture, then how many poses of
/// visuals, of cameras and how many bent shapes there are (u32 each); poses as x, y, z in metres
/// and the quaternion x, y, z, w; of each bent shape the number of its visual and of its vertices
/// (u32 each), then all positions and all normals. Numbers are f32.
pub(super) fn message(
    model: &mut SceneModel,
    snapshot: &SceneSnapshot,
    stamp: TimeNs,
) -> Result<Vec<u8>, SimulationError> {
    let (visuals, cameras) = (model.poses(snapshot), model.camera_poses(snapshot)?);
    let bent = model.bent(snapshot);
    let mut bytes = encode::head(Stream::SCENE, stamp);
    for count in [visuals.len(), cameras.len(), bent.len()] {
        put_count(&mut bytes, count);
    }
    for pose in visuals.iter().chain(&cameras) {
        put(&mut bytes, &seven(pose));
    }
    for (index, mesh) in bent {
        put_shape(&mut bytes, index, mesh);
    }
    Ok(bytes)
}

/// The poses of visuals and of cameras that a message of [`message`] says; none if it is no such
/// message.
pub(super) fn places(message: &[u8]) -> Option<(Vec<Pose>, Vec<Pose>)> {
    let [visuals, cameras, _] = counts(message)?;
    let poses = message.get(encode::HEAD + 12..)?.chunks_exact(POSE_BYTES);
    let mut poses = poses.map(pose).take(visuals.checked_add(cameras)?);
    let visuals = poses.by_ref().take(visuals).collect();
    Some((visuals, poses.collect()))
}

/// The bent shapes that a message of [`message`] says; none if it is no such message.
fn bent(message: &[u8]) -> Option<BentPositions> {
    let [visuals, cameras, shapes] = counts(message)?;
    let poses = visuals.checked_add(cameras)?.checked_mul(POSE_BYTES)?;
    let mut rest = message.get(encode::HEAD + 12..)?.get(poses..)?;
    let mut bent = Vec::new();
    for _ in 0..shapes {
        let (index, vertices) = (count(rest, 0)?, count(rest, 4)?);
        let bytes = vertices.checked_mul(VECTOR_BYTES)?;
        let shape = rest.get(8..)?;
        let positions = shape.get(..bytes)?.chunks_exact(VECTOR_BYTES);
        let positions = positions.map(|bytes| [0, 1, 2].map(|index| single(bytes, index)));
        bent.push((index, positions.collect()));
        rest = shape.get(bytes.checked_mul(2)?..)?;
    }
    Some(bent)
}

/// How many visuals, cameras and bent shapes a message of [`message`] says.
fn counts(message: &[u8]) -> Option<[usize; 3]> {
    let of = |place: usize| count(message, encode::HEAD + 4 * place);
    Some([of(0)?, of(1)?, of(2)?])
}

/// The count at this place of `bytes`.
fn count(bytes: &[u8], at: usize) -> Option<usize> {
    let bytes = bytes.get(at..at + 4)?.try_into().ok()?;
    usize::try_from(u32::from_le_bytes(bytes)).ok()
}

/// The number of this index among those in `bytes`.
fn single(bytes: &[u8], index: usize) -> f32 {
    let bytes = bytes.get(4 * index..4 * index + 4);
    let bytes = bytes.and_then(|bytes| bytes.try_into().ok());
    bytes.map_or(0.0, f32::from_le_bytes)
}

/// The pose that [`seven`] numbers are.
fn pose(bytes: &[u8]) -> Pose {
    let number = |index: usize| f64::from(single(bytes, index));
    let turn = Quaternion::new(number(6), number(3), number(4), number(5));
    Pose::from_parts(
        Translation3::new(number(0), number(1), number(2)),
        UnitQuaternion::new_normalize(turn),
    )
}

fn put_shape(bytes: &mut Vec<u8>, index: usize, mesh: &Mesh) {
    put_count(bytes, index);
    put_count(bytes, mesh.positions.len());
    for vector in mesh.positions.iter().chain(&mesh.normals) {
        put(bytes, vector);
    }
}

fn put_count(bytes: &mut Vec<u8>, count: usize) {
    bytes.extend(count_u32(count).to_le_bytes());
}

fn put(bytes: &mut Vec<u8>, numbers: &[f32]) {
    bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
}

/// Position and quaternion (x, y, z, w).
#[expect(clippy::cast_possible_truncation, reason = "what a page draws")]
fn seven(pose: &Pose) -> [f32; 7] {
    let (at, turned) = (pose.translation.vector, pose.rotation.coords);
    [at.x, at.y, at.z, turned.x, turned.y, turned.z, turned.w].map(|number| number as f32)
}

/// The scene of a run, on its way to the pages that look at it.
pub(crate) struct SceneTap {
    model: SceneModel,
    board: Arc<Board>,
}

impl SceneTap {
    pub(super) const fn new(model: SceneModel, board: Arc<Board>) -> Self {
        Self { model, board }
    }

    /// From now on the camera of this index is there.
    pub(crate) fn move_camera(&mut self, camera: usize, camera_in_scene: &Pose) {
        self.model.move_camera(camera, camera_in_scene);
    }

    /// Shows where everything is at `stamp`, if a page looks at it.
    ///
    /// # Errors
    /// [`SimulationError::NoCarrier`] if an arm that carries a camera is not in `snapshot`.
    pub(crate) fn show(
        &mut self,
        snapshot: &SceneSnapshot,
        stamp: TimeNs,
    ) -> Result<(), SimulationError> {
        if self.board.wants(Stream::SCENE) {
            let message = message(&mut self.model, snapshot, stamp)?;
            self.board.put_up(Stream::SCENE, message);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_tasks::simulation::{Rendering, Simulation};
    use trocar_tasks::task::TaskConfig;

    fn u32_at(bytes: &[u8], at: usize) -> usize {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
    }

    fn f32_at(bytes: &[u8], at: usize) -> f32 {
        f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
    }

    /// A viewer is told of each shape that bends, in its frame, what a page is.
    fn viewers_see_what_bends(model: &mut SceneModel, snapshot: &SceneSnapshot, bytes: &[u8]) {
        let now = model.bent(snapshot).into_iter();
        let now: Vec<_> = now.map(|(index, mesh)| (index, mesh.clone())).collect();
        let indices: Vec<usize> = now.iter().map(|(index, _)| *index).collect();
        let shapes = Shapes::new(model, &indices);
        let told = shapes.bent(bytes);
        assert_eq!(told.len(), now.len());
        for (shape, (index, mesh)) in told.iter().zip(&now) {
            assert_eq!(Some(shape.frame), shapes.frames().nth(*index));
            assert!(shapes.files().all(|(frame, _)| frame != shape.frame));
            assert_eq!(shape.positions, mesh.positions);
            assert_eq!(shape.indices, mesh.indices);
            assert!(shape.colour.iter().all(|part| (0.0..=1.0).contains(part)));
        }
        // Those of another scene are not mixed with this one's triangles.
        let mut other = bytes.to_vec();
        if let Some((index, _)) = now.first() {
            let at =
                encode::HEAD + 12 + POSE_BYTES * (model.visuals().len() + model.cameras().count());
            assert_eq!(count(&other, at), Some(*index));
            other[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
            assert_eq!(shapes.bent(&other).len(), now.len() - 1);
        }
    }

    /// The message has exactly what it says, and the flap is where the simulation has it.
    #[test]
    fn a_message_says_where_everything_is() {
        for name in TaskConfig::names() {
            let task = TaskConfig::built_in(name).unwrap();
            let simulation = Simulation::new(&task, 3, Rendering::Off).unwrap();
            let snapshot = simulation.snapshot();
            let mut model = SceneModel::new(&task, 3);
            let bytes = message(&mut model, &snapshot, TimeNs(2_000_000_000)).unwrap();
            assert_eq!(bytes[0], Stream::SCENE.camera);
            let [visuals, cameras, bent] = [16, 20, 24].map(|at| u32_at(&bytes, at));
            assert_eq!(visuals, model.visuals().len(), "{name}");
            assert_eq!(cameras, model.cameras().count(), "{name}");
            assert_eq!(bent, if snapshot.flap.is_some() { 2 } else { 0 }, "{name}");
            let last = model.poses(&snapshot).pop().unwrap();
            let (read, read_cameras) = places(&bytes).unwrap();
            assert_eq!(
                (read.len(), read_cameras.len()),
                (visuals, cameras),
                "{name}"
            );
            let apart = read.last().unwrap().inv_mul(&last);
            assert!(apart.translation.vector.norm() < 1e-6, "{name}");
            let at = 28 + 28 * (visuals - 1);
            for (axis, expected) in seven(&last).into_iter().enumerate() {
                assert!((f32_at(&bytes, at + 4 * axis) - expected).abs() < 1e-9);
            }
            let mut end = 28 + 28 * (visuals + cameras);
            for _ in 0..bent {
                end += 8 + 24 * u32_at(&bytes, end + 4);
            }
            assert_eq!(end, bytes.len(), "{name}");
            viewers_see_what_bends(&mut model, &snapshot, &bytes);
            assert_eq!(super::bent(&bytes[..bytes.len() - 1]), None, "{name}");
        }
    }
}
