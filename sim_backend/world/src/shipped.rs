//! The physics of the tasks as they ship, for tests.

use hal::config::Source;
use serde::Deserialize;

use crate::WorldConfig;

/// The part of a scene file that is about the world; what else is in it belongs to the task.
#[derive(Deserialize)]
struct SceneFile {
    world: WorldConfig,
}

/// Drives and contact physics of the task `task`.
pub(crate) fn world(task: &str) -> WorldConfig {
    let root = env!("CARGO_MANIFEST_DIR");
    let source = Source::read(&format!("{root}/../../config/tasks/{task}/scene.toml")).unwrap();
    let file: SceneFile = source.parse().unwrap();
    file.world.check(&source, "world").unwrap();
    file.world
}
