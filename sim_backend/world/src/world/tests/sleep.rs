//! Facts about things that are not calculated because they lie still.

use super::{Bench, HALF_CIRCLE, World};
use nalgebra::Vector3;

const LYING: f64 = HALF_CIRCLE.wire_radius_m + 1e-4;

fn sleeping(world: &World) -> bool {
    world.stage.thing(0).is_asleep()
}

fn sleeps(bench: &Bench) -> bool {
    sleeping(&bench.world)
}

/// A needle that lies alone falls asleep and keeps its place to the bit.
#[test]
fn sleeping_needle_keeps_its_pose_to_the_bit() {
    let mut bench = Bench::new(0.06, 0.01, LYING);
    assert!(!sleeps(&bench));
    bench.wait(3.0);
    assert!(sleeps(&bench));
    let asleep = bench.world.thing_in_scene(0);
    assert_eq!(bench.world.thing_velocity(0), [Vector3::zeros(); 2]);
    bench.wait(0.5);
    assert_eq!(bench.world.thing_in_scene(0), asleep);
}

#[test]
fn a_needle_asleep_lies_where_one_that_was_kept_awake_lies() {
    let mut asleep = Bench::new(0.06, 0.01, LYING);
    let mut awake = Bench::new(0.06, 0.01, LYING);
    asleep.wait(3.0);
    awake.wait(3.0);
    for _ in 0..3000 {
        awake.world.stage.wake(0);
        awake.wait(1e-3);
        asleep.wait(1e-3);
    }
    assert!(sleeps(&asleep) && !sleeps(&awake));
    let apart = asleep.world.thing_in_scene(0).inverse() * awake.world.thing_in_scene(0);
    assert!(apart.translation.vector.norm() < 1e-6 && apart.rotation.angle() < 1e-4);
}

#[test]
fn fingers_that_come_near_wake_it_before_they_touch_it() {
    let mut bench = Bench::new(0.06, 0.0, LYING);
    bench.jaw(0.0);
    bench.wait(3.0);
    assert!(sleeps(&bench));
    let (mut woken_at, mut touched_at) = (None, None);
    bench.run(2.0, |time_s, command, world| {
        command.position[2] += 3e-5;
        if !sleeping(world) {
            woken_at.get_or_insert(time_s);
        }
        if world.is_touched(0, 0) {
            touched_at.get_or_insert(time_s);
        }
    });
    assert!(woken_at.unwrap() < touched_at.unwrap() - 1.5e-3);
}

#[test]
fn a_needle_in_the_fingers_never_sleeps() {
    let mut bench = Bench::lifted(-0.15);
    bench.run(3.0, |_, _, world| assert!(!sleeping(world)));
    assert!(bench.world.grasp(0, 0).both_touch);
}

#[test]
fn a_push_wakes_it() {
    let mut bench = Bench::new(0.06, 0.01, LYING);
    bench.wait(3.0);
    assert!(sleeps(&bench));
    let before = bench.world.thing_in_scene(0);
    let push = [Vector3::new(0.1, 0.0, 0.0), Vector3::zeros()];
    bench.world.stage.throw(0, &push);
    bench.wait(0.02);
    let moved = before.translation.vector - bench.world.thing_in_scene(0).translation.vector;
    assert!(!sleeps(&bench) && moved.norm() > 1e-4, "{moved}");
}
