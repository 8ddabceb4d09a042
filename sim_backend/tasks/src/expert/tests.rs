//! Facts about what an expert foresees.

use hal::TimeNs;
use trocar_world::Grasp;

use super::*;
use crate::closed_loop::forward;
use crate::scene::ArmScene;
use crate::task::needle_lift::NeedleLift;

#[test]
fn chunk_starts_with_the_step_and_goes_on_smoothly() {
    let task = TaskConfig::shipped("needle-lift");
    let lift = NeedleLift::shipped();
    let needle_in_scene = lift.start.draw(0, &lift.needle, &lift.organ);
    let base = task.arms[0].scene_from_rcm;
    let mut scene = SceneState {
        first: ArmScene {
            tip_in_rcm: forward(&task.arms[0].joints),
            thing_in_rcm: base.inv_mul(&needle_in_scene),
            jaw: task.arms[0].jaw,
            grasp: Grasp::default(),
        },
        second: None,
        goal_in_scene: None,
    };
    let mut expert = Expert::new(&task, 0);
    let mut steps = Expert::new(&task, 0);
    let mut expected = None;
    for step in 0..60 {
        let now = TimeNs(step * STEP_NS);
        let chunk = expert.chunk(now, &scene, step + 1);
        let targets = chunk.valid_targets();
        assert_eq!(
            (targets.len(), chunk.step_ns, chunk.observed_at),
            (CHUNK_LEN, STEP_NS, now)
        );
        assert_eq!(targets[0], steps.script.wishes(now, &scene)[0].first);
        // With an arm that keeps up, what was foreseen is what comes.
        assert!(
            expected.is_none_or(|target| target == targets[0]),
            "step {step}"
        );
        expected = Some(targets[1]);
        scene.first.tip_in_rcm = targets[0].tip_in_rcm();
        scene.first.jaw = targets[0].jaw;
    }
}
