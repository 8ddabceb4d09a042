//! How things lie when an episode begins: at rest, or else laid elsewhere.
//!
//! A thing starts a tenth of a millimetre above the ground, and gets 250 ms to settle, the arms
//! standing at their start. On made-up ground that is all. On a patient's organ, which may be
//! steep, one that then still slides is laid at another place drawn by the seed; the 20th is taken
//! as it is. So an episode's start costs at most 20 times 250 steps of physics, and is the same for
//! the same seed.

use trocar_world::rng::Rng;
use trocar_world::{ArmStart, Scenery, World, WorldConfig};

use super::{TaskConfig, TaskScene};

/// Time that things get to come to rest before the episode begins, ms.
const SETTLE_STEPS: u32 = 250;

/// Speed of a thing after that time above which it slides over a patient's organ, m/s.
const SLIDES_M_S: f64 = 0.001;

/// Places that are tried on a patient's organ before a thing that slides is left where it is.
const LAID_MAX: usize = 20;

/// Episodes of which one must begin at rest on a patient.
const EPISODES: u64 = 3;

/// The world of the episode `seed` after things have come to rest: what slides over a patient's
/// organ is laid elsewhere.
pub(crate) fn settled(task: &TaskConfig, scene: &dyn TaskScene, seed: u64) -> World {
    let scenery = |place| scene.scenery(place);
    if scene.patient().is_some() {
        laid(&task.world, &task.arms, &scenery, seed)
    } else {
        after_settling(&task.world, &task.arms, &scenery(seed))
    }
}

/// Whether the things of `scenery` come to rest on a patient's organ in one of the first episodes
/// at least. Up to 60 worlds are settled for a no.
pub(super) fn rests(
    config: &WorldConfig,
    arms: &[ArmStart],
    scenery: impl Fn(u64) -> Scenery,
) -> bool {
    (0..EPISODES).any(|seed| !slides(&laid(config, arms, &scenery, seed)))
}

/// The world in which things are at rest on a patient's organ, at the first of some places where
/// they are.
fn laid(
    config: &WorldConfig,
    arms: &[ArmStart],
    scenery: &impl Fn(u64) -> Scenery,
    seed: u64,
) -> World {
    let mut world = after_settling(config, arms, &scenery(seed));
    let mut places = Rng::stream(seed, "another place");
    for _ in 1..LAID_MAX {
        if !slides(&world) {
            break;
        }
        world = after_settling(config, arms, &scenery(places.next_u64()));
    }
    world
}

/// The world of `scenery` when [`SETTLE_STEPS`] have passed without a command to any arm.
pub(super) fn after_settling(config: &WorldConfig, arms: &[ArmStart], scenery: &Scenery) -> World {
    let mut world = World::new(config, scenery, arms);
    for _ in 0..SETTLE_STEPS {
        world.step();
    }
    world
}

/// Whether any thing's centre of mass moves faster than [`SLIDES_M_S`]; rotation does not count.
fn slides(world: &World) -> bool {
    (0..world.thing_count()).any(|thing| world.thing_velocity(thing)[0].norm() > SLIDES_M_S)
}
