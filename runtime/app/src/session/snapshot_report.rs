//! Where everything in a scene is, as it travels to the process that draws it: plain numbers and
//! back.

use hal::{ARMS_MAX, Pose, TimeNs};
use trocar_tasks::scene::{SceneSnapshot, THINGS_MAX};
use trocar_topics::{
    FLAP_NODES_MAX, Flap, InstrumentParts, Line, PoseMessage, SCENE_THINGS_MAX, SnapshotReport,
};
use trocar_world::ArmBodies;
use trocar_world::tissue::{FlapSnapshot, NODES_MAX};

use super::world_report::WorldName;

const _: () = assert!(THINGS_MAX == SCENE_THINGS_MAX && NODES_MAX == FLAP_NODES_MAX);

/// The report of `scene` at `stamp` on the system's clock, the step `sequence` of the episode of
/// `world`, for all cameras.
pub(super) fn report(
    stamp: TimeNs,
    sequence: u64,
    world: &WorldName,
    scene: &SceneSnapshot,
) -> SnapshotReport {
    let arms = scene.arms.map(|arm| arm.map(|arm| parts(&arm)));
    SnapshotReport {
        stamp,
        sequence,
        task: Line::new(&world.task),
        scene_hash: world.scene_hash,
        seed: world.seed,
        wanted: u64::MAX,
        moment_ms: u64::from(scene.moment_ms),
        things: scene.things.map(|thing| PoseMessage::new(&thing)),
        goal: PoseMessage::new(&scene.goal),
        arm_count: arms.iter().flatten().count() as u64,
        arms: arms.map(Option::unwrap_or_default),
        has_flap: u64::from(scene.flap.is_some()),
        flap: scene.flap.map_or_else(Flap::default, |flap| Flap {
            nodes_m: *flap.nodes_m(),
            mark_m: flap.mark_m(),
        }),
    }
}

fn parts(arm: &ArmBodies) -> InstrumentParts {
    InstrumentParts {
        shaft: PoseMessage::new(&arm.shaft),
        wrist: PoseMessage::new(&arm.wrist),
        finger_left: PoseMessage::new(&arm.finger_left),
        finger_right: PoseMessage::new(&arm.finger_right),
        tip: PoseMessage::new(&arm.tip),
    }
}

/// The scene in `report`, for the renderer.
pub(super) fn scene(report: &SnapshotReport) -> SceneSnapshot {
    let mut arms = [None; ARMS_MAX];
    let count = usize::try_from(report.arm_count).unwrap_or(ARMS_MAX);
    for (arm, parts) in arms.iter_mut().zip(&report.arms).take(count) {
        *arm = Some(bodies(parts));
    }
    SceneSnapshot {
        moment_ms: u32::try_from(report.moment_ms).unwrap_or(u32::MAX),
        things: report.things.map(|thing| thing.pose()),
        goal: report.goal.pose(),
        arms,
        flap: (report.has_flap != 0)
            .then(|| FlapSnapshot::from_parts(report.flap.nodes_m, report.flap.mark_m)),
    }
}

fn bodies(parts: &InstrumentParts) -> ArmBodies {
    let InstrumentParts {
        shaft,
        wrist,
        finger_left,
        finger_right,
        tip,
    } = parts;
    let [shaft, wrist, finger_left, finger_right, tip]: [Pose; 5] =
        [shaft, wrist, finger_left, finger_right, tip].map(PoseMessage::pose);
    ArmBodies {
        shaft,
        wrist,
        finger_left,
        finger_right,
        tip,
    }
}

#[cfg(test)]
mod tests {
    use trocar_tasks::simulation::{Rendering, Simulation};
    use trocar_tasks::task::TaskConfig;

    use super::*;

    /// What another process draws is bit for bit what this one would.
    #[test]
    fn a_snapshot_comes_back_bit_for_bit() {
        for name in TaskConfig::names() {
            let task = TaskConfig::built_in(name).unwrap();
            let snapshot = Simulation::new(&task, 5, Rendering::Off)
                .unwrap()
                .snapshot();
            let world = WorldName {
                task: name.to_owned(),
                scene_hash: 9,
                seed: 5,
            };
            let told = report(TimeNs(7), 3, &world, &snapshot);
            assert_eq!(format!("{:?}", scene(&told)), format!("{snapshot:?}"));
            assert_eq!((told.stamp, told.sequence), (TimeNs(7), 3));
            assert_eq!((told.task.text().as_str(), told.seed), (name, 5));
            assert_eq!(told.has_flap == 1, task.kind == "tissue-retraction");
            assert_eq!(usize::try_from(told.arm_count), Ok(task.arms.len()));
        }
    }

    #[test]
    fn more_arms_than_there_can_be_are_none() {
        let wild = SnapshotReport {
            arm_count: u64::MAX,
            ..SnapshotReport::default()
        };
        assert_eq!(scene(&wild).arms.iter().flatten().count(), ARMS_MAX);
    }
}
