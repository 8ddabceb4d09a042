//! What is at a policy step, on topics: the simulated arms for a policy process, past the cameras,
//! which may be slow or not there, and where everything is for whoever draws it.

use std::thread;
use std::time::Duration;

use hal::{ArmObservation, PerArm, arm_names};
use rtrb::{Consumer, Producer, RingBuffer};
use trocar_topics::{ArmReport, ArmStateTopic, Publisher, TopicNode};

use super::scene_topics::{SceneForCameras, SceneForPages, Snapshot, show_pages};
use super::signals::{EndRunOnDrop, Signals};
use crate::mailbox::MailboxReader;
use crate::rt::MonotonicClock;
use crate::session::SessionError;

/// Steps that may wait for the thread, of which a reader finds no more anyway.
const QUEUE: usize = 16;

/// Polling period for whether the run is over, and for readers that have come since.
const IDLE: Duration = Duration::from_millis(10);

/// The arms at a policy step.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepStates {
    pub(super) step: u64,
    pub(super) arms: PerArm<ArmObservation>,
}

/// The thread before it runs. Whoever puts something into its queue or mailboxes wakes it.
pub(super) struct StatesThread {
    /// For a policy process that is shown the arms at each step, one an arm.
    topics: Vec<Publisher<ArmReport>>,
    states: Consumer<StepStates>,
    scene: Option<(SceneForCameras, MailboxReader<Snapshot>)>,
    pages: Option<SceneForPages>,
}

impl StatesThread {
    /// Shows `scene` and `pages`, and on the topics of `node` the states of `arms` arms; also gives
    /// the end of the queue for these.
    pub(super) fn open(
        arms: Option<(&TopicNode, usize)>,
        scene: Option<(SceneForCameras, MailboxReader<Snapshot>)>,
        pages: Option<SceneForPages>,
    ) -> Result<(Self, Producer<StepStates>), SessionError> {
        let (to, states) = RingBuffer::new(QUEUE);
        let topics = arms.into_iter().flat_map(|(node, arms)| {
            arm_names(arms).map(move |arm| ArmStateTopic::publisher(node, arm))
        });
        let thread = Self {
            topics: topics.collect::<Result<_, _>>()?,
            states,
            scene,
            pages,
        };
        Ok((thread, to))
    }

    /// Publishes, by the run's `clock`, until the control thread has stopped.
    pub(super) fn run(
        mut self,
        clock: MonotonicClock,
        signals: &Signals,
    ) -> Result<(), SessionError> {
        let _ends = EndRunOnDrop(signals);
        while !signals.stopped() {
            while let Ok(StepStates { step, mut arms }) = self.states.pop() {
                for (topic, arm) in self.topics.iter().zip(arms.iter_mut()) {
                    // Instants on topics are the system's, which all processes share.
                    arm.state.stamp = clock.to_system(arm.state.stamp);
                    topic.publish(&ArmReport::new(step, &arm.state, &arm.tip_in_rcm))?;
                }
            }
            if let Some((scene, snapshots)) = &mut self.scene {
                match snapshots.take() {
                    Some(snapshot) => scene.show(&snapshot, clock)?,
                    None => scene.keep_alive()?,
                }
            }
            show_pages(&mut self.pages, clock, signals);
            for topic in &self.topics {
                topic.keep_alive()?;
            }
            thread::park_timeout(IDLE);
        }
        Ok(())
    }
}
