//! What a run over CAN waits for before any drive gets torque: named on the terminal within a second, and not for ever.

use trocar_topics::{CameraTopic, FrameSubscriber, SceneReport, Subscriber, TopicNode};

use super::bring_up::uninterrupted;
use crate::rt::{self, MonotonicClock};
use crate::session::SessionError;

/// A world shows itself every 40 ms; one that has not done so for this long is not there, ns.
const WORLD_NS_MAX: u64 = 3_000_000_000;

/// A camera may be switched on after the run was started, ns.
const CAMERA_NS_MAX: u64 = 10_000_000_000;

/// Whoever waits for longer wants to know for what, ns.
pub(super) const PATIENCE_NS: u64 = 500_000_000;

/// Time between two looks, ns.
const POLL_NS: u64 = 1_000_000;

/// Says a line on the terminal, from any thread.
pub type Say<'a> = &'a (dyn Fn(&str) + Sync);

/// Looks until there is something, for `limit_ns` at most; `lacking` says what was not there, and what would help.
fn await_it<T>(
    what: &str,
    lacking: &str,
    limit_ns: u64,
    say: Say<'_>,
    mut look: impl FnMut() -> Result<Option<T>, SessionError>,
) -> Result<T, SessionError> {
    let clock = MonotonicClock::new();
    let mut said = false;
    while clock.now().0 < limit_ns {
        uninterrupted()?;
        if let Some(found) = look()? {
            return Ok(found);
        }
        if !said && clock.now().0 > PATIENCE_NS {
            said = true;
            say(&format!(
                "waiting for {what}, for {} s at most; no drive has torque",
                limit_ns / 1_000_000_000
            ));
        }
        rt::sleep_ns(POLL_NS);
    }
    Err(SessionError::RealTime(lacking.to_owned()))
}

/// Waits for the first sight of the world.
pub(super) fn world(
    scene: &Subscriber<SceneReport>,
    topics: &str,
    say: Say<'_>,
) -> Result<SceneReport, SessionError> {
    let what = format!("a world on topics {topics:?}");
    let lacking = format!(
        "nobody shows a scene on topics {topics:?}: start `trocar drives` first, or name its topics with --topics"
    );
    await_it(&what, &lacking, WORLD_NS_MAX, say, || Ok(scene.newest()?))
}

/// A camera by name, with the frames that it shows.
pub(super) type Camera = (String, FrameSubscriber);

/// Waits for a frame of each of the cameras `wanted`, which must have the size that is asked for, if any is.
pub(super) fn cameras(
    node: &TopicNode,
    wanted: &[(String, Option<(u32, u32)>)],
    topics: &str,
    say: Say<'_>,
) -> Result<Vec<Camera>, SessionError> {
    let mut found = Vec::new();
    for (name, size) in wanted {
        let mut topic = CameraTopic::subscriber(node, name)?;
        let what = format!("a frame of camera {name} on topics {topics:?}");
        let lacking = format!(
            "camera {name} has shown no frame on topics {topics:?} for {} s: start whoever publishes it, or name its topics with \
             --topics",
            CAMERA_NS_MAX / 1_000_000_000
        );
        let lens = await_it(&what, &lacking, CAMERA_NS_MAX, say, || {
            let frame = topic.newest()?;
            Ok(frame.map(|view| view.header().intrinsics))
        })?;
        let shown = (lens.width, lens.height);
        if let Some((width, height)) = size.filter(|size| *size != shown) {
            return Err(SessionError::BadArgument(format!(
                "camera {name} on topics {topics:?} shows {} x {} pixels, the policy was trained with {width} x {height}",
                shown.0, shown.1
            )));
        }
        found.push((name.clone(), topic));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    #[test]
    fn what_is_waited_for_is_named_once_and_given_up_in_time() {
        let lines = Mutex::new(Vec::new());
        let say = |line: &str| lines.lock().unwrap().push(line.to_owned());
        let clock = MonotonicClock::new();
        let error = await_it::<()>(
            "a camera",
            "there is no camera",
            1_000_000_000,
            &say,
            || Ok(None),
        );
        assert!(clock.now().0 >= 1_000_000_000);
        assert_eq!(error.unwrap_err().to_string(), "there is no camera");
        let said = lines.into_inner().unwrap();
        let named = "waiting for a camera, for 1 s at most; no drive has torque";
        assert_eq!(said, [named]);
    }

    #[test]
    fn what_is_there_at_once_is_not_spoken_of() {
        let say = |line: &str| panic!("{line}");
        let mut looks = 0;
        let found = await_it("it", "", 1_000_000_000, &say, || {
            looks += 1;
            Ok((looks == 3).then_some(7))
        });
        assert_eq!(found.unwrap(), 7);
    }
}
