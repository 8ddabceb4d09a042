//! Nothing that a jaw does can drive the numbers out of their range.

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::{OPEN_RAD, Puppet, flap_config, grasped, jaw};
use crate::rng::Rng;

/// Throws the jaw about at `speed_m_s` in a new direction every 40 ms for 2 s; the largest stretch
/// on the way, and the time for which the tissue was held, ms.
fn throw_about(puppet: &mut Puppet, speed_m_s: f64, seed: u64) -> (f64, usize) {
    let mut rng = Rng::new(seed);
    let home = puppet.tip;
    let (mut stretch, mut held) = (0.0_f64, 0);
    let mut velocity = Vector3::zeros();
    for step in 0..2000 {
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
    puppet.grip_n = 0.0;
    puppet.opening_rad = OPEN_RAD;
    puppet.tip = Translation3::new(0.0, -0.1, 0.05) * home;
    (stretch, held)
}

#[test]
fn violent_motion_leaves_a_sound_flap() {
    for (speed_m_s, break_force_n, seed) in [
        (0.2, 1.0, 2),
        (0.2, 20.0, 4),
        (1.0, 20.0, 5),
        (5.0, 20.0, 8),
    ] {
        let mut config = flap_config();
        config.grasp.break_force_n = break_force_n;
        let mut puppet = grasped(&config);
        let (stretch, held) = throw_about(&mut puppet, speed_m_s, seed);
        puppet.wait(4000);
        let report = *puppet.tissue.report();
        // It may have been thrown over its attached edge, but it lies still, no part stretched,
        // crumpled or turned over.
        assert!(
            report.speed_m_s < 0.01 && report.stretch < 0.02,
            "{speed_m_s} m/s: {stretch} {held} {report:?}"
        );
        let sheet = puppet.tissue.sheet();
        for j in 0..sheet.nodes()[1] - 1 {
            for i in 0..sheet.nodes()[0] - 1 {
                let at = |i, j| sheet.positions()[sheet.node(i, j)];
                let (u, v) = (at(i + 1, j) - at(i, j), at(i, j + 1) - at(i, j));
                let area = u.cross(&v).norm() / (sheet.spacing_m[0] * sheet.spacing_m[1]);
                assert!(
                    (0.97..1.03).contains(&area),
                    "{speed_m_s} m/s: cell {i} {j} has {area} of its area"
                );
            }
        }
    }
}

#[test]
fn wrong_numbers_stop_the_flap_where_it_was() {
    let mut puppet = grasped(&flap_config());
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
