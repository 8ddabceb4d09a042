//! What an operator sees: the scene as it was.

use std::collections::VecDeque;

use hal::TimeNs;
use trocar_tasks::scene::SceneState;

/// Scenes of the last moments.
#[derive(Clone, Debug)]
pub(super) struct Sight {
    delay_ns: u64,
    scenes: VecDeque<(TimeNs, SceneState)>,
}

impl Sight {
    /// One that comes `delay_ms` late.
    pub(super) const fn new(delay_ms: u64) -> Self {
        Self {
            delay_ns: delay_ms * 1_000_000,
            scenes: VecDeque::new(),
        }
    }

    /// This is how the scene is `now`; the newest that is old enough to be seen, and when it was
    /// so.
    pub(super) fn look(&mut self, now: TimeNs, scene: &SceneState) -> Option<(TimeNs, SceneState)> {
        self.scenes.push_back((now, *scene));
        let is_seen = |(at, _): &(TimeNs, SceneState)| now.since(*at) >= self.delay_ns;
        while self.scenes.get(1).is_some_and(is_seen) {
            self.scenes.pop_front();
        }
        self.scenes.front().copied().filter(is_seen)
    }
}
