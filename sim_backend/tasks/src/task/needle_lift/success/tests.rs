//! Facts about verdicts: what holds, what breaks a hold, what loses.

use hal::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use trocar_world::Grasp;

use super::*;
use crate::task::needle_lift::NeedleLift;
use crate::task::{Judge, Reason};

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

const FALLEN: Outcome = Outcome::Failure(Reason::Fallen {
    thing: "needle",
    ground: "organ",
});
const LIMIT_S: f64 = 12.0;

struct Bench {
    task: NeedleLift,
    judge: Judge,
    lying: Pose,
}

impl Bench {
    fn new() -> Self {
        let task = NeedleLift::shipped();
        let monitor = SuccessMonitor::new(&task.success, &task.needle, &task.organ);
        let judge = Judge::new(Box::new(monitor), LIMIT_S);
        let lying = task.start.draw(1, &task.needle, &task.organ);
        Self { task, judge, lying }
    }

    fn show(&mut self, thing_in_scene: Pose, grasp: &Grasp) {
        self.judge.observe(&MonitorInput {
            thing_in_scene,
            grasps: vec![*grasp],
            tips_in_scene: vec![Pose::identity()],
            sunk_m: 0.0,
            ground_force_n: 0.0,
            tissue: None,
            free_energy_j: None,
        });
    }

    /// Raises the needle smoothly by `height_m` in a second, then keeps it there for `hold_s`.
    fn lift(&mut self, height_m: f64, hold_s: f64, grasp: &Grasp) -> Outcome {
        for step in 0..1000 {
            let share = f64::from(step) / 1000.0;
            self.show(
                Translation3::new(0.0, 0.0, height_m * share) * self.lying,
                grasp,
            );
        }
        self.hold(height_m, hold_s, grasp)
    }

    fn hold(&mut self, height_m: f64, hold_s: f64, grasp: &Grasp) -> Outcome {
        let mut waited_s = 0.0;
        while waited_s < hold_s {
            self.show(Translation3::new(0.0, 0.0, height_m) * self.lying, grasp);
            waited_s += 1e-3;
        }
        self.judge.outcome()
    }
}

#[test]
fn gripped_lift_that_is_held_succeeds_and_stays_so() {
    let mut bench = Bench::new();
    assert_eq!(bench.lift(0.03, 0.6, &FIRM), Outcome::Success);
    assert_eq!(bench.hold(0.0, 20.0, &NO_GRASP), Outcome::Success);
}

#[test]
fn still_needle_runs_out_of_time() {
    let mut bench = Bench::new();
    assert_eq!(bench.hold(0.0, LIMIT_S - 0.01, &FIRM), Outcome::Running);
    assert_eq!(
        bench.hold(0.0, 0.02, &FIRM),
        Outcome::Failure(Reason::TimeLimit {
            missing: "needle not lifted",
            limit_s: LIMIT_S
        })
    );
}

#[test]
fn lift_without_both_fingers_is_no_success() {
    let one_finger = Grasp {
        right_force_n: 0.0,
        both_touch: false,
        ..FIRM
    };
    let weak = Grasp {
        right_force_n: 0.01,
        ..FIRM
    };
    for grasp in [NO_GRASP, one_finger, weak] {
        assert_eq!(
            Bench::new().lift(0.03, 3.0, &grasp),
            Outcome::Running,
            "{grasp:?}"
        );
    }
}

#[test]
fn lift_that_is_too_low_is_no_success() {
    let mut bench = Bench::new();
    let height_m = bench.task.success.lift_height_m;
    assert_eq!(bench.lift(height_m - 0.002, 3.0, &FIRM), Outcome::Running);
}

#[test]
fn short_holds_do_not_add_up() {
    let mut bench = Bench::new();
    bench.lift(0.019, 0.0, &FIRM);
    let hold_s = bench.task.success.hold_s;
    for _ in 0..5 {
        assert_eq!(bench.hold(0.022, 0.8 * hold_s, &FIRM), Outcome::Running);
        assert_eq!(bench.hold(0.022, 0.01, &NO_GRASP), Outcome::Running);
    }
    assert_eq!(bench.hold(0.022, 1.1 * hold_s, &FIRM), Outcome::Success);
}

#[test]
fn needle_that_still_hangs_onto_the_organ_is_no_success() {
    // Turned about the grip until its ends hang down: the middle is high, the ends are in the
    // organ.
    let hanging = || {
        let mut bench = Bench::new();
        let middle = Vector3::new(bench.task.needle.arc_radius_m, 0.0, 0.0);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -1.5);
        bench.lying *= Translation3::from(middle) * turn * Translation3::from(-middle);
        bench
    };
    let ends_m = hanging().task.needle.arc_radius_m;
    assert_eq!(hanging().lift(0.021, 3.0, &FIRM), Outcome::Running);
    assert_eq!(hanging().lift(0.021 + ends_m, 0.6, &FIRM), Outcome::Success);
}

#[test]
fn thrown_needle_is_a_failure() {
    let mut bench = Bench::new();
    for step in 0..100 {
        let height_m = f64::from(step) * 0.001;
        bench.show(Translation3::new(0.0, 0.0, height_m) * bench.lying, &FIRM);
    }
    assert!(
        matches!(bench.judge.outcome(), Outcome::Failure(Reason::Thrown { speed_m_s, .. }) if speed_m_s > 0.9)
    );
}

#[test]
fn grip_that_sinks_into_the_needle_is_invalid() {
    let deep = Grasp {
        penetration_m: 0.001,
        ..FIRM
    };
    let mut bench = Bench::new();
    assert_eq!(bench.hold(0.0, 0.015, &deep), Outcome::Running);
    assert_eq!(
        bench.hold(0.0, 0.010, &deep),
        Outcome::Invalid(Reason::Penetration {
            thing: "needle",
            depth_m: 0.001
        })
    );
}

#[test]
fn needle_off_the_organ_is_a_failure() {
    for [x, z] in [[0.1, 0.0], [0.0, -0.01]] {
        let mut bench = Bench::new();
        bench.show(Translation3::new(x, 0.0, z) * bench.lying, &FIRM);
        assert_eq!(bench.judge.outcome(), FALLEN);
    }
    let mut bench = Bench::new();
    bench.show(Pose::translation(f64::NAN, 0.0, 0.0), &FIRM);
    assert_eq!(
        bench.judge.outcome(),
        Outcome::Invalid(Reason::NotFinite { thing: "needle" })
    );
}
