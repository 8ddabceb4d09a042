//! Inside all limits nothing is changed.

use core::f64::consts::TAU;

use nalgebra::Vector3;

use super::{follow, home_m, target};
use crate::QpOutcome;
use crate::tests::adversary::rig::{Rig, Scene};
use hal::random::SplitMix64;

/// A smooth motion near home that breaks nothing: a few sines.
#[derive(Clone, Copy)]
struct Sines([[f64; 3]; 6]);

impl Sines {
    fn new(random: &mut SplitMix64) -> Self {
        Self(core::array::from_fn(|index| {
            let amplitude = if index < 3 { 0.004 } else { 0.25 };
            [
                random.between(0.2, 1.0) * amplitude,
                random.between(0.1, 0.7),
                random.between(0.0, TAU),
            ]
        }))
    }

    fn at(&self, time_s: f64) -> [f64; 6] {
        self.0.map(|[amplitude, frequency_hz, phase]| {
            amplitude * ((TAU * frequency_hz * time_s + phase).sin() - phase.sin())
        })
    }
}

fn nothing_is_changed<const ARMS: usize>(seed: u64) {
    let scene = Scene::of_arms(ARMS);
    let mut random = SplitMix64::new(seed);
    let (mut ticks, mut solved, mut intervened) = (0_u64, 0_u64, 0_u64);
    let mut change = 0.0_f64;
    for _ in 0..10 {
        let mut rig = Rig::<ARMS>::enabled(&scene.config);
        let motions: [Sines; ARMS] = core::array::from_fn(|_| Sines::new(&mut random));
        let path = |arm: usize, time_s: f64| {
            let [x, y, z, roll, pitch, yaw] = motions[arm].at(time_s);
            target(
                home_m() + Vector3::new(x, y, z),
                Vector3::new(roll, pitch, yaw),
            )
        };
        follow(&mut rig, 8.0, path, |_, outputs| {
            ticks += 1;
            for output in outputs {
                solved += u64::from(output.report.qp != QpOutcome::NotNeeded);
                intervened += u64::from(output.report.guard_intervened);
                change = change.max(output.report.correction);
            }
        });
    }
    println!(
        "minimal intervention, {ARMS} arms: {ticks} ticks, solved {solved}, guard {intervened}, change {change:e}"
    );
    assert_eq!((solved, intervened), (0, 0));
    assert!(change <= 1e-9, "{change}");
}

#[test]
fn a_motion_inside_all_limits_passes_unchanged() {
    nothing_is_changed::<1>(501);
}

#[test]
fn motions_of_two_arms_inside_all_limits_pass_unchanged() {
    nothing_is_changed::<2>(502);
}
