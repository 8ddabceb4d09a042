//! Conservation of momentum and energy, and repetition bit by bit.

use hal::Pose;
use nalgebra::{Translation3, Vector3};

use super::{OPEN_RAD, Puppet, flap_config, grasped, jaw_at, organ_ground};
use crate::rng::Rng;
use crate::tissue::{Ground, Sheet, SheetShape, Tissue};

/// Momentum and angular momentum about the origin.
fn momentum(sheet: &Sheet) -> [Vector3<f64>; 2] {
    let mut sums = [Vector3::zeros(); 2];
    for ((at, velocity), mass) in sheet
        .positions
        .iter()
        .zip(&sheet.velocities)
        .zip(&sheet.masses)
    {
        sums[0] += velocity * *mass;
        sums[1] += at.cross(velocity) * *mass;
    }
    sums
}

/// A sheet that nothing holds, moving wildly.
fn tumbling(relaxation_s: f64) -> Sheet {
    let mut material = flap_config().material;
    material.drag_per_s = 0.0;
    material.relaxation_s = relaxation_s;
    let shape = SheetShape {
        size_m: [0.06, 0.048],
        cells: [15, 12],
    };
    let mut sheet = Sheet::new(&shape, &material, &Pose::identity(), Vector3::zeros());
    let mut rng = Rng::new(5);
    for index in 0..sheet.positions.len() {
        let at = sheet.positions[index];
        let noise: [f64; 3] = std::array::from_fn(|_| rng.range(-0.02, 0.02));
        sheet.velocities[index] = Vector3::new(0.1, -0.2, 0.05)
            + Vector3::new(1.0, 2.0, 4.0).cross(&at)
            + Vector3::from(noise);
    }
    sheet
}

fn run(sheet: &mut Sheet, dt_s: f64, steps: usize) {
    for _ in 0..steps {
        sheet.load();
        sheet.accelerate(dt_s);
        sheet.drift(dt_s);
    }
}

#[test]
fn free_sheet_keeps_its_momentum() {
    // Damping of bending does not know a turning curved sheet from one that bends: with it a little
    // spin is lost.
    for (relaxation_s, spin_lost) in [(0.0, 1e-11), (5e-5, 1e-6)] {
        let mut sheet = tumbling(relaxation_s);
        let [linear, angular] = momentum(&sheet);
        run(&mut sheet, 1e-3 / 8.0, 8000);
        let [linear_after, angular_after] = momentum(&sheet);
        let lost = (linear_after - linear).norm() / linear.norm();
        let spin = (angular_after - angular).norm() / angular.norm();
        assert!(lost < 1e-11 && spin < spin_lost);
    }
}

#[test]
fn undamped_energy_neither_grows_nor_fades() {
    let mut sheet = tumbling(0.0);
    let start: f64 = sheet.energy_j().iter().sum();
    let [mut early, mut late] = [0.0_f64; 2];
    for step in 0..5000 {
        run(&mut sheet, 1e-3 / 8.0, 8);
        let now: f64 = sheet.energy_j().iter().sum();
        let strayed = (now / start - 1.0).abs();
        if step < 1000 {
            early = early.max(strayed);
        } else if step >= 4000 {
            late = late.max(strayed);
        }
    }
    assert!(early < 0.01 && late < 0.01);
}

#[test]
fn damping_only_takes_energy() {
    let mut sheet = tumbling(5e-5);
    let start: f64 = sheet.energy_j().iter().sum();
    let mut last = start;
    for step in 0..1000 {
        run(&mut sheet, 1e-3 / 8.0, 8);
        let now: f64 = sheet.energy_j().iter().sum();
        // The integrator keeps an energy that differs from this one by a part in a thousand of what
        // swings.
        assert!(
            now <= last + 1e-6 * start,
            "step {step}: {last:e} to {now:e}"
        );
        last = now;
    }
    assert!(last < 0.999 * start);
}

/// A jaw at the edge of a flap with nothing holding it, no ground and no gravity.
fn floating() -> Puppet {
    let mut config = flap_config();
    config.gravity_m_s2 = 0.0;
    config.material.drag_per_s = 0.0;
    let mut puppet = Puppet::at_edge_over(Ground::none(), &config, 0.006, 0.0);
    let sheet = &mut puppet.tissue.sheet;
    sheet.inverse_masses = sheet.masses.iter().map(|mass| mass.recip()).collect();
    puppet
}

#[test]
fn what_the_jaw_feels_is_what_the_tissue_loses() {
    // The jaw closes on the sheet, holds it, and flies off with it.
    let mut puppet = floating();
    let mut impulse = Vector3::zeros();
    let mut angular = Vector3::zeros();
    let mut grasped = false;
    let mut pressed_n = 0.0_f64;
    for step in 0..1200 {
        if step < 600 {
            puppet.opening_rad = (puppet.opening_rad - 0.001).max(0.12);
            puppet.grip_n = 2.0;
        } else {
            let speed = 0.1 * f64::from(step - 600).min(100.0) / 100.0;
            puppet.tip =
                Translation3::new(0.5e-3 * speed, -1e-3 * speed, 1e-3 * speed) * puppet.tip;
        }
        puppet.step();
        let felt = puppet.tissue.jaw(0);
        grasped |= felt.grasp.is_some();
        pressed_n = pressed_n.max(felt.pressed_n[0]);
        let total = felt.total();
        impulse += total.force * 1e-3;
        angular += (total.moment + puppet.tip.translation.vector.cross(&total.force)) * 1e-3;
    }
    let [linear_now, angular_now] = momentum(puppet.tissue.sheet());
    let lost = (impulse + linear_now).norm() / linear_now.norm();
    let spin = (angular + angular_now).norm() / angular_now.norm();
    assert!(grasped && pressed_n > 0.0 && linear_now.norm() > 1e-5);
    assert!(lost < 1e-9);
    // The same loss of spin by damped bending as above.
    assert!(spin < 1e-5);
}

#[test]
fn flap_on_its_organ_comes_to_rest_and_stays() {
    let config = flap_config();
    let away = jaw_at([0.0, 0.0, 0.08], OPEN_RAD, 0.0);
    let mut tissue = Tissue::new(&config, organ_ground(), 1, &[away]);
    let before = tissue.sheet().positions().to_vec();
    for _ in 0..2000 {
        tissue.step(&[away]);
    }
    let moved = tissue
        .sheet()
        .positions()
        .iter()
        .zip(&before)
        .map(|(now, then)| (now - then).norm())
        .fold(0.0, f64::max);
    assert!(moved < 2e-5 && tissue.report().speed_m_s < 1e-5);
}

#[test]
fn same_inputs_give_the_same_bits() {
    let run = || {
        let config = flap_config();
        let mut puppet = Puppet::at_edge(&config, 0.006, 0.0);
        puppet.close(2.0);
        puppet.travel(Vector3::new(0.003, 0.005, 0.02), 0.05);
        let report = *puppet.tissue.report();
        let bits: Vec<u64> = puppet.tissue.state().map(f64::to_bits).collect();
        (bits, report)
    };
    let (first, second) = (run(), run());
    assert!(first.1.grasp.is_some());
    assert_eq!(first, second);
}

#[test]
fn half_the_sub_step_changes_next_to_nothing() {
    let lifted = |substeps: u32| {
        let mut config = flap_config();
        config.substeps = substeps;
        let mut puppet = grasped(&config);
        puppet.travel(Vector3::new(0.0, 0.005, 0.02), 0.02);
        puppet.wait(2000);
        let report = puppet.tissue.report();
        (report.force_n, report.stretch, report.mark_rise_m)
    };
    let (whole, half) = (lifted(8), lifted(16));
    // Not nothing: the fingers touch, and the jaw takes hold, a little earlier or later.
    assert!(
        (whole.0 / half.0 - 1.0).abs() < 0.01,
        "force {whole:?} {half:?}"
    );
    assert!(
        (whole.1 / half.1 - 1.0).abs() < 0.01,
        "stretch {whole:?} {half:?}"
    );
    assert!((whole.2 - half.2).abs() < 2e-5, "rise {whole:?} {half:?}");
}

#[test]
fn bar_swings_at_the_beams_first_frequency() {
    let mut material = flap_config().material;
    material.drag_per_s = 0.0;
    let (length_m, cells) = (0.02_f64, 20_u32);
    // Two fixed columns: the wall is half way between them.
    let spacing_m = length_m / (f64::from(cells) + 0.5);
    let shape = SheetShape {
        size_m: [spacing_m * f64::from(cells + 1), 0.003],
        cells: [21, 1],
    };
    let mut sheet = Sheet::new(&shape, &material, &Pose::identity(), Vector3::zeros());
    for j in 0..2 {
        for i in 0..2 {
            sheet.fix(sheet.node(i, j));
        }
    }
    // A push along about the first mode; the others fade by the inner damping.
    let end = sheet.node(21, 0);
    for index in 0..sheet.positions.len() {
        let share = (sheet.positions[index].x / length_m).powi(2);
        sheet.velocities[index] =
            Vector3::z() * (0.01 * share * sheet.inverse_masses[index].min(1.0));
    }
    let dt_s = 2e-5;
    let mut crossings_s = Vec::new();
    for step in 0..100_000_u32 {
        let before = sheet.positions[end].z;
        run(&mut sheet, dt_s, 1);
        let after = sheet.positions[end].z;
        if before < 0.0 && after >= 0.0 {
            crossings_s.push(dt_s * (f64::from(step) + before / (before - after)));
        }
    }
    let last = crossings_s.len() - 1;
    let rad_s = core::f64::consts::TAU * f64::from(u32::try_from(last).unwrap())
        / (crossings_s[last] - crossings_s[0]);
    let stiff = material.young_pa * material.thickness_m.powi(2) / (12.0 * material.density_kg_m3);
    let expected_rad_s = 1.8751_f64.powi(2) * stiff.sqrt() / length_m.powi(2);
    assert!(last >= 8, "{last} swings");
    assert!(
        (rad_s / expected_rad_s - 1.0).abs() < 0.01,
        "{rad_s} of {expected_rad_s}"
    );
}
