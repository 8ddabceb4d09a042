//! A robot behind anyone's rig, in real time: limits, a policy of this process and a log; no bus,
//! no task and no verdict.

use std::sync::Arc;

use hal::Rig;
use trocar_topics::TopicNode;

use super::super::by_hand::ByHand;
use super::super::channels::ThreadChannels;
use super::super::control_thread::ControlThread;
use super::super::ended::closed;
use super::super::remote_arms::{Camera, PrintLine, cameras};
use super::super::shown::show_rig;
use super::super::signals::Moving;
use super::super::threads;
use super::{RobotOptions, RobotThread, check_faults, robot_ended};
use crate::rig::ObservedRig;
use crate::rt::{self, MonotonicClock};
use crate::session::run::RunResult;
use crate::session::source::ChunkSource;
use crate::session::{Plan, Robot, SessionError};

/// The cameras of a robot behind a rig of one's own: their topics, on which each has shown a frame.
/// None by default.
#[derive(Debug, Default)]
pub struct RigCameras {
    node: Option<TopicNode>,
    cameras: Vec<Camera>,
}

impl RigCameras {
    /// Waits on the topics of this name for a frame of each camera that `source` looks through, and
    /// of the others of `asked`. Whoever publishes them
    /// ([`CameraTopic::publisher`](trocar_topics::CameraTopic::publisher)) may be in this process
    /// or another; `say` tells what is waited for.
    ///
    /// # Errors
    /// [`SessionError::RealTime`] with the name of a camera that shows no frame of now within 10 s,
    /// [`SessionError::BadArgument`] with that of one whose frames have another size than the
    /// policy was trained with; those of the topics.
    pub fn wait(
        topics: &str,
        source: &ChunkSource,
        asked: &RobotOptions,
        say: PrintLine<'_>,
    ) -> Result<Self, SessionError> {
        let node = TopicNode::join(topics)?;
        let mut wanted = source.sized_cameras().to_vec();
        for name in &asked.cameras {
            if wanted.iter().all(|(known, _)| known != name) {
                wanted.push((name.clone(), None));
            }
        }
        let remedy =
            "start whoever publishes it (`CameraTopic::publisher` for NAME), or wait on its topics";
        let clock = MonotonicClock::new();
        let at = (topics, remedy);
        let cameras = cameras(&node, &wanted, clock, at, (say, &mut || Ok(())))?;
        Ok(Self {
            node: Some(node),
            cameras,
        })
    }
}

/// Runs a robot behind `rig`, whose periods are 1 ms each on `clock`, with the policy `source`,
/// which that of `plan` only names, until the time of `asked` is up, a signal comes, or a fault.
/// The policy runs in a thread of its own, which also looks at the time, and sees the arms and no
/// camera. It has to return: while it does not, its last chunk ends and the arms rest, but the run
/// does not end by time.
///
/// SIGINT, SIGTERM and SIGHUP bring the arms to rest. As soon as they rest the rig is dropped, and
/// takes its drives down.
///
/// # Errors
/// [`SessionError::BadArgument`] for cameras, which [`run_rig_seeing`] takes, and if the rig has
/// another number of arms than `robot`; those of the policy and the log.
pub fn run_rig<R: Rig + Send>(
    plan: &Plan<Robot>,
    rig: (R, MonotonicClock),
    source: ChunkSource,
    asked: &RobotOptions,
) -> Result<RunResult, SessionError> {
    run_rig_seeing(plan, rig, source, asked, RigCameras::default())
}

/// The same with `cameras`, whose frames the log keeps. The policy may look through some of them:
/// it then sees the arms as they were when its first camera took a frame, with frames of the others
/// of within 40 ms. A camera of the policy's that shows no new frame for 2 s ends the run, or the
/// arms hold until it does (`policy.restarts` of `control.toml`). Frames that are further apart for
/// 10 s and a query's interval end it too. While the policy computes, frames are not logged.
///
/// A committed policy, or any checkpoint, is [`ChunkSource::network`] of [`Robot::network`]. It is
/// computed in this process, on cores that the control thread should not have to share.
///
/// # Errors
/// [`SessionError::BadArgument`] for a camera of the policy's or of `asked` that is not among
/// `cameras`; those of [`run_rig`].
pub fn run_rig_seeing<R: Rig + Send>(
    plan: &Plan<Robot>,
    (rig, clock): (R, MonotonicClock),
    mut source: ChunkSource,
    asked: &RobotOptions,
    cameras: RigCameras,
) -> Result<RunResult, SessionError> {
    plan.real_time.check()?;
    let robot = &plan.setup;
    check_faults(robot)?;
    let RigCameras { node, mut cameras } = cameras;
    let sees = source.cameras();
    check_cameras(&plan.policy.name(), (&sees, asked), &cameras)?;
    // Those that the policy looks through come first, in its order.
    cameras.sort_by_key(|(name, _)| sees.iter().position(|it| it == name).unwrap_or(sees.len()));
    let events = node.as_ref().map(TopicNode::events).transpose()?;
    source.reset(plan.seed);
    rt::catch_interrupts_in_motion().map_err(SessionError::signals)?;
    let mut channels = ThreadChannels::new((plan.open_log(false)?, plan.console.as_ref()), clock);
    let port = (channels.listener.as_ref(), &mut channels.control.operator);
    let names = cameras.iter().map(|(name, _)| name.clone()).collect();
    let pages = show_rig(plan, (Vec::new(), 0), (names, None), port);
    let local = Some((source, channels.chunk_in));
    let (by_hand, local, hands) = ByHand::of(plan, local);
    let control_thread = ControlThread::new(plan, channels.control, hands)?;
    let signals = Arc::clone(control_thread.signals());
    let rig = ObservedRig::new(rig, channels.measured);
    // An operator looks through all of them.
    let looked_at = if by_hand.is_some() {
        cameras.len()
    } else {
        sees.len()
    };
    let robot_thread = RobotThread::new(
        channels.seen,
        local,
        Vec::new(),
        (cameras, looked_at),
        (asked, (robot.control.supervision, plan.warn)),
    );
    let robot_thread = robot_thread.moved_by(by_hand);
    let robot_thread = robot_thread.shown_on(pages.cameras).shown_in(pages.arms);
    let robot_thread = robot_thread.marked_by(pages.marked_by.clone());
    let robot_thread = match events {
        Some(events) => robot_thread.woken_by(events),
        None => robot_thread,
    };
    let control = move || {
        // Until the drives are taken down.
        let _moving = Moving;
        Ok(control_thread.run(rig).with_rig(|rig| rig.arms))
    };
    let served = (&*signals, channels.listener.as_ref(), clock);
    let ends = threads::run(None, served, control, || robot_thread.run());
    let all = ends.control.and_then(|control| {
        let arms = control.rig;
        if arms > 0 && arms != robot.arms() {
            return Err(SessionError::BadArgument(format!(
                "the rig has {arms} arms, {} is for {}",
                robot.name,
                robot.arms()
            )));
        }
        Ok((control, ends.seen?, ends.watched?))
    });
    let (mut control, seen, watched) = match all {
        Ok(all) => all,
        Err(error) => {
            channels.log.map(|log| log.finish(None)).transpose()?;
            return Err(error);
        }
    };
    let ended = robot_ended(&seen, &watched, control.tally.faults());
    control.tally.inferences(&seen.inference);
    let log = (channels.log, pages.marked_by.as_deref());
    Ok(closed(plan, &control, &ended, log))
}

/// A run has the cameras that its policy looks through, and those whose frames its log is to keep.
fn check_cameras(
    policy: &str,
    (sees, asked): (&[String], &RobotOptions),
    cameras: &[Camera],
) -> Result<(), SessionError> {
    let lacks = |name: &&String| cameras.iter().all(|(known, _)| known != *name);
    let Some(name) = sees.iter().chain(&asked.cameras).find(lacks) else {
        return Ok(());
    };
    let who = if sees.contains(name) {
        format!("policy {policy} looks through")
    } else {
        "the log is to keep".to_owned()
    };
    let known: Vec<&str> = cameras.iter().map(|(known, _)| known.as_str()).collect();
    let known = if known.is_empty() {
        "none".to_owned()
    } else {
        known.join(", ")
    };
    Err(SessionError::BadArgument(format!(
        "{who} camera {name}, and the rig has {known}: RigCameras::wait finds it, run_rig_seeing takes it"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_that_the_rig_lacks_is_named() {
        let node = TopicNode::join(&format!("test-{}-lacks", std::process::id())).unwrap();
        let camera = |name: &str| {
            let topic = trocar_topics::CameraTopic::subscriber(&node, name).unwrap();
            (name.to_owned(), topic)
        };
        let found = |sees: &str, kept: &str, cameras: &[Camera]| {
            let asked = RobotOptions {
                seconds: None,
                cameras: vec![kept.to_owned()],
            };
            let checked = check_cameras("swings", (&[sees.to_owned()], &asked), cameras);
            checked.map_err(|error| error.to_string())
        };
        let cameras = [camera("scope"), camera("room")];
        assert_eq!(found("scope", "room", &cameras), Ok(()));
        let refused = found("scope", "room", &[]).unwrap_err();
        let named = "policy swings looks through camera scope, and the rig has none: ";
        assert!(refused.starts_with(named), "{refused}");
        let refused = found("scope", "wrist", &cameras).unwrap_err();
        let named = "the log is to keep camera wrist, and the rig has scope, room: ";
        assert!(refused.starts_with(named), "{refused}");
    }
}
