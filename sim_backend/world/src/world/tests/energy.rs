//! Facts about energy: what falls freely keeps it, what bounces, rests or is held gains none.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::{Bench, Ground, HALF_CIRCLE, RigidBody, Scenery, World};
use crate::organ::Organ;
use crate::organ::tests::BACK_MUSCLE;
use crate::shipped;
use crate::world::{Shape, WorldConfig};
use hal::Pose;

/// Tasks that grip a needle.
pub(super) const NEEDLE_TASKS: [&str; 3] = ["needle-lift", "needle-handover", "suture-pad"];

fn config(task: &str) -> WorldConfig {
    shipped::world(task)
}

/// A needle alone in the world over `ground`, at rest at `in_scene`.
fn alone(config: &WorldConfig, ground: Ground, in_scene: Pose) -> World {
    let needle = if matches!(ground, Ground::Solids(_)) {
        RigidBody::bare_needle(&HALF_CIRCLE, in_scene)
    } else {
        RigidBody::needle(&HALF_CIRCLE, in_scene)
    };
    let scenery = Scenery {
        things: vec![needle],
        ground,
        flap: None,
    };
    let mut world = World::new(config, &scenery, &[]);
    // The engine works masses out in its first step.
    world.step();
    world
}

fn plate() -> Ground {
    Ground::Solids(vec![Shape::Block {
        low: Point3::new(-0.1, -0.1, -0.01),
        high: Point3::new(0.1, 0.1, 0.0),
    }])
}

/// The centre of mass of thing 0 in the scene.
fn centre(world: &World) -> Point3<f64> {
    world.thing_in_scene(0) * HALF_CIRCLE.mass_properties().centre
}

#[test]
fn a_needle_falls_as_a_stone_does() {
    let config = config("needle-lift");
    let tilted = UnitQuaternion::from_euler_angles(0.4, -0.7, 0.2);
    let start = Pose::from_parts([0.0, 0.0, 1.0].into(), tilted);
    let mut world = alone(&config, Ground::Organ(Organ::Rolling(BACK_MUSCLE)), start);
    let g = config.gravity_m_s2;
    world.stage.throw(0, &[Vector3::zeros(); 2]);
    let (from, energy_j) = (centre(&world), world.energy_j(0));
    for step in 1..=300_u32 {
        world.step();
        let time_s = 1e-3 * f64::from(step);
        let fallen = from - centre(&world);
        let substep_s = 1e-3 / f64::from(config.plant.substeps);
        // Velocity first, then place: half a sub-step further than in continuous time.
        let expected = 0.5 * g * time_s * (time_s + substep_s);
        assert!((fallen - Vector3::z() * expected).norm() < 1e-9, "{fallen}");
        let velocity = world.thing_velocity(0)[0];
        assert!((velocity + Vector3::z() * (g * time_s)).norm() < 1e-9);
        let lost = HALF_CIRCLE.mass_kg * g * 0.5 * g * time_s * substep_s;
        assert!((energy_j - world.energy_j(0) - lost).abs() < 1e-12);
    }
    let turned = start.rotation.angle_to(&world.thing_in_scene(0).rotation);
    assert!(turned < 1e-9, "turns by itself: {turned}");
}

#[test]
fn a_needle_that_bounces_never_has_more_energy_than_before() {
    for (task, ground) in [
        ("needle-lift", Ground::Organ(Organ::Rolling(BACK_MUSCLE))),
        ("suture-pad", plate()),
    ] {
        let config = config(task);
        for tilt in [0.0, 0.6, 1.5] {
            let turn = UnitQuaternion::from_euler_angles(tilt, 0.3 * tilt, 0.0);
            let start = Pose::from_parts([0.0, 0.0, 0.03].into(), turn);
            let mut world = alone(&config, ground.clone(), start);
            let fall_j = world.energy_j(0);
            let mut least_j = fall_j;
            let (mut gained_j, mut still_since) = (0.0_f64, 0);
            for step in 0..3000 {
                world.stage.wake(0);
                world.step();
                let energy_j = world.energy_j(0);
                gained_j = gained_j.max(energy_j - least_j);
                least_j = least_j.min(energy_j);
                if world.thing_velocity(0)[0].norm() > 1e-5 {
                    still_since = step;
                }
            }
            // What contacts store in a bounce and give back: half of what the judge lets pass, a
            // sixteenth of the fall.
            assert!(
                gained_j < 2.5e-5 && gained_j < fall_j / 16.0,
                "{task}, {tilt}: {gained_j} J of {fall_j}"
            );
            assert!(still_since < 2500, "{task}, {tilt}: moves on");
        }
    }
}

#[test]
fn a_held_needle_neither_creeps_nor_gains() {
    for task in NEEDLE_TASKS {
        let mut bench = Bench::lifted_in(task, -0.15);
        bench.wait(0.5);
        let (held, energy_j) = (bench.needle_in_tip(), bench.world.energy_j(0));
        let (mut crept_m, mut turned, mut gained_j, mut fastest) =
            (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
        bench.run(5.0, |_, _, world| {
            let now = world.tip_in_scene(0).inverse() * world.thing_in_scene(0);
            let middle = Point3::new(HALF_CIRCLE.arc_radius_m, 0.0, 0.0);
            crept_m = crept_m.max((now * middle - held * middle).norm());
            turned = turned.max(now.rotation.angle_to(&held.rotation));
            gained_j = gained_j.max((world.energy_j(0) - energy_j).abs());
            fastest = fastest.max(world.thing_velocity(0)[0].norm());
        });
        // It trembles by less than a thousandth of its wire and creeps nowhere.
        assert!(
            crept_m < 2e-6 && turned < 2e-3,
            "{task}: {crept_m} m, {turned} rad"
        );
        assert!(
            gained_j < 1e-7 && fastest < 5e-3,
            "{task}: {gained_j} {fastest}"
        );
    }
}
