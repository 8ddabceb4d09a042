//! Arms that another process leads, over topics: a simulator's, or a robot's that no drive on CAN
//! turns. The control thread touches no topic: one thread beside it takes feedback, and one sends
//! set-points.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use hal::{
    ARM_NAMES, ArmCommand, ArmState, JointVector, Measured, PerArm, Period, Rig, SafeTail,
    Setpoint, TICK_NS, TimeNs, arm_names,
};
use rtrb::Consumer;
use trocar_log::pre_faulted_queue;
use trocar_topics::{
    ArmFeedback, ArmFeedbackTopic, ArmSetpoint, ArmSetpointTopic, Events, Publisher, Subscriber,
    TopicError, TopicNode, arms_of,
};

use super::super::signals::Signals;
use super::ArmLink;
use super::awaited::{PrintLine, await_it};
use crate::mailbox::{MailboxReader, MailboxWriter, mailbox};
use crate::rig::can::Noticed;
use crate::rig::topics::{ToSender, TopicsRig};
use crate::rt::{self, MonotonicClock, Periodic, RtOptions, configure_thread};
use crate::session::{Robot, SessionError};

/// An arm may be switched on after the run was started, ns.
const ARM_NS_MAX: u64 = 10_000_000_000;

/// How far from now a measurement may bear its time, ns.
const STAMP_NS_MAX: u64 = 500_000_000;

/// Set-points that may wait to be sent.
const SETPOINTS: usize = 64;

/// The longest time between two looks of either thread, ns.
const LOOK_NS: u64 = 10_000_000;

/// How long the last set-points, which leave the arms without torque, stay readable, ns: they lie
/// in this process's memory.
const LINGER_NS: u64 = 200_000_000;

/// What the threads beside the control thread ask of the system: they come before all that is not
/// real time, and after it, on any core.
const BESIDE: RtOptions = RtOptions {
    priority: Some(70),
    cpu: None,
    lock_stack: false,
    strict: false,
};

/// Where the arms are: whoever is on these topics.
#[derive(Clone, Debug)]
pub struct TopicArms {
    /// The name of the topics of the world, or of the cameras; those of the arms are on [`arms_of`]
    /// it.
    pub topics: String,
}

/// The ports of each arm.
pub(in super::super) struct Ports {
    /// Keeps the topics open; other processes see it as this run.
    node: TopicNode,
    /// One an arm, in arm order; of several messages only the newest is read.
    feedback: Vec<Subscriber<ArmFeedback>>,
    /// One an arm, the same sequence number for all of one period.
    setpoints: Vec<Publisher<ArmSetpoint>>,
}

impl ArmLink for TopicArms {
    type Opened = Ports;
    type Ready = Linked;
    type Rig = LinkedRig;

    fn topics(&self) -> &str {
        &self.topics
    }

    fn host(&self) -> &'static str {
        "trocar simulator"
    }

    /// Topics on which another process publishes set-points already are an error.
    fn open(&self, robot: &Robot, _clock: MonotonicClock) -> Result<Ports, SessionError> {
        let node = TopicNode::join(&arms_of(&self.topics))?;
        let (mut feedback, mut setpoints) = (Vec::new(), Vec::new());
        for name in arm_names(robot.arms()) {
            feedback.push(ArmFeedbackTopic::subscriber(&node, name)?);
            setpoints.push(ArmSetpointTopic::publisher(&node, name)?);
        }
        Ok(Ports {
            node,
            feedback,
            setpoints,
        })
    }

    /// Hears each arm once: it must measure now, and be well.
    fn bring_up(
        &self,
        ports: Ports,
        clock: MonotonicClock,
        say: PrintLine<'_>,
    ) -> Result<Linked, SessionError> {
        let mut heard_first = Vec::new();
        for (topic, name) in ports.feedback.iter().zip(ARM_NAMES) {
            let heard = format!("feedback of {name} on topics {:?}", self.topics);
            let lacking = format!(
                "no {heard} for {} s: start whoever leads that arm (`trocar simulator` for a simulated one), or name its topics with --topics",
                ARM_NS_MAX / 1_000_000_000
            );
            let message = await_it(&heard, &lacking, ARM_NS_MAX, say, || Ok(topic.newest()?))?;
            check(&heard, &message, clock.to_system(clock.now()))?;
            heard_first.push(message);
        }
        Linked::start(ports, &heard_first, clock)
    }

    /// The arms get torque with the first enabled set-point.
    ///
    /// Polls for the permission once a period.
    fn enable(
        &self,
        linked: Linked,
        _noticed: MailboxWriter<Noticed>,
        signals: &Signals,
        clock: MonotonicClock,
    ) -> Result<LinkedRig, SessionError> {
        while !signals.torque_allowed() {
            if signals.done() || rt::interrupted() {
                return Err(SessionError::Interrupted);
            }
            rt::sleep_ns(TICK_NS);
        }
        let periodic = Periodic::new(clock, clock.now().plus_ns(TICK_NS), TICK_NS);
        Ok(LinkedRig {
            rig: TopicsRig::new(linked.measured, linked.commands, periodic),
            links: linked.links,
            failure: None,
        })
    }

    fn take_down(rig: &mut LinkedRig, _clock: MonotonicClock) {
        rig.close();
    }

    fn fault(rig: &LinkedRig) -> Option<String> {
        rig.failure.clone()
    }
}

/// What `heard` says at `now`, by the system's clock, must be of now and without a fault.
///
/// 500 ms either way: far more than clocks of one machine differ, far less than a recording is old.
fn check(heard: &str, message: &ArmFeedback, now: TimeNs) -> Result<(), SessionError> {
    if now.0.abs_diff(message.stamp.0) > STAMP_NS_MAX {
        let wrong = if message.stamp.0 > now.0 {
            "ahead"
        } else {
            "old"
        };
        let seconds = TimeNs(now.0.abs_diff(message.stamp.0)).seconds();
        return Err(SessionError::RealTime(format!(
            "{heard} is {seconds:.1} s {wrong}: it has to bear the time of its measurement on CLOCK_MONOTONIC, in ns"
        )));
    }
    match message.measured() {
        Ok(_) => Ok(()),
        Err(error) => Err(SessionError::RealTime(format!("{heard}: {error}"))),
    }
}

/// A thread's end: an error of a topic before its time.
type Ended = Result<(), TopicError>;

/// The threads beside the control thread. Dropping this ends them.
struct Links {
    stop: Arc<AtomicBool>,
    /// The one that sends set-points, and the one that takes feedback.
    threads: Option<[JoinHandle<Ended>; 2]>,
    /// The arms' place among the topics, which ends after the threads.
    _node: TopicNode,
}

impl Links {
    /// Sends what is left to be sent, and ends both threads; what had ended one before its time.
    ///
    /// Blocks until both threads are joined: the sender lingers 200 ms.
    fn close(&mut self) -> Option<String> {
        self.stop.store(true, Ordering::Release);
        let threads = self.threads.take()?;
        let ends = threads.map(|thread| {
            thread.thread().unpark();
            match thread.join() {
                Ok(ended) => ended.err().map(|error| error.to_string()),
                Err(_) => Some("a thread to the arms has panicked".to_owned()),
            }
        });
        ends.into_iter().flatten().next()
    }
}

impl Drop for Links {
    fn drop(&mut self) {
        self.close();
    }
}

/// Arms that were heard, and are without torque.
pub(in super::super) struct Linked {
    measured: MailboxReader<PerArm<Measured>>,
    /// The control thread's way to the sending thread.
    commands: ToSender,
    links: Links,
}

impl Linked {
    /// Starts both threads, which inherit nothing of a control thread. What was `heard` of each arm
    /// is its first measurement, and ages as any.
    fn start(
        ports: Ports,
        heard: &[ArmFeedback],
        clock: MonotonicClock,
    ) -> Result<Self, SessionError> {
        let Ports {
            node,
            feedback,
            setpoints,
        } = ports;
        let (stop, broken) = (
            Arc::new(AtomicBool::new(false)),
            Arc::new(AtomicBool::new(false)),
        );
        let (measured_in, measured) = mailbox();
        let (queue, commands_out) = pre_faulted_queue(SETPOINTS);
        let events = node.events()?;
        let first: Vec<Measured> = heard.iter().map(|it| measured_at(it, clock)).collect();
        let (stopped, breaks) = (Arc::clone(&stop), Breaks(Arc::clone(&broken)));
        let taking = thread::spawn(move || {
            let _breaks = breaks;
            let _granted = configure_thread(&BESIDE);
            take_feedback(&feedback, first, measured_in, (&events, clock), &stopped)
        });
        let (stopped, breaks) = (Arc::clone(&stop), Breaks(Arc::clone(&broken)));
        let sending = thread::spawn(move || {
            let _breaks = breaks;
            let _granted = configure_thread(&BESIDE);
            send_setpoints(&setpoints, commands_out, clock, &stopped)
        });
        Ok(Self {
            measured,
            commands: ToSender {
                queue,
                thread: sending.thread().clone(),
                broken,
            },
            links: Links {
                stop,
                threads: Some([sending, taking]),
                _node: node,
            },
        })
    }
}

/// Held by either thread: an end of it before its time is a lost measurement for the control
/// thread.
struct Breaks(Arc<AtomicBool>);

impl Drop for Breaks {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

/// The arms with the threads to them.
pub(in super::super) struct LinkedRig {
    rig: TopicsRig,
    links: Links,
    /// What ended a thread before its time.
    failure: Option<String>,
}

impl LinkedRig {
    fn close(&mut self) {
        self.failure = self.links.close();
    }
}

impl Rig for LinkedRig {
    fn exchange(&mut self, setpoints: Option<&PerArm<Setpoint>>) -> Period {
        self.rig.exchange(setpoints)
    }
}

/// What an arm measured, by the run's clock.
///
/// The arm's own error passes as it is.
fn measured_at(message: &ArmFeedback, clock: MonotonicClock) -> Measured {
    message.measured().map(|state| ArmState {
        stamp: clock.from_system(state.stamp),
        ..state
    })
}

/// Hands on what all arms measured last, whenever one has measured again.
///
/// Woken by whatever is published on the node, or after 10 ms. All arms are handed on at once, so
/// one that has stopped ages beside another that has not.
fn take_feedback(
    topics: &[Subscriber<ArmFeedback>],
    mut newest: Vec<Measured>,
    mut to: MailboxWriter<PerArm<Measured>>,
    (events, clock): (&Events, MonotonicClock),
    stop: &AtomicBool,
) -> Ended {
    let mut heard = true;
    while !stop.load(Ordering::Acquire) {
        for (topic, newest) in topics.iter().zip(&mut newest) {
            if let Some(message) = topic.newest()? {
                heard = true;
                *newest = measured_at(&message, clock);
            }
        }
        if let Some(all) = PerArm::collect(newest.iter().copied()).filter(|_| heard) {
            to.put(all);
        }
        heard = false;
        rt::wait(events, LOOK_NS);
    }
    Ok(())
}

/// Sends set-points as they come. In the end the arms, which rest, lose torque, also after a fault,
/// with which they would hold.
///
/// In order and none left out, each with the system's stamp of its period. `stop` ends it after the
/// queue is empty.
fn send_setpoints(
    topics: &[Publisher<ArmSetpoint>],
    mut from: Consumer<PerArm<Setpoint>>,
    clock: MonotonicClock,
    stop: &AtomicBool,
) -> Ended {
    let (mut sequence, mut last) = (0, None);
    let mut send = |setpoints: &PerArm<Setpoint>| {
        sequence += 1;
        for (topic, (command, tail)) in topics.iter().zip(setpoints.iter()) {
            let mut message = ArmSetpoint::new(sequence, command, tail);
            message.stamp = clock.to_system(command.stamp);
            message.stop_stamp = clock.to_system(tail.stamp);
            topic.publish(&message)?;
        }
        Ok::<(), TopicError>(())
    };
    loop {
        let stopped = stop.load(Ordering::Acquire);
        let mut idle = true;
        while let Ok(setpoints) = from.pop() {
            send(&setpoints)?;
            last = Some(setpoints);
            idle = false;
        }
        if stopped {
            if let Some(last) = last {
                send(&last.map(|(command, _)| without_torque(&command, clock.now())))?;
            }
            rt::sleep_ns(LINGER_NS);
            return Ok(());
        }
        if idle {
            topics.iter().try_for_each(Publisher::keep_alive)?;
        }
        thread::park_timeout(Duration::from_nanos(LOOK_NS));
    }
}

/// The set-point of an arm at `now` that rests where `command` puts it, and lets go.
///
/// Its tail holds the same position, for a reader that hears nothing more.
fn without_torque(command: &ArmCommand, now: TimeNs) -> Setpoint {
    let command = ArmCommand {
        stamp: now,
        velocity: JointVector::zeros(),
        acceleration: JointVector::zeros(),
        jaw_velocity: 0.0,
        enabled: false,
        ..*command
    };
    (command, SafeTail::hold(&command))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn feedback_of_another_clock_and_of_a_failed_drive_is_refused() {
        let now = TimeNs(100_000_000_000);
        let at = |stamp: u64| ArmFeedback {
            stamp: TimeNs(stamp),
            ..ArmFeedback::default()
        };
        let refused = |message: &ArmFeedback| {
            let checked = check("feedback of psm1", message, now);
            checked.map_err(|error| error.to_string())
        };
        assert_eq!(refused(&at(now.0)), Ok(()));
        assert_eq!(refused(&at(now.0 - STAMP_NS_MAX)), Ok(()));
        let old = refused(&at(0)).unwrap_err();
        assert!(
            old.contains("100.0 s old") && old.contains("CLOCK_MONOTONIC"),
            "{old}"
        );
        let ahead = refused(&at(now.0 + 2_000_000_000)).unwrap_err();
        assert!(ahead.contains("2.0 s ahead"), "{ahead}");
        let failed = ArmFeedback {
            fault: 3,
            fault_code: 0x7305,
            ..at(now.0)
        };
        let error = refused(&failed).unwrap_err();
        assert!(
            error.contains("drive of axis 2 reports fault 0x7305"),
            "{error}"
        );
    }
}
