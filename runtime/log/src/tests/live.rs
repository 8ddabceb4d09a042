//! What whoever looks on is told.

use hal::{ArmState, JointVector, Pose, TimeNs};
use prost::Message as _;

use super::samples;
use crate::frames::of_arms;
use crate::json::TimingMessage;
use crate::live::{SCENE, of_run, tick, transforms};
use crate::messages::FrameTransforms;
use crate::record::TickRecord;

/// A tick in which the arm is measured.
fn measured() -> TickRecord {
    let mut record = samples::record(1);
    let joints = JointVector::new(0.1, 0.0, 0.12, 0.0, 0.0, 0.0);
    record.arms.first.measured = Ok(ArmState::at_rest(TimeNs(0), joints, 0.2));
    record
}

/// Each channel says what its messages are, and each message of a tick has a channel.
#[test]
fn every_message_has_a_channel() {
    let channels = of_run(1, &["endoscope".to_owned()]);
    assert!(channels.iter().all(|channel| !channel.schema.is_empty()));
    let record = measured();
    let messages = tick(&record, TimeNs(record.now.0 - 7), &[Pose::identity()]);
    assert_eq!(messages.len(), 7);
    let timing = messages
        .iter()
        .find(|(topic, _)| *topic == "/timing")
        .unwrap();
    let timing: TimingMessage = serde_json::from_slice(&timing.1).unwrap();
    assert_eq!(timing.period_ns, 7);
    for (topic, bytes) in messages {
        let known = channels.iter().find(|channel| channel.topic == topic);
        assert!(known.is_some() && !bytes.is_empty(), "{topic}");
    }
}

#[test]
fn frames_form_one_tree() {
    let arms = of_arms(&measured(), &[Pose::identity(), Pose::identity()]);
    let frames = [
        ("endoscope", Pose::identity()),
        ("needle", Pose::identity()),
    ];
    let more = transforms(TimeNs(5), frames.into_iter());
    let more = FrameTransforms::decode(&more[..]).unwrap();
    let all: Vec<_> = arms.transforms.iter().chain(&more.transforms).collect();
    assert_eq!(all.len(), 4);
    for frame in &all {
        let child = &frame.child_frame_id;
        let parents = all.iter().filter(|other| other.child_frame_id == *child);
        assert_eq!(parents.count(), 1, "{child}");
        let parent = &frame.parent_frame_id;
        let known = all.iter().any(|other| other.child_frame_id == *parent);
        assert!(parent == SCENE || known, "{parent}");
    }
}
