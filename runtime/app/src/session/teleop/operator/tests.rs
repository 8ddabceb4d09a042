//! A simulated operator is what its figures say.

use hal::Pose;
use trocar_tasks::simulation::{Rendering, Simulation};
use trocar_tasks::task::TaskConfig;

use super::corrections::{Corrections, blend, moved};
use super::noise::{Noise, Tremor};
use super::*;
use nalgebra::Vector3;

const MS: u64 = 1_000_000;

/// What is seen at t is the scene of t - 80 ms, and nothing before there is one.
#[test]
fn the_scene_is_seen_as_it_was_80_ms_ago() {
    let task = TaskConfig::built_in("needle-lift").unwrap();
    let mut scene = Simulation::new(&task, 1, Rendering::Off)
        .unwrap()
        .scene_state();
    let mut sight = Sight::new(OperatorFigures::default().delay_ms);
    for look in 0..100_u64 {
        let now = TimeNs(8 * MS * look);
        scene.first.tip_in_rcm.translation.x = now.seconds();
        let seen = sight.look(now, &scene);
        let then = (look >= 10).then(|| TimeNs(now.0 - 80 * MS));
        assert_eq!(seen.map(|(then, _)| then), then, "{look}");
        let place = seen.map(|(_, scene)| scene.first.tip_in_rcm.translation.x);
        assert_eq!(place, then.map(TimeNs::seconds), "{look}");
    }
    let now = TimeNs(8 * MS);
    let at_once = Sight::new(0).look(now, &scene).map(|(then, _)| then);
    assert_eq!(at_once, Some(now));
}

/// Tremor has the amplitude that it is asked for, in its band.
#[test]
fn tremor_is_as_large_and_as_fast_as_asked() {
    for seed in 0..4 {
        let tremor = Tremor::new(1e-4, [8.0, 12.0], &mut Rng::new(seed));
        let steps: u32 = 60_000;
        let places: Vec<_> = (0..steps)
            .map(|step| tremor.at(f64::from(step) * 1e-3))
            .collect();
        let power: f64 = places.iter().map(Vector3::norm_squared).sum();
        let rms = (power / f64::from(steps)).sqrt();
        assert!((0.9e-4..1.1e-4).contains(&rms), "{rms}");
        let crosses = |pair: &&[Vector3<f64>]| pair[0].x * pair[1].x < 0.0;
        let hertz = places.windows(2).filter(crosses).count() / 2 / 60;
        assert!((8..=12).contains(&hertz), "{hertz} Hz");
    }
}

/// How far off a minimum-jerk movement over 1 m in `seconds` ends, rms along one axis, m.
fn end_error(seconds: f64) -> f64 {
    let figures = OperatorFigures::default();
    let error = |seed| {
        let mut noise = Noise::new(&figures, Rng::new(seed));
        let mut at = Vector3::zeros();
        let mut time = 0.0;
        while time < seconds {
            let share = blend((time + MESSAGE_S) / seconds) - blend(time / seconds);
            let ([way, _], _) = noise.step(
                [Vector3::x() * share, Vector3::zeros()],
                &figures,
                MESSAGE_S,
            );
            at += way;
            time += MESSAGE_S;
        }
        (at - Vector3::x()).norm_squared() / 3.0
    };
    ((0..400).map(error).sum::<f64>() / 400.0).sqrt()
}

/// A way of one second ends 4 % off, a faster one further off: as the documentation of the figures
/// says.
#[test]
fn errors_grow_with_speed() {
    let [slow, fast] = [1.0, 0.5].map(end_error);
    assert!((0.034..0.046).contains(&slow), "{slow}");
    let ratio = fast / slow;
    assert!((1.25..1.5).contains(&ratio), "{fast} after {slow}");
}

/// A tip that is seen to be off is brought back by movements one after another, though it is seen
/// late and the arm follows late.
#[test]
fn what_is_off_is_corrected() {
    let figures = OperatorFigures::default();
    let wanted = Pose::translation(0.0, 0.0, -0.1);
    let off = [
        Vector3::new(0.004, -0.003, 0.0),
        Vector3::new(0.0, 0.0, 0.2),
    ];
    let late_ns = 80 * MS + 60 * MS;
    let mut corrections = Corrections::default();
    let mut tips = vec![moved(&wanted, off)];
    let mut begun = 0;
    for step in 1..120_u64 {
        let now = TimeNs(16 * MS * step);
        let added = corrections.step(now, &wanted, &figures);
        tips.push(moved(tips.last().unwrap(), added));
        // Where the arm was when it is seen.
        let before = (16 * MS * step).saturating_sub(late_ns) / (16 * MS);
        let seen = &tips[usize::try_from(before).unwrap()];
        let idle = !corrections.any();
        corrections.look(now, (TimeNs(now.0.saturating_sub(80 * MS)), seen), &figures);
        begun += u32::from(idle && corrections.any());
    }
    let tip = tips.last().unwrap();
    let left_m = (tip.translation.vector - wanted.translation.vector).norm();
    assert!(left_m < figures.near_m, "{left_m}");
    assert!(tip.rotation.angle_to(&wanted.rotation) < figures.near_rad);
    assert!((1..=3).contains(&begun), "{begun} corrections");
}
