//! Facts about what is varied: how far, on what that hangs, and that nothing else changes.

use super::*;
use crate::cameras::SceneCameras;
use crate::simulation::{Rendering, Simulation};
use crate::task::Outcome;
use hal::{CameraFrame, Distortion};
use trocar_render::visual::instance;

/// Two arms, and tissue that bends: opening a renderer takes seconds.
const DIFFERENT: [&str; 2] = ["needle-handover", "tissue-retraction"];

/// A built-in task with small pictures.
fn small(name: &str) -> TaskConfig {
    let mut task = TaskConfig::shipped(name);
    for camera in &mut task.cameras {
        (camera.width, camera.height) = (96, 96);
    }
    task
}

fn varied(name: &str, variations: &[Variation]) -> TaskConfig {
    small(name).with_variations(variations).unwrap()
}

/// What all cameras see at the start of the episode `seed`; and the cameras for the next.
fn frames(
    task: &TaskConfig,
    seed: u64,
    cameras: Option<SceneCameras>,
) -> (Vec<CameraFrame>, Option<SceneCameras>) {
    let mut simulation = match cameras {
        Some(cameras) => Simulation::with_cameras(task, seed, cameras),
        None => Simulation::new(task, seed, Rendering::On).unwrap(),
    };
    let cameras = simulation.cameras().unwrap();
    let mut frames: Vec<CameraFrame> = (0..cameras.count())
        .map(|camera| cameras.blank_frame(camera).unwrap())
        .collect();
    let which: Vec<usize> = (0..frames.len()).collect();
    simulation.render_all(&which, &mut frames).unwrap();
    (frames, simulation.into_cameras())
}

fn planes(frames: &[CameraFrame]) -> Vec<(&[u8], &[f32], &[u8])> {
    frames
        .iter()
        .map(|frame| {
            let (colour, depth_m) = (frame.colour.as_slice(), frame.depth_m.as_slice());
            (colour, depth_m, frame.instance.as_slice())
        })
        .collect()
}

#[test]
fn nothing_varied_draws_nothing() {
    for name in TaskConfig::names() {
        let task = TaskConfig::shipped(name);
        assert_eq!(task.drawn(7), Drawn::default(), "{name}");
    }
}

#[test]
fn needles_are_drawn_evenly_and_are_the_episodes() {
    let task = varied("needle-lift", &[Variation::Needles]);
    let mut counts = BTreeMap::<String, u32>::new();
    for seed in 0..1000 {
        let needle = task.drawn(seed).needle.unwrap();
        assert_eq!(task.scene_of(seed).needle(), Some(needle.as_str()));
        *counts.entry(needle).or_default() += 1;
    }
    let names: Vec<_> = counts.keys().map(String::as_str).collect();
    assert_eq!(names, ["N1", "N2", "N3", "N4", "N5"]);
    assert!(
        counts.values().all(|count| (150..250).contains(count)),
        "{counts:?}"
    );
}

#[test]
fn expert_lifts_the_needle_that_is_drawn() {
    use crate::closed_loop::run;
    let task = varied("needle-lift", &Variation::ALL);
    for seed in 0..4 {
        let needle = task.drawn(seed).needle.unwrap();
        let chosen = TaskConfig::shipped("needle-lift").with_needle(&needle);
        let (episode, expected) = (
            run(&task, seed, |_, _| {}),
            run(&chosen.unwrap(), seed, |_, _| {}),
        );
        assert_eq!(episode.outcome, Outcome::Success, "{needle}");
        assert_eq!(episode.state_hash, expected.state_hash, "{needle}");
    }
}

#[test]
fn pictures_show_the_needle_that_is_drawn() {
    let task = varied("needle-lift", &[Variation::Needles]);
    let mut cameras = None;
    for seed in 0..6 {
        let needle = task.drawn(seed).needle.unwrap();
        let chosen = small("needle-lift").with_needle(&needle).unwrap();
        let (seen, used) = frames(&task, seed, cameras);
        cameras = used;
        let (expected, _) = frames(&chosen, seed, None);
        assert!(planes(&seen) == planes(&expected), "seed {seed}, {needle}");
        let shown = seen[0].instance.contains(&instance::NEEDLE);
        assert!(shown, "seed {seed}, {needle}");
    }
}

#[test]
fn light_changes_colours_alone() {
    for name in DIFFERENT {
        let (plain, lit) = (small(name), varied(name, &[Variation::Light]));
        let (before, cameras) = frames(&plain, 3, None);
        let (seen, cameras) = frames(&lit, 3, cameras);
        for (seen, before) in seen.iter().zip(&before) {
            assert_ne!(seen.colour, before.colour, "{name}");
            assert_eq!(seen.instance, before.instance, "{name}");
            assert!(seen.depth_m == before.depth_m, "{name}");
        }
        let (another, cameras) = frames(&lit, 4, cameras);
        assert_ne!(another[0].colour, seen[0].colour, "{name}");
        let (again, cameras) = frames(&lit, 3, cameras);
        assert!(planes(&again) == planes(&seen), "{name}");
        // Nothing of it is left.
        let (after, _) = frames(&plain, 3, cameras);
        assert!(planes(&after) == planes(&before), "{name}");
    }
}

/// Depth and ids go with the distorted picture, the plain one comes back, and the same seed sees
/// the same.
#[test]
fn lenses_are_the_episodes() {
    for name in DIFFERENT {
        let (plain, worn) = (small(name), varied(name, &[Variation::Lens]));
        let (before, cameras) = frames(&plain, 3, None);
        let (seen, cameras) = frames(&worn, 3, cameras);
        let drawn = worn.drawn(3).lenses;
        for ((camera, seen), before) in worn.cameras.iter().zip(&seen).zip(&before) {
            let drawn = Distortion::new(drawn[&camera.name].distortion);
            assert_eq!(seen.intrinsics.distortion, drawn, "{name}");
            assert_eq!(seen.intrinsics.pinhole(), before.intrinsics, "{name}");
            assert_ne!(seen.colour, before.colour, "{name}");
            assert_ne!(seen.depth_m, before.depth_m, "{name}");
        }
        let (another, cameras) = frames(&worn, 4, cameras);
        assert_ne!(another[0].colour, seen[0].colour, "{name}");
        let (again, cameras) = frames(&worn, 3, cameras);
        assert!(planes(&again) == planes(&seen), "{name}");
        let (after, _) = frames(&plain, 3, cameras);
        assert!(planes(&after) == planes(&before), "{name}");
    }
}

/// A lens of the scene file dims its own camera's corners, and what is drawn takes its share of
/// what that lets through.
#[test]
fn the_scene_files_vignette_is_in_every_episode() {
    let plain = small("block-transfer");
    assert!(plain.cameras.iter().all(|camera| camera.vignette <= 0.0));
    let mut dim = plain.clone();
    dim.cameras[0].vignette = 0.8;
    let (before, cameras) = frames(&plain, 3, None);
    let (seen, _) = frames(&dim, 3, cameras);
    let bytes = |frame: &CameraFrame| -> u64 {
        let bytes = frame.colour.iter();
        bytes.map(|byte| u64::from(*byte)).sum()
    };
    let [now, clean] = [&seen[0], &before[0]].map(bytes);
    assert!(100 * now < 98 * clean, "{now} {clean}");
    let middle = 3 * (96 * 48 + 48);
    for (now, clean) in seen[0].colour[middle..middle + 3]
        .iter()
        .zip(&before[0].colour[middle..middle + 3])
    {
        assert!(now.abs_diff(*clean) < 3, "{now} {clean}");
    }
    assert_eq!(seen[0].depth_m, before[0].depth_m);
    assert!(planes(&seen[1..]) == planes(&before[1..]));
    let name = plain.cameras[0].name.clone();
    let vary = |task: &TaskConfig, effect| task.clone().with_variations(&[effect]).unwrap();
    let drawn = |task: &TaskConfig, seed| task.drawn(seed).lenses[&name].vignette;
    let [clean, worn] = [&plain, &dim].map(|task| vary(task, Variation::Vignette));
    let exposed = vary(&dim, Variation::Exposure);
    for seed in 0..20 {
        let left = 0.2 * (1.0 - drawn(&clean, seed));
        assert!((1.0 - drawn(&worn, seed) - left).abs() < 1e-12);
        assert!((drawn(&exposed, seed) - 0.8).abs() < 1e-12);
    }
}

/// Smoke alone changes colours alone, and only in the episodes that have some.
#[test]
fn smoke_can_be_alone() {
    let (plain, smoky) = (
        small("block-transfer"),
        varied("block-transfer", &[Variation::Smoke]),
    );
    let amount = |seed: &u64| smoky.drawn(*seed).lenses["endoscope"].smoke_per_m;
    let clear = (0..100).find(|seed| amount(seed) <= 0.0).unwrap();
    let thick = (0..100).find(|seed| amount(seed) > 1.0).unwrap();
    let mut cameras = None;
    for (seed, is_clear) in [(clear, true), (thick, false)] {
        let (before, used) = frames(&plain, seed, cameras);
        let (seen, used) = frames(&smoky, seed, used);
        cameras = used;
        for (seen, before) in seen.iter().zip(&before) {
            assert_eq!(seen.colour == before.colour, is_clear, "seed {seed}");
            assert_eq!(seen.intrinsics, before.intrinsics);
            assert_eq!(seen.instance, before.instance);
            assert!(seen.depth_m == before.depth_m);
        }
    }
}

/// A sensor's noise is another one a millisecond later, though nothing moves that one could see.
#[test]
fn noise_goes_with_time() {
    let task = varied("block-transfer", &[Variation::Lens]);
    let mut simulation = Simulation::new(&task, 1, Rendering::On).unwrap();
    let shoot = |simulation: &mut Simulation| {
        let mut frame = simulation.cameras().unwrap().blank_frame(0).unwrap();
        simulation.render(0, &mut frame).unwrap();
        frame.colour
    };
    let first = shoot(&mut simulation);
    assert!(shoot(&mut simulation) == first, "at the same instant");
    simulation.step();
    let second = shoot(&mut simulation);
    let apart = first.iter().zip(&second).filter(|(a, b)| a != b).count();
    assert!(apart > first.len() / 4, "{apart}");
}

#[test]
fn looks_keep_to_their_bounds_and_use_them() {
    let task = varied("block-transfer", &[Variation::Light]);
    let mut extremes = [[0.0_f64; 2]; 7];
    for seed in 0..2000 {
        let look = task.drawn(seed).light.unwrap();
        let [x, y] = look.guide_shift_m.map(|shift| shift / GUIDE_SHIFT_M);
        let [a, b] = look.guide_turn_rad.map(|turn| turn / GUIDE_TURN_RAD);
        let intensity = look.intensity.ln() / INTENSITY_FACTOR.ln();
        let ambient = look.ambient.ln() / AMBIENT_FACTOR.ln();
        let values = [x, y, a, b, intensity, ambient, look.warmth / WARMTH];
        for (value, [low, high]) in values.into_iter().zip(&mut extremes) {
            assert!(value.abs() <= 1.0 + 1e-9, "seed {seed}: {value}");
            *low = low.min(value);
            *high = high.max(value);
        }
        let most = BRIGHTNESS_FACTOR * (1.0 + TINT) + 1e-6;
        let least = (1.0 - TINT) / BRIGHTNESS_FACTOR - 1e-6;
        let factors = look.tints.values().flatten();
        assert!(
            factors
                .map(|&it| f64::from(it))
                .all(|it| (least..most).contains(&it))
        );
    }
    for [low, high] in extremes {
        assert!(low < -0.98 && high > 0.98, "{low} {high}");
    }
}

#[test]
fn views_are_those_of_view1_and_are_told() {
    let task = varied("suture-pad", &[Variation::Views]);
    assert_eq!(task.view, View::View1);
    let drawn = task.drawn(5).cameras;
    let names: Vec<_> = drawn.keys().map(String::as_str).collect();
    assert_eq!(names, ["endoscope", "side"]);
    let camera = task.cameras.iter().find(|camera| camera.name == "side");
    let shift = View::View1.shift(camera.unwrap(), 5);
    assert_eq!(drawn["side"][..3], *shift.translation.vector.as_slice());
    assert_ne!(drawn, task.drawn(6).cameras);
}

#[test]
fn what_cannot_be_varied_is_refused_with_what_can() {
    let error = small("suture-pad")
        .with_variations(&Variation::ALL)
        .unwrap_err();
    assert_eq!(
        error.to_string(),
        "suture-pad has no choice of needles; it can vary views, light, lens"
    );
    let seen = small("needle-lift").with_view(View::View2).unwrap();
    let error = seen.with_variations(&[Variation::Views]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "needle-lift has its cameras moved by the view already; it can vary needles, light, lens"
    );
}
