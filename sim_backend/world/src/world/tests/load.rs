//! Facts about contacts under load: what an instrument presses with all that its drives give goes
//! nowhere but where stated stiffness lets it, and what was pressed lies there afterwards as if
//! nothing had been.

use hal::psm::EFFORT_MAX;
use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::{
    ArmStart, BACK_MUSCLE, Bench, HALF_CIRCLE, OPEN, RigidBody, Scenery, World, insertion,
};
use crate::block::BlockShape;
use crate::shipped;
use crate::world::{Collider, CollisionMask, Ground, Shape};
use hal::{ArmCommand, JointVector, Pose, TimeNs};

/// What hard contacts may give way, m.
const GIVE_M: f64 = 1e-4;
/// How far below what it meets the instrument is told to go, m: far more than its drives can push
/// through.
const BEYOND_M: f64 = 0.02;

const BLOCK: BlockShape = BlockShape {
    side_m: 0.005,
    corner_m: 0.008,
    hole_m: 0.003_6,
    height_m: 0.014_5,
    mass_kg: 0.01,
};

fn plate() -> Shape {
    Shape::Block {
        low: Point3::new(-0.1, -0.1, -0.01),
        high: Point3::new(0.1, 0.1, 0.0),
    }
}

fn block(in_scene: Pose) -> RigidBody {
    let pieces = BLOCK.pieces().map(|ends| Collider {
        shape: Shape::Hull(ends.into_iter().flatten().collect()),
        meets: CollisionMask::Both,
    });
    RigidBody {
        in_scene,
        mass_kg: BLOCK.mass_kg,
        centre: Point3::origin(),
        inertia: BLOCK.inertia(),
        axes: UnitQuaternion::identity(),
        pieces: pieces.into(),
    }
}

/// Fingers pointing down, open, with their ends at `end_m`, over `thing` on `solids`, with the
/// physics of `task`.
fn over(task: &str, thing: RigidBody, solids: Vec<Shape>, end_m: f64) -> Bench {
    let scenery = Scenery {
        things: vec![thing],
        ground: Ground::Solids(solids),
        flap: None,
    };
    let position = JointVector::from([0.0, 0.0, insertion(end_m), 0.0, 0.0, 0.0]);
    let arm = ArmStart {
        scene_from_rcm: Pose::translation(0.0, 0.0, 0.15),
        joints: position,
        jaw: OPEN,
    };
    let config = shipped::world(task);
    Bench {
        world: World::new(&config, &scenery, &[arm]),
        command: ArmCommand {
            stamp: TimeNs(0),
            position,
            velocity: JointVector::zeros(),
            acceleration: JointVector::zeros(),
            jaw_position: OPEN,
            jaw_velocity: 0.0,
            enabled: true,
        },
    }
}

/// The worst of a press: overlaps with the ground and in the fingers, m, the ground's force on the
/// thing, N, and the greatest speed, m/s.
#[derive(Debug, Default)]
struct Worst {
    sunk_m: f64,
    in_fingers_m: f64,
    arm_sunk_m: f64,
    ground_n: f64,
    speed_m_s: f64,
}

impl Worst {
    fn observe(&mut self, world: &World) {
        self.sunk_m = self.sunk_m.max(world.sunk_m(0));
        self.in_fingers_m = self.in_fingers_m.max(world.grasp(0, 0).penetration_m);
        self.arm_sunk_m = self.arm_sunk_m.max(world.stage.part_sunk_m(0));
        self.ground_n = self.ground_n.max(world.thing_ground_force_n(0));
        self.speed_m_s = self.speed_m_s.max(world.stage.thing(0).speed_m_s());
    }
}

/// Moves joint `joint` by `way` over 1 s and waits for 1 s.
fn press(bench: &mut Bench, joint: usize, way: f64) -> Worst {
    let from = bench.command.position[joint];
    let mut worst = Worst::default();
    bench.run(2.0, |time_s, command, world| {
        command.position[joint] = from + way * time_s.min(1.0);
        worst.observe(world);
    });
    bench.command.position[joint] = from + way;
    worst
}

/// What the insertion's drive pushes with at rest, N, at least: its dry friction may hold a part
/// back.
fn insertion_n() -> f64 {
    let plant = shipped::world("block-transfer").plant;
    EFFORT_MAX[2] - 2.0 * plant.coulomb[2]
}

/// Presses the insertion on a thing, checks that it holds, lets it go, and checks that the thing
/// lies where it lay.
fn stands_a_press(mut bench: Bench, rest: &Pose) {
    let worst = press(&mut bench, 2, BEYOND_M);
    let pushed_n = bench.world.thing_ground_force_n(0);
    let least_n = insertion_n();
    assert!(
        pushed_n > least_n && pushed_n < EFFORT_MAX[2] + 1.0,
        "pushes with {pushed_n} N of {least_n}"
    );
    assert!(
        worst.sunk_m < GIVE_M && worst.in_fingers_m < GIVE_M && worst.arm_sunk_m < GIVE_M,
        "{worst:?}"
    );
    let state = bench.world.measured(0, TimeNs(0));
    let behind_m = bench.command.position[2] - state.position[2];
    assert!(behind_m > 0.8 * BEYOND_M - 0.002, "behind by {behind_m} m");
    let tip = bench.world.tip_in_scene(0).translation.vector;
    bench.wait(0.5);
    let crept_m = (bench.world.tip_in_scene(0).translation.vector - tip).norm();
    assert!(crept_m < 5e-5, "creeps by {crept_m} m");
    let pressed = bench.world.thing_in_scene(0);
    let shifted = (rest.inverse() * pressed).translation.vector.norm();
    assert!(shifted < 1e-3, "shifted by {shifted} m");
    let low_j = bench.world.energy_j(0);
    let released = press(&mut bench, 2, -BEYOND_M - 0.005);
    assert!(released.speed_m_s < 0.05, "let go at {released:?}");
    let gained_j = bench.world.energy_j(0) - low_j;
    assert!(gained_j < 1e-6, "gained {gained_j} J");
    let moved = pressed.inverse() * bench.world.thing_in_scene(0);
    assert!(
        moved.translation.vector.norm() < 2e-4 && moved.rotation.angle() < 0.02,
        "released, it moved by {moved}"
    );
}

#[test]
fn a_block_on_the_board_stands_all_that_the_drives_give() {
    let rest = Pose::translation(0.0, 0.0, 0.5 * BLOCK.height_m);
    let bench = over(
        "block-transfer",
        block(rest),
        vec![plate()],
        BLOCK.height_m + 0.001,
    );
    stands_a_press(bench, &rest);
}

#[test]
fn a_needle_on_the_pad_stands_all_that_the_drives_give() {
    let radius_m = HALF_CIRCLE.wire_radius_m;
    let rest = Pose::translation(-HALF_CIRCLE.arc_radius_m, 0.0, radius_m);
    let needle = RigidBody::bare_needle(&HALF_CIRCLE, rest);
    let mut bench = over("suture-pad", needle, vec![plate()], 2.0 * radius_m + 0.001);
    bench.jaw(0.0);
    stands_a_press(bench, &rest);
}

#[test]
fn the_bare_instrument_does_not_sink_into_the_board() {
    let aside = Pose::translation(0.05, 0.05, 0.5 * BLOCK.height_m);
    let mut bench = over("block-transfer", block(aside), vec![plate()], 0.001);
    let worst = press(&mut bench, 2, BEYOND_M);
    let pushed_n = bench.world.ground_force_n(0);
    assert!(pushed_n > insertion_n(), "{pushed_n} N");
    assert!(worst.arm_sunk_m < GIVE_M, "{worst:?}");
}

#[test]
fn a_needle_sinks_into_the_organ_as_its_stiffness_says() {
    // Closed fingers press the middle of the arc until the tissue holds them: more of the drive's
    // force goes into the tissue beside the wire.
    for way_m in [0.003, 0.006, BEYOND_M] {
        let mut bench = Bench::new(0.01, 0.0, HALF_CIRCLE.wire_radius_m + 1e-4);
        bench.jaw(0.0);
        bench.wait(0.3);
        press(&mut bench, 2, 0.01 + way_m);
        let stiffness = shipped::world("needle-lift").ground.stiffness_n_m;
        let needle = bench.world.thing_in_scene(0);
        let depth_m = |p: Point3<f64>| {
            let p = needle * p;
            let above_m = p.z - BACK_MUSCLE.height_m(p.x, p.y);
            let upright = BACK_MUSCLE.normal(p.x, p.y).z;
            (HALF_CIRCLE.wire_radius_m - above_m * upright).max(0.0)
        };
        let depths_m: f64 = HALF_CIRCLE.centre_line(9).into_iter().map(depth_m).sum();
        let stated_n = stiffness * depths_m;
        let grasp = bench.world.grasp(0, 0);
        let pressed_n = grasp.left_force_n + grasp.right_force_n;
        let tissue_n = bench.world.ground_force_n(0);
        assert!(pressed_n > 0.3, "presses with {pressed_n} N");
        let apart = (pressed_n + HALF_CIRCLE.mass_kg * 9.81) / stated_n;
        assert!((apart - 1.0).abs() < 0.1, "{pressed_n} N at {stated_n} N");
        assert!(grasp.penetration_m < GIVE_M);
        if way_m == BEYOND_M {
            let all_n = pressed_n + tissue_n;
            assert!(all_n > insertion_n(), "the drive gives {all_n} N");
            let state = bench.world.measured(0, TimeNs(0));
            let behind_m = bench.command.position[2] - state.position[2];
            assert!(behind_m > 0.8 * BEYOND_M, "behind by {behind_m} m");
        }
    }
}

/// A bar of 6 by 4 by 14 mm, as heavy as the block.
fn bar(in_scene: Pose) -> RigidBody {
    let half = Vector3::new(0.003, 0.002, 0.007);
    let moment = |a: f64, b: f64| BLOCK.mass_kg / 3.0 * (a * a + b * b);
    RigidBody {
        in_scene,
        mass_kg: BLOCK.mass_kg,
        centre: Point3::origin(),
        inertia: Vector3::new(
            moment(half.y, half.z),
            moment(half.x, half.z),
            moment(half.x, half.y),
        ),
        axes: UnitQuaternion::identity(),
        pieces: vec![Collider {
            shape: Shape::Block {
                low: (-half).into(),
                high: half.into(),
            },
            meets: CollisionMask::Both,
        }],
    }
}

/// What the jaw's drive gives while it closes on nothing, J: its effort by the angle that a held
/// thing keeps it open. What leaves the jaw under load is driven by it, and by the instrument that
/// moves on; it takes a part.
const JAW_J: f64 = 0.04 * 0.16;

/// A box to the side of a held thing: `[lowest corner, highest corner]`.
fn wall([low, high]: [[f64; 3]; 2]) -> Shape {
    Shape::Block {
        low: Point3::from(low),
        high: Point3::from(high),
    }
}

/// A peg of the board, whose surface is 1 mm nearer than `x_m`, `y_m`, as high as the walls.
fn peg(x_m: f64, y_m: f64) -> Shape {
    Shape::Capsule {
        from: Point3::new(x_m, y_m, -0.01),
        to: Point3::new(x_m, y_m, 0.007),
        radius_m: 0.001,
    }
}

/// Leads what the jaw holds against what stands beside it with all the torque of `joint`, and back.
fn stands_a_push(
    bench: &mut Bench,
    joint: usize,
    way: f64,
    least_n: f64,
    mass_kg: f64,
    name: &str,
) {
    assert!(bench.world.grasp(0, 0).both_touch, "{name}: not held");
    let worst = press(bench, joint, way);
    assert!(worst.ground_n > least_n, "{name}: pushes little, {worst:?}");
    assert!(
        worst.sunk_m < GIVE_M && worst.in_fingers_m < GIVE_M && worst.arm_sunk_m < GIVE_M,
        "{name}: {worst:?}"
    );
    let back = press(bench, joint, -way);
    assert!(back.sunk_m < GIVE_M, "{name}: {back:?}");
    for speed_m_s in [worst.speed_m_s, back.speed_m_s] {
        let taken_j = 0.5 * mass_kg * speed_m_s.powi(2);
        assert!(
            taken_j < 0.25 * JAW_J && speed_m_s < 0.7,
            "{name}: leaves at {speed_m_s} m/s"
        );
    }
}

#[test]
fn a_bar_pushed_against_a_wall_or_a_peg_gives_way_nowhere() {
    // Held at its upper end, and led against it with all the torque of yaw or pitch. Across the jaw
    // it is levered open.
    for (joint, way, least_n, beside) in [
        (
            0,
            0.15,
            5.0,
            wall([[0.008, -0.05, 0.0], [0.02, 0.05, 0.008]]),
        ),
        (
            0,
            -0.15,
            5.0,
            wall([[-0.02, -0.05, 0.0], [-0.008, 0.05, 0.008]]),
        ),
        (
            1,
            0.15,
            0.5,
            wall([[-0.05, -0.02, 0.0], [0.05, -0.007, 0.008]]),
        ),
        (
            1,
            -0.15,
            0.5,
            wall([[-0.05, 0.007, 0.0], [0.05, 0.02, 0.008]]),
        ),
        (0, 0.15, 5.0, peg(0.009, 0.0)),
        (0, -0.15, 5.0, peg(-0.009, 0.0)),
        (1, 0.15, 0.5, peg(0.0, -0.008)),
        (1, -0.15, 0.5, peg(0.0, 0.008)),
    ] {
        let name = format!("joint {joint} by {way} against {beside:?}");
        let thing = bar(Pose::translation(0.0, 0.0, 0.007));
        let mut bench = over("block-transfer", thing, vec![plate(), beside], 0.017);
        bench.insert(0.007, 0.5);
        bench.jaw(-0.1);
        bench.wait(0.3);
        bench.insert(-0.003, 0.5);
        bench.wait(0.2);
        stands_a_push(&mut bench, joint, way, least_n, BLOCK.mass_kg, &name);
        bench.jaw(OPEN);
        bench.wait(1.0);
        let end = bench.world.thing_in_scene(0).translation.vector;
        assert!(end.z < 0.02 && end.norm() < 0.05, "{name}: lies at {end}");
    }
}

#[test]
fn a_needle_in_the_jaw_gives_way_nowhere_at_the_lip() {
    // Held at the middle of its arc, its end is led against the lip of the suture pad with all the
    // torque of pitch.
    let radius_m = HALF_CIRCLE.wire_radius_m;
    let front_m = HALF_CIRCLE.arc_radius_m + radius_m + 0.003;
    for (way, low_m) in [(0.15, -front_m - 0.005), (-0.15, front_m)] {
        let lip = wall([[-0.025, low_m, 0.0], [0.025, low_m + 0.005, 0.016]]);
        let rest = Pose::translation(-HALF_CIRCLE.arc_radius_m, 0.0, radius_m);
        let needle = RigidBody::bare_needle(&HALF_CIRCLE, rest);
        let mut bench = over("suture-pad", needle, vec![plate(), lip], 0.012);
        bench.insert(0.0115, 0.5);
        bench.jaw(-0.1);
        bench.wait(0.3);
        bench.insert(-0.005, 0.5);
        bench.wait(0.2);
        let name = format!("pitch by {way}");
        stands_a_push(&mut bench, 1, way, 5.0, HALF_CIRCLE.mass_kg, &name);
    }
}
