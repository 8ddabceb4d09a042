//! When a jaw takes hold, what it feels, and when it lets go.

use hal::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::{OPEN_RAD, Puppet, down, flap_config, grasped, jaw, organ_ground};
use crate::tissue::{Ground, JawReport, Tissue};

/// Closing on the mark takes the area between the pads and lifts it.
#[test]
fn closing_on_the_mark_grasps_the_tissue() {
    let mut puppet = grasped(&flap_config());
    let grasp = puppet.tissue.report().grasp.unwrap();
    // The pads are 3 mm wide and 6 mm over the edge.
    assert!((1.4e-5..=2.2e-5).contains(&grasp.area_m2), "{grasp:?}");
    assert!(grasp.beside_mark_m < 0.001, "{grasp:?}");
    puppet.travel(Vector3::new(0.0, 0.005, 0.02), 0.02);
    puppet.wait(4000);
    let report = *puppet.tissue.report();
    assert!((0.019..0.021).contains(&report.mark_rise_m), "{report:?}");
    assert!(!report.torn && report.lost == 0 && report.slowed == 0 && !report.fault);
}

#[test]
fn the_jaw_carries_what_the_attached_edge_does_not() {
    let mut puppet = grasped(&flap_config());
    puppet.travel(Vector3::new(0.0, 0.005, 0.03), 0.02);
    puppet.wait(5000);
    let felt = puppet.tissue.jaw(0).total().force;
    let ground_m = puppet.tissue.report().ground_depth_m;
    let sheet = &mut puppet.tissue.sheet;
    sheet.load();
    // Elastic forces sum to nothing, so what the attached nodes feel is what the edge carries, but
    // for its sign.
    let fixed = sheet
        .forces
        .iter()
        .zip(&sheet.inverse_masses)
        .filter(|(_, inverse)| **inverse <= 0.0);
    let edge: Vector3<f64> = fixed.map(|(force, _)| force).sum();
    let expected = sheet.gravity * sheet.masses.iter().sum::<f64>() - edge;
    assert!(ground_m <= 0.0, "hangs free");
    assert!((felt - expected).norm() < 0.01 * felt.norm());
}

/// A jaw that points straight down over `ground`, its hinge turned by `yaw_rad` from the edge, its
/// ends `above_m` over the face of the flap at a point `inward_m` further from the free edge than
/// the mark.
fn from_above(ground: Ground, inward_m: f64, yaw_rad: f64, above_m: f64) -> Puppet {
    let mut puppet = Puppet::new(&flap_config(), ground);
    let mark = puppet.tissue.mark_in_scene().translation.vector;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
    let reach_m = hal::psm::FINGER_M * (0.5 * OPEN_RAD).cos();
    let hinge = Translation3::new(mark.x, mark.y + inward_m, mark.z + above_m + reach_m);
    puppet.tip = Pose::from_parts(hinge, turn * down());
    puppet
}

#[test]
fn a_fold_is_pinched_from_above_where_the_organ_bears_it() {
    // In the middle of the flap across and along, and at the mark along the edge.
    let along = core::f64::consts::FRAC_PI_2;
    let wide = || Ground::sampled([-0.06, -0.05], [0.06, 0.045], 0.003, |_, _| 0.0);
    let pinched = |ground: Ground, inward_m: f64, yaw_rad: f64| {
        let mut puppet = from_above(ground, inward_m, yaw_rad, 0.003);
        puppet.travel(Vector3::new(0.0, 0.0, -0.003_3), 0.02);
        puppet.close(2.0);
        puppet
    };
    for (inward_m, yaw_rad) in [(0.015, 0.0), (0.015, 1.2), (0.0, along)] {
        let mut puppet = pinched(wide(), inward_m, yaw_rad);
        let grasp = puppet.tissue.report().grasp.unwrap();
        assert!((grasp.beside_mark_m - inward_m).abs() < 0.002, "{grasp:?}");
        puppet.travel(Vector3::new(0.0, 0.0, 0.008), 0.02);
        puppet.wait(300);
        assert!(
            puppet.tissue.report().grasp.is_some(),
            "{yaw_rad}: {:?}",
            puppet.tissue.report()
        );
    }
    // Where the flap stands out freely it gives way and tilts out from between the ends.
    let puppet = pinched(organ_ground(), 0.0, along);
    assert!(puppet.tissue.report().grasp.is_none());
}

#[test]
fn a_jaw_that_only_pushes_feels_the_tissue_and_holds_nothing() {
    let mut puppet = from_above(organ_ground(), 0.015, 0.0, 0.003);
    puppet.close(2.0);
    assert!(puppet.opening_rad <= 0.0, "it closes on air");
    puppet.travel(Vector3::new(0.0, 0.0, -0.003), 0.02);
    puppet.wait(300);
    let pressed = puppet.tissue.jaw(0);
    let load_n = pressed.pressed_n[0] + pressed.pressed_n[1];
    assert!(load_n > 0.01 && pressed.grasp.is_none(), "{pressed:?}");
    assert!(
        pressed.total().force.z > 0.8 * load_n,
        "it is pushed up: {pressed:?}"
    );
    assert!(pressed.depth_m < 0.000_75, "{pressed:?}");
    // Dragged sideways it rubs, up to the coefficient of friction.
    puppet.travel(Vector3::new(0.005, 0.0, 0.0), 0.02);
    let rubbed = puppet.tissue.jaw(0);
    let load_n = rubbed.pressed_n[0] + rubbed.pressed_n[1];
    let share = -rubbed.total().force.x / load_n;
    assert!((0.4..=0.9).contains(&share), "{share} {rubbed:?}");
    puppet.travel(Vector3::new(0.0, 0.0, 0.01), 0.05);
    puppet.wait(1500);
    let report = puppet.tissue.report();
    assert!(
        report.force_n <= 0.0 && report.grasp.is_none() && report.speed_m_s < 0.005,
        "{report:?}"
    );
}

#[test]
fn the_wrist_pushes_too() {
    let config = flap_config();
    let mut puppet = Puppet::at_edge(&config, 0.006, 0.0);
    // Level, a wrist's radius and more above the flap, over its middle; then down.
    puppet.tip = Translation3::new(0.0, 0.02, 0.012) * puppet.tip;
    puppet.opening_rad = 0.0;
    puppet.wait(1);
    puppet.travel(Vector3::new(0.0, 0.0, -0.01), 0.02);
    let felt = puppet.tissue.jaw(0);
    assert!(
        felt.pressed_n[2] > 0.01 && felt.wrist.force.z > 0.01,
        "{felt:?}"
    );
    assert!(felt.grasp.is_none());
}

/// Closing beside the tissue or on too little of it takes nothing.
#[test]
fn closing_beside_the_tissue_grasps_nothing() {
    let config = flap_config();
    for (over_m, aside_m) in [(-0.004, 0.0), (0.001_2, 0.0), (0.006, 0.06)] {
        let mut puppet = Puppet::at_edge(&config, over_m, aside_m);
        puppet.close(2.0);
        puppet.wait(100);
        assert!(
            puppet.tissue.report().grasp.is_none(),
            "{over_m} {:?}",
            puppet.tissue.report()
        );
    }
}

/// Nothing is taken without grip or by a jaw that was shut before.
#[test]
fn shut_jaw_grasps_nothing() {
    let config = flap_config();
    let mut puppet = Puppet::at_edge(&config, 0.006, 0.0);
    puppet.close(0.1);
    assert!(puppet.tissue.report().grasp.is_none());
    let mut puppet = Puppet::at_edge(&config, -0.006, 0.0);
    puppet.close(2.0);
    puppet.travel(Vector3::new(0.0, 0.012, 0.0), 0.05);
    assert!(puppet.tissue.report().grasp.is_none());
}

/// Tissue slips out at the break force and is not taken again until the jaw opens.
#[test]
fn tissue_slips_out_at_the_break_force() {
    let config = flap_config();
    let mut puppet = grasped(&flap_config());
    let mut last_n = 0.0;
    let mut steps = 0;
    while puppet.tissue.report().lost == 0 && steps < 20_000 {
        puppet.travel(Vector3::new(0.0, -0.000_01, 0.0), 0.01);
        let felt = puppet.tissue.jaw(0);
        if let Some(grasp) = felt.grasp {
            last_n = grasp.force_n;
        }
        steps += 1;
    }
    assert!(
        (last_n / config.grasp.break_force_n - 1.0).abs() < 0.02,
        "{last_n}"
    );
    puppet.wait(200);
    assert!(puppet.tissue.report().grasp.is_none());
    assert_eq!(puppet.tissue.report().lost, 1);
}

#[test]
fn an_opening_jaw_lets_go() {
    let mut puppet = grasped(&flap_config());
    puppet.travel(Vector3::new(0.0, 0.0, 0.01), 0.02);
    puppet.grip_n = 0.0;
    puppet.step();
    puppet.step();
    assert!(puppet.tissue.report().grasp.is_none());
    assert_eq!(puppet.tissue.report().lost, 0);
    puppet.opening_rad = OPEN_RAD;
    puppet.travel(Vector3::new(0.0, -0.02, 0.0), 0.05);
    puppet.wait(2500);
    let report = puppet.tissue.report();
    assert!(
        report.mark_rise_m.abs() < 0.001 && report.speed_m_s < 0.002,
        "{report:?}"
    );
}

/// What two jaws feel that take a floating flap by its free edge 24 mm apart and pull by 3 mm, once
/// all is still.
fn pulled_apart() -> [JawReport; 2] {
    let mut config = flap_config();
    config.gravity_m_s2 = 0.0;
    config.material.drag_per_s = 20.0;
    let one = Puppet::at_edge(&config, 0.006, 0.0).tip;
    let jaws = |opening_rad: f64, aside_m: f64| {
        [-1.0, 1.0].map(|side| {
            let mut tip = one;
            tip.translation.vector.x = side * aside_m;
            tip.translation.vector.z = 0.5 * config.material.thickness_m;
            jaw(&tip, opening_rad, 2.0)
        })
    };
    let mut tissue = Tissue::new(&config, Ground::none(), 3, &jaws(OPEN_RAD, 0.012));
    for node in 0..tissue.sheet.masses.len() {
        tissue.sheet.inverse_masses[node] = tissue.sheet.masses[node].recip();
    }
    let mut opening_rad = OPEN_RAD;
    while opening_rad > 0.2 && (0..2).any(|index| tissue.jaw(index).grasp.is_none()) {
        opening_rad -= 0.001;
        tissue.step(&jaws(opening_rad, 0.012));
    }
    for step in 0..4000_u32 {
        let out_m = 0.001_5 * f64::from(step.min(1000)) / 1000.0;
        tissue.step(&jaws(opening_rad, 0.012 + out_m));
    }
    [tissue.jaw(0), tissue.jaw(1)]
}

#[test]
fn two_jaws_that_pull_at_one_flap_feel_each_other() {
    let felt = pulled_apart();
    let [left, right] = felt.map(|felt| felt.total());
    assert!(felt.iter().all(|felt| felt.grasp.is_some()), "{felt:?}");
    assert!(left.force.x > 0.02, "{left:?}");
    assert!(
        (left.force + right.force).norm() < 1e-3 * left.force.norm(),
        "{left:?} {right:?}"
    );
}

#[test]
fn held_tissue_gets_stiffer_the_thinner_it_is_squeezed() {
    let mut puppet = grasped(&flap_config());
    let mut squeezed_n = Vec::new();
    for opening_rad in [0.17, 0.13, 0.09, 0.05] {
        while puppet.opening_rad > opening_rad {
            puppet.opening_rad -= 0.001;
            puppet.step();
        }
        puppet.wait(50);
        let felt = puppet.tissue.jaw(0);
        // The two fingers are pushed apart, and next to nothing is left of that on the whole.
        let apart = (felt.fingers[0].force - felt.fingers[1].force).norm() / 2.0;
        assert!(
            felt.total().force.norm() < 0.1 && felt.grasp.is_some(),
            "{felt:?}"
        );
        squeezed_n.push(apart);
    }
    let steps: Vec<f64> = squeezed_n
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .collect();
    assert!(
        steps[0] > 0.0 && steps[1] > 1.3 * steps[0] && steps[2] > 1.3 * steps[1],
        "{squeezed_n:?}"
    );
}
