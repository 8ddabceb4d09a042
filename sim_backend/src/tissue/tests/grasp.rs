//! When a jaw takes hold, what it feels, and when it lets go.

use hal::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::{OPEN_RAD, Puppet, edge_tip, flap_config, jaw, jaw_at, organ_ground};
use crate::rng::Rng;
use crate::tissue::Tissue;

/// A jaw that has just grasped the flap at the mark, by its edge.
fn grasped() -> Puppet {
    let config = flap_config();
    let mut puppet = Puppet::new(&config, organ_ground(), edge_tip(&config, 0.006, 0.0));
    puppet.close(2.0);
    assert!(puppet.tissue.report().grasp.is_some(), "{:?}", puppet.tissue.report());
    puppet
}

#[test]
fn closing_on_the_mark_takes_the_area_between_the_pads_and_lifts_it() {
    let mut puppet = grasped();
    let grasp = puppet.tissue.report().grasp.unwrap();
    println!("{grasp:?} opening {}", puppet.opening_rad);
    // The pads are 3 mm wide and 6 mm over the edge.
    assert!((1.4e-5..=2.2e-5).contains(&grasp.area_m2), "{grasp:?}");
    assert!(grasp.beside_mark_m < 0.001, "{grasp:?}");
    puppet.travel(Vector3::new(0.0, 0.005, 0.02), 0.02);
    puppet.wait(4000);
    let report = *puppet.tissue.report();
    println!("{report:?} {:?}", puppet.tissue.jaw(0).total());
    assert!((0.019..0.021).contains(&report.mark_rise_m), "{report:?}");
    assert!(!report.torn && report.lost == 0 && report.slowed == 0 && !report.fault);
}

#[test]
fn the_jaw_carries_what_the_attached_edge_does_not() {
    let mut puppet = grasped();
    puppet.travel(Vector3::new(0.0, 0.005, 0.03), 0.02);
    puppet.wait(5000);
    let felt = puppet.tissue.jaw(0).total().force;
    let ground_m = puppet.tissue.report().ground_depth_m;
    let sheet = &mut puppet.tissue.sheet;
    sheet.load();
    // Elastic forces sum to nothing, so what the attached nodes feel is what the edge carries, but for its sign.
    let fixed = sheet.forces.iter().zip(&sheet.inverse_masses).filter(|(_, inverse)| **inverse <= 0.0);
    let edge: Vector3<f64> = fixed.map(|(force, _)| force).sum();
    let expected = sheet.gravity * sheet.masses.iter().sum::<f64>() - edge;
    println!("felt {felt:?} expected {expected:?}, ground {ground_m:e}");
    assert!(ground_m <= 0.0, "hangs free");
    assert!((felt - expected).norm() < 0.01 * felt.norm());
}

#[test]
fn a_fold_is_pinched_from_above() {
    let config = flap_config();
    let away = jaw_at([0.0, 0.0, 0.1], OPEN_RAD, 0.0);
    let rest = Tissue::new(&config, organ_ground(), 3, &[away]);
    let mark = rest.mark_in_scene().translation.vector;
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), core::f64::consts::PI);
    let hinge = Translation3::new(mark.x, mark.y + 0.01, mark.z + 0.005 + hal::psm::FINGER_M);
    let mut puppet = Puppet::new(&config, organ_ground(), Pose::from_parts(hinge, down));
    puppet.travel(Vector3::new(0.0, 0.0, -0.0054), 0.02);
    println!("{:?}", puppet.tissue.jaw(0));
    puppet.close(2.0);
    println!("{:?} opening {}", puppet.tissue.report(), puppet.opening_rad);
    assert!(puppet.tissue.report().grasp.is_some());
    puppet.travel(Vector3::new(0.0, 0.0, 0.01), 0.02);
    puppet.wait(300);
    println!("{:?}", puppet.tissue.report());
    assert!(puppet.tissue.report().grasp.is_some());
}

#[test]
fn closing_beside_the_tissue_or_on_too_little_of_it_takes_nothing() {
    let config = flap_config();
    for (over_m, aside_m) in [(-0.004, 0.0), (0.001_2, 0.0), (0.006, 0.06)] {
        let mut puppet = Puppet::new(&config, organ_ground(), edge_tip(&config, over_m, aside_m));
        puppet.close(2.0);
        puppet.wait(100);
        assert!(puppet.tissue.report().grasp.is_none(), "{over_m} {:?}", puppet.tissue.report());
    }
}

#[test]
fn nothing_is_taken_without_grip_or_by_a_jaw_that_was_shut_before() {
    let config = flap_config();
    let mut puppet = Puppet::new(&config, organ_ground(), edge_tip(&config, 0.006, 0.0));
    puppet.close(0.1);
    assert!(puppet.tissue.report().grasp.is_none());
    let outside = edge_tip(&config, -0.006, 0.0);
    let mut puppet = Puppet::new(&config, organ_ground(), outside);
    puppet.close(2.0);
    puppet.travel(Vector3::new(0.0, 0.012, 0.0), 0.05);
    assert!(puppet.tissue.report().grasp.is_none());
}

#[test]
fn tissue_slips_out_at_the_break_force_and_is_not_taken_again_until_the_jaw_opens() {
    let config = flap_config();
    let mut puppet = grasped();
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
    println!("slipped at {last_n} after {steps} steps; {:?}", puppet.tissue.report());
    assert!((last_n / config.grasp.break_force_n - 1.0).abs() < 0.02, "{last_n}");
    puppet.wait(200);
    assert!(puppet.tissue.report().grasp.is_none());
    assert_eq!(puppet.tissue.report().lost, 1);
}

#[test]
fn an_opening_jaw_lets_go() {
    let mut puppet = grasped();
    puppet.travel(Vector3::new(0.0, 0.0, 0.01), 0.02);
    puppet.grip_n = 0.0;
    puppet.step();
    puppet.step();
    assert!(puppet.tissue.report().grasp.is_none());
    assert_eq!(puppet.tissue.report().lost, 0);
    puppet.opening_rad = OPEN_RAD;
    puppet.travel(Vector3::new(0.0, -0.02, 0.0), 0.05);
    puppet.wait(1500);
    let report = puppet.tissue.report();
    println!("{report:?}");
    assert!(report.mark_rise_m.abs() < 0.001 && report.speed_m_s < 0.002, "{report:?}");
}

#[test]
fn violent_motion_never_leaves_the_numbers_range() {
    for (speed_m_s, seed) in [(0.2, 1_u64), (0.2, 2), (1.0, 3), (5.0, 4)] {
        let mut puppet = grasped();
        let mut rng = Rng::new(seed);
        let home = puppet.tip;
        let (mut stretch, mut held) = (0.0_f64, 0);
        let mut velocity = Vector3::zeros();
        for step in 0..3000 {
            if step % 40 == 0 {
                let direction: [f64; 3] = std::array::from_fn(|_| rng.range(-1.0, 1.0));
                let homeward = (home.translation.vector - puppet.tip.translation.vector) * 30.0;
                velocity = (Vector3::from(direction) + homeward).normalize() * speed_m_s;
            }
            let turn = UnitQuaternion::new(Vector3::new(0.0, 0.0, 0.003 * velocity.x / speed_m_s));
            puppet.tip = Translation3::from(velocity * 1e-3) * puppet.tip * turn;
            puppet.step();
            let report = puppet.tissue.report();
            stretch = stretch.max(report.stretch);
            held += usize::from(report.grasp.is_some());
            assert!(!report.fault, "seed {seed} step {step}");
            assert!(puppet.tissue.state().all(f64::is_finite));
        }
        let report = puppet.tissue.report();
        println!("{speed_m_s} m/s: stretch {stretch:.2}, held {held} of 3000 ms, {report:?}");
        puppet.grip_n = 0.0;
        puppet.opening_rad = OPEN_RAD;
        puppet.tip = Translation3::new(0.0, -0.1, 0.05) * home;
        puppet.wait(2500);
        let [kinetic, elastic, _] = puppet.tissue.sheet().energy_j();
        println!("    afterwards {:?}, {kinetic:e} {elastic:e} J", puppet.tissue.report());
        assert!(puppet.tissue.report().speed_m_s < 0.02, "it comes to rest again");
    }
}

#[test]
fn wrong_numbers_stop_the_flap_where_it_was() {
    let mut puppet = grasped();
    puppet.travel(Vector3::new(0.0, 0.0, 0.01), 0.02);
    let before = puppet.tissue.sheet().positions().to_vec();
    let mut bad = jaw(&puppet.tip, puppet.opening_rad, 2.0);
    bad.fingers[0].translation.vector.x = f64::NAN;
    puppet.tissue.step(&[bad]);
    puppet.wait(10);
    assert!(puppet.tissue.report().fault);
    assert!(puppet.tissue.sheet().positions() == before, "it moved");
    assert_eq!(puppet.tissue.jaw(0).total().force, Vector3::zeros());
}
