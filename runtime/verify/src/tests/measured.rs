//! Measured arms away from their commands.

use hal::{ArmError, ArmState, JointVector, TimeNs};

use super::scene::{CommandSample, HOME, Scene, all_broken};
use crate::Stream;
use crate::differences::AXES;

/// The floor is 5 mm below the closed finger tips at home, of which the fingers' radius leaves 1
/// mm.
const FLOOR: &str = "[[forbidden]]\nname = \"floor\"\nshape = \"half_space\"\npoint_m = [0, 0, -0.1287]\nnormal = [0, 0, 1]\n";

fn closed(deeper_m: f64) -> [f64; AXES] {
    let mut place = HOME;
    place[2] += deeper_m;
    place[6] = 0.0;
    place
}

fn with_floor() -> Scene {
    let mut scene = Scene::loose(1);
    scene.regions = FLOOR.to_owned();
    scene
}

/// An arm that is commanded to stay at home and is measured so much deeper, tick after tick.
fn measured_deeper(scene: &Scene, deeper_m: &[f64]) -> Stream {
    let mut stream = scene.stream();
    for (tick, &deeper_m) in (0..).zip(deeper_m) {
        let mut told = CommandSample::powered(tick, &closed(0.0));
        let [joints @ .., jaw] = closed(deeper_m);
        let stamp = TimeNs::from_tick(tick);
        told.measured = Ok(ArmState::at_rest(stamp, JointVector::from(joints), jaw));
        stream.tick(tick, &[told.pair()]);
    }
    stream
}

#[test]
fn a_measured_arm_within_a_region_is_a_violation() {
    let scene = with_floor();
    let mut found = measured_deeper(&scene, &[0.0, 0.0005, 0.0009]).measured();
    found.retain(|nearest| nearest.boundary == "forbidden.floor");
    assert_eq!((found[0].tick, found[0].ticks_beyond), (2, 0));
    assert!((found[0].clearance_m - 0.0001).abs() < 1e-4, "{found:?}");
    let stream = measured_deeper(&scene, &[0.0, 0.0005, 0.002, 0.003, 0.0]);
    assert_eq!(
        all_broken(&stream),
        [
            "measured.forbidden.floor.left_finger",
            "measured.forbidden.floor.right_finger"
        ]
    );
    let found = stream.measured();
    let nearest = found
        .iter()
        .find(|nearest| nearest.boundary == "forbidden.floor");
    let nearest = nearest.unwrap();
    assert_eq!((nearest.tick, nearest.ticks_beyond), (3, 2));
    assert!((nearest.clearance_m + 0.002).abs() < 1e-4, "{nearest:?}");
    assert!(nearest.part.ends_with("finger") && nearest.arm == "psm1");
}

#[test]
fn an_arm_that_begins_beyond_is_told_and_no_violation() {
    // Not even where its setpoints are brought back by a hair and it lags behind.
    let stream = measured_deeper(&with_floor(), &[0.003, 0.002, 0.0012, 0.0013]);
    assert!(
        all_broken(&stream)
            .iter()
            .all(|name| !name.starts_with("measured."))
    );
    let found = stream.measured();
    assert_eq!(found[1].ticks_beyond, 4, "{found:?}");
    // Once well within it stays within.
    let again = measured_deeper(&with_floor(), &[0.003, 0.0002, 0.002]);
    assert!(all_broken(&again).contains(&"measured.forbidden.floor.left_finger".to_owned()));
}

#[test]
fn the_workspace_holds_the_measured_points_too() {
    let mut scene = Scene::loose(1);
    scene.arms[0].low[2] = -0.1247;
    let stream = measured_deeper(&scene, &[0.0, 0.005]);
    let broken = all_broken(&stream);
    assert!(
        broken.contains(&"measured.workspace.left_finger_tip.z_min".to_owned()),
        "{broken:?} {:?}",
        stream.measured()
    );
    assert_eq!(stream.measured()[0].boundary, "workspace");
}

#[test]
fn an_arm_without_torque_or_measurement_is_not_looked_at() {
    let scene = with_floor();
    let mut stream = scene.stream();
    let mut told = CommandSample::limp(0, &closed(0.01));
    stream.tick(0, &[told.pair()]);
    told = CommandSample::powered(1, &closed(0.0));
    told.measured = Err(ArmError::MeasurementLost { age_ns: 60_000_000 });
    stream.tick(1, &[told.pair()]);
    assert!(stream.measured().is_empty(), "{:?}", stream.measured());
}

#[test]
fn two_measured_arms_keep_their_gap() {
    let mut scene = Scene::loose(2);
    scene.arms[1].place = [0.03, 0.0, 0.0];
    scene.gaps_m = [0.02, -1.0];
    let run = |yaw: f64| {
        let mut stream = scene.stream();
        for tick in 0..3 {
            let first = CommandSample::powered(tick, &HOME);
            let mut second = first;
            if tick > 0 {
                let state = second.measured.as_mut().unwrap();
                state.position[0] = yaw;
            }
            stream.tick(tick, &[first.pair(), second.pair()]);
        }
        (all_broken(&stream), stream.measured())
    };
    let (broken, found) = run(0.0);
    assert!(broken.is_empty(), "{broken:?}");
    let gap = found
        .iter()
        .find(|nearest| nearest.boundary == "between_arms");
    assert!((gap.unwrap().clearance_m - 0.002).abs() < 1e-6, "{found:?}");
    let towards = [-0.05, 0.05].map(|yaw| run(yaw).0);
    let nearer = vec!["measured.between_arms.shaft.shaft".to_owned()];
    assert!(towards.contains(&nearer), "{towards:?}");
}
