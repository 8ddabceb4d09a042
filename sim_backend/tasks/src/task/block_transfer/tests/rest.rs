//! Facts about a block at rest: on its peg it stays.

use trocar_world::{REST_M_S, World};

use crate::task::TaskConfig;
use crate::task::block_transfer::BlockTransfer;

/// A world of the block transfer at the start of an episode, with the block on any of the pegs or
/// beside the `goal`.
fn block_on_peg(seed: u64, goal: Option<usize>) -> (TaskConfig, World) {
    let mut task = TaskConfig::shipped("block-transfer");
    task.scene_mut::<BlockTransfer>().unwrap().start.goal_peg = goal;
    let scenery = task.scene.scenery(seed);
    let world = World::new(&task.world, &scenery, &task.arms);
    (task, world)
}

#[test]
fn a_block_on_its_peg_does_not_creep_sink_or_jitter() {
    for seed in 0..3 {
        let (task, mut world) = block_on_peg(seed, None);
        let scene: &BlockTransfer = task.scene().unwrap();
        for _ in 0..500 {
            world.step();
        }
        let rest = world.thing_in_scene(0);
        // The whole weight on one of four points, at most.
        let give_m =
            scene.block.mass_kg * task.world.gravity_m_s2 / task.world.ground.stiffness_n_m;
        let height_m = 0.5 * scene.block.height_m - rest.translation.z;
        assert!(
            world.sunk_m(0) < 2.0 * give_m && height_m.abs() < give_m,
            "{} and {height_m} of {give_m}",
            world.sunk_m(0)
        );
        let (mut crept_m, mut turned, mut fastest) = (0.0_f64, 0.0_f64, 0.0_f64);
        for _ in 0..5000 {
            // Asleep it could not creep.
            world.wake(0);
            world.step();
            let drift = rest.inverse() * world.thing_in_scene(0);
            crept_m = crept_m.max(drift.translation.vector.norm());
            turned = turned.max(drift.rotation.angle());
            let [linear, angular] = world.thing_velocity(0);
            fastest = fastest.max(linear.norm() + angular.norm() * scene.block.corner_m);
        }
        assert!(
            crept_m < 1e-7 && turned < 1e-5,
            "creeps {crept_m}, {turned}"
        );
        // Slow enough to fall asleep.
        assert!(fastest < REST_M_S, "jitters at {fastest}");
    }
}

/// A block that leans on its peg trembles by less than a micrometre and goes nowhere.
#[test]
fn leaning_block_rests_within_a_micrometre() {
    // Of the first ten episodes, the one in which block and peg touch.
    let (_, mut world) = block_on_peg(1, Some(4));
    let mut go = |steps: u32| {
        for _ in 0..steps {
            world.wake(0);
            world.step();
        }
        world.thing_in_scene(0)
    };
    let rest = go(500);
    let mut farthest = |steps: u32| {
        (0..steps).fold((0.0_f64, 0.0_f64), |(far_m, turned), _| {
            let drift = rest.inverse() * go(1);
            let far_m = far_m.max(drift.translation.vector.norm());
            (far_m, turned.max(drift.rotation.angle()))
        })
    };
    let early = farthest(2000);
    let _ = farthest(3000);
    let late = farthest(2000);
    assert!(late.0 < 5e-7 && late.1 < 5e-5, "{late:?}");
    assert!(
        late.0 < 1.5 * early.0 + 1e-9 && late.1 < 1.5 * early.1 + 1e-7,
        "creeps: {early:?}, {late:?}"
    );
}
