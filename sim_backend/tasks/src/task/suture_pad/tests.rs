//! Facts about the suture pad: where the needle starts, that the hole is real, what counts.

use nalgebra::Point3;
use trocar_world::{Grasp, World};

use super::*;
use crate::simulation::pictures::{Looks, saturation};
use crate::task::{Judge, MonitorInput, Outcome, Reason, TaskConfig};

/// The needle flat at the height of the hole, its point `angle_rad` past the plane of the lip on
/// the circle through the hole.
fn on_circle(scene: &SuturePad, angle_rad: f64) -> Pose {
    let centre = scene.pad.hole() - Vector3::x() * scene.needle.arc_radius_m;
    let yaw = angle_rad - 0.5 * scene.needle.arc_angle_rad;
    Pose::from_parts(
        centre.into(),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
    )
}

fn show(judge: &mut Judge, needle: Pose, sunk_m: f64, seconds: f64) -> Outcome {
    let mut shown_s = 0.0;
    while shown_s < seconds {
        judge.observe(&MonitorInput {
            thing_in_scene: needle,
            grasps: vec![Grasp::default()],
            tips_in_scene: vec![Pose::identity()],
            sunk_m,
            ground_force_n: 0.0,
            tissue: None,
            free_energy_j: None,
        });
        shown_s += 1e-3;
    }
    judge.outcome()
}

#[test]
fn needle_starts_along_the_lip_and_at_rest() {
    let scene = SuturePad::shipped();
    let task = TaskConfig::shipped(NAME);
    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
    for seed in 0..1000 {
        let middle = scene.start.draw(seed, &scene.needle)
            * Point3::new(scene.needle.arc_radius_m, 0.0, 0.0);
        assert!(middle.y < scene.pad.lip_front_m - 0.02);
        least = least.min(middle.x);
        most = most.max(middle.x);
    }
    assert!((-0.0201..-0.0197).contains(&least) && (0.0197..0.0201).contains(&most));
    let mut world = World::new(&task.world, &scene.scenery(3), &task.arms);
    for _ in 0..500 {
        world.step();
    }
    let rest = world.thing_in_scene(0);
    for _ in 0..1000 {
        world.step();
    }
    let drift = rest.inverse() * world.thing_in_scene(0);
    assert!(drift.translation.vector.norm() < 1e-6 && drift.rotation.angle() < 1e-5);
    assert!((rest.translation.z - scene.needle.wire_radius_m).abs() < 1e-4);
}

#[test]
fn wire_fits_through_the_hole_and_not_through_the_lip() {
    let scene = SuturePad::shipped();
    let task = TaskConfig::shipped(NAME);
    let sunk = |in_scene| {
        let mut scenery = scene.scenery(0);
        scenery.things[0].in_scene = in_scene;
        let mut world = World::new(&task.world, &scenery, &task.arms);
        world.step();
        world.sunk_m(0)
    };
    for angle_rad in [-0.2, 0.0, 0.2, 0.5, 0.8] {
        assert!(sunk(on_circle(&scene, angle_rad)) < 1e-9);
    }
    for aside in [
        Translation3::new(0.005, 0.0, 0.0),
        Translation3::new(-0.005, 0.0, 0.0),
        Translation3::new(0.0, 0.0, 0.004),
        Translation3::new(0.0, 0.0, -0.004),
    ] {
        assert!(sunk(aside * on_circle(&scene, 0.5)) > 2e-4);
    }
}

#[test]
fn needle_through_the_hole_is_a_success() {
    let scene = SuturePad::shipped();
    let mut judge = Judge::new(scene.monitor(0), 25.0);
    for step in 0..1000 {
        let angle_rad = -0.3 + 0.9 * f64::from(step) / 1000.0;
        show(&mut judge, on_circle(&scene, angle_rad), 0.0, 0.001);
    }
    assert_eq!(
        show(&mut judge, on_circle(&scene, 0.5), 0.0, 1.0),
        Outcome::Running
    );
    let through = on_circle(&scene, 0.7);
    assert_eq!(show(&mut judge, through, 0.0, 0.2), Outcome::Running);
    assert_eq!(show(&mut judge, through, 0.0, 0.2), Outcome::Success);
}

#[test]
fn needle_beside_or_behind_the_hole_is_no_success() {
    let scene = SuturePad::shipped();
    let driven = on_circle(&scene, 0.7);
    for aside in [
        // Over the lip, through the lip, past its end, and all of it behind.
        Translation3::new(0.0, 0.0, 0.01),
        Translation3::new(0.003, 0.0, 0.0),
        Translation3::new(0.03, 0.0, 0.0),
        Translation3::new(0.0, 0.025, 0.0),
    ] {
        let mut judge = Judge::new(scene.monitor(0), 25.0);
        assert_eq!(
            show(&mut judge, aside * driven, 0.0, 1.0),
            Outcome::Running,
            "{aside}"
        );
    }
}

#[test]
fn needle_inside_the_lip_is_invalid() {
    let scene = SuturePad::shipped();
    let mut judge = Judge::new(scene.monitor(0), 25.0);
    let outcome = show(&mut judge, on_circle(&scene, 0.1), 0.001, 0.1);
    assert!(matches!(outcome, Outcome::Invalid(Reason::Sunk { .. })));
}

#[test]
fn silicone_has_the_hue_of_skin() {
    let looks = Looks::of(NAME);
    let ground = looks.colour(instance::ORGAN);
    let [red, green, blue] = ground;
    looks.check(red > green && green > blue, "silicone has the hue of skin");
    looks.check((0.15..0.6).contains(&saturation(ground)), "and is pale");
}
