//! What a run of arms outside of this process waits for before any of them gets torque: named on
//! the terminal within a second, and not for ever.

use trocar_tasks::scene::SceneSnapshot;
use trocar_topics::{CameraTopic, FrameSubscriber, SceneReport, Subscriber, TopicNode, Verdict};

use super::super::scene_topics::WorldTopics;
use crate::rt::{self, MonotonicClock};
use crate::session::SessionError;
use crate::session::source::{STEP_NS, SizedCamera};
use hal::TimeNs;

/// A world shows itself every 40 ms; one that has not done so for this long is not there, ns.
const WORLD_NS_MAX: u64 = 3_000_000_000;

/// A frame that was taken longer ago is none of now, ns.
pub(in super::super) const FRAME_NS_MAX: u64 = 500_000_000;

/// How far from ahead a frame may be, ns: a policy step.
pub(in super::super) const AHEAD_NS_MAX: u64 = STEP_NS;

/// A camera that has been seen shows its next frame in this time, ns.
const NEXT_FRAME_NS_MAX: u64 = 2_000_000_000;

/// A camera may be switched on after the run was started, ns.
const CAMERA_NS_MAX: u64 = 10_000_000_000;

/// Whoever waits for longer wants to know for what, ns.
///
/// Shorter waits say nothing.
pub(in super::super) const PATIENCE_NS: u64 = 500_000_000;

/// Polling period, ns.
const POLL_NS: u64 = 1_000_000;

/// Prints a line on the terminal, from any thread.
pub type PrintLine<'a> = &'a (dyn Fn(&str) + Sync);

/// Looks until there is something, for `limit_ns` at most; `lacking` says what was not there, and
/// what would help.
///
/// Polls once a millisecond. `what` completes "waiting for"; the line is said once, after half a
/// second.
///
/// # Errors
/// [`SessionError::RealTime`] with `lacking` when the time is up, or for an interrupt; any error of
/// `look` at once.
pub(super) fn await_it<T>(
    what: &str,
    lacking: &str,
    limit_ns: u64,
    say: PrintLine<'_>,
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
    (topics, host): (&str, &str),
    say: PrintLine<'_>,
) -> Result<SceneReport, SessionError> {
    let what = format!("a world on topics {topics:?}");
    let lacking = format!(
        "no publisher of a scene on topics {topics:?}: start `{host}` first, or name its topics with --topics"
    );
    await_it(&what, &lacking, WORLD_NS_MAX, say, || Ok(scene.newest()?))
}

/// Waits until it is known where everything is in the world, whose state was seen on `topics`, for
/// pages to see it; nothing of a world that does not say so.
pub(super) fn start(
    world: &WorldTopics,
    topics: &str,
    say: PrintLine<'_>,
) -> Result<Option<SceneSnapshot>, SessionError> {
    let what = format!("where everything is in the world on topics {topics:?}");
    let lacking = format!(
        "the world on topics {topics:?} does not say where everything is: the console shows no scene"
    );
    match await_it(&what, &lacking, WORLD_NS_MAX, say, || world.newest()) {
        Err(SessionError::RealTime(_)) => {
            uninterrupted()?;
            say(&lacking);
            Ok(None)
        }
        found => found.map(Some),
    }
}

/// Waits until the world reports that its drives are not operational, as ours are not once they are
/// brought up: those that are belong to another master.
pub(super) fn stopped(
    scene: &Subscriber<SceneReport>,
    clock: MonotonicClock,
    topics: &str,
    say: PrintLine<'_>,
) -> Result<(), SessionError> {
    let what = format!("the drives of the world on topics {topics:?} to be those brought up");
    let lacking = format!(
        "the drives of the world on topics {topics:?} are operational, ours are not started: are ours its own?"
    );
    let since = clock.to_system(clock.now());
    await_it(&what, &lacking, WORLD_NS_MAX, say, || {
        let newest = scene.newest()?;
        let newest = newest.filter(|report| report.stamp >= since);
        Ok(newest.and_then(|report| (report.verdict() == Verdict::Waiting).then_some(())))
    })
}

/// A camera by name, with the frames that it shows.
pub(in super::super) type Camera = (String, FrameSubscriber);

/// How far from now a frame was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Taken {
    /// Just now.
    Live,
    /// So many seconds ago.
    Ago(f64),
    /// So many seconds from now.
    Ahead(f64),
}

impl Taken {
    /// Of a frame with the system's `stamp`, at `now` by the same clock.
    ///
    /// At most 500 ms old and 40 ms ahead is live.
    fn at(stamp: TimeNs, now: TimeNs) -> Self {
        let (ago, ahead) = (now.since(stamp), stamp.since(now));
        match (ago > FRAME_NS_MAX || ahead > AHEAD_NS_MAX, ago > 0) {
            (false, _) => Self::Live,
            (true, true) => Self::Ago(TimeNs(ago).seconds()),
            (true, false) => Self::Ahead(TimeNs(ahead).seconds()),
        }
    }
}

/// What a camera showed whose frames are not of now.
///
/// For an error, such as of a camera that stamps frames by a clock of its own.
fn untimely(name: &str, topics: &str, taken: Taken) -> String {
    let when = match taken {
        Taken::Live => return format!("camera {name} on topics {topics:?}"),
        Taken::Ago(seconds) => format!("{seconds:.1} s old"),
        Taken::Ahead(seconds) => format!("stamped {seconds:.1} s ahead"),
    };
    format!(
        "frames of camera {name} on topics {topics:?} are {when}: it has to show new ones, with the time of their exposure on \
         CLOCK_MONOTONIC, in ns"
    )
}

/// Waits for the next frame of now of each of `cameras`, which have been seen before.
///
/// Bring-up takes its time, in which a camera can have gone.
pub(super) fn still_there(
    cameras: &mut [Camera],
    clock: MonotonicClock,
    topics: &str,
    say: PrintLine<'_>,
) -> Result<(), SessionError> {
    for (name, topic) in cameras {
        let what = format!("the next frame of camera {name} on topics {topics:?}");
        let lacking = format!(
            "camera {name} on topics {topics:?} has published no frame for {} s",
            NEXT_FRAME_NS_MAX / 1_000_000_000
        );
        await_it(&what, &lacking, NEXT_FRAME_NS_MAX, say, || {
            let frame = topic.newest()?;
            let now = clock.to_system(clock.now());
            Ok(frame.and_then(|view| {
                let taken = Taken::at(view.header().stamp, now);
                (taken == Taken::Live).then_some(())
            }))
        })?;
    }
    Ok(())
}

/// Waits for a frame of now of each of the cameras `wanted`, which must have the size that is asked
/// for, if any is, on `topics`; the `remedy` for one that shows none names it NAME. Any `clock`
/// will do. `meanwhile` is done again and again.
///
/// Cameras are waited for one after the other, 10 s each.
///
/// # Errors
/// [`SessionError::RealTime`] for one that shows nothing or only frames of another time,
/// [`SessionError::BadArgument`] for one of another size.
pub(in super::super) fn cameras(
    node: &TopicNode,
    wanted: &[SizedCamera],
    clock: MonotonicClock,
    (topics, remedy): (&str, &str),
    (say, meanwhile): (PrintLine<'_>, &mut dyn FnMut() -> Result<(), SessionError>),
) -> Result<Vec<Camera>, SessionError> {
    let mut found = Vec::new();
    for (name, size) in wanted {
        let mut topic = CameraTopic::subscriber(node, name)?;
        let what = format!("a frame of camera {name} on topics {topics:?}");
        let lacking = format!(
            "camera {name} has published no frame on topics {topics:?} for {} s: {}",
            CAMERA_NS_MAX / 1_000_000_000,
            remedy.replace("NAME", name)
        );
        let mut stale = None;
        let lens = await_it(&what, &lacking, CAMERA_NS_MAX, say, || {
            meanwhile()?;
            let Some(view) = topic.newest()? else {
                return Ok(None);
            };
            let taken = Taken::at(view.header().stamp, clock.to_system(clock.now()));
            stale = (taken != Taken::Live).then_some(taken);
            Ok(stale.is_none().then_some(view.header().intrinsics))
        });
        let lens = match (lens, stale) {
            (Err(SessionError::RealTime(_)), Some(taken)) => {
                return Err(SessionError::RealTime(untimely(name, topics, taken)));
            }
            (lens, _) => lens?,
        };
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

/// Whoever interrupts a run before its drives have torque does not want them to get it.
pub(super) fn uninterrupted() -> Result<(), SessionError> {
    if rt::interrupted() {
        let what = "interrupted before the drives were enabled";
        return Err(SessionError::RealTime(what.to_owned()));
    }
    Ok(())
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
            3_000_000_000,
            &say,
            || Ok(None),
        );
        assert!(clock.now().0 >= 3_000_000_000);
        assert_eq!(error.unwrap_err().to_string(), "there is no camera");
        let said = lines.into_inner().unwrap();
        let named = "waiting for a camera, for 3 s at most; no drive has torque";
        assert_eq!(said, [named]);
    }

    #[test]
    fn a_frame_of_now_is_neither_old_nor_ahead() {
        let s = |tenths: u64| TimeNs(tenths * 100_000_000);
        let at = |stamp| Taken::at(s(stamp), s(1000));
        assert_eq!([at(1000), at(996)], [Taken::Live; 2]);
        let ahead = Taken::at(s(1000).plus_ns(AHEAD_NS_MAX), s(1000));
        assert_eq!(ahead, Taken::Live);
        assert_eq!(at(0), Taken::Ago(100.0));
        assert_eq!(at(1010), Taken::Ahead(1.0));
        let said = untimely("left", "lab", at(0));
        assert!(
            said.contains("left on topics \"lab\" are 100.0 s old"),
            "{said}"
        );
        assert!(said.contains("CLOCK_MONOTONIC"), "{said}");
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
