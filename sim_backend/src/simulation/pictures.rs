//! Tests of what the tasks look like, and that looking changes nothing.

use super::{Rendering, Simulation};
use crate::task::TaskConfig;
use crate::visual::instance;

/// What the first camera must show of a task at its start: instance ids with least counts of pixels.
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
        other => panic!("say what {other} shows"),
    };
    own.into_iter().chain(first).collect()
}

#[test]
fn every_task_shows_all_of_its_parts() {
    for name in TaskConfig::names() {
        let task = TaskConfig::parse(&TaskConfig::source(name).unwrap()).unwrap();
        let mut simulation = Simulation::new(&task, 1, Rendering::On).unwrap();
        let mut frame = simulation.cameras().unwrap().blank_frame(0).unwrap();
        simulation.render(0, &mut frame).unwrap();
        if let Some(folder) = std::env::var_os("TROCAR_TASK_SAMPLES") {
            let mut picture = b"P6 512 512 255\n".to_vec();
            picture.extend(&frame.colour);
            let path = std::path::Path::new(&folder).join(format!("{name}.ppm"));
            std::fs::write(path, picture).unwrap();
        }
        for (id, least) in visible(name) {
            let pixels = frame.instance.iter().filter(|&&seen| seen == id).count();
            assert!(pixels >= least, "{name}: {pixels} pixels of instance {id}");
        }
    }
}

#[test]
fn looking_changes_nothing() {
    for name in TaskConfig::names() {
        let task = TaskConfig::parse(&TaskConfig::source(name).unwrap()).unwrap();
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
