//! What a world in another process shows besides frames: the true state of its scene, and how the
//! episode stands.
//!
//! Drives on a bus stand for an arm, and their process for the world around it. A scripted expert
//! looks at that world, and a run has to know how the task went.

use iceoryx2::prelude::ZeroCopySend;

use super::Message;
use super::message::{pose, xyzw};
use hal::{ARMS_MAX, Pose, TimeNs};

/// A pose in some frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/place/1")]
pub struct PoseMessage {
    /// Metres.
    pub position_m: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub rotation_xyzw: [f64; 4],
}

impl PoseMessage {
    /// The message of `pose`.
    #[must_use]
    pub fn new(pose: &Pose) -> Self {
        Self {
            position_m: pose.translation.vector.into(),
            rotation_xyzw: xyzw(pose),
        }
    }

    /// The pose, bit for bit.
    #[must_use]
    pub fn pose(&self) -> Pose {
        pose(self.position_m, self.rotation_xyzw)
    }
}

/// Room in a line of text, bytes of UTF-8.
pub const LINE_BYTES_MAX: usize = 248;

/// A line of text.
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/line/1")]
pub struct Line {
    length: u64,
    bytes: [u8; LINE_BYTES_MAX],
}

impl Default for Line {
    fn default() -> Self {
        Self {
            length: 0,
            bytes: [0; LINE_BYTES_MAX],
        }
    }
}

impl Line {
    /// As much of `text` as there is room for.
    #[must_use]
    pub fn new(text: &str) -> Self {
        let mut line = Self::default();
        let mut length = text.len().min(line.bytes.len());
        while !text.is_char_boundary(length) {
            length -= 1;
        }
        line.bytes[..length].copy_from_slice(&text.as_bytes()[..length]);
        line.length = length as u64;
        line
    }

    /// The text; what is no text is marked.
    #[must_use]
    pub fn text(&self) -> String {
        let length = usize::try_from(self.length).unwrap_or(usize::MAX);
        let bytes = &self.bytes[..length.min(self.bytes.len())];
        String::from_utf8_lossy(bytes).into_owned()
    }
}

/// The scene as one arm's base sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/scene_arm/1")]
pub struct SceneArm {
    /// Tip in the RCM frame.
    pub tip_in_rcm: PoseMessage,
    /// What the task is about, in the RCM frame.
    pub thing_in_rcm: PoseMessage,
    /// Angle between the jaw fingers, rad.
    pub jaw: f64,
    /// Sum of normal forces on the left and on the right finger, N.
    pub finger_force_n: [f64; 2],
    /// Deepest overlap of a finger and the thing, m.
    pub penetration_m: f64,
    /// 1 if both fingers hold the thing.
    pub held: u64,
}

/// What a soft tissue has gone through: the largest values so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/scene_tissue/1")]
pub struct SceneTissue {
    /// Force between an instrument as a whole and the tissue, N.
    pub force_n: f64,
    /// Normal force of one finger on it, N.
    pub squeeze_n: f64,
    /// Stretch; 0.1 is a tenth longer than at rest.
    pub stretch: f64,
    /// How far the mark rose, m.
    pub mark_rise_m: f64,
}

/// How an episode stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The arms' drives are not operational: the episode has not begun.
    Waiting,
    /// Their drives are operational, in the sense of NMT, and not all enabled: the episode begins
    /// when they are.
    Operational,
    /// Not decided yet.
    Running,
    /// The task is done.
    Success,
    /// The episode is lost; the report's reason says why.
    Failure,
    /// The simulation was at fault: the episode says nothing.
    Invalid,
}

/// The true state of a scene at a policy step.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/scene_report/2")]
pub struct SceneReport {
    /// When it was so, on the system's monotonic clock.
    pub stamp: TimeNs,
    /// Counts the policy steps of the world; frames of the same instant have the same number and
    /// the same stamp.
    pub sequence: u64,
    /// The task.
    pub task: Line,
    /// The beginning of a hash of its scene's configuration: with another one it is another world.
    pub scene_hash: u64,
    /// The seed of the episode.
    pub seed: u64,
    /// How many of `arms` there are.
    pub arm_count: u64,
    /// The arms.
    pub arms: [SceneArm; ARMS_MAX],
    /// Whether there is a goal.
    pub has_goal: u64,
    /// Where something is to be brought, scene frame.
    pub goal_in_scene: PoseMessage,
    /// Whether there is a soft tissue.
    pub has_tissue: u64,
    /// What it has gone through.
    pub tissue: SceneTissue,
    /// How the episode stands, as a number; see [`Self::verdict`].
    pub code: u64,
    /// Why it was lost.
    pub reason: Line,
}

impl Message for SceneReport {
    const TOPIC: &'static str = "scene";
}

impl SceneReport {
    /// The number that says `verdict`.
    #[must_use]
    pub const fn code_of(verdict: Verdict) -> u64 {
        match verdict {
            Verdict::Waiting => 0,
            Verdict::Running => 1,
            Verdict::Success => 2,
            Verdict::Failure => 3,
            Verdict::Invalid => 4,
            Verdict::Operational => 5,
        }
    }

    /// How the episode stands; nonsense counts as lost.
    #[must_use]
    pub const fn verdict(&self) -> Verdict {
        match self.code {
            0 => Verdict::Waiting,
            1 => Verdict::Running,
            2 => Verdict::Success,
            4 => Verdict::Invalid,
            5 => Verdict::Operational,
            _ => Verdict::Failure,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_keeps_what_fits_and_survives_nonsense() {
        assert_eq!(Line::new("needle lift").text(), "needle lift");
        let long = Line::new(&"ä".repeat(200)).text();
        assert_eq!(long.chars().count(), 124);
        let wild = Line {
            length: u64::MAX,
            bytes: [0xFF; 248],
        };
        assert_eq!(wild.text().chars().count(), 248);
    }

    #[test]
    fn verdicts_come_back_and_nonsense_is_no_success() {
        for verdict in [
            Verdict::Waiting,
            Verdict::Operational,
            Verdict::Running,
            Verdict::Success,
            Verdict::Failure,
            Verdict::Invalid,
        ] {
            let report = SceneReport {
                code: SceneReport::code_of(verdict),
                ..SceneReport::default()
            };
            assert_eq!(report.verdict(), verdict);
        }
        let wild = SceneReport {
            code: 77,
            ..SceneReport::default()
        };
        assert_eq!(wild.verdict(), Verdict::Failure);
    }
}
