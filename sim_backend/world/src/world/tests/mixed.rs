//! Facts about solids that stand on a soft organ.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::{BACK_MUSCLE, HALF_CIRCLE, RigidBody, Scenery, World};
use crate::organ::Organ;
use crate::shipped;
use crate::world::{Ground, Shape, SoftOrgan};
use hal::Pose;

fn wall(low: [f64; 3], high: [f64; 3]) -> Shape {
    Shape::Block {
        low: Point3::from(low),
        high: Point3::from(high),
    }
}

/// A needle let go just above the organ, with what `solids` stand on it, half a second later.
fn at_rest(ground: Ground, height_m: f64) -> World {
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &BACK_MUSCLE.normal(0.0, 0.0));
    let in_scene = Pose::from_parts([0.0, 0.0, height_m].into(), turn.unwrap());
    let (needle, task) = if let Ground::OrganWithSolids(..) = ground {
        (
            RigidBody::needle_on_any_ground(&HALF_CIRCLE, in_scene),
            "suture-pad",
        )
    } else {
        (RigidBody::needle(&HALF_CIRCLE, in_scene), "needle-lift")
    };
    let scenery = Scenery {
        things: vec![needle],
        ground,
        flap: None,
    };
    let mut world = World::new(&shipped::world(task), &scenery, &[]);
    for _ in 0..500 {
        world.step();
    }
    world
}

fn organ_with(solids: Vec<Shape>) -> Ground {
    let lift = shipped::world("needle-lift");
    let soft = SoftOrgan {
        organ: Organ::Rolling(BACK_MUSCLE),
        ground: lift.ground,
        press: lift.press,
    };
    Ground::OrganWithSolids(soft, solids)
}

/// A needle lies on the organ as if no solid stood there, and on a solid that is under it, which
/// does not give way.
#[test]
fn a_needle_lies_on_the_organ_and_on_what_stands_on_it() {
    let above_m = BACK_MUSCLE.height_m(0.0, 0.0) + 0.003;
    let alone = at_rest(Ground::Organ(Organ::Rolling(BACK_MUSCLE)), above_m);
    let away = wall([0.05, -0.01, -0.02], [0.06, 0.01, 0.02]);
    let beside = at_rest(organ_with(vec![away]), above_m);
    assert_eq!(beside.thing_in_scene(0), alone.thing_in_scene(0));
    // What it sinks into the organ is none of the hard ground's.
    assert!(alone.subject_sunk_m() > 0.0 && beside.subject_sunk_m() <= 0.0);

    let top_m = 0.012;
    let under = wall([-0.04, -0.04, -0.02], [0.04, 0.04, top_m]);
    let world = at_rest(organ_with(vec![under]), top_m + 0.003);
    let on = world.thing_in_scene(0);
    assert!(world.subject_sunk_m() > 0.0);
    let gap_m = on.translation.z - HALF_CIRCLE.wire_radius_m - top_m;
    assert!(gap_m.abs() < 2e-5, "{gap_m}");
    assert!((on * Vector3::z()).z > 0.999, "{on}");
}
