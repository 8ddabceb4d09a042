//! How things lie when an episode begins: at rest, or else laid elsewhere.

use trocar_world::World;
use trocar_world::rng::Rng;

use super::{TaskConfig, TaskScene};

/// Time that things get to come to rest before the episode begins, ms.
const SETTLE_STEPS: u32 = 250;

/// Speed of a thing after that time above which it slides over a patient's organ, m/s.
const SLIDES_M_S: f64 = 0.001;

/// Places that are tried on a patient's organ before a thing that slides is left where it is.
const LAID_MAX: usize = 20;

/// Episodes of which one must begin at rest on a patient.
const EPISODES: u64 = 3;

/// The world of the episode `seed` after things have come to rest: what slides over a patient's organ is laid elsewhere.
pub(crate) fn settled(task: &TaskConfig, scene: &dyn TaskScene, seed: u64) -> World {
    let laid = |place: u64| {
        let mut world = World::new(&task.world, &scene.scenery(place), &task.arms);
        for _ in 0..SETTLE_STEPS {
            world.step();
        }
        world
    };
    let mut world = laid(seed);
    if scene.patient().is_some() {
        let mut places = Rng::stream(seed, "another place");
        for _ in 1..LAID_MAX {
            if !slides(&world) {
                break;
            }
            world = laid(places.next_u64());
        }
    }
    world
}

/// Whether things slide off the patient's organ wherever they are laid.
pub(super) fn always_slides(task: &TaskConfig) -> bool {
    let scene = &*task.scene;
    let lies = |seed| !slides(&settled(task, scene, seed));
    scene.patient().is_some() && !scene.scenery(0).things.is_empty() && !(0..EPISODES).any(lies)
}

fn slides(world: &World) -> bool {
    (0..world.thing_count()).any(|thing| world.thing_velocity(thing)[0].norm() > SLIDES_M_S)
}
