//! What the simulated arms measure at a policy step, on topics for a policy process: past the cameras, which may be slow or not there.

use std::thread;
use std::time::Duration;

use hal::{PerArm, SeenArm};
use rtrb::{Consumer, Producer, RingBuffer};
use trocar_topics::{ArmReport, ArmStateTopic, Publisher, TopicNode};

use super::policy_process::arm_names;
use super::signals::{EndsRun, Signals};
use crate::session::SessionError;

/// Steps that may wait for the thread, of which a reader finds no more anyway.
const QUEUE: usize = 16;

/// Time between two looks at whether the run is over, and for readers that have come since.
pub(super) const IDLE: Duration = Duration::from_millis(10);

/// The arms at a policy step.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepStates {
    pub(super) step: u64,
    pub(super) arms: PerArm<SeenArm>,
}

/// The thread before it runs. Whoever puts states into its queue wakes it.
pub(super) struct StatesThread {
    /// One an arm.
    topics: Vec<Publisher<ArmReport>>,
    states: Consumer<StepStates>,
}

impl StatesThread {
    /// Opens the topics of `arms` arms; also gives the end of the queue for their states.
    pub(super) fn open(
        node: &TopicNode,
        arms: usize,
    ) -> Result<(Self, Producer<StepStates>), SessionError> {
        let topics = arm_names(arms).map(|arm| ArmStateTopic::publisher(node, arm));
        let (to, states) = RingBuffer::new(QUEUE);
        let topics = topics.collect::<Result<_, _>>()?;
        Ok((Self { topics, states }, to))
    }

    /// Publishes states until the control thread has stopped.
    pub(super) fn run(mut self, signals: &Signals) -> Result<(), SessionError> {
        let _ends = EndsRun(signals);
        while !signals.stopped() {
            while let Ok(StepStates { step, arms }) = self.states.pop() {
                for (topic, arm) in self.topics.iter().zip(arms.iter()) {
                    topic.publish(&ArmReport::new(step, &arm.state, &arm.tip_in_rcm))?;
                }
            }
            for topic in &self.topics {
                topic.keep_alive()?;
            }
            thread::park_timeout(IDLE);
        }
        Ok(())
    }
}
