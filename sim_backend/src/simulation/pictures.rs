//! Tests of what the tasks look like, and that looking changes nothing.

use hal::CameraFrame;

use super::{Rendering, Simulation};
use crate::cameras::SceneSnapshot;
use crate::task::{SIDE, TaskConfig};
use crate::visual::instance;

/// What endoscope and side camera together must show of a task at its start: instance ids with least counts of pixels.
fn visible(task: &str) -> Vec<(u8, usize)> {
    let first = [(instance::SHAFT, 300), (instance::JAW, 500)];
    let (ground, needle) = ((instance::ORGAN, 40_000), (instance::NEEDLE, 500));
    let own = match task {
        "needle-lift" | "suture-pad" => vec![ground, needle],
        "needle-handover" => vec![
            ground,
            needle,
            (instance::SECOND_SHAFT, 300),
            (instance::SECOND_JAW, 500),
        ],
        "block-transfer" => vec![
            ground,
            (instance::BLOCK, 1_500),
            (instance::PEG, 1_000),
            (instance::GOAL_PEG, 150),
        ],
        "tissue-retraction" => vec![ground, (instance::TISSUE, 30_000), (instance::MARK, 200)],
        other => panic!("say what {other} shows"),
    };
    own.into_iter().chain(first).collect()
}

/// Mean colour of the pixels of one id.
fn colour(frame: &CameraFrame, id: u8) -> [f64; 3] {
    let (mut sums, mut count) = ([0.0; 3], 0.0);
    for (pixel, _) in frame
        .colour
        .chunks_exact(3)
        .zip(&frame.instance)
        .filter(|(_, seen)| **seen == id)
    {
        count += 1.0;
        for (sum, byte) in sums.iter_mut().zip(pixel) {
            *sum += f64::from(*byte);
        }
    }
    sums.map(|sum| sum / count)
}

/// 0 for grey, 1 for a pure colour.
fn saturation(colour: [f64; 3]) -> f64 {
    let [high, low] = [f64::max, f64::min].map(|of| colour.into_iter().fold(colour[0], of));
    (high - low) / high
}

/// What tells organs and tools apart must be in the picture: hues, greys, light and dark.
fn check_colours(task: &str, frame: &CameraFrame) {
    let of = |id| colour(frame, id);
    let ground = of(instance::ORGAN);
    let [red, green, blue] = ground;
    let told = |holds: bool, what: &str| assert!(holds, "{task}: {what}, ground {ground:?}");
    if frame.instance.contains(&0) {
        let dim = (4.0..110.0).contains(&of(0)[0]);
        told(dim, "the backdrop is dim, no void");
    }
    told(saturation(of(instance::JAW)) < 0.3, "jaws are steel");
    match task {
        "needle-lift" => {
            told(red > 1.6 * green && red > 110.0, "muscle is bright red");
        }
        "needle-handover" => {
            told(red > 1.5 * green, "liver is red-brown");
            told((25.0..135.0).contains(&red), "and dark");
        }
        "tissue-retraction" => {
            let [skin, mark] = [of(instance::TISSUE), of(instance::MARK)];
            told(red > 1.5 * green, "liver and body are red");
            told((0.1..0.5).contains(&saturation(skin)), "skin is pale");
            told(skin[0] > 1.3 * red, "and lighter than the liver");
            told(saturation(mark) > saturation(skin) + 0.2, "the mark is red");
        }
        "suture-pad" => {
            told(red > green && green > blue, "silicone has the hue of skin");
            told((0.15..0.6).contains(&saturation(ground)), "and is pale");
        }
        "block-transfer" => {
            told(saturation(ground) < 0.12, "the board is grey");
            let [red, green, blue] = of(instance::GOAL_PEG);
            told(red > 2.0 * green && blue > 1.3 * green, "the goal is pink");
            told(saturation(of(instance::PEG)) < 0.2, "other pegs are not");
            let [red, _, blue] = of(instance::BLOCK);
            told(blue > 2.0 * red, "the block is blue");
        }
        other => panic!("say what tells the parts of {other} apart"),
    }
    if frame.instance.contains(&instance::NEEDLE) {
        let needle = of(instance::NEEDLE);
        told(saturation(needle) < 0.3, "the needle is steel");
        told(
            saturation(needle) < saturation(ground) - 0.1,
            "unlike what it lies on",
        );
    }
}

#[test]
fn every_task_shows_all_of_its_parts() {
    for name in TaskConfig::names() {
        let task = TaskConfig::shipped(name);
        let mut simulation = Simulation::new(&task, 1, Rendering::On).unwrap();
        let mut frame = simulation.cameras().unwrap().blank_frame(0).unwrap();
        simulation.render(0, &mut frame).unwrap();
        // From so steeply above, wrists hide most of jaws that point down, and little is seen of what is behind.
        let side = simulation.cameras().unwrap().find(SIDE).unwrap();
        let mut other = simulation.cameras().unwrap().blank_frame(side).unwrap();
        simulation.render(side, &mut other).unwrap();
        if let Some(folder) = std::env::var_os("TROCAR_TASK_SAMPLES") {
            let mut picture = b"P6 512 512 255\n".to_vec();
            picture.extend(&frame.colour);
            let path = std::path::Path::new(&folder).join(format!("{name}.ppm"));
            std::fs::write(path, picture).unwrap();
        }
        frame.colour.extend(&other.colour);
        frame.instance.extend(&other.instance);
        for (id, least) in visible(name) {
            let pixels = frame.instance.iter().filter(|&&seen| seen == id).count();
            assert!(pixels >= least, "{name}: {pixels} pixels of instance {id}");
        }
        check_colours(name, &frame);
    }
}

#[test]
fn a_flap_is_drawn_where_it_has_gone() {
    let task = TaskConfig::shipped("tissue-retraction");
    let mut simulation = Simulation::new(&task, 1, Rendering::On).unwrap();
    let mut frame = simulation.cameras().unwrap().blank_frame(0).unwrap();
    let flat = simulation.snapshot();
    // Lifted by 2 cm as a whole: more than any lens would miss.
    let raised = SceneSnapshot {
        flap: flat.flap.map(|flap| flap.moved([0.0, 0.0, 0.02])),
        ..flat
    };
    let cameras = simulation.cameras.as_mut().unwrap();
    let mut mean_depth_m = |snapshot: &SceneSnapshot, id: u8| {
        cameras.render(0, snapshot, &mut frame).unwrap();
        let seen = frame.instance.iter().zip(&frame.depth_m);
        let depths: Vec<f64> = seen
            .filter(|(seen, _)| **seen == id)
            .map(|(_, depth_m)| f64::from(*depth_m))
            .collect();
        let count = u32::try_from(depths.len()).unwrap();
        depths.iter().sum::<f64>() / f64::from(count)
    };
    let low_m = mean_depth_m(&flat, instance::MARK);
    let high_m = mean_depth_m(&raised, instance::MARK);
    // The endoscope looks down at 57 degrees.
    assert!(
        (0.012..0.019).contains(&(low_m - high_m)),
        "{low_m} {high_m}"
    );
    let high_m = mean_depth_m(&raised, instance::TISSUE);
    let low_m = mean_depth_m(&flat, instance::TISSUE);
    assert!(
        (0.012..0.022).contains(&(low_m - high_m)),
        "{low_m} {high_m}"
    );
    let again_m = mean_depth_m(&flat, instance::TISSUE);
    assert!((again_m - low_m).abs() < 1e-12);
}

#[test]
fn looking_changes_nothing() {
    for name in TaskConfig::names() {
        let task = TaskConfig::shipped(name);
        let hash = |rendering| {
            let mut simulation = Simulation::new(&task, 3, rendering).unwrap();
            for step in 0..100 {
                if rendering == Rendering::On && step % 40 == 0 {
                    let mut frame = simulation.cameras().unwrap().blank_frame(0).unwrap();
                    simulation.render(0, &mut frame).unwrap();
                }
                simulation.step();
            }
            simulation.state_hash()
        };
        assert_eq!(hash(Rendering::On), hash(Rendering::Off), "{name}");
    }
}
