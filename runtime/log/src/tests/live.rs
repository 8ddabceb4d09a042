//! What whoever looks on is told.

use hal::{ArmState, JointVector, Pose, TimeNs};
use prost::Message as _;

use super::samples;
use crate::frames::of_arms;
use crate::json::TimingMessage;
use crate::live::{BentShape, SCENE, bent, of_run, tick, transforms};
use crate::messages::{FrameTransforms, SceneUpdate};
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

/// A shape that bends is triangles in its frame, and takes the place of itself.
#[test]
fn a_bent_shape_is_triangles() {
    let shape = |height| BentShape {
        frame: "3 flap",
        positions: vec![[0.0, 0.5, height], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        indices: &[0, 1, 2, 2, 1, 0],
        colour: [1.0, 0.5, 0.25],
    };
    let read = |height| {
        let bytes = bent(TimeNs(5), [shape(height)].into_iter());
        let mut update = SceneUpdate::decode(&bytes[..]).unwrap();
        assert_eq!(update.entities.len(), 1);
        update.entities.remove(0)
    };
    let (first, then) = (read(0.25), read(0.75));
    assert_eq!((&*first.id, &first.id), (&*first.frame_id, &then.id));
    assert_eq!(&*first.frame_id, "3 flap");
    assert!(first.frame_locked && first.models.is_empty());
    let heights = [&first, &then].map(|entity| entity.triangles[0].points[0].z);
    assert!(heights[0] < heights[1], "{heights:?}");
    let triangles = &then.triangles[0];
    assert_eq!(triangles.points.len(), 3);
    assert_eq!(triangles.indices, [0, 1, 2, 2, 1, 0]);
    let colour = triangles.color.unwrap();
    assert!(colour.r > colour.g && colour.g > colour.b && colour.a > 0.99);
}
