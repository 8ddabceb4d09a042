//! Facts about rest and slip: a block on its peg stays, and a grip slips and lets turn where Coulomb's law says.

use core::f64::consts::TAU;

use hal::psm::FINGER_M;
use nalgebra::{Point3, Vector3};

use super::energy::NEEDLE_TASKS;
use super::{Bench, HALF_CIRCLE, OPEN, REACH_M, World, shake};
use crate::task::TaskConfig;
use crate::task::block_transfer::BlockTransfer;
use crate::world::contact::{Contact, Side};
use crate::world::thing::REST_M_S;

/// A world of the block transfer at the start of an episode, with the block on any of the pegs or beside the `goal`.
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
            world.stage.wake(0);
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

#[test]
fn a_block_that_leans_on_its_peg_trembles_by_less_than_a_micrometre_and_goes_nowhere() {
    // Of the first ten episodes, the one in which block and peg touch.
    let (_, mut world) = block_on_peg(1, Some(4));
    let mut go = |steps: u32| {
        for _ in 0..steps {
            world.stage.wake(0);
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

/// The needle held at the middle of its arc and, for a second, with friction `friction` only: how far that point moves in the
/// jaws, m, how far the needle turns in them, rad, and the weaker finger's force, N.
fn held_by(friction: f64) -> (f64, f64, f64) {
    let mut bench = Bench::lifted(-0.15);
    let held = bench.needle_in_tip();
    let grasp = bench.world.grasp(0, 0);
    bench.world.stage.set_grip_friction(friction);
    let middle = Point3::new(HALF_CIRCLE.arc_radius_m, 0.0, 0.0);
    let (mut slip_m, mut turn) = (0.0_f64, 0.0_f64);
    bench.run(1.0, |_, _, world| {
        let now = world.tip_in_scene(0).inverse() * world.thing_in_scene(0);
        slip_m = slip_m.max((now * middle - held * middle).norm());
        turn = turn.max(now.rotation.angle_to(&held.rotation));
    });
    (slip_m, turn, grasp.left_force_n.min(grasp.right_force_n))
}

#[test]
fn a_wire_slips_out_of_the_wedge_of_the_fingers_below_the_angle_of_friction() {
    // The hinge is a finger's length away, so the faces stand at the angle at which they touch the wire on both sides, and
    // drive it out unless friction exceeds its tangent. Besides, the needle's weight pulls, and turns it about the wire, since
    // its centre of mass is beside it; half of both falls on each finger.
    let weight_n = HALF_CIRCLE.mass_kg * 9.81;
    let beside_m = HALF_CIRCLE.arc_radius_m - HALF_CIRCLE.mass_properties().centre.x;
    let pull_n = 0.5 * weight_n * (1.0 + beside_m / HALF_CIRCLE.wire_radius_m);
    let half_angle = (HALF_CIRCLE.wire_radius_m / (FINGER_M - REACH_M)).asin();
    let (_, _, force_n) = held_by(0.6);
    let critical = half_angle.tan() + pull_n / force_n;
    let (slip_m, _, _) = held_by(0.7 * critical);
    assert!(slip_m > 0.002, "held at 0.7 of {critical}: {slip_m} m");
    let (slip_m, turn, _) = held_by(1.4 * critical);
    assert!(slip_m < 1e-4, "slips at 1.4 of {critical}: {slip_m} m");
    assert!(turn < 0.02, "turns at 1.4 of {critical}: {turn} rad");
}

#[test]
fn a_wire_lies_on_a_finger_at_the_two_ends_of_a_line_and_at_nothing_twice() {
    let bench = Bench::lifted_in("needle-handover", -0.15);
    let contacts = bench.world.stage.contacts();
    let faces = [0, 1].map(|finger| {
        let of = |contact: &&Contact| {
            let side = Side::Part {
                arm: 0,
                part: finger,
            };
            contact.sides[0] == side && contact.gap_m < 0.0
        };
        let points = contacts.iter().filter(of).map(|contact| contact.point);
        points.collect::<Vec<_>>()
    });
    assert!(faces.iter().any(|points| points.len() == 2), "{faces:?}");
    for points in &faces {
        assert!(points.len() <= 2, "{points:?}");
        if let [one, other] = points.as_slice() {
            assert!((one - other).norm() > 1e-6, "{points:?}");
        }
    }
}

#[test]
fn shaking_turns_a_held_needle_as_little_as_published() {
    for task in NEEDLE_TASKS {
        // The best free grip on record for this engine slips 0.22 mm and turns 0.2 degrees; its usual one 2.9 degrees.
        let mut bench = Bench::lifted_in(task, -0.15);
        let grasped = Point3::new(HALF_CIRCLE.arc_radius_m, 0.0, 0.0);
        let (slip_m, turn) = shake(&mut bench, &grasped);
        assert!(slip_m < 2.2e-4, "{task}: {slip_m}");
        assert!(turn < 2.9 * TAU / 360.0, "{task}: {turn}");
        // And nothing of it stays after the shaking but what was stuck anew.
        let after = bench.needle_in_tip();
        bench.wait(1.0);
        let drift = after.inverse() * bench.needle_in_tip();
        assert!(drift.translation.vector.norm() < 1e-5, "{task}: {drift}");
        bench.jaw(OPEN);
        bench.wait(0.2);
        let fallen: Vector3<f64> = bench.world.thing_velocity(0)[0];
        assert!(
            bench.middle_in_scene().z < 0.03 || fallen.z < -0.5,
            "{task}: attached"
        );
    }
}
