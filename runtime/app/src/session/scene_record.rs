//! Where everything in a simulated scene is, and how its task stands, as a log has it and back.

use hal::{ARMS_MAX, Pose};
use trocar_log::{CriterionRecord, FlapRecord, Recorder, SceneRecord, TaskRecord};
use trocar_tasks::scene::{SceneSnapshot, THINGS_MAX};
use trocar_topics::{CriterionReport, TaskReport};
use trocar_world::ArmBodies;
use trocar_world::tissue::FlapSnapshot;

use super::episode::StepView;
use super::source::STEP_NS;

/// Writes the scene of a policy step into a log.
pub(super) fn keep(recorder: &mut Recorder, view: &StepView<'_>) {
    let at = view.arms.first.state.stamp;
    let told = view.task.report(at, at.0 / STEP_NS);
    recorder.scene(at, record(view.snapshot, &told));
}

/// The record of `scene`, whose task stands as `told`.
pub(crate) fn record(scene: &SceneSnapshot, told: &TaskReport) -> SceneRecord {
    let parts = |arm: &ArmBodies| {
        [
            arm.shaft,
            arm.wrist,
            arm.finger_left,
            arm.finger_right,
            arm.tip,
        ]
    };
    SceneRecord {
        moment_ms: scene.moment_ms,
        things: scene.things.to_vec(),
        goal: scene.goal,
        arms: scene.arms.iter().flatten().map(parts).collect(),
        flap: scene.flap.map(|flap| FlapRecord {
            nodes_m: flap.nodes_m().to_vec(),
            mark_m: flap.mark_m(),
        }),
        task: task(told),
    }
}

/// How a task stands, as it was told: in a log and for pages.
pub(crate) fn task(told: &TaskReport) -> TaskRecord {
    let criterion = |it: &CriterionReport| CriterionRecord {
        name: it.name.text(),
        unit: it.unit.text(),
        value: Some(it.value).filter(|value| value.is_finite()),
        goal: it.goal,
        at_least: it.at_least != 0,
        met: it.met != 0,
    };
    TaskRecord {
        missing: told.missing.text(),
        criteria: told.criteria().iter().map(criterion).collect(),
    }
}

/// The scene of `record`; none if its flap has another number of nodes.
pub(crate) fn snapshot(record: &SceneRecord) -> Option<SceneSnapshot> {
    let mut things = [Pose::identity(); THINGS_MAX];
    for (thing, pose) in things.iter_mut().zip(&record.things) {
        *thing = *pose;
    }
    let mut arms = [None; ARMS_MAX];
    for (arm, parts) in arms.iter_mut().zip(&record.arms) {
        let [shaft, wrist, finger_left, finger_right, tip] = *parts;
        *arm = Some(ArmBodies {
            shaft,
            wrist,
            finger_left,
            finger_right,
            tip,
        });
    }
    let flap = record.flap.as_ref().map(|flap| {
        let nodes_m = flap.nodes_m.as_slice().try_into().ok()?;
        Some(FlapSnapshot::from_parts(nodes_m, flap.mark_m))
    });
    Some(SceneSnapshot {
        moment_ms: record.moment_ms,
        things,
        goal: record.goal,
        arms,
        flap: flap.map_or(Some(None), |flap| flap.map(Some))?,
    })
}

#[cfg(test)]
mod tests {
    use hal::TimeNs;
    use trocar_tasks::simulation::{Rendering, Simulation};
    use trocar_tasks::task::TaskConfig;

    use super::*;
    use crate::session::TaskState;

    /// What is drawn of a log is bit for bit what was there; a second of it takes little.
    #[test]
    fn a_scene_comes_back_from_a_log_bit_for_bit() {
        for name in TaskConfig::names() {
            let task = TaskConfig::built_in(name).unwrap();
            let mut simulation = Simulation::new(&task, 5, Rendering::Off).unwrap();
            for _ in 0..40 {
                simulation.step();
            }
            let (scene, stands) = (simulation.snapshot(), TaskState::of(&simulation));
            let message =
                serde_json::to_vec(&record(&scene, &stands.report(TimeNs(0), 0))).unwrap();
            let most = if scene.flap.is_some() { 12_000 } else { 5000 };
            assert!(message.len() < most, "{name}: {} bytes", message.len());
            let read = SceneRecord::read(&message).unwrap();
            assert_eq!(
                format!("{:?}", snapshot(&read)),
                format!("{:?}", Some(scene)),
                "{name}"
            );
            assert_eq!(read.task.missing, stands.missing, "{name}");
            let told = read.task.criteria.iter().map(|it| (&*it.name, it.met));
            let stood: Vec<_> = stands.criteria.iter().map(|it| (it.name, it.met)).collect();
            assert_eq!(told.collect::<Vec<_>>(), stood, "{name}");
            assert!(!stood.is_empty(), "{name}");
        }
    }

    #[test]
    fn a_flap_of_other_nodes_is_none() {
        let record = SceneRecord {
            flap: Some(FlapRecord::default()),
            ..SceneRecord::default()
        };
        assert!(snapshot(&record).is_none());
        assert!(snapshot(&SceneRecord::default()).is_some());
    }
}
