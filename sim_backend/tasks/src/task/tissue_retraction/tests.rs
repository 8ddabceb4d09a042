//! Facts about the retraction's scene: where the flap lies and what holds it, and that the drives
//! feel it.

use hal::{ArmCommand, JointVector, TimeNs};
use nalgebra::{Point3, Translation3};
use trocar_world::World;
use trocar_world::tissue::{Grasp, TissueReport};

use super::*;
use crate::closed_loop::{forward, inverse};
use crate::simulation::pictures::{Looks, saturation};
use crate::task::{MonitorInput, Outcome, TaskConfig, TaskFiles};

fn task() -> TaskConfig {
    TaskConfig::shipped(NAME)
}

/// The world of the episode `seed`, the arm's jaw open around the free edge at the mark.
fn around_the_edge(task: &TaskConfig, seed: u64) -> World {
    let scene = TissueRetraction::shipped();
    let scenery = scene.scenery(seed);
    let far = World::new(&task.world, &scenery, &task.arms);
    let mark = far.subject_in_scene().translation;
    let mut arm = task.arms[0];
    // Level, its ends 5 mm past the edge: the hinge is 8.2 mm before the mark.
    let home = arm.scene_from_rcm * forward(&arm.joints);
    let level =
        nalgebra::UnitQuaternion::from_euler_angles(-core::f64::consts::FRAC_PI_2, 0.0, 0.0);
    assert!(level.angle_to(&home.rotation) < 0.4, "{home}");
    let tip = Pose::from_parts(
        Translation3::new(mark.x, mark.y - 0.0082, mark.z - 0.0008),
        level,
    );
    arm.joints = inverse(&arm.scene_from_rcm.inv_mul(&tip), &arm.joints);
    arm.jaw = 0.65;
    World::new(&task.world, &scenery, &[arm])
}

/// Lets the arm hold its place with the jaw at `jaw_rad` for `steps`.
fn squeeze(world: &mut World, joints: &JointVector, jaw_rad: f64, steps: u32) {
    for _ in 0..steps {
        world.command(
            0,
            &ArmCommand {
                stamp: TimeNs(0),
                position: *joints,
                velocity: JointVector::zeros(),
                acceleration: JointVector::zeros(),
                jaw_position: jaw_rad,
                jaw_velocity: 0.0,
                enabled: true,
            },
        );
        world.step();
    }
}

#[test]
fn a_closing_jaw_takes_the_flap_and_is_stopped_by_it() {
    let task = task();
    let mut world = around_the_edge(&task, 5);
    let joints = world.measured(0, TimeNs(0)).position;
    let touched = world.tissue().unwrap().report().force_n;
    assert!(touched <= 0.0, "open, it touches nothing: {touched}");
    squeeze(&mut world, &joints, -0.2, 400);
    let grasp = world.tissue().unwrap().report().grasp.unwrap();
    assert!(grasp.beside_mark_m < 0.001, "{grasp:?}");
    let hold = world.subject_grasp(0);
    assert!(hold.both_touch && hold.left_force_n > 2.0, "{hold:?}");
    // The report has the pinch, whose two sides cancel in the force on the whole instrument.
    let report = *world.tissue().unwrap().report();
    assert!(
        report.smooth_squeeze_n > 4.0 && report.force_n < 0.5,
        "{report:?}"
    );
    // The drive presses with all it has; without tissue the fingers would be shut.
    let jaw = world.measured(0, TimeNs(0)).jaw_position;
    assert!((0.02..0.15).contains(&jaw), "{jaw}");
    squeeze(&mut world, &joints, 0.6, 300);
    assert!(!world.subject_grasp(0).both_touch);
}

#[test]
fn the_mark_is_what_the_task_is_about() {
    let task = task();
    let scene = TissueRetraction::shipped();
    let world = World::new(&task.world, &scene.scenery(2), &task.arms);
    assert_eq!(world.thing_count(), 0);
    let mark = world.subject_in_scene();
    let edge_m = scene.tissue.edge_m[1] - scene.tissue.depth_m;
    let from_edge_m = mark.translation.y - edge_m;
    assert!(
        (from_edge_m - scene.tissue.mark.inset_m).abs() < 5e-4,
        "{from_edge_m}"
    );
    // It stands out over the rim, and sags little.
    assert!(mark.translation.y < scene.liver.low_m[1] - scene.liver.rim_m);
    assert!(mark.translation.z.abs() < 0.003);
    let out = mark * Point3::new(0.0, 0.001, 0.0);
    assert!(
        out.y < mark.translation.y - 0.0009,
        "y of its frame is outward"
    );
}

#[test]
fn the_state_of_the_flap_is_in_the_hash() {
    let task = task();
    let mut first = around_the_edge(&task, 5);
    let mut second = around_the_edge(&task, 5);
    assert_eq!(first.state_hash(), second.state_hash());
    let joints = first.measured(0, TimeNs(0)).position;
    squeeze(&mut first, &joints, 0.1, 200);
    squeeze(&mut second, &joints, 0.1, 200);
    assert_eq!(first.state_hash(), second.state_hash());
    let untouched =
        |scene: &TissueRetraction, seed| World::new(&task.world, &scene.scenery(seed), &task.arms);
    let mut scene = TissueRetraction::shipped();
    let other = untouched(&scene, 6);
    // Untouched flaps differ by nothing but the mark, which is no state.
    assert_eq!(other.state_hash(), untouched(&scene, 7).state_hash());
    // A lighter flap hangs otherwise, with the same arms at the same place: nothing else in the
    // world tells them apart.
    scene.tissue.gravity_m_s2 *= 0.5;
    let lighter = untouched(&scene, 6);
    assert_eq!(other.measured(0, TimeNs(0)), lighter.measured(0, TimeNs(0)));
    assert_ne!(other.state_hash(), lighter.state_hash());
}

#[test]
fn the_liver_is_drawn_as_it_is_felt() {
    let liver = TissueRetraction::shipped().liver;
    let (mesh, ground) = (liver.mesh(), liver.ground());
    assert!(mesh.indices.len() / 3 < 4000);
    for triangle in mesh.indices.chunks_exact(3) {
        let [a, b, c] = [0, 1, 2]
            .map(|k| nalgebra::Vector3::from(mesh.positions[triangle[k] as usize].map(f64::from)));
        assert!((b - a).cross(&(c - a)).z > 0.0, "faces up");
        let middle = (a + b + c) / 3.0;
        let height_m = ground.height_m(middle.x, middle.y).unwrap();
        assert!((height_m - middle.z).abs() < 0.001, "{middle}");
    }
}

#[test]
fn verdicts_of_the_flap_are_those_of_the_task() {
    let scene = TissueRetraction::shipped();
    let show = |report: TissueReport, steps: u32| {
        let mut monitor = scene.monitor(0);
        let mut outcome = Outcome::Running;
        for _ in 0..steps {
            outcome = monitor.observe(&MonitorInput {
                thing_in_scene: Pose::identity(),
                grasps: Vec::new(),
                tips_in_scene: Vec::new(),
                sunk_m: 0.0,
                ground_force_n: 0.0,
                tissue: Some(report),
                free_energy_j: None,
            });
        }
        outcome
    };
    let rest = TissueReport::at_rest();
    let held = TissueReport {
        grasp: Some(Grasp {
            area_m2: 1e-5,
            force_n: 0.1,
            middle_m: [0.03, 0.045],
            beside_mark_m: 0.001,
        }),
        mark_rise_m: 0.021,
        ..rest
    };
    assert_eq!(show(rest, 600), Outcome::Running);
    assert_eq!(show(held, 499), Outcome::Running);
    assert_eq!(show(held, 500), Outcome::Success);
    let torn = show(TissueReport { torn: true, ..held }, 1);
    assert_eq!(torn.to_string(), "tissue torn");
}

#[test]
fn a_flap_of_more_nodes_than_can_be_drawn_is_refused() {
    let text = TaskFiles::built_in(NAME).unwrap().scene.text().to_owned();
    let finer = text.replace("cells = [15, 12]", "cells = [15, 13]");
    let message = TaskConfig::parse(NAME, &Source::embedded("scene.toml", &finer))
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("tissue.cells = 16 x 14 nodes is outside cells of at most 208 nodes"),
        "{message}"
    );
}

#[test]
fn flap_and_mark_are_seen_on_the_liver() {
    let looks = Looks::of(NAME);
    looks.show(&[(instance::TISSUE, 30_000), (instance::MARK, 200)]);
    let [red, green, _] = looks.colour(instance::ORGAN);
    let [skin, mark] = [instance::TISSUE, instance::MARK].map(|id| looks.colour(id));
    looks.check(red > 1.5 * green, "liver and body are red");
    looks.check((0.1..0.5).contains(&saturation(skin)), "skin is pale");
    looks.check(skin[0] > 1.3 * red, "and lighter than the liver");
    let [of_skin, of_mark] = [skin, mark].map(|[red, green, _]| green / red);
    looks.check(
        of_mark < 0.75 * of_skin,
        &format!("the mark is redder: {skin:?}, {mark:?}"),
    );
}
