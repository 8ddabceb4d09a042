//! The answers of a policy process, put together again from the topics of the arms.

use hal::{Chunk, PerArm, arm_names};
use trocar_topics::{ChunkTopic, Subscriber, TopicNode};

use crate::session::SessionError;

/// The chunk topics of all arms. Each is read for itself, so one may be a step behind another.
pub(super) struct ArmChunks {
    /// In arm order.
    topics: Vec<Subscriber<Chunk>>,
    /// The newest chunk of each arm that has not been handed on.
    waiting: Vec<Option<Chunk>>,
}

impl ArmChunks {
    /// Reads the topics of `count` arms.
    pub(super) fn open(node: &TopicNode, count: usize) -> Result<Self, SessionError> {
        let topics = arm_names(count).map(|arm| ChunkTopic::subscriber(node, arm));
        Ok(Self {
            topics: topics.collect::<Result<_, _>>()?,
            waiting: vec![None; count],
        })
    }

    /// The newest answer, once the chunks of all arms are there; none twice.
    ///
    /// A chunk whose partner is replaced before it was read is dropped with it: only the newest
    /// whole answer counts.
    pub(super) fn newest(&mut self) -> Result<Option<PerArm<Chunk>>, SessionError> {
        for (topic, waiting) in self.topics.iter().zip(&mut self.waiting) {
            if let Some(newest) = topic.newest()? {
                *waiting = Some(newest);
            }
        }
        Ok(take_answer(&mut self.waiting))
    }
}

/// Takes the chunks of one answer, if all are there.
///
/// Chunks belong together by time of observation and sequence number. Incomplete ones stay and
/// wait.
fn take_answer(waiting: &mut [Option<Chunk>]) -> Option<PerArm<Chunk>> {
    let of = |chunk: &Option<Chunk>| chunk.map(|chunk| (chunk.observed_at, chunk.sequence));
    let answer = of(waiting.first()?)?;
    if !waiting.iter().all(|chunk| of(chunk) == Some(answer)) {
        return None;
    }
    PerArm::collect(waiting.iter_mut().filter_map(Option::take))
}

#[cfg(test)]
mod tests {
    use hal::TimeNs;

    use super::*;

    fn chunk(sequence: u64, step_ns: u64) -> Option<Chunk> {
        Some(Chunk::new(TimeNs(40 * sequence), sequence, step_ns, &[]))
    }

    #[test]
    fn chunks_of_different_answers_wait_for_each_other() {
        let mut waiting = vec![chunk(1, 10), None];
        assert!(take_answer(&mut waiting).is_none());
        // The first arm's next chunk takes the place of the one that was never complete.
        waiting = vec![chunk(2, 10), chunk(1, 20)];
        assert!(take_answer(&mut waiting).is_none());
        waiting[1] = chunk(2, 20);
        let answer = take_answer(&mut waiting).unwrap();
        assert_eq!(answer.map(|chunk| chunk.step_ns), PerArm::two(10, 20));
        assert_eq!(answer.map(|chunk| chunk.sequence), PerArm::two(2, 2));
        assert!(take_answer(&mut waiting).is_none(), "none twice");
        let mut alone = [chunk(1, 10)];
        assert_eq!(
            take_answer(&mut alone).map(|answer| answer.count()),
            Some(1)
        );
        assert!(take_answer(&mut []).is_none());
    }
}
