//! Frames of the log: the scene, remote centres in it, tips and cameras; and the messages that
//! place them in each other.

use hal::{ARMS_MAX, ArmState, Pose, TimeNs};

use super::messages::{self, FrameTransform, FrameTransforms, PoseInFrame, Timestamp};
use super::record::TickRecord;
use crate::verify::tip_in_rcm;

/// The frame that everything else is in.
pub const SCENE: &str = "scene";

/// Frame of each arm's measured tip pose.
pub(super) const RCM_FRAMES: [&str; ARMS_MAX] = ["psm1_rcm", "psm2_rcm"];

/// Frames of the tips.
const TIP_FRAMES: [&str; ARMS_MAX] = ["psm1_tip", "psm2_tip"];

/// Where the remote centres are in the scene, as far as that is known, and the measured tips from
/// there.
pub(super) fn of_arms(tick: &TickRecord, rcms_in_scene: &[Pose]) -> FrameTransforms {
    let mut transforms = Vec::new();
    for (index, arm) in tick.arms.iter().enumerate() {
        let (Some(rcm), Some(tip)) = (RCM_FRAMES.get(index), TIP_FRAMES.get(index)) else {
            continue;
        };
        if let Some(pose) = rcms_in_scene.get(index) {
            transforms.push(transform(tick.now, (SCENE, rcm), pose));
        }
        if let Some(state) = arm.measured.ok().filter(ArmState::is_finite) {
            let pose = tip_in_rcm(&state.position);
            transforms.push(transform(tick.now, (rcm, tip), &pose));
        }
    }
    FrameTransforms { transforms }
}

/// The message that places the frame `child` at `pose` (m) in `parent`.
pub(super) fn transform(at: TimeNs, (parent, child): (&str, &str), pose: &Pose) -> FrameTransform {
    let pose = messages::Pose::from(pose);
    FrameTransform {
        timestamp: Some(Timestamp::new(at)),
        parent_frame_id: parent.to_owned(),
        child_frame_id: child.to_owned(),
        translation: pose.position,
        rotation: pose.orientation,
    }
}

/// The pose of the measured tip in its remote-centre frame `frame`.
pub(super) fn measured_tip(frame: &str, state: &ArmState) -> PoseInFrame {
    let tip = tip_in_rcm(&state.position);
    PoseInFrame {
        timestamp: Some(Timestamp::new(state.stamp)),
        frame_id: frame.to_owned(),
        pose: Some((&tip).into()),
    }
}
