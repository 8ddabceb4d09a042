//! Facts about the needle handover: where the arms stand, where the needle lies, what counts.

use nalgebra::Point3;
use trocar_world::{Grasp, World};

use super::*;
use crate::simulation::pictures::Looks;
use crate::task::{Judge, MonitorInput, Outcome, Reason, TaskConfig};

const NO_GRASP: Grasp = Grasp {
    left_force_n: 0.0,
    right_force_n: 0.0,
    both_touch: false,
    penetration_m: 0.0,
};
const FIRM: Grasp = Grasp {
    left_force_n: 2.0,
    right_force_n: 2.0,
    both_touch: true,
    penetration_m: 0.000_02,
};

struct Bench {
    judge: Judge,
    up: Pose,
}

impl Bench {
    fn new() -> Self {
        let scene = NeedleHandover::shipped();
        Self {
            judge: Judge::new(scene.monitor(0), 30.0),
            up: scene.goal(0).unwrap(),
        }
    }

    /// Shows the needle at one place, the giver's control point `away_m` beyond the needle's point.
    fn show(&mut self, needle: Pose, grasps: [Grasp; 2], away_m: f64, seconds: f64) -> Outcome {
        let scene = NeedleHandover::shipped();
        let (sin, cos) = (0.5 * scene.needle.arc_angle_rad).sin_cos();
        let point = needle * (Point3::new(cos, sin, 0.0) * scene.needle.arc_radius_m);
        let giver = Pose::translation(point.x, point.y + away_m, point.z);
        let mut shown_s = 0.0;
        while shown_s < seconds {
            self.judge.observe(&MonitorInput {
                thing_in_scene: needle,
                grasps: grasps.to_vec(),
                tips_in_scene: vec![giver, Pose::identity()],
                sunk_m: 0.0,
                ground_force_n: 0.0,
                tissue: None,
                free_energy_j: None,
            });
            shown_s += 1e-3;
        }
        self.judge.outcome()
    }

    /// Shows the needle on its way, for a second.
    fn lead(&mut self, from: &Pose, to: &Pose, grasps: [Grasp; 2]) {
        for step in 0..1000 {
            let needle = from.lerp_slerp(to, f64::from(step) / 1000.0);
            self.show(needle, grasps, 0.05, 0.001);
        }
    }
}

#[test]
fn both_shafts_point_at_the_scene_from_their_sides() {
    let task = TaskConfig::shipped(NAME);
    let scene = NeedleHandover::shipped();
    let world = World::new(&task.world, &scene.scenery(0), &task.arms);
    for (arm, side) in [(0, 1.0), (1, -1.0)] {
        let base = task.arms[arm].scene_from_rcm;
        let down = base.rotation * -Vector3::z();
        let ahead = Point3::from(base.translation.vector + down * 0.17);
        assert!(ahead.coords.norm() < 1e-4, "{ahead}");
        let tip = world.tip_in_scene(arm).translation.vector;
        assert!(tip.x * side > 0.03 && tip.z > 0.05, "{tip}");
    }
}

#[test]
fn needle_covers_its_region() {
    let scene = NeedleHandover::shipped();
    let middle = Point3::new(scene.needle.arc_radius_m, 0.0, 0.0);
    let mut most = [0.0_f64; 2];
    for seed in 0..1000 {
        let place = scene.start.draw(seed, &scene.needle, &scene.organ) * middle;
        for (axis, most) in most.iter_mut().enumerate() {
            *most = most.max((place[axis] - scene.start.centre_m[axis]).abs());
        }
    }
    // The organ's slope adds a little.
    assert!((0.0147..0.0162).contains(&most[0]), "{most:?}");
    assert!((0.0196..0.0213).contains(&most[1]), "{most:?}");
}

#[test]
fn needle_that_changed_hands_is_a_success() {
    let mut bench = Bench::new();
    let up = bench.up;
    bench.show(up, [FIRM, NO_GRASP], 0.01, 0.4);
    bench.show(up, [FIRM, FIRM], 0.01, 0.4);
    assert_eq!(
        bench.show(up, [NO_GRASP, FIRM], 0.014, 1.0),
        Outcome::Running
    );
    assert_eq!(
        bench.show(up, [NO_GRASP, FIRM], 0.016, 0.4),
        Outcome::Running
    );
    assert_eq!(
        bench.show(up, [NO_GRASP, FIRM], 0.016, 0.2),
        Outcome::Success
    );
}

#[test]
fn one_arm_alone_hands_nothing_over() {
    // The left one fetches it itself.
    let mut bench = Bench::new();
    let up = bench.up;
    assert_eq!(
        bench.show(up, [NO_GRASP, FIRM], 0.05, 2.0),
        Outcome::Running
    );
    // The right one keeps it.
    let mut bench = Bench::new();
    assert_eq!(
        bench.show(up, [FIRM, NO_GRASP], 0.05, 2.0),
        Outcome::Running
    );
    // It was never off the organ in the right hand.
    let mut bench = Bench::new();
    let low = Pose::translation(0.0, 0.0, -0.033) * up;
    bench.show(low, [FIRM, NO_GRASP], 0.01, 1.0);
    bench.lead(&low, &up, [NO_GRASP, FIRM]);
    assert_eq!(
        bench.show(up, [NO_GRASP, FIRM], 0.05, 2.0),
        Outcome::Running
    );
}

#[test]
fn a_needle_that_was_dropped_on_the_way_was_not_given() {
    let mut bench = Bench::new();
    let up = bench.up;
    bench.show(up, [FIRM, NO_GRASP], 0.01, 0.4);
    // A contact that flickers is no drop.
    bench.show(up, [NO_GRASP; 2], 0.01, 0.01);
    bench.show(up, [FIRM, NO_GRASP], 0.01, 0.1);
    let low = Pose::translation(0.0, 0.0, -0.033) * up;
    bench.lead(&up, &low, [NO_GRASP; 2]);
    // The left one picks it up.
    bench.lead(&low, &up, [NO_GRASP, FIRM]);
    assert_eq!(
        bench.show(up, [NO_GRASP, FIRM], 0.05, 2.0),
        Outcome::Running
    );
    // Given anew it counts.
    bench.show(up, [FIRM, NO_GRASP], 0.01, 0.4);
    bench.show(up, [NO_GRASP; 2], 0.05, 0.01);
    assert_eq!(
        bench.show(up, [NO_GRASP, FIRM], 0.05, 1.0),
        Outcome::Success
    );
}

#[test]
fn touch_of_the_right_arm_is_not_away() {
    let mut bench = Bench::new();
    let up = bench.up;
    let brush = Grasp {
        left_force_n: 0.01,
        ..NO_GRASP
    };
    bench.show(up, [FIRM, NO_GRASP], 0.01, 0.4);
    assert_eq!(bench.show(up, [brush, FIRM], 0.05, 2.0), Outcome::Running);
}

#[test]
fn needle_off_the_organ_is_a_failure() {
    let mut bench = Bench::new();
    let beside = Pose::translation(0.0, 0.1, -0.03) * bench.up;
    let outcome = bench.show(beside, [NO_GRASP; 2], 0.1, 0.01);
    assert!(matches!(outcome, Outcome::Failure(Reason::Fallen { .. })));
}

#[test]
fn liver_is_red_brown_and_dark() {
    let looks = Looks::of(NAME);
    let [red, green, _] = looks.colour(instance::ORGAN);
    looks.check(red > 1.5 * green, "liver is red-brown");
    looks.check((25.0..135.0).contains(&red), "and dark");
}
